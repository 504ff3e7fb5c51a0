"""Draw the map points that a photograph observes over it, and outline its objects.

Objects with a point are green, objects without one red, as in Fig. 1 of the object-connect paper.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from objconnect.network.segmentation import NOTHING, Labels
from objconnect.scene.maps.sparse_map import MapImage
from objconnect.scene.storage.atomic import atomic_write

_DPI = 110
# Width of a panel, inches.
_PANEL_WIDTH = 7.5
# Colours of outlines of objects with a point and without one.
_WITH, _WITHOUT = "#37e05b", "#ff3b30"
# End of the colour scale of distances.
_MAX_DISTANCE_M = 1.0


@dataclass(frozen=True)
class Panel:
    """The map with one selection of its points, such as those before points were added.

    Attributes:
        kept: (M,) bool, the selected points.
        has_points: whether each object of the photograph has a point, by label.
    """

    title: str
    kept: NDArray[np.bool_]
    has_points: Mapping[int, bool]


def draw(
    photograph: NDArray[np.uint8],
    image: MapImage,
    labels: Labels,
    distance_m: NDArray[np.float64] | None,
    panels: list[Panel],
    path: Path,
) -> None:
    """Draw the panels: outlines of objects, and observations coloured by distance.

    Args:
        photograph: the photograph (H, W, 3).
        image: the photograph's image in the map.
        labels: label map (H, W) of the objects to outline.
        distance_m: distance (M,) of each point from the true surface, metres; None if unknown.
        panels: selections of points, drawn side by side.
        path: file of the picture.

    Raises:
        InputError: the folder cannot be written.
    """
    height, width = photograph.shape[:2]
    figure = Figure(
        figsize=(_PANEL_WIDTH * len(panels) + 1, _PANEL_WIDTH * height / width + 0.6),
        layout="constrained",
    )
    row = figure.subplots(1, len(panels), squeeze=False)[0]
    for ax, panel in zip(row, panels, strict=True):
        ax.imshow(photograph, extent=(0, width, height, 0))
        _outline(ax, labels, panel.has_points)
        is_observed = image.point_rows >= 0
        is_observed[is_observed] = panel.kept[image.point_rows[is_observed]]
        x, y = image.xy[is_observed].T
        if distance_m is None:
            ax.scatter(x, y, s=9, c="#ffd60a", edgecolors="black", linewidths=0.3)
        else:
            shown_distance = distance_m[image.point_rows[is_observed]].clip(0, _MAX_DISTANCE_M)
            shown = ax.scatter(x, y, s=9, c=shown_distance, cmap="plasma", vmin=0,
                               vmax=_MAX_DISTANCE_M, edgecolors="black",
                               linewidths=0.3)  # fmt: skip
        without_points = sum(not has for has in panel.has_points.values())
        counted = (f": {len(panel.has_points) - without_points} objects have a point "
                   f"(green), {without_points} none (red)" if panel.has_points else "")  # fmt: skip
        ax.set_title(f"{panel.title}{counted}", fontsize=10)
        ax.set(xlim=(0, width), ylim=(height, 0))
        ax.set_axis_off()
    if distance_m is not None:
        figure.colorbar(shown, ax=list(row), shrink=0.7, label="distance from the true surface (m)")
    with atomic_write(path) as partial:
        figure.savefig(partial, format="png", dpi=_DPI)


def _outline(ax: Axes, labels: Labels, has_points: Mapping[int, bool]) -> None:
    for label in np.unique(labels[labels != NOTHING]).tolist():
        mask = (labels == label).astype(np.uint8)
        # The outline runs around the object, so that objects one pixel wide stay visible.
        wider = cv2.dilate(mask, np.ones((5, 5), np.uint8))
        colour = _WITH if has_points[label] else _WITHOUT
        for ring in cv2.findContours(wider, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
            closed = np.concatenate([ring, ring[:1]])[:, 0] + 0.5
            ax.plot(closed[:, 0], closed[:, 1], color=colour, linewidth=1.4)
