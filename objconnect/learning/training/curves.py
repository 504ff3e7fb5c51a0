"""The plot of the training curves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.files import read_text

# Number of logged steps over which a curve of the training is averaged.
_SMOOTHED_STEPS = 25
# Width and height of one plot, inches, and number of plots in a row.
_WIDTH, _HEIGHT = 4.2, 2.8
_COLUMNS = 3


def draw_curves(log: Path, picture: Path) -> None:
    """Plot every value of the log against the step: training smoothed, validation as points.

    Args:
        log: file of the training log.
        picture: PNG file to write.
    """
    values_of: dict[str, list[tuple[int, float]]] = {}
    for line in read_text(log, "training log").splitlines():
        row = json.loads(line)
        for name, value in row.items():
            if name != "step":
                values_of.setdefault(name, []).append((row["step"], value))
    names = sorted({name.removeprefix("val/") for name in values_of})
    rows = -(-len(names) // _COLUMNS)
    # Imported here, because it takes half a second.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH * _COLUMNS, _HEIGHT * rows), layout="constrained")
    for name, axes in zip(names, figure.subplots(rows, _COLUMNS, squeeze=False).flat, strict=False):
        if name in values_of:
            steps, values = np.array(values_of[name]).T
            axes.plot(steps, _smooth(values), color="tab:blue", label="training")
        if f"val/{name}" in values_of:
            steps, values = np.array(values_of[f"val/{name}"]).T
            axes.plot(steps, values, "o-", color="tab:orange", markersize=3, label="validation")
            axes.legend(fontsize=7)
        axes.set_title(name, fontsize=9)
        axes.grid(alpha=0.3)
    for axes in figure.axes[len(names) :]:
        axes.set_visible(False)
    with atomic_write(picture) as partial:
        figure.savefig(partial, format="png", dpi=90)


def _smooth(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the running mean of values (N,) over the last ``_SMOOTHED_STEPS`` values."""
    sums = np.cumsum(np.nan_to_num(np.insert(values, 0, 0.0), posinf=0.0))
    ends = np.arange(1, len(values) + 1)
    begins = np.maximum(ends - _SMOOTHED_STEPS, 0)
    return np.asarray((sums[ends] - sums[begins]) / (ends - begins))
