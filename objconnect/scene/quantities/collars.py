"""White or black collars (borders) of orthophotos that their files do not declare as no data."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

_COLOURS: Final = {255: "white", 0: "black"}
# Smallest share of the picture, and of its edge, that is reported.
_SHARE, _EDGE_SHARE = 0.01, 0.1


def describe_collar(strips: Iterable[NDArray[np.float32]]) -> str | None:
    """Return a phrase about a white or black collar; None if the picture has none.

    Args:
        strips: pieces of the picture from top to bottom, (bands, H, W) in 0..255; NaN where the
            file declares no data.
    """
    count, edge_count = dict.fromkeys(_COLOURS, 0), dict.fromkeys(_COLOURS, 0)
    total = edge_total = 0
    last_row: NDArray[np.float32] | None = None
    for strip in strips:
        sides = [
            strip[:, :, :1],
            strip[:, :, -1:],
            *([] if last_row is not None else [strip[:, :1]]),
        ]
        edge_pixels = np.concatenate([side.reshape(len(strip), -1) for side in sides], 1)
        total += int(np.isfinite(strip).all(0).sum())
        edge_total += int(np.isfinite(edge_pixels).all(0).sum())
        for value in _COLOURS:
            count[value] += int((strip == value).all(0).sum())
            edge_count[value] += int((edge_pixels == value).all(0).sum())
        last_row = strip[:, -1]
    if last_row is not None:
        edge_total += int(np.isfinite(last_row).all(0).sum())
        for value in _COLOURS:
            edge_count[value] += int((last_row == value).all(0).sum())
    for value, name in _COLOURS.items():
        if count[value] > _SHARE * total and edge_count[value] > _EDGE_SHARE * edge_total:
            return (
                f"{100 * count[value] / total:.0f} % of the pixels are {name}, and {name} pixels "
                f"lie at the edge: if {name} means no data, declare that with: gdal_edit "
                f"-a_nodata {value} FILE"
            )
    return None
