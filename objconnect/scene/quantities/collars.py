"""White or black collars of orthophotos that their files do not declare as no data."""

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
    inside, edge = dict.fromkeys(_COLOURS, 0), dict.fromkeys(_COLOURS, 0)
    known = around = 0
    last: NDArray[np.float32] | None = None
    for strip in strips:
        sides = [strip[:, :, :1], strip[:, :, -1:], *([] if last is not None else [strip[:, :1]])]
        rim = np.concatenate([side.reshape(len(strip), -1) for side in sides], 1)
        known += int(np.isfinite(strip).all(0).sum())
        around += int(np.isfinite(rim).all(0).sum())
        for value in _COLOURS:
            inside[value] += int((strip == value).all(0).sum())
            edge[value] += int((rim == value).all(0).sum())
        last = strip[:, -1]
    if last is not None:
        around += int(np.isfinite(last).all(0).sum())
        for value in _COLOURS:
            edge[value] += int((last == value).all(0).sum())
    for value, name in _COLOURS.items():
        if inside[value] > _SHARE * known and edge[value] > _EDGE_SHARE * around:
            return (
                f"{100 * inside[value] / known:.0f} % of the pixels are {name}, also at the edge: "
                f"if they are no data, gdal_edit -a_nodata {value} declares it"
            )
    return None
