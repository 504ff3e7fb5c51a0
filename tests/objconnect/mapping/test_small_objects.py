"""Small things without a point are found in rendered photographs, and added to the map."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from benchmark.cli import app
from objconnect.mapping.supplement.blobs import find_blobs
from objconnect.mapping.supplement.classifier import read_classifier
from objconnect.mapping.supplement.config import SupplementConfig
from objconnect.mapping.supplement.ground_plane import Ground, find_nearest, heights_above_ground
from objconnect.mapping.supplement.photoconsistency import HEIGHTS, compare_with_ground
from objconnect.mapping.supplement.small_objects import supplement_points
from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import ObjConnectNet, read_network
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.images import read_rgb


def test_heights_are_above_the_plane_of_most_points() -> None:
    rng = np.random.default_rng(0)
    cloud = rng.uniform(0, 40, (2000, 3))
    cloud[:, 2] = 0.1 * cloud[:, 0] - 0.05 * cloud[:, 1] + rng.normal(scale=0.02, size=2000)
    cloud[::5, 2] += 2.0
    feet = rng.uniform(5, 35, (50, 2))
    ground = 0.1 * feet[:, 0] - 0.05 * feet[:, 1]
    above = heights_above_ground(np.column_stack([feet, ground + 1]), cloud)
    np.testing.assert_allclose(above, 1, atol=0.1)
    assert np.isinf(heights_above_ground(cloud[:3], cloud[:5])).all()


def test_the_nearest_are_the_nearest() -> None:
    rng = np.random.default_rng(1)
    cloud, query = rng.uniform(0, 9, (500, 3)), rng.uniform(0, 9, (20, 3))
    _, off = find_nearest(query, cloud, 4)
    every = np.linalg.norm(query[:, None] - cloud, axis=2)
    np.testing.assert_allclose(off, np.sort(every, axis=1)[:, :4], atol=1e-5)


def test_rays_meet_the_ground_at_a_height(rendered: Scene) -> None:
    rng = np.random.default_rng(2)
    cloud = rng.uniform(-200, 200, (3000, 3))
    cloud[:, 2] = 0.1 * cloud[:, 0] - 0.05 * cloud[:, 1]
    ground = Ground.of(cloud)
    image = rendered.sparse_map().images[rendered.splits.map[0]]
    xy = rng.uniform(20, 100, (50, 2))
    places = ground.intersect_rays(image, xy, 1.5)
    expected = 0.1 * places[:, 0] - 0.05 * places[:, 1] + 1.5
    np.testing.assert_allclose(places[:, 2], expected, atol=0.02)
    seen = image.camera.project(image.pose.transform(torch.from_numpy(places)))
    np.testing.assert_allclose(seen.xy.numpy(), xy, atol=0.05)


def test_spots_are_where_they_are_and_differ_from_what_is_around() -> None:
    rgb = np.full((80, 120, 3), 90, np.uint8)
    rgb[30:33, 50:53] = [200, 40, 40]
    rgb[60:62, 100:102] = [240, 240, 240]
    found = find_blobs(rgb)
    for place, lighter in ((51.5, 31.5), False), ((101.0, 61.0), True):
        off = np.linalg.norm(found.xy - place, axis=1)
        nearest_spot = off.argmin()
        assert off[nearest_spot] < 0.3
        assert found.strength[nearest_spot] > 10
        assert (found.appearance[nearest_spot, 0] > 20) == lighter
    # Nothing else stands out.
    off = np.linalg.norm(found.xy[:, None] - [[51.5, 31.5], [101.0, 61.0]], axis=2).min(1)
    assert (off < 8).all()


def test_costs_are_held_against_those_of_the_ground() -> None:
    above = 1.0 + np.abs(HEIGHTS - 0.9)
    on_it = 1.0 + np.abs(HEIGHTS)
    costs = np.stack([above, on_it, np.full(len(above), np.nan)])
    found = compare_with_ground(costs, np.full(3, 1.0))
    assert found.least_ratio[0] < 0.65
    assert found.distance_m[0] < 0.15
    assert found.least_ratio[1] == 1
    assert found.distance_m[1] > 0.9
    assert np.isinf(found.least_ratio[2])
    np.testing.assert_allclose(found.ratios[0], above / found.ground_cost[0])
    assert np.isfinite(found.ratios).all()


def test_a_network_says_how_sure_spots_are_and_what_they_look_like(rendered: Scene) -> None:
    torch.manual_seed(0)
    config = ObjConnectNetConfig(width=0.125, steps=(8, 8, 8, 8), strides=(16, 4), dims=(8, 8))
    network = ObjConnectNet(config).eval()
    name = rendered.splits.map[0]
    rgb = read_rgb(rendered.images_root / name)
    plain, seen = find_blobs(rgb).detections, find_blobs(rgb, network).detections
    assert len(plain.xy) > 200
    assert len(seen.xy) > len(plain.xy)
    lengths = np.linalg.norm(seen.descriptors, axis=1)
    np.testing.assert_allclose(lengths[seen.confidence > 0], 1, atol=1e-5)
    assert (seen.confidence > 0).mean() > 0.9
    assert (seen.confidence < 1).all()
    masks = np.full(rgb.shape[:2], -1, np.int64)
    masks[100:140, 50:120] = 0
    inside = find_blobs(rgb, masks=masks).xy
    assert len(inside) > 0
    assert ((inside >= [50, 100]) & (inside <= [120, 140])).all()


def test_centres_of_learned_objects_are_spots_too(rendered: Scene) -> None:
    network, _ = read_network(SHIPPED)
    rgb = read_rgb(rendered.images_root / rendered.splits.map[0])
    plain, seen = find_blobs(rgb), find_blobs(rgb, network)
    image = torch.from_numpy(rgb.astype(np.float32) / 255).permute(2, 0, 1)[None]
    centres = network.detect_objects(image)[0].xy.double().numpy()
    assert len(centres) > 0
    added = len(seen.xy) - len(plain.xy)
    assert 0 < added <= len(centres)
    # What a spot looks like stays its appearance, which the tracking compares.
    assert seen.detections.descriptors.shape[1] == plain.detections.descriptors.shape[1]


def run(*arguments: str) -> dict[str, Any]:
    answer = CliRunner().invoke(app, ["supplement", *arguments, "--json"])
    assert answer.exit_code == 0, answer.output
    parsed: dict[str, Any] = json.loads(answer.stdout)
    return parsed


@pytest.mark.thorough
def test_small_things_are_added_once_and_taken_out_again(rendered_copy: Path) -> None:
    folder = Scene.open(rendered_copy).map_path
    files = {file.name: sha256_of(file) for file in folder.iterdir()}
    first = run(str(rendered_copy))
    assert first["points"] > 0
    again = run(str(rendered_copy))
    assert again["points"] == first["points"]
    assert (
        again["diagnosis"]["before"]["points"] + first["points"]
        == (again["diagnosis"]["map"]["points"])
    )
    assert run(str(rendered_copy), "--remove") == {"removed": first["points"]}
    assert {file.name: sha256_of(file) for file in folder.iterdir()} == files
    refused = CliRunner().invoke(app, ["supplement", str(rendered_copy), "--remove"])
    assert refused.exit_code == 2
    assert "has no added points" in refused.output


def test_views_along_the_ground_are_refused(rendered: Scene) -> None:
    sparse_map = rendered.sparse_map()
    level = np.eye(4)
    level[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # looks north
    images = {
        name: replace(image, cam_from_world=level) for name, image in sparse_map.images.items()
    }
    with pytest.raises(InputError, match="no photograph looks down by 30 degrees"):
        supplement_points(
            replace(sparse_map, images=images),
            rendered.images_root,
            SupplementConfig(),
            read_classifier(),
        )
