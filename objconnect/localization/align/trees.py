"""Operations on all tensors of a dataclass, for batches of poses, cameras and costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any, TypeVar

import torch
from torch import Tensor

T = TypeVar("T")


def tree_map(function: Callable[..., Tensor], first: T, *others: T) -> T:
    """Apply a function to the tensors of dataclasses of one type, field by field.

    Fields that are dataclasses or tuples of dataclasses are processed in the same way. Any other
    field is copied from the first dataclass.
    """
    values: dict[str, Any] = {}
    for field in fields(first):  # type: ignore[arg-type]
        value, *rest = (getattr(each, field.name) for each in (first, *others))
        if isinstance(value, Tensor):
            value = function(value, *rest)
        elif isinstance(value, tuple):
            value = tuple(tree_map(function, *each) for each in zip(value, *rest, strict=True))
        elif hasattr(value, "__dataclass_fields__"):
            value = tree_map(function, value, *rest)
        values[field.name] = value
    return type(first)(**values)


def select(tree: T, index: Tensor) -> T:
    """Select elements of a batch by index or by a mask."""
    return tree_map(lambda t: t[index], tree)


def choose(condition: Tensor, yes: T, no: T) -> T:
    """Return elements of ``yes`` (..., any) where ``condition`` (...) is true, else of ``no``."""

    def pick(a: Tensor, b: Tensor) -> Tensor:
        return torch.where(condition[(..., *[None] * (a.ndim - condition.ndim))], a, b)

    return tree_map(pick, yes, no)
