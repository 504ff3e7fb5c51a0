"""A map triangulated from a rendered flight lies on the rendered surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from scene.bundle import FEATURES, Scene
from scene.errors import InputError
from scene.features import read_features
from scene.manifest import SceneObject
from simulate.map_report import points_inside
from simulate.mapping import build_map, choose_pairs


def test_map_of_a_rendered_flight(rendered: Scene) -> None:
    sparse_map = rendered.sparse_map()
    assert set(sparse_map.images) == set(rendered.splits.map)
    assert len(sparse_map.xyz) > 300
    assert sparse_map.reprojection_error() < 1.0
    frames = rendered.frames("summer-noon-nadir-map")
    for k, name in enumerate(frames.names):
        assert np.allclose(sparse_map.images[name].cam_from_world, frames.cam_from_world[k])
        assert sparse_map.images[name].camera == frames.cameras[k]


def test_points_lie_on_the_surface(rendered: Scene) -> None:
    """Depth of each point in the views that observe it, against the rendered depth there."""
    sparse_map = rendered.sparse_map()
    frames = rendered.frames("summer-noon-nadir-map")
    off = []
    with rendered.dense("summer-noon-nadir-map") as dense:
        for k, name in enumerate(frames.names):
            image = sparse_map.images[name]
            seen = image.point_rows >= 0
            xyz = torch.from_numpy(sparse_map.xyz[image.point_rows[seen]])
            z = image.pose.transform(xyz)[:, 2].numpy()
            columns, rows = np.floor(image.xy[seen]).astype(int).T
            off.append(np.abs(z - dense.read("depth", k)[rows, columns]))
    assert np.median(np.concatenate(off)) < 0.25


def test_features_lie_beside_the_map(rendered: Scene) -> None:
    features = read_features(rendered.map_path / FEATURES)
    sparse_map = rendered.sparse_map()
    assert set(features) == set(sparse_map.images)
    for name, image in sparse_map.images.items():
        assert np.abs(features[name].xy - image.xy).max() < 1e-3


def test_mapping_again_replaces_the_map(rendered_copy: Path) -> None:
    before = Scene.open(rendered_copy).sparse_map()
    (rendered_copy / "map" / "points3D.bin").write_bytes(b"damaged")
    build_map(rendered_copy)
    scene = Scene.open(rendered_copy)
    assert np.allclose(scene.sparse_map().xyz, before.xyz)
    assert scene.changed_files() == []


def test_pairs_are_the_overlapping_ones() -> None:
    overlap = np.array([[0, 0.9, 0.1], [0.9, 0, 0.3], [0.1, 0.3, 0]])
    assert choose_pairs(overlap) == [(0, 1), (1, 2)]


def test_a_damaged_photograph_keeps_the_old_map(rendered_copy: Path) -> None:
    before = Scene.open(rendered_copy).sparse_map()
    photograph = rendered_copy / "sessions" / before.names[3]
    photograph.write_bytes(photograph.read_bytes()[:4000])
    with pytest.raises(InputError, match=f"{photograph} is damaged"):
        build_map(rendered_copy)
    assert Scene.open(rendered_copy).sparse_map().sha256 == before.sha256
    assert not list(rendered_copy.glob(".*"))


def test_structure_from_motion_finds_the_poses(rendered_copy: Path) -> None:
    report = build_map(rendered_copy, "sfm")
    assert report.registered == report.images == 12
    assert report.reprojection_error_px < 1.0
    assert 0 < report.position_rms_m < 0.5
    assert report.rotation_rms_deg < 0.5
    scene = Scene.open(rendered_copy)
    assert scene.changed_files() == []
    assert scene.sparse_map().reprojection_error() == report.reprojection_error_px


def test_report_of_a_triangulated_map(rendered_copy: Path) -> None:
    report = build_map(rendered_copy)
    scene = Scene.open(rendered_copy)
    assert report.points == len(scene.sparse_map().xyz)
    # Poses went into COLMAP's file as quaternions and came back.
    assert report.position_max_m < 1e-9
    assert report.rotation_max_deg < 1e-9
    assert sum(c.seen for c in report.objects.values()) <= len(scene.objects.objects)
    for coverage in report.objects.values():
        assert coverage.with_points <= min(coverage.seen, coverage.points)
    assert report.objects["medium"].points > 20
    assert f"{report.points} points" in report.text()


def test_points_inside_an_oriented_box() -> None:
    """A car of 4 x 2 x 1.5 m, turned by 90 degrees: long from south to north."""
    car = SceneObject(
        id=1, class_name="car", centre=(10, 20, 1), size=(4, 2, 1.5), yaw_deg=90,
        size_class="medium",
    )  # fmt: skip
    inside = [[10, 20, 1], [10.9, 20, 1], [10, 21.9, 1], [10, 20, 1.9]]
    outside = [[11.9, 20, 1], [10, 22.5, 1], [10, 20, 2.5]]
    assert points_inside(np.array(inside), car) == 4
    assert points_inside(np.array(outside), car) == 0
