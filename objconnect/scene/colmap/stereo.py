"""Dense stereo and fusion by COLMAP."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from objconnect.scene.errors import InputError


def patch_match_stereo(workspace: Path) -> None:
    """Run COLMAP's dense stereo on a workspace of undistorted photographs, on a CUDA device.

    Raises:
        InputError: this pycolmap was built without CUDA.
    """
    if not pycolmap.has_cuda:
        raise InputError(
            "COLMAP's stereo needs pycolmap with CUDA, and this build has none: leave out "
            "'--stereo colmap'"
        )
    pycolmap.patch_match_stereo(workspace)


def fuse_depth_maps(
    workspace: Path, out: Path, min_views: int
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Fuse the depth and normal maps of a workspace to a point cloud, and write it as PLY.

    COLMAP ends the process on a damaged workspace, so its files must have been checked.

    Args:
        workspace: folder in COLMAP's layout, with ``*.geometric.bin`` of every image it lists.
        out: PLY file; its list of visible images is written beside it as ``.vis``.
        min_views: smallest number of depth maps in which a point appears.

    Returns:
        Points (M, 3), world metres, and their colours (M, 3).
    """
    options = pycolmap.StereoFusionOptions()
    options.min_num_pixels = min_views
    options.num_threads = 1  # with more threads the order of the points is not reproducible
    model = pycolmap.stereo_fusion(out, workspace, options=options, output_type="PLY")
    points = list(model.points3D.values())
    xyz = np.array([point.xyz for point in points], np.float64).reshape(-1, 3)
    return xyz, np.array([point.color for point in points], np.uint8).reshape(-1, 3)
