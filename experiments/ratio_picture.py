"""Draw the benchmark ratios of several versions: a panel for each group of benchmarks.

``python -m experiments.ratio_picture RATIOS... --out PNG`` takes files that ``make bench``
wrote, in the order of their versions; their names without the ending are those of the versions.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from experiments.ratios import KIND, Ratio, Ratios
from objconnect.scene.bundle.manifest import read_json
from objconnect.scene.errors import InputError

_COLUMNS = 2


def figure_of(versions: Mapping[str, Ratios]) -> Figure:
    """Draw the ratios of each version, in order, with their spreads; below 1, ours is faster."""
    groups: dict[str, dict[str, dict[int, Ratio]]] = defaultdict(lambda: defaultdict(dict))
    for column, ratios in enumerate(versions.values()):
        for each in ratios.ratios:
            groups[each.group][_label(each)][column] = each
    rows = -(-len(groups) // _COLUMNS)
    figure = Figure(figsize=(11, 2.6 * rows), layout="constrained")
    panels = figure.subplots(rows, _COLUMNS, squeeze=False).flat
    for panel, (group, lines) in zip(panels, sorted(groups.items()), strict=False):
        _draw_group(panel, group, lines, tuple(versions))
    for panel in figure.axes[len(groups) :]:
        panel.set_visible(False)
    return figure


def _label(ratio: Ratio) -> str:
    name, over = (word.removeprefix("test_").replace("_", " ") for word in (ratio.name, ratio.over))
    return fill(f"{name} / {over}", 34)


def _draw_group(
    panel: Axes, group: str, lines: Mapping[str, Mapping[int, Ratio]], names: tuple[str, ...]
) -> None:
    for label, line in lines.items():
        columns = list(line)
        ratio = np.array([each.ratio for each in line.values()])
        spread = np.array([each.spread for each in line.values()])
        below = np.minimum(spread, 0.9 * ratio)  # the axis is logarithmic
        panel.errorbar(columns, ratio, (below, spread), marker="o", capsize=3, label=label)
    panel.axhline(1, color="0.6", linewidth=0.8)
    panel.set_yscale("log", base=2)
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.set_xticks(range(len(names)), names, rotation=20, ha="right")
    panel.set_xlim(-0.3, len(names) - 0.7)
    panel.set_title(group, fontsize=9)
    panel.legend(fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the picture; return 2 if a file is damaged."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ratios", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args(arguments)
    try:
        versions = {path.stem: read_json(path, Ratios, KIND) for path in args.ratios}
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    figure_of(versions).savefig(args.out, dpi=100)
    return 0


if __name__ == "__main__":
    sys.exit(main())
