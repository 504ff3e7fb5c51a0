from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.sparse_map import MapImage, SparseMap

CAMERA = Camera("PINHOLE", 100, 80, (90.0, 90.0, 50.0, 40.0))


def small_map() -> SparseMap:
    """Make two photographs, 30 m above three points, with keypoints 3 px to the right."""
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    xyz = np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0]])
    images = {}
    for name, east in (("b.jpg", 0.0), ("a.jpg", 2.0)):
        cam_from_world = down.copy()
        cam_from_world[:3, 3] = -down[:3, :3] @ [east, 0, 30]
        local = xyz @ down[:3, :3].T + cam_from_world[:3, 3]
        xy = 90 * local[:, :2] / local[:, 2:] + [53, 40]
        images[name] = MapImage(name, CAMERA, cam_from_world, xy, np.array([0, -1, 2]))
    return SparseMap(images, xyz, np.zeros((3, 3), np.uint8), np.zeros(3), np.full(3, 2, np.int64))


def test_names_are_sorted_and_centres_follow_them() -> None:
    sparse_map = small_map()
    assert sparse_map.names == ("a.jpg", "b.jpg")
    np.testing.assert_allclose(sparse_map.centres, [[2, 0, 30], [0, 0, 30]])


def test_residuals_are_observed_minus_projected() -> None:
    sparse_map = small_map()
    np.testing.assert_allclose(sparse_map.residuals("a.jpg"), [[3, 0], [3, 0]], atol=1e-9)
    assert sparse_map.reprojection_error() == pytest.approx(3)


def test_digest_changes_with_what_a_localizer_reads() -> None:
    sparse_map = small_map()
    digest = sparse_map.sha256
    assert small_map().sha256 == digest
    image = sparse_map.images["a.jpg"]
    moved = image.cam_from_world.copy()
    moved[0, 3] += 1e-9
    others = [
        replace(image, cam_from_world=moved),
        replace(image, xy=image.xy + 1e-9),
        replace(image, point_rows=np.array([0, 1, 2])),
        replace(image, camera=CAMERA.resize(50, 40)),
    ]
    changed = [
        replace(sparse_map, images={**sparse_map.images, "a.jpg": other}) for other in others
    ]
    changed.append(replace(sparse_map, xyz=sparse_map.xyz + 1e-9))
    changed.append(replace(sparse_map, track_length=sparse_map.track_length + 1))
    assert len({digest, *(other.sha256 for other in changed)}) == 7
