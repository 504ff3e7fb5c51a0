"""A tuned process keeps little memory and few pauses; one that is not tuned is left as it is."""

from __future__ import annotations

import os
import sys

import pytest

from objconnect.scene.runtime.tuning import ProcessTuning
from tests.programs import run_and_print

FREED = """
import ctypes
from objconnect.scene.runtime.memory import resident_bytes
from objconnect.scene.runtime.tuning import ProcessTuning, trim_heap_above

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
trim_heap_above(0)
print(held - resident_bytes())
ProcessTuning().__enter__()
held = resident_bytes()
trim_heap_above(held + 50_000_000)
print(held - resident_bytes())
trim_heap_above(held - 50_000_000)
print(held - resident_bytes())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc keeps what is freed")
def test_freed_memory_goes_back_above_a_bound() -> None:
    untuned, below, above = map(int, run_and_print(FREED).split())
    assert abs(untuned) < 20_000_000
    assert abs(below) < 20_000_000
    assert above > 150_000_000


PASSES = """
import ctypes, os, resource
from objconnect.scene.runtime.memory import resident_bytes
from objconnect.scene.runtime.tuning import ProcessTuning, retain_heap, trim_heap

libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.malloc.argtypes = [ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]
# Without huge pages, which the kernel gives or not: PR_SET_THP_DISABLE.
libc.prctl(41, 1, 0, 0, 0)

def one():
    # The maps of a picture: together more than twice the largest of them.
    blocks = [libc.malloc(16_000_000) for _ in range(4)]
    for block in blocks:
        ctypes.memset(block, 1, 16_000_000)
    for block in blocks:
        libc.free(block)

retain_heap()  # not tuned: nothing
if os.environ.get("KEEP"):
    ProcessTuning().__enter__()
    retain_heap()
for _ in range(3):
    one()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    one()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
held = resident_bytes()
trim_heap()
print(held - resident_bytes())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc gives memory back")
def test_passes_find_the_memory_of_the_one_before_and_it_can_still_go_back() -> None:
    faults, given_back = map(int, run_and_print(PASSES, KEEP="1").split())
    assert faults < 1000
    assert given_back > 50_000_000
    assert int(run_and_print(PASSES).split()[0]) > 50_000  # of 156,000 pages


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's thresholds")
def test_thresholds_of_the_environment_are_left_as_they_are() -> None:
    faults, _ = map(int, run_and_print(PASSES, KEEP="1", MALLOC_TRIM_THRESHOLD_="100000").split())
    assert faults > 50_000


KERNELS = """
import torch
from objconnect.scene.runtime.memory import resident_bytes
from objconnect.scene.runtime.tuning import ProcessTuning, trim_heap

torch.set_num_threads(1)
ProcessTuning().__enter__()
layer = torch.nn.Conv2d(16, 16, 3)
with torch.inference_mode():
    layer(torch.rand(1, 16, 64, 64))
    before = resident_bytes()
    for width in range(200):
        layer(torch.rand(1, 16, 64, 65 + width))
trim_heap()
print(resident_bytes() - before)
"""


VARIABLE = "ONEDNN_PRIMITIVE_CACHE_CAPACITY"


@pytest.mark.parametrize("theirs", [None, "1024"])
def test_few_kernels_are_asked_for(theirs: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Unless the user says how many."""
    monkeypatch.delenv(VARIABLE, raising=False)
    if theirs is not None:
        monkeypatch.setenv(VARIABLE, theirs)
    with ProcessTuning():
        assert os.environ[VARIABLE] == (theirs or "32")
    assert os.environ.get(VARIABLE) == theirs


@pytest.mark.thorough
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc gives memory back")
def test_few_kernels_are_kept() -> None:
    few = int(run_and_print(KERNELS))
    all_of_them = int(run_and_print(KERNELS, **{VARIABLE: "1024"}))
    assert few < 0.7 * all_of_them, (few, all_of_them)


CODE = """
import numpy as np
from objconnect.scene.runtime.loops import compile_loop
from objconnect.scene.runtime.tuning import ProcessTuning, release_code

ProcessTuning().__enter__()

def resident():
    found, kept = 0, False
    for line in open("/proc/self/smaps"):
        if "-" in line.split()[0]:
            kept = "llvmlite" in line and " r-xp " in line
        elif kept and line.startswith("Rss:"):
            found += int(line.split()[1])
    return found

def double(numbers):
    for k in range(len(numbers)):
        numbers[k] *= 2

import llvmlite.binding as llvm
llvm.initialize_native_target()
print(resident())
loop, numbers = compile_loop(double, "void(f8[::1])"), np.ones(3)
print(resident())
loop(numbers)
compile_loop(double, "void(f4[::1])")
print(int(numbers.sum()))
release_code("no such library")
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux tells what is resident")
def test_a_compiler_that_has_done_its_work_leaves_memory() -> None:
    before, after, doubled = map(int, run_and_print(CODE).split())
    assert before > 4 * after
    assert doubled == 6


SPARED = """
import gc
import weakref
from objconnect.scene.runtime.tuning import ProcessTuning, freeze_objects

tuning = ProcessTuning().__enter__()

class Cycle:
    def __init__(self):
        self.itself = self

held = Cycle()
seen = weakref.ref(held)
before = len(gc.get_objects())
freeze_objects()
print(before, len(gc.get_objects()))
del held
gc.collect()
print(seen() is None)
freeze_objects()
print(seen() is None)
tuning.__exit__()
print(gc.get_freeze_count())
"""


def test_the_collector_leaves_out_what_there_is_until_the_next_call() -> None:
    counts, *gone, frozen = run_and_print(SPARED).splitlines()
    before, after = map(int, counts.split())
    assert after < 0.1 * before
    assert gone == ["False", "True"] and frozen == "0"


HOST = """
import ctypes, gc, os, signal, sys, threading, warnings
from dataclasses import replace
from pathlib import Path
import cv2, numba, torch  # they change the process themselves

asked = []

class Watched(ctypes.CDLL):
    def __getattr__(self, name):
        asked.extend({name} & {"mallopt", "malloc_trim", "madvise"})
        return super().__getattr__(name)

ctypes.CDLL = Watched

def state():
    return {
        "collector": (gc.get_threshold(), gc.get_freeze_count(), list(gc.callbacks)),
        "threads": threading.enumerate(),
        "torch": (torch.get_num_threads(), torch.get_num_interop_threads()),
        "opencv": cv2.getNumThreads(),
        "variables": dict(os.environ),
        "folder": os.getcwd(),
        "signals": [signal.getsignal(number) for number in sorted(signal.valid_signals())],
    }

before = state()
import objconnect as oc

flight = Path("benchmark/gate/gate-snow")
place = oc.open_map(flight)
localizer = oc.create_localizer(os.environ["METHOD"], {})
first = dict(list(place.sparse_map.images.items())[:6])
localizer.prepare(replace(place.sparse_map, images=first), flight / "images")
name, image = next(iter(first.items()))
pixels = oc.read_rgb(flight / "images" / name)
sure = oc.Prior(image.pose.centre().numpy(), None, image.pose.rotation.numpy())
for prior in (sure, None):
    print(localizer.localize(oc.Query("a", pixels, image.camera, prior)).status)
after = state()
print(asked, [part for part in before if before[part] != after[part]])
print([each for each in warnings.filters if "PIL" in str(each[3])])
"""


@pytest.mark.parametrize("method", ["sift", pytest.param("objconnect", marks=pytest.mark.thorough)])
def test_a_host_s_process_is_left_as_it_is(method: str) -> None:
    found, again, changed, filters = run_and_print(HOST, METHOD=method).splitlines()
    assert found == again == "ok"
    assert changed == "[] []" and filters == "[]"


COMMAND = """
import benchmark.cli
from objconnect.scene.runtime.tuning import is_tuned

benchmark.cli.app = lambda: print(is_tuned())
print(is_tuned())
benchmark.cli.main()
print(is_tuned())
"""


def test_the_command_line_tunes_its_process() -> None:
    assert run_and_print(COMMAND).split() == ["False", "True", "False"]


WORKERS = """
import threading
from objconnect.scene.runtime.tuning import ProcessTuning, worker_threads

def names():
    with worker_threads() as pool:
        return {pool.submit(threading.current_thread).result().ident}

names()
print(threading.active_count())
with ProcessTuning():
    print(names() == names(), threading.active_count())
print(threading.active_count())
"""


def test_worker_threads_stay_in_a_tuned_process_alone() -> None:
    assert run_and_print(WORKERS).split() == ["1", "True", "2", "1"]
