from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from objconnect.scene.bundle.covisibility import (
    Covisibility,
    mutual_overlap,
    read_covisibility,
    surface_points,
    visible_share,
    write_covisibility,
)
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera

# This camera sees 40 x 30 m of flat ground from 40 m.
CAMERA = Camera("PINHOLE", 80, 60, (80.0, 80.0, 40.0, 30.0))


def looking_down(east: float) -> np.ndarray:
    cam_from_world = np.diag([1.0, -1.0, -1.0, 1.0])
    cam_from_world[:3, 3] = -cam_from_world[:3, :3] @ [east, 0.0, 40.0]
    return cam_from_world


def test_surface_points_lie_on_the_ground_in_view() -> None:
    depth = np.full((60, 80), 40.0, np.float32)
    depth[:30] = 0  # the upper half is sky
    points = surface_points(CAMERA, looking_down(5.0), depth, per_side=4)
    seen = np.isfinite(points).all(1)
    assert seen.sum() == 8
    np.testing.assert_allclose(points[seen][:, 2], 0, atol=1e-9)
    assert np.abs(points[seen][:, 0] - 5).max() < 20
    assert (points[seen][:, 1] < 0).all()


def test_overlap_of_a_strip_of_flat_ground() -> None:
    poses = np.stack([looking_down(east) for east in (0.0, 10.0, 100.0)])
    depth = np.full((60, 80), 40.0, np.float32)
    points = np.stack([surface_points(CAMERA, pose, depth, 16) for pose in poses])
    shares = mutual_overlap([CAMERA] * 3, poses, points)
    assert shares[0, 1] == pytest.approx(0.75, abs=0.07)
    assert shares[0, 2] == shares[1, 2] == 0
    np.testing.assert_array_equal(shares, shares.T)
    np.testing.assert_array_equal(np.diag(shares), 0)


def test_a_picture_of_nothing_overlaps_nothing() -> None:
    poses = np.stack([looking_down(0.0)] * 2)
    points = np.full((2, 4, 3), np.nan)
    np.testing.assert_array_equal(mutual_overlap([CAMERA] * 2, poses, points), 0)


def depth_with_block() -> np.ndarray:
    """Depth of flat ground 40 m below, a sixth of it hidden by a block 15 m high."""
    depth = np.full((60, 80), 40.0, np.float32)
    depth[:, 40:54] = 25.0
    return depth


def test_what_is_hidden_is_not_seen() -> None:
    """The ground under a block is in the other frame's view but not seen by it."""
    poses = np.stack([looking_down(0.0), looking_down(0.0)])
    depths = [np.full((60, 80), 40.0, np.float32), depth_with_block()]
    points = np.stack([surface_points(CAMERA, poses[0], d, 40) for d in depths])
    shares = visible_share([CAMERA] * 2, poses, points, depths)
    hidden = (depths[1] == 25).mean()
    assert hidden > 0.05
    # The first sees all that the second sees: the top of the block lies before its ground.
    assert shares[1, 0] == 1
    assert shares[0, 1] == pytest.approx(1 - hidden, abs=0.03)
    assert mutual_overlap([CAMERA] * 2, poses, points)[0, 1] == 1


def test_covisibility_comes_back_from_disk(tmp_path: Path) -> None:
    overlap = np.array([[0, 0.75, 0], [0.25, 0, 0.05], [0, 0.5, 0]])
    path = tmp_path / "covisibility.h5"
    write_covisibility(path, Covisibility(("a", "b", "c"), overlap))
    back = read_covisibility(path)
    assert back.names == ("a", "b", "c")
    np.testing.assert_array_equal(back.overlap, overlap)
    with h5py.File(path) as file:
        assert file["pairs"][:].tolist() == [[0, 1]]
        assert file["share"][:].tolist() == [0.25]
    np.testing.assert_array_equal(back.select(["c", "b"]).overlap, [[0, 0.5], [0.05, 0]])
    with pytest.raises(InputError, match="lacks frame d"):
        back.select(["a", "d"])


def test_damaged_covisibility_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "covisibility.h5"
    with pytest.raises(InputError, match="does not exist"):
        read_covisibility(path)
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="is damaged"):
        read_covisibility(path)
    with h5py.File(path, "w") as file:
        file["names"], file["overlap"] = np.array([b"a", b"b"]), np.zeros((3, 3))
    with pytest.raises(InputError, match="2 frames has shape"):
        read_covisibility(path)


def test_covisibility_of_a_rendered_scene(rendered: Scene) -> None:
    """Neighbours of a flight share their ground; winter and summer show the same ground."""
    covisibility = rendered.covisibility
    frames = [name for s in rendered.sessions for name in rendered.frames(s).names]
    assert covisibility.names == tuple(frames)
    assert np.abs(np.diag(covisibility.overlap)).max() == 0
    mapped = covisibility.select(rendered.splits.map).mutual
    assert np.median(mapped.max(1)) > 0.4
    winter = rendered.splits.queries["winter-dusk-oblique-query"]
    rows = [frames.index(name) for name in winter]
    columns = [frames.index(name) for name in rendered.splits.map]
    assert covisibility.overlap[np.ix_(rows, columns)].max() > 0.1
