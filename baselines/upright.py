"""Features of pictures turned north up, for networks that do not know turned pictures again.

Photographs of a survey are turned every way, and every second line by half a turn. The map's poses
say how, the query's attitude prior to a few degrees.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from scene.features import Features

# Keypoints this near (px) to the edge of the picture see what is not there.
_MARGIN: Final = 8.0
# Sine of the steepest view, downwards, that still counts as one along the ground.
_LEVEL: Final = -0.5


def north(cam_from_world: NDArray[np.float64]) -> float:
    """Clockwise angle (rad) from the picture's up to the ground's north, of a rotation (3, 3).

    Of a view straight along north it is that of the sky, which is up as well. Of views within 30
    degrees of the horizon, as from a street, it is the sky's wherever they look.
    """
    east_axis, north_axis, up_axis = cam_from_world.T
    if up_axis[2] > _LEVEL:
        return float(np.arctan2(up_axis[0], -up_axis[1]))
    # The picture plane turned about its axis so that east comes right and north up, as well as can.
    return float(np.arctan2(north_axis[0] + east_axis[1], east_axis[0] - north_axis[1]))


def upright(
    extract: Callable[[NDArray[np.uint8]], Features], rgb: NDArray[np.uint8], angle: float
) -> Features:
    """Features of a picture turned counter-clockwise by ``angle`` (rad), in its own pixels.

    The corners that come in are black, and nothing found at or beyond the picture's edge is kept.

    Args:
        extract: finds features in an (H, W, 3) image.
        rgb: the picture as taken.
        angle: of ``north``.
    """
    height, width = rgb.shape[:2]
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, sine], [-sine, cosine]])
    size = np.ceil(np.abs(turn) @ [width, height]).astype(int)
    # Pixels counted from the edge, as ours; OpenCV counts from the first centre.
    shift = size / 2 - turn @ [width / 2, height / 2]
    affine = np.column_stack([turn, shift + turn @ [0.5, 0.5] - 0.5])
    turned = cv2.warpAffine(rgb, affine, size.tolist(), flags=cv2.INTER_LINEAR)
    found = extract(np.asarray(turned, np.uint8))
    xy = (found.xy - shift) @ turn
    kept = ((xy >= _MARGIN) & (xy <= np.array([width, height]) - _MARGIN)).all(1)
    descriptors = found.descriptors[kept]
    return Features(xy[kept].astype(found.xy.dtype), found.scale[kept], descriptors)
