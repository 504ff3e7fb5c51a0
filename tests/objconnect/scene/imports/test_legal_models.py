"""Random legal files of other programs: the truth, or an error that names the field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.geodesy import enu_axes, enu_from_geodetic
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.imports.formats import read_foreign
from tests.objconnect.scene.imports.made_models import WRITERS, Truth

FILES = 130


def same(path: Path, truth: Truth) -> bool:
    """Read a file; whether every pose, place and pixel is that of the truth."""
    poses = read_foreign(path)
    assert sorted(poses.names) == sorted(truth.names)
    assert (poses.origin is not None) == truth.placed
    shift, turn = np.zeros(3), np.eye(3)
    if poses.origin is not None:
        shift = enu_from_geodetic(poses.origin, truth.origin)
        turn = enu_axes(truth.origin) @ enu_axes(poses.origin).T
    row = {name: k for k, name in enumerate(poses.names)}
    for name, world_from_cam in zip(truth.names, truth.world_from_cam, strict=True):
        point = world_from_cam[:3, :3] @ (60 * truth.ray()) + world_from_cam[:3, 3]
        there = torch.from_numpy(turn.T @ (point - shift))[None]
        camera = poses.cameras[row[name]]
        assert camera is not None
        pose = Pose.from_matrix(poses.cam_from_world[row[name]])
        seen = camera.project(pose.transform(there))
        if not np.allclose(seen.xy[0].numpy(), truth.pixel(), atol=2e-3):
            return False
        centre = turn @ poses.positions[row[name]] + shift
        if not np.allclose(centre, world_from_cam[:3, 3], atol=2e-3):
            return False
    return True


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_is_read_right_or_named(kind: str, tmp_path: Path) -> None:
    right = 0
    for seed in range(FILES):
        folder = tmp_path / str(seed)
        folder.mkdir()
        path, truth = WRITERS[kind](np.random.default_rng(seed), folder)
        try:
            found = same(path, truth)
        except InputError as error:
            assert any(field in str(error) for field in truth.fields), (seed, truth.fields, error)
            continue
        assert found, (seed, truth.lens, truth.fields)
        right += 1
    assert right > FILES / 3
