"""Detections of known centres become points of the map, and leave it as if never there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from objconnect.mapping.diagnosis.command import diagnose
from objconnect.mapping.supplement.config import SupplementConfig
from objconnect.mapping.supplement.map import add_to_map, remove_from_map
from objconnect.mapping.supplement.triangulation import (
    TriangulatedPoint,
    associate_and_triangulate,
    triangulate_linearly,
)
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.bundle.supplement import ADDED_FEATURES, SUPPLEMENT, read_supplement
from objconnect.scene.errors import InputError
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.features import read_features
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.digests import sha256_of
from tests.objconnect.network.oracle import detections

CONFIG = SupplementConfig()


def centres_of(scene: Scene) -> np.ndarray:
    return np.array([o.centre for o in scene.objects.objects if o.size_class == "small"])


def distances(scene: Scene, points: list[TriangulatedPoint]) -> np.ndarray:
    """From each point to the nearest true centre, metres."""
    xyz = np.array([point.xyz for point in points]).reshape(-1, 3)
    return np.linalg.norm(xyz[:, None] - centres_of(scene), axis=2).min(1)


def test_linear_points_are_exact() -> None:
    rng = np.random.default_rng(0)
    xyz = rng.uniform(-20, 20, (50, 3))
    poses = np.tile(np.eye(4)[:3], (50, 3, 1, 1))
    poses[:, :, :, 3] = rng.uniform([-10, -10, 50], [10, 10, 70], (50, 3, 3))
    local = xyz[:, None] + poses[..., 3]
    normalised = local[..., :2] / local[..., 2:]
    np.testing.assert_allclose(triangulate_linearly(normalised, poses), xyz, atol=1e-8)


def test_exact_detections_are_lifted_to_their_centres(rendered: Scene) -> None:
    found = detections(rendered)
    points = associate_and_triangulate(rendered.sparse_map(), found, CONFIG)
    assert len(points) > 10
    assert distances(rendered, points).max() < 1e-6
    # No detection makes two points, and each point is seen often enough.
    used = [(name, row) for point in points for name, row in point.rows.items()]
    assert len(used) == len(set(used))
    assert min(len(point.rows) for point in points) >= CONFIG.views
    assert min(point.angle_deg for point in points) >= CONFIG.angle_deg


def test_noise_and_false_detections_move_points_little(rendered: Scene) -> None:
    exact = len(associate_and_triangulate(rendered.sparse_map(), detections(rendered), CONFIG))
    found = detections(rendered, noise_px=0.4, blur=0.3, outliers=6)
    points = associate_and_triangulate(rendered.sparse_map(), found, CONFIG)
    off = distances(rendered, points)
    assert len(points) >= 0.8 * exact
    assert (off < 0.5).mean() > 0.9
    assert all(point.error_px < CONFIG.reprojection_px for point in points)


def test_what_looks_different_or_lies_elsewhere_is_not_one_object(rendered: Scene) -> None:
    sparse_map, found = rendered.sparse_map(), detections(rendered)
    rng = np.random.default_rng(1)

    unlike = np.eye(400, dtype=np.float32)
    strangers = {
        name: replace(item, descriptors=unlike[7 * k :][: len(item.xy)] * (k % 2 or -1))
        for k, (name, item) in enumerate(found.items())
    }
    assert len(associate_and_triangulate(sparse_map, strangers, CONFIG)) < 3
    shuffled = {
        name: replace(item, xy=rng.uniform(0, 320, item.xy.shape)) for name, item in found.items()
    }
    assert len(associate_and_triangulate(sparse_map, shuffled, CONFIG)) < 0.2 * len(
        centres_of(rendered)
    )
    assert associate_and_triangulate(sparse_map, {}, CONFIG) == []
    assert associate_and_triangulate(sparse_map, dict(list(found.items())[:2]), CONFIG) == []


def test_rays_that_hardly_cross_make_no_point(rendered: Scene) -> None:
    found = detections(rendered)
    points = associate_and_triangulate(rendered.sparse_map(), found, CONFIG)
    widest = float(np.median([point.angle_deg for point in points]))
    stricter = associate_and_triangulate(
        rendered.sparse_map(), found, SupplementConfig(angle_deg=widest)
    )
    assert 0 < len(stricter) < len(points)


def digests(folder: Path) -> dict[str, str]:
    return {file.name: sha256_of(file) for file in folder.iterdir()}


def test_added_points_change_nothing_else_and_can_be_removed(rendered_copy: Path) -> None:
    scene = Scene.open(rendered_copy)
    before, files = scene.sparse_map(), digests(scene.map_path)
    found = detections(scene, noise_px=0.3, blur=0.2)
    points = associate_and_triangulate(before, found, CONFIG)
    with pytest.raises(InputError, match="another run changed the map"):
        add_to_map(rendered_copy, points, found, "0" * 64)
    add_to_map(rendered_copy, points, found, before.sha256)
    supplement = add_to_map(rendered_copy, points, found)  # in place of the first
    scene = Scene.open(rendered_copy)
    assert scene.find_changed_files() == []
    after = scene.sparse_map()
    added = scene.is_added_point(after)
    assert added.sum() == len(points) == len(after.xyz) - len(before.xyz)
    np.testing.assert_array_equal(after.xyz[~added], before.xyz)
    np.testing.assert_array_equal(after.error[~added], before.error)
    np.testing.assert_allclose(after.xyz[added], [point.xyz for point in points])
    np.testing.assert_allclose(after.error[added], [point.error_px for point in points], atol=1e-9)
    for name, image in before.images.items():
        count = len(image.xy)
        np.testing.assert_array_equal(after.images[name].xy[:count], image.xy)
        np.testing.assert_array_equal(after.images[name].cam_from_world, image.cam_from_world)
        # Descriptors stand in the order of the added keypoints.
        if len(after.images[name].xy) > count:
            kept = read_features(scene.map_path / ADDED_FEATURES)[name]
            np.testing.assert_allclose(kept.xy, after.images[name].xy[count:], rtol=1e-6)
            assert len(kept.descriptors) == len(kept.xy)
    assert read_supplement(scene.map_path) == supplement
    assert supplement.map_sha256 == before.sha256
    assert [p.confidence for p in supplement.points] == [p.confidence for p in points]

    remove_from_map(rendered_copy)
    assert digests(scene.map_path) == files
    assert Scene.open(rendered_copy).find_changed_files() == []
    with pytest.raises(InputError, match="has no added points"):
        remove_from_map(rendered_copy)


def test_a_supplemented_model_passes_bundle_adjustment(rendered_copy: Path, tmp_path: Path) -> None:
    scene = Scene.open(rendered_copy)
    found = detections(scene, noise_px=0.3)
    add_to_map(rendered_copy, associate_and_triangulate(scene.sparse_map(), found, CONFIG), found)
    before = scene.sparse_map()
    native = pycolmap.Reconstruction(scene.map_path)
    assert native.num_points3D() == len(before.xyz)
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in native.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.refine_focal_length = options.refine_extra_params = False
    summary = pycolmap.create_default_bundle_adjuster(options, config, native).solve()
    assert summary.is_solution_usable()
    native.write(tmp_path)
    after = read_model(tmp_path)
    assert squares(after) < squares(before)
    # Added points stay where their objects are, though all poses may move.
    added = after.xyz[scene.is_added_point(before)]
    off = np.linalg.norm(added[:, None] - centres_of(scene), axis=2).min(1)
    assert off.max() < 0.5


def squares(sparse_map: SparseMap) -> float:
    return sum(float((sparse_map.residuals(name) ** 2).sum()) for name in sparse_map.names)


def test_the_diagnosis_shows_what_was_added(rendered_copy: Path) -> None:
    """The middle of what is thicker than a metre is too deep in it to lie on its surface."""
    scene = Scene.open(rendered_copy)
    found = detections(scene, lambda item: item.size_class == "small" and min(item.size) < 1)
    add_to_map(rendered_copy, associate_and_triangulate(scene.sparse_map(), found, CONFIG), found)
    diagnosis = diagnose(rendered_copy)
    assert diagnosis.before is not None
    assert diagnosis.added is not None
    before, after = diagnosis.before.objects["small"], diagnosis.map.objects["small"]
    assert after.seen == before.seen
    assert after.with_points - before.with_points >= 0.5 * (before.seen - before.with_points)
    assert diagnosis.added.close >= 0.9


def test_marks_of_another_map_are_refused(rendered_copy: Path) -> None:
    scene = Scene.open(rendered_copy)
    found = detections(scene)
    add_to_map(rendered_copy, associate_and_triangulate(scene.sparse_map(), found, CONFIG), found)
    files = digests(scene.map_path)
    marks = scene.map_path / SUPPLEMENT
    whole = marks.read_text()
    marks.write_text(whole.replace('"id": ', '"id": 9'))
    with pytest.raises(InputError, match="has no point 9"):
        remove_from_map(rendered_copy)
    marks.write_text(whole[:-20])
    with pytest.raises(InputError, match="not valid JSON"):
        remove_from_map(rendered_copy)
    marks.write_text(whole)
    assert digests(scene.map_path) == files
    assert not list(rendered_copy.glob(".*"))
