"""Memory that was freed goes back to the system where the process holds too much."""

from __future__ import annotations

import sys

import pytest

from tests.programs import printed

FREED = """
import ctypes
from scene.runtime.memory import resident_bytes, return_freed_above

libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.malloc.argtypes = [ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]
blocks = [libc.malloc(100_000) for _ in range(2000)]
for block in blocks:
    ctypes.memset(block, 1, 100_000)
# The last one stays, so that the heap cannot shrink by itself.
for block in blocks[:-1]:
    libc.free(block)
held = resident_bytes()
return_freed_above(held + 50_000_000)
print(held - resident_bytes())
return_freed_above(held - 50_000_000)
print(held - resident_bytes())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc keeps what is freed")
def test_freed_memory_goes_back_above_a_bound() -> None:
    below, above = map(int, printed(FREED).split())
    assert abs(below) < 20_000_000
    assert above > 150_000_000


KERNELS = """
import torch
from scene.runtime.memory import keep_few_kernels, resident_bytes, return_freed

torch.set_num_threads(1)
keep_few_kernels()
layer = torch.nn.Conv2d(16, 16, 3)
with torch.inference_mode():
    layer(torch.rand(1, 16, 64, 64))
    before = resident_bytes()
    for width in range(400):
        layer(torch.rand(1, 16, 64, 65 + width))
return_freed()
print(resident_bytes() - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc gives memory back")
def test_few_kernels_are_kept() -> None:
    few = int(printed(KERNELS))
    all_of_them = int(printed(KERNELS, ONEDNN_PRIMITIVE_CACHE_CAPACITY="1024"))
    assert few < 0.7 * all_of_them, (few, all_of_them)
