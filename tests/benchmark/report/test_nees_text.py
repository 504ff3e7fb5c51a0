"""A NEES that is far too large is told as that, in texts and on pages."""

from __future__ import annotations

import pytest

from benchmark.report.markdown import nees_text


@pytest.mark.parametrize(
    ("value", "text"), [(6.04, "6.0"), (1000, "1000.0"), (1000.1, "> 1000"), (1e100, "> 1000")]
)
def test_large_nees_are_shown_as_a_bound(value: float, text: str) -> None:
    assert nees_text(value) == text
