"""A simulated CUDA device for tests on machines without one.

Its tensors are kept in the memory of the CPU, and operations give the same bits as there. Like a
real device, it refuses operations on tensors of both devices, and views of its memory without a
copy.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final
from unittest import mock

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

CUDA: Final = torch.device("cuda", 0)
_CPU: Final = torch.device("cpu")
# The device that torch itself sees for these tensors: the only one that needs no memory.
_META: Final = torch.device("meta")
_COPIES: Final = (torch.ops.aten._to_copy, torch.ops.aten.to, torch.ops.aten.copy_)
# Indices may be tensors of the CPU for tensors of any device.
_INDEXING: Final = (torch.ops.aten.index, torch.ops.aten.index_put, torch.ops.aten.index_put_)


class CudaTensor(Tensor):
    """A tensor of the second device.

    Attributes:
        here: its values, a tensor of the CPU.
    """

    here: Tensor
    device = property(lambda self: CUDA)  # type: ignore[assignment]
    __torch_function__ = torch._C._disabled_torch_function_impl  # type: ignore[assignment]

    @staticmethod
    def __new__(cls, here: Tensor) -> CudaTensor:
        """Wrap a tensor of the CPU."""
        with torch.inference_mode(False):  # of which torch makes views everywhere
            made: CudaTensor = torch.Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]
                cls,
                here.size(),
                strides=here.stride(),
                storage_offset=here.storage_offset(),
                dtype=here.dtype,
                device=_META,
                requires_grad=here.requires_grad,
            )
        made.here = here
        return made

    @classmethod
    def __torch_dispatch__(
        cls,
        func: Any,
        types: Any,
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        """Compute where the arguments are; see ``Tensor``."""
        return _compute(func, args, dict(kwargs or {}))


class _DeviceDispatch(TorchDispatchMode):
    """Lets operations name the second device."""

    def __torch_dispatch__(
        self,
        func: Any,
        types: Any,
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        return _compute(func, args, dict(kwargs or {}))


class _NumberConversion(TorchFunctionMode):
    """Lets numbers of Python become tensors of the second device, which torch makes by itself."""

    def __torch_function__(
        self,
        func: Any,
        types: Any,
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        asked = dict(kwargs or {})
        if func is torch.tensor:
            device = asked.pop("device", None) or _CPU
            return torch.tensor(*args, **asked).to(device)
        if func is Tensor.new_tensor:
            like, *rest = args
            return torch.tensor(*rest, **{"dtype": like.dtype} | asked).to(like.device)
        if func is Tensor.to and len(args) > 1 and isinstance(args[1], Tensor):
            return args[0].to(dtype=args[1].dtype, device=args[1].device)
        return func(*args, **asked)


def _compute(func: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    tensors = [each for each in tree_flatten((args, kwargs))[0] if isinstance(each, Tensor)]
    there = any(isinstance(each, CudaTensor) for each in tensors)
    packet = func.overloadpacket
    both = there and any(not isinstance(each, CudaTensor) and each.ndim for each in tensors)
    if packet in _INDEXING:
        both = isinstance(args[0], CudaTensor) != there
    if both and packet not in _COPIES:
        raise RuntimeError(f"{func}: tensors of cpu and cuda")
    for asked in tree_flatten((args, kwargs))[0]:
        if isinstance(asked, torch.device):
            there = asked != _CPU
    if packet is torch.ops.aten.copy_:
        there = isinstance(args[0], CudaTensor)
    made = func(*tree_map(_here, args), **tree_map(_here, kwargs))
    if func._schema.is_mutable:
        return kwargs.get("out", args[0])
    return tree_map(
        lambda each: (
            CudaTensor(each.resolve_conj()) if there and isinstance(each, Tensor) else each
        ),
        made,
    )


def _here(value: Any) -> Any:
    if isinstance(value, torch.device):
        return _CPU
    return value.here if isinstance(value, CudaTensor) else value


@contextmanager
def second_device() -> Iterator[torch.device]:
    """Let torch find one CUDA device, as long as the context lasts."""
    found = {"is_available": True, "device_count": 1, "_lazy_init": None}
    changed = {name: mock.Mock(return_value=value) for name, value in found.items()}
    with mock.patch.multiple(torch.cuda, **changed), _DeviceDispatch(), _NumberConversion():
        yield CUDA
