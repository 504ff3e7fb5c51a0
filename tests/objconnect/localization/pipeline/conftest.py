"""Fixtures of the tests of the everyday job: those of data sets."""

from __future__ import annotations

from tests.benchmark.conftest import flight_copy, made_flight

__all__ = ["flight_copy", "made_flight"]
