"""COLMAP's dense stereo."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from scene.errors import InputError


def patch_match_stereo(workspace: Path) -> None:
    """COLMAP's own dense stereo in a workspace of undistorted photographs, on a CUDA device.

    Raises:
        InputError: this pycolmap was built without CUDA.
    """
    if not pycolmap.has_cuda:
        raise InputError(
            "COLMAP's stereo needs a CUDA build of pycolmap, and this is none: leave out "
            "'--stereo colmap'"
        )
    pycolmap.patch_match_stereo(workspace)


def fuse_depth_maps(
    workspace: Path, out: Path, min_views: int
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Fuse a workspace's depth and normal maps into a cloud, and write it as PLY to ``out``.

    COLMAP ends the process on a damaged workspace: hand it one whose files were just read.

    Args:
        workspace: in COLMAP's layout, with ``*.geometric.bin`` of every image it lists.
        out: the PLY file; its list of visible images lies beside it as ``.vis``.
        min_views: a point is kept when so many maps have it.

    Returns:
        Points (M, 3), world metres, and their colours (M, 3).
    """
    options = pycolmap.StereoFusionOptions()
    options.min_num_pixels = min_views
    options.num_threads = 1  # threads take pixels from one another in another order each time
    model = pycolmap.stereo_fusion(out, workspace, options=options, output_type="PLY")
    points = list(model.points3D.values())
    xyz = np.array([point.xyz for point in points], np.float64).reshape(-1, 3)
    return xyz, np.array([point.color for point in points], np.uint8).reshape(-1, 3)
