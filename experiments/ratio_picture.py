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
# The site shows pictures at most about 900 pixels wide, so that a point is a readable 1.4 pixels.
_WIDTH_IN, _DPI = 9.0, 100
_TEXT_PT = 9
_LEGEND_LETTERS = 50
# Values of the parameter "tilted" of a benchmark.
_WORDS = {"True": "tilted", "False": "level"}


def figure_of(versions: Mapping[str, Ratios]) -> Figure:
    """Draw the ratios of each version, in order, with their spreads; below 1, ours is faster."""
    groups: dict[str, dict[str, dict[int, Ratio]]] = defaultdict(lambda: defaultdict(dict))
    for column, ratios in enumerate(versions.values()):
        for each in ratios.ratios:
            groups[each.group][_label(each)][column] = each
    rows = -(-len(groups) // _COLUMNS)
    figure = Figure(figsize=(_WIDTH_IN, 2.9 * rows), layout="constrained")
    panels = figure.subplots(rows, _COLUMNS, squeeze=False).flat
    for panel, (group, lines) in zip(panels, sorted(groups.items()), strict=False):
        _draw_group(panel, group, lines, tuple(versions))
    for panel in figure.axes[len(groups) :]:
        panel.set_visible(False)
    return figure


def _label(ratio: Ratio) -> str:
    """Return both names; where they differ in a parameter alone, only the parameters."""
    (name, parameter), (other, base) = map(_split_name, (ratio.name, ratio.over))
    if name == other:
        return f"{parameter} / {base}"
    return fill(f"{name} {parameter} / {other} {base}".replace("  ", " "), _LEGEND_LETTERS)


def _split_name(name: str) -> tuple[str, str]:
    """Return the name of a benchmark and its parameters in words."""
    name, _, parameters = name.removeprefix("test_").rstrip("]").partition("[")
    words = [_WORDS.get(word, word) for word in parameters.replace("_", " ").split("-")]
    # All numbers are numbers of photographs of a map.
    words = [f"{int(word):,} photographs" if word.isdigit() else word for word in words]
    return name.replace("_", " "), ", ".join(words)


def _draw_group(
    panel: Axes, group: str, lines: Mapping[str, Mapping[int, Ratio]], names: tuple[str, ...]
) -> None:
    for label, line in lines.items():
        columns = list(line)
        ratio = np.array([each.ratio for each in line.values()])
        spread = np.array([each.spread for each in line.values()])
        lower_spread = np.minimum(spread, 0.9 * ratio)  # the axis is logarithmic
        panel.errorbar(columns, ratio, (lower_spread, spread), marker="o", capsize=3, label=label)
    panel.axhline(1, color="0.6", linewidth=0.8)
    panel.set_yscale("log", base=2)
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.set_xticks(range(len(names)), names)
    panel.set_xlim(-0.3, len(names) - 0.7)
    panel.tick_params(labelsize=_TEXT_PT)
    panel.set_title(group, fontsize=_TEXT_PT + 1)
    panel.legend(fontsize=_TEXT_PT, loc="upper center", bbox_to_anchor=(0.5, -0.12), frameon=False)


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
    figure_of(versions).savefig(args.out, dpi=_DPI)
    return 0


if __name__ == "__main__":
    sys.exit(main())
