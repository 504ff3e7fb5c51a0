"""The picture of a forecast: the site from above, its waypoints coloured by probability."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from benchmark.forecasting.report import VERDICTS, Forecast
from objconnect.scene.runtime.escaping import for_figure
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.provenance import PNG_METADATA
from simulate.place.world import World

COLOURS = ("#c0261c", "#f2b134", "#1f6fb4")
"""Colours of the probabilities 0, 0.5 and 1, which the colour-blind can also tell apart."""

_SCALE = LinearSegmentedColormap.from_list("probability", COLOURS)
_SIDE, _DPI = 5.0, 110  # side of a panel, inches, and resolution
_MOST_PIXELS = 900  # largest side of the orthophoto, pixels
_BRIGHTNESS = 1.25  # factor on the albedo, which is darker than a photograph
_MOST_NUMBERED = 60  # with more waypoints, every tenth is numbered
_WHITE_SHARE = 0.35  # share of white mixed into the ground, so that coloured waypoints stand out


def ground_from_above(world: World) -> NDArray[np.uint8]:
    """Return the orthophoto of a site in its original season, (n, n, 3) sRGB, north up."""
    imagery = world.imagery
    assert imagery is not None
    pixels = len(imagery.albedo)
    margin = round(pixels * world.margin_m / (world.side_m + 2 * world.margin_m))
    inner = imagery.albedo[margin : pixels - margin, margin : pixels - margin][::-1]
    side = min(_MOST_PIXELS, len(inner))
    small = cv2.resize(np.ascontiguousarray(inner), (side, side), interpolation=cv2.INTER_AREA)
    return np.asarray(np.clip(small * _BRIGHTNESS, 0, 255), np.uint8)


def as_jpeg(rgb: NDArray[np.uint8]) -> bytes:
    """Return a picture as the bytes of a JPEG."""
    stream = io.BytesIO()
    Image.fromarray(rgb).save(stream, "JPEG", quality=80)
    return stream.getvalue()


def draw(forecast: Forecast, ground: NDArray[np.uint8], side_m: float, path: Path) -> None:
    """Draw one panel for each season.

    Args:
        forecast: the report.
        ground: the site from above, north up.
        side_m: side of the site, metres.
        path: path of the PNG file.

    Raises:
        WriteError: the file cannot be written.
    """
    columns = min(3, len(forecast.seasons))
    rows = -(-len(forecast.seasons) // columns)
    figure = Figure(figsize=(_SIDE * columns + 0.6, (_SIDE + 0.5) * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    half = 0.5 * side_m
    faded = np.asarray((1 - _WHITE_SHARE) * ground + _WHITE_SHARE * 255, np.uint8)
    for panel, season in zip(panels, forecast.seasons, strict=False):
        panel.imshow(faded, extent=(-half, half, -half, half))
        _draw_route(panel, forecast, season.name)
        panel.set_title(
            f"{season.name}: {VERDICTS[season.verdict]}\na fix at {100 * season.share:.0f} %, "
            f"longest gap {season.longest_gap_m:.0f} m",
            fontsize=10,
        )
        panel.set(aspect="equal", xlabel="east (m)")
    for panel in panels[len(forecast.seasons) :]:
        panel.set_axis_off()
    panels[0].set_ylabel("north (m)")
    colour_bar = figure.colorbar(panels[0].collections[0], ax=list(panels), shrink=0.8, pad=0.01)
    colour_bar.set_label(
        f"probability of a fix within {forecast.config.fix_m:g} m and "
        f"{forecast.config.fix_deg:g}° by {for_figure(forecast.method.name)}"
    )
    with atomic_write(path) as partial:
        figure.savefig(partial, format="png", dpi=_DPI, metadata=PNG_METADATA)


def _draw_route(panel: Axes, forecast: Forecast, season: str) -> None:
    positions = np.array([waypoint.enu_m[:2] for waypoint in forecast.waypoints])
    probabilities = [waypoint.seasons[season].probability for waypoint in forecast.waypoints]
    panel.plot(*positions.T, color="0.15", linewidth=1.0)
    x, y = positions.T
    panel.scatter(
        x, y, c=probabilities, cmap=_SCALE, vmin=0, vmax=1, s=70, edgecolors="white", zorder=3
    )
    for number in _choose_numbers(len(positions)):
        panel.annotate(
            str(number + 1),
            positions[number],
            (5, 5),
            textcoords="offset points",
            fontsize=7,
            bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.6},
        )


def _choose_numbers(count: int) -> Sequence[int]:
    return range(0, count, 1 if count <= _MOST_NUMBERED else 10)
