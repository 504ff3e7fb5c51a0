"""The page of a forecast: a verdict by season, the map, the weak stretches, every waypoint."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.forecasting.calibration import POOL_M
from benchmark.forecasting.picture import COLOURS, as_jpeg
from benchmark.forecasting.report import CAUSES, FEW_POINTS, VERDICTS, Forecast
from benchmark.report.self_contained import fill

MARK = b"<title>ObjConnect forecast</title>"
"""Bytes near the beginning of every page, by which an earlier page is recognized and replaced."""


def page(forecast: Forecast, ground: NDArray[np.uint8], side_m: float) -> str:
    """Return the page as HTML.

    Args:
        forecast: the report.
        ground: the site from above, (n, n, 3) sRGB, north up.
        side_m: side of the site, metres.
    """
    picture = base64.b64encode(as_jpeg(ground)).decode()
    data: dict[str, Any] = forecast.as_dict()
    data |= {
        "verdicts": dict(VERDICTS),
        "causes": dict(CAUSES),
        "colours": list(COLOURS),
        "ground": f"data:image/jpeg;base64,{picture}",
        "side_m": side_m,
        "few_points": FEW_POINTS,
        "pool_m": POOL_M,
    }
    return fill("forecast", data, base="shared")
