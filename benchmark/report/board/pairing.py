"""Whether two runs may be compared query by query.

A difference between methods can only be read from runs on the same photographs with the same
version of this package. A *control* is a method that a track declares to differ from another one
in a single part; all options that both have must be equal.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any, Final

from benchmark.report.board.runs import BoardRun
from benchmark.results.results import Results

# Largest number of options that a reason names; the rest is counted.
_NAMED_OPTIONS: Final = 3


def reason_against(
    controls: Mapping[str, str] | None, first: BoardRun, second: BoardRun, datasets: Collection[str]
) -> str:
    """Return why two runs must not be compared query by query; empty if they may be.

    Args:
        controls: the method that each control is compared with, see ``Track.controls``.
        first: a run.
        second: another run with the same starting information.
        datasets: data sets whose queries are compared; those that a run lacks are ignored.
    """
    names = sorted({first.method, second.method})
    is_control = any(sorted(pair) == names for pair in (controls or {}).items())
    for dataset in datasets:
        if dataset not in first.results or dataset not in second.results:
            continue
        one, other = first.results[dataset], second.results[dataset]
        if one.dataset.sha256 != other.dataset.sha256:
            return f"they are of different renders of {dataset}"
        # Scores of another program's poses record the version that scored them.
        is_external = one.method.is_external or other.method.is_external
        versions = one.environment.objconnect, other.environment.objconnect
        if versions[0] != versions[1] and not is_external:
            return f"they are of versions {' and '.join(versions)} of objconnect"
        if is_control and (differing := sorted(_differing_options(one, other))):
            named = ", ".join(differing[:_NAMED_OPTIONS])
            more = len(differing) - _NAMED_OPTIONS
            return f"their options differ: {named}" + (f" and {more} more" if more > 0 else "")
    return ""


def _differing_options(one: Results, other: Results) -> Iterator[str]:
    """Yield the names of options that both methods have with different values."""
    values, others = (dict(_flatten(run.method.config)) for run in (one, other))
    for name, value in values.items():
        if name in others and others[name] != value:
            yield name


def _flatten(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the options of nested groups by their full names."""
    for name, value in config.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value
