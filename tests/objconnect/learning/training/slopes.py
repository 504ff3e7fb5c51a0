"""How much each part of a loss teaches: the slope of the sum by the part."""

from __future__ import annotations

from collections.abc import Iterable
from types import ModuleType
from typing import Any

import pytest
from torch import Tensor


def watch_functions(
    monkeypatch: pytest.MonkeyPatch, module: ModuleType, names: Iterable[str]
) -> dict[str, Tensor]:
    """What functions of a module return from now on, the first of it where it is several things.

    After ``backward`` their ``grad`` is the slope of the loss by each.
    """
    seen: dict[str, Tensor] = {}

    def watch(name: str) -> None:
        function = getattr(module, name)

        def call(*args: Any) -> Any:
            answer = function(*args)
            seen[name] = answer if isinstance(answer, Tensor) else answer[0]
            seen[name].retain_grad()
            return answer

        monkeypatch.setattr(module, name, call)

    for name in names:
        watch(name)
    return seen
