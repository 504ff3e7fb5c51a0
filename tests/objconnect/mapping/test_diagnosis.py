"""A diagnosis of a rendered map says what its instance and depth images say."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from benchmark.cli import app
from objconnect.mapping.diagnosis.command import Diagnosis, diagnose
from objconnect.mapping.diagnosis.surface_distances import SurfaceDistances, read_truth
from objconnect.mapping.diagnosis.uniformity import uniformity
from objconnect.scene.bundle.manifest import write_json
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.bundle.supplement import SUPPLEMENT, AddedPoint, Supplement
from objconnect.scene.errors import InputError
from objconnect.scene.maps.colmap_files import read_point_ids

SESSION = "summer-noon-nadir-map"


@pytest.fixture(scope="module")
def diagnosis(rendered: Scene, tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    folder = tmp_path_factory.mktemp("diagnosed")
    return diagnose(Path(shutil.copytree(rendered.path, folder / "hamlet")))


def test_objects_have_the_points_that_photographs_show_on_them(
    rendered: Scene, diagnosis: Diagnosis
) -> None:
    """Counted anew: by the object at each observation's pixel, and by all pixels for the seen."""
    small = {o.id for o in rendered.objects.objects if o.size_class == "small"}
    sparse_map = rendered.sparse_map()
    seen: set[int] = set()
    votes: list[list[int]] = [[] for _ in sparse_map.xyz]
    with rendered.layers(SESSION) as dense:
        for k, name in enumerate(rendered.frames(SESSION).names):
            instance = dense.read("instance", k)
            seen |= set(np.unique(instance).tolist())
            image = sparse_map.images[name]
            for (x, y), row in zip(image.xy, image.point_rows, strict=True):
                if row >= 0:
                    votes[row].append(int(instance[int(y), int(x)]))
    with_points = {max(set(v), key=v.count) for v in votes} & small
    found = diagnosis.map.objects["small"]
    assert found.seen == len(seen & small)
    assert abs(found.with_points - len(with_points)) <= 1  # ties may go either way
    assert diagnosis.before is None
    assert diagnosis.added is None


def test_points_lie_near_the_surface_and_moved_ones_do_not(
    rendered: Scene, diagnosis: Diagnosis
) -> None:
    distances = diagnosis.map.surface_distances
    assert distances["all"].points == diagnosis.map.points
    assert distances["ground"].median_m is not None
    assert distances["ground"].median_m < 0.1
    sparse_map = rendered.sparse_map()
    lifted = replace(sparse_map, xyz=sparse_map.xyz + np.array([0, 0, 2.0]))
    truth, moved = read_truth(rendered, sparse_map), read_truth(rendered, lifted)
    assert truth is not None
    assert moved is not None
    ground = (truth.owners == 0) & (truth.distance_m < 0.1)
    # Streets are nearly flat: what was on them is two metres above them.
    assert np.median(moved.distance_m[ground]) == pytest.approx(2, abs=0.15)
    assert SurfaceDistances.of(moved.distance_m[ground]).close < 0.02


def test_infinite_distances_are_not_close() -> None:
    found = SurfaceDistances.of(np.array([0.1, 0.3, np.inf, np.inf]))
    assert (found.points, found.close, found.median_m) == (4, 0.5, pytest.approx(0.2))
    assert SurfaceDistances.of(np.array([np.inf])) == SurfaceDistances(1, 0.0, None, None)


def test_even_cover_has_all_the_entropy() -> None:
    cells = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    middle = (cells + 0.5) * 5.0
    even = uniformity(np.column_stack([middle, np.zeros(4)]), cells, 5.0)
    one = uniformity(np.full((9, 3), 2.0), cells, 5.0)
    outside = uniformity(np.full((9, 3), -20.0), cells, 5.0)
    assert even is not None
    assert (even.empty, even.entropy) == (0, pytest.approx(1))
    assert one is not None
    assert (one.empty, one.entropy) == (0.75, 0)
    assert outside is not None
    assert (outside.empty, outside.entropy) == (1, 0)
    assert uniformity(middle, np.zeros((0, 2), np.int64), 5.0) is None


def test_added_points_are_told_apart(rendered_copy: Path) -> None:
    scene = Scene.open(rendered_copy)
    sparse_map = scene.sparse_map()
    truth = read_truth(scene, sparse_map)
    assert truth is not None
    on_object, on_ground = (
        np.flatnonzero(truth.owners > 0)[:5],
        np.flatnonzero(truth.owners == 0)[:5],
    )
    ids = read_point_ids(scene.map_path)
    points = [AddedPoint(id=int(ids[k]), object=1, confidence=1) for k in (*on_object, *on_ground)]
    marks = Supplement(points=tuple(points), map_sha256="")
    write_json(scene.map_path / SUPPLEMENT, marks)
    diagnosis = diagnose(rendered_copy)
    assert diagnosis.before is not None
    assert diagnosis.before.points == diagnosis.map.points - 10
    # An added point on the ground stands for no object.
    assert diagnosis.added is not None
    assert diagnosis.added.points == 10
    assert diagnosis.added.close <= 0.5
    write_json(
        scene.map_path / SUPPLEMENT,
        Supplement(points=(AddedPoint(id=10**9, object=1, confidence=1),), map_sha256=""),
    )
    with pytest.raises(InputError, match="lists point 1000000000, which the map"):
        diagnose(rendered_copy)


def test_masks_stand_in_for_objects(rendered_copy: Path, tmp_path: Path) -> None:
    scene = Scene.open(rendered_copy)
    image = scene.sparse_map().images[scene.splits.map[0]]
    labels = np.zeros((image.camera.height, image.camera.width), np.uint8)
    x, y = image.xy[image.point_rows >= 0][0].astype(int)
    labels[y : y + 3, x : x + 3] = 1
    busy = {tuple(p) for p in image.xy[image.point_rows >= 0].astype(int).tolist()}
    bare = next(
        (row, column)
        for row in range(10, 300)
        for column in range(10, 300)
        if not busy & {(column + dx, row + dy) for dx in range(4) for dy in range(4)}
        and not labels[row : row + 4, column : column + 4].any()
    )
    labels[bare[0] : bare[0] + 4, bare[1] : bare[1] + 4] = 2
    folder = tmp_path / "masks"
    path = folder / Path(image.name).with_suffix(".png")
    path.parent.mkdir(parents=True)
    Image.fromarray(labels).save(path)
    (found,) = diagnose(rendered_copy, folder).map.masks.items()
    assert found[0] == "small"
    assert (found[1].seen, found[1].with_points) == (2, 1)
    Image.fromarray(labels[:50]).save(path)
    with pytest.raises(InputError, match="are 320 x 50 pixels"):
        diagnose(rendered_copy, folder)
    path.unlink()
    with pytest.raises(InputError, match="has masks of none"):
        diagnose(rendered_copy, folder)


def test_the_command_line_says_the_same(rendered_copy: Path, diagnosis: Diagnosis) -> None:
    answer = CliRunner().invoke(app, ["diagnose", str(rendered_copy), "--json"])
    assert answer.exit_code == 0
    said = json.loads(answer.stdout)
    assert said["map"]["objects"]["small"]["seen"] == diagnosis.map.objects["small"].seen
    assert Path(said["picture"]).is_file()
    answer = CliRunner().invoke(app, ["diagnose", str(rendered_copy / "map")])
    assert answer.exit_code == 2
