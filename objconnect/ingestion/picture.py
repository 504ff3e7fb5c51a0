"""Draw an ingested flight: camera positions, and their GPS positions."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from objconnect.ingestion.adjustment import AdjustedModel
from objconnect.ingestion.report import residuals
from objconnect.scene.storage.atomic import atomic_write

PICTURE = Path("pictures/ingest.png")
"""The picture of a flight, in the folder of its scene."""


def draw(
    path: Path,
    title: str,
    adjusted: AdjustedModel,
    order: Sequence[str],
    queries: Collection[str],
    fixes: Mapping[str, NDArray[np.float64]],
) -> None:
    """Draw points and cameras from above, arrows to their GPS positions, and residuals over time.

    Args:
        path: path of the PNG.
        title: title of the picture.
        adjusted: the model in world coordinates; GPS fixes that georegistration rejected are not
            drawn.
        order: names of its photographs in the order they were taken.
        queries: names of the queries.
        fixes: measured positions by name, world metres.

    Raises:
        InputError: the folder cannot be written.
    """
    model, blunders = adjusted.model, adjusted.georegistration.blunders
    # Matplotlib takes half a second to import, so it is imported only here.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 11), layout="constrained")
    top, timeline = figure.subplots(2, 1, height_ratios=[4, 1])
    size = float(np.clip(2e4 / len(model.xyz), 0.5, 8))
    top.scatter(*model.xyz[:, :2].T, s=size, c=model.rgb / 255, linewidths=0)
    centres = np.array([model.images[name].centre for name in order])
    top.plot(*centres[:, :2].T, color="0.4", linewidth=0.8)
    is_query = np.array([name in queries for name in order])
    for rows, marker, label in ((~is_query, "o", "map"), (is_query, "^", "queries")):
        top.scatter(*centres[rows, :2].T, marker=marker, s=30, label=label, zorder=3)
    drawn = [k for k, name in enumerate(order) if name in fixes and name not in blunders]
    offsets = residuals(model, fixes, [order[k] for k in drawn])
    magnification = _magnification(centres, offsets)
    top.quiver(
        *centres[drawn, :2].T, *magnification * offsets[:, :2].T, color="C3", zorder=4,
        angles="xy", scale_units="xy", scale=1, width=0.003,
        label="to GPS" if magnification == 1 else f"to GPS, {magnification} times as long",
    )  # fmt: skip
    # The axes fit cameras, arrows and most points, so that outliers do not shrink the flight.
    ends = np.concatenate(
        [centres[:, :2], centres[drawn, :2] + magnification * offsets[:, :2], _extent(model.xyz)]
    )
    low, high = ends.min(0), ends.max(0)
    margin = 0.05 * float((high - low).max())
    top.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    top.set(aspect="equal", xlabel="east (m)", ylabel="north (m)", title=title)
    top.legend(loc="upper left", fontsize=8)
    timeline.plot(drawn, np.linalg.norm(offsets[:, :2], axis=1), ".-", label="horizontal")
    timeline.plot(drawn, offsets[:, 2], ".-", label="vertical")
    timeline.axhline(0, color="0.7", linewidth=0.8)
    timeline.set(xlabel="photograph", ylabel="GPS - camera (m)", xlim=(-0.5, len(order) - 0.5))
    timeline.legend(fontsize=8)
    with atomic_write(path) as partial:
        figure.savefig(partial, format="png", dpi=110)


def _magnification(centres: NDArray[np.float64], offsets: NDArray[np.float64]) -> int:
    """Return the power of ten that scales the longest arrow to at most a quarter of the flight.

    It is 1 if the arrow is longer than that already.
    """
    extent = float(np.ptp(centres[:, :2], axis=0).max())
    longest = max(float(np.linalg.norm(offsets[:, :2], axis=1).max(initial=0)), 1e-3)
    return int(10 ** max(np.floor(np.log10(max(0.25 * extent / longest, 1))), 0))


def _extent(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners (2, 2) of the middle 96 % of points (N, 3) along east and north."""
    return np.asarray(np.percentile(xyz[:, :2], [2, 98], axis=0))
