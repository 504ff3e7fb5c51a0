"""The page of a forecast: a verdict by season, the map, the weak stretches, every waypoint."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.forecasting.picture import COLOURS, as_jpeg
from benchmark.forecasting.report import CAUSES, VERDICTS, Forecast
from benchmark.report.self_contained import fill

MARK = b"<title>ObjConnect forecast</title>"
"""These bytes stand near the beginning of every page."""


def page(forecast: Forecast, ground: NDArray[np.uint8], area_m: float) -> str:
    """Return the page; it contains the picture of the ground (n, n, 3), north up."""
    picture = base64.b64encode(as_jpeg(ground)).decode()
    data: dict[str, Any] = forecast.as_dict()
    data |= {
        "verdicts": dict(VERDICTS),
        "causes": dict(CAUSES),
        "colours": list(COLOURS),
        "ground": f"data:image/jpeg;base64,{picture}",
        "area_m": area_m,
    }
    return fill("forecast", data, base="shared")
