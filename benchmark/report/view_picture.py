"""A picture of a scene from above, before and after points were added to its map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from benchmark.report.view_content import MethodEstimates, ViewContent
from objconnect.scene.runtime.escaping import for_figure
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.provenance import PNG_METADATA

_DPI = 110
_SIDE = 8.0  # side of a panel, inches
# Colours of objects with and without a point in the map, and of added points.
_WITH_POINT, _WITHOUT_POINT, _ADDED = "#189a3c", "#e02a1f", "#d61ec0"


def draw(name: str, centres: NDArray[np.float64], content: ViewContent, path: Path) -> None:
    """Draw points, objects, cameras and queries in one panel, or in two where points were added.

    Args:
        name: name of the scene.
        centres: (N, 3) centres of the map's cameras, metres.
        content: points, objects, query paths and estimates to draw.
        path: path of the PNG file.

    Raises:
        InputError: the folder cannot be written.
    """
    added = any(cloud.layer == "added" for cloud in content.clouds)
    states = [("before", False), ("after", True)] if added else [("", True)]
    figure = Figure(figsize=(_SIDE * len(states), _SIDE), layout="constrained")
    axes = figure.subplots(1, len(states), squeeze=False, sharex=True, sharey=True)[0]
    for ax, (state, after) in zip(axes, states, strict=True):
        small_objects = [o for o in content.objects if o.item.size_class == "small"]
        with_point = sum(o.after if after else o.before for o in small_objects)
        for cloud in content.clouds:
            if cloud.layer == "sparse":
                # The more points there are, the smaller is the area of each dot.
                area = float(np.clip(2e4 / max(len(cloud.xyz), 1), 0.5, 8))
                ax.scatter(*cloud.xyz[:, :2].T, s=area, c=cloud.rgb / 255, linewidths=0)
            elif cloud.layer == "added" and after:
                ax.scatter(*cloud.xyz[:, :2].T, s=14, c=_ADDED, marker="x", linewidths=1.2,
                           label=f"{len(cloud.xyz)} added points", zorder=5)  # fmt: skip
            elif cloud.layer == "landmarks":
                ax.scatter(*cloud.xyz[:, :2].T, s=10, facecolors="none", edgecolors=cloud.rgb / 255,
                           linewidths=0.8, label=f"{len(cloud.xyz)} learned objects")  # fmt: skip
        for o in small_objects:
            colour = _WITH_POINT if (o.after if after else o.before) else _WITHOUT_POINT
            ax.add_patch(Polygon(o.corners, fill=False, edgecolor=colour, linewidth=1.5))
        ax.plot(*centres[:, :2].T, "o", color="C0", markersize=3, label="photographs of the map")
        for centres_of_queries in content.query_paths:
            ax.plot(*centres_of_queries[:, :2].T, "-", color="0.3", linewidth=0.8)
        for number, method in enumerate(content.methods):
            _draw_method(ax, method, f"C{number + 1}")
        words = [for_figure(name), *([state] if state else [])]
        if small_objects:
            words.append(f"{with_point} of {len(small_objects)} small objects have a point")
        ax.set_title(", ".join(words), fontsize=10)
        ax.set(aspect="equal", xlabel="east (m)", ylabel="north (m)")
        ax.legend(loc="upper left", fontsize=8)
    with atomic_write(path) as partial:
        figure.savefig(partial, format="png", dpi=_DPI, metadata=PNG_METADATA)


def _draw_method(ax: Axes, method: MethodEstimates, colour: str) -> None:
    """Draw the estimates of a method, each joined with its true camera centre."""
    # Matplotlib ignores labels that begin with an underscore.
    label = for_figure(method.name).lstrip("_") or "a method"
    for query in method.queries:
        if query.centre is None:
            continue
        ax.plot(*np.stack([query.truth, query.centre])[:, :2].T, color=colour, linewidth=1.2)
        ax.plot(*query.centre[:2], "s", color=colour, markersize=3, label=label, zorder=4)
        label = "_nolegend_"
