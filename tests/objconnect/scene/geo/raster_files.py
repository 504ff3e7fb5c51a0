"""GeoTIFFs that tests write, and what is read from them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.transform import from_origin

from objconnect.scene.geo.rasters import Kind, Raster

UPRIGHT = from_origin(500_000.0, 5_200_000.0, 0.5, 0.5)


def write(
    path: Path,
    values: NDArray[Any],
    *,
    after: Callable[[Any], None] = lambda _: None,
    **profile: Any,
) -> Path:
    """Write (bands, H, W), upright in UTM unless told otherwise; ``after`` adds what it likes."""
    bands, height, width = values.shape
    size = {"driver": "GTiff", "count": bands, "height": height, "width": width}
    place = {"crs": "EPSG:32632", "transform": UPRIGHT, "dtype": values.dtype}
    with rasterio.open(path, "w", **size | place | profile) as file:
        after(file)
        file.write(values)
    return path


def interpret(*names: str) -> Callable[[Any], None]:
    """Say what the bands are."""

    def say(file: Any) -> None:
        file.colorinterp = [ColorInterp[name] for name in names]

    return say


def values_of(path: Path, kind: Kind) -> NDArray[np.float32]:
    """What the product reads, (channels, H, W)."""
    raster = Raster.open(path, kind)
    return raster.patch(raster.grid.box).values
