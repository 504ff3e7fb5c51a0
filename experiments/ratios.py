"""Write the ratios of a benchmark run to a file, and compare them with an earlier run.

``python -m experiments.ratios write RUN RATIOS`` takes the file of ``--benchmark-json``.
``python -m experiments.ratios check RATIOS --against EARLIER`` fails if a ratio grew by more than
its spread. Ratios depend less on the machine and its other work than seconds.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal, NamedTuple

from pydantic import Field

from objconnect.scene.bundle.manifest import read_json, write_json
from objconnect.scene.config import Config
from objconnect.scene.errors import InputError
from objconnect.scene.storage.files import parse_json, read_text

# A benchmark whose name holds one of these words is a baseline: the times of the other benchmarks
# in its group are divided by its time. In a group without such a name, the first benchmark by name
# is the baseline, because tests run in any order.
_BASELINES: Final = ("bare", "pycolmap", "opencv", "products", "by_torch", "untracked")
# Minimum spread, as a share of a ratio. Runs on different days differ by this much, although rounds
# of one run differ less.
_MIN_SPREAD: Final = 0.1
KIND: Final = "file of ratios"


class Ratio(Config):
    """The time of one benchmark over that of another of its group.

    Attributes:
        group: name of the group.
        name: name of the benchmark.
        over: name of the baseline.
        ratio: ratio of their median seconds.
        spread: spread of the ratio, from the quartiles of both.
    """

    group: str
    name: str
    over: str
    ratio: float = Field(gt=0)
    spread: float = Field(ge=0)


class Ratios(Config):
    """The ratios of one run.

    Attributes:
        schema_version: version of the file format.
        commit: commit of the code.
        processor: name of the processor.
        ratios: ratios of all groups.
    """

    schema_version: Literal[1] = 1
    commit: str
    processor: str
    ratios: tuple[Ratio, ...]


class Change(NamedTuple):
    """A ratio in both of two runs.

    Attributes:
        earlier: the ratio of the earlier run.
        later: the ratio of the later run.
        is_worse: whether it grew by more than the spread of both.
    """

    earlier: Ratio
    later: Ratio
    is_worse: bool


def ratios_of(run: Path) -> Ratios:
    """Return the ratios of a run.

    Args:
        run: file that pytest-benchmark wrote.

    Raises:
        InputError: it is no such file.
    """
    groups: dict[str, list[tuple[str, float, float]]] = defaultdict(list)
    try:
        read = parse_json(read_text(run, "file of benchmarks"))
        for each in read["benchmarks"]:
            stats = each["stats"]
            row = (str(each["name"]), float(stats["median"]), float(stats["iqr"]))
            groups[str(each["group"])].append(row)
        processor = str(read["machine_info"]["cpu"].get("brand_raw", ""))
        commit = str(read["commit_info"].get("id", ""))
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(
            f"{run} is not a file of pytest-benchmark: write it with --benchmark-json"
        ) from None
    found = [
        ratio for group, rows in sorted(groups.items()) for ratio in _group_ratios(group, rows)
    ]
    return Ratios(commit=commit, processor=processor, ratios=tuple(found))


def _group_ratios(group: str, rows: Sequence[tuple[str, float, float]]) -> list[Ratio]:
    """Return the ratios of a group, given names, medians and distances of quartiles."""
    measured = [row for row in rows if row[1] > 0]
    first = sorted(measured, key=lambda row: _number_key(row[0]))[:1]
    baselines = [row for row in measured if any(word in row[0] for word in _BASELINES)] or first
    found = []
    for name, median, quartiles in (row for row in measured if row not in baselines):
        for over, other_median, other_quartiles in baselines:
            spread = math.hypot(quartiles / median, other_quartiles / other_median)
            ratio = median / other_median
            found.append(
                Ratio(group=group, name=name, over=over, ratio=ratio, spread=ratio * spread)
            )
    return found


def _number_key(name: str) -> list[int | str]:
    """Return a sort key that compares numbers in names by value, so that 100 precedes 1000."""
    parts = re.split(r"(\d+)", name)
    return [int(part) if part.isdigit() else part for part in parts]


def changes(later: Ratios, earlier: Ratios) -> list[Change]:
    """Return the ratios in both runs, in the order of the later one."""
    known = {(each.group, each.name, each.over): each for each in earlier.ratios}
    found = []
    for each in later.ratios:
        former = known.get((each.group, each.name, each.over))
        if former is not None:
            spread = max(math.hypot(each.spread, former.spread), _MIN_SPREAD * former.ratio)
            found.append(Change(former, each, each.ratio > former.ratio + spread))
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return 1 if a ratio got worse, and 2 if a file is damaged."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    write = commands.add_parser("write")
    write.add_argument("run", type=Path)
    write.add_argument("ratios", type=Path)
    check = commands.add_parser("check")
    check.add_argument("ratios", type=Path)
    check.add_argument("--against", type=Path, required=True)
    args = parser.parse_args(arguments)
    try:
        if args.command == "write":
            write_json(args.ratios, ratios_of(args.run))
            return 0
        later, earlier = (read_json(path, Ratios, KIND) for path in (args.ratios, args.against))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    compared = changes(later, earlier)
    if not compared:
        print(f"error: {args.ratios} and {args.against} share no ratio", file=sys.stderr)
        return 2
    if later.processor != earlier.processor:
        print(f"measured on another processor: {earlier.processor}, now {later.processor}")
    for change in compared:
        word = "WORSE" if change.is_worse else "ok"
        print(
            f"{word:5s} {change.later.group}: {change.later.name} over {change.later.over} "
            f"{change.later.ratio:.3g} (spread {change.later.spread:.2g}), "
            f"before {change.earlier.ratio:.3g} ({change.earlier.spread:.2g})"
        )
    return int(any(change.is_worse for change in compared))


if __name__ == "__main__":
    sys.exit(main())
