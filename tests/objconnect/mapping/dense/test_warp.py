from __future__ import annotations

import torch

from objconnect.mapping.dense.warp import Warp, round_trip
from tests.objconnect.mapping.dense.made_views import CAMERA, REFERENCE, SOURCES, inverse_depth_at

SOURCE = SOURCES[0]
THERE, BACK = Warp.between(REFERENCE, SOURCE), Warp.between(SOURCE, REFERENCE)
X, Y = CAMERA.pixel_grid().unbind(-1)


def test_it_is_the_projection() -> None:
    w = inverse_depth_at(REFERENCE)
    rays, _ = CAMERA.unproject(CAMERA.pixel_grid())
    world = torch.linalg.inv(torch.from_numpy(REFERENCE.cam_from_world))
    relative = torch.from_numpy(SOURCE.cam_from_world) @ world
    local = (rays / w[..., None]) @ relative[:3, :3].T + relative[:3, 3]
    expected = CAMERA.project(local)
    at = THERE(X, Y, w)
    assert torch.allclose(torch.stack([at.u, at.v], -1), expected.xy, atol=1e-9)
    assert torch.allclose(at.z / w, local[..., 2], atol=1e-9)
    assert torch.equal(at.seen, expected.valid & CAMERA.contains(expected.xy))


def test_slopes_are_derivatives_along_the_plane() -> None:
    w = inverse_depth_at(REFERENCE)
    gx, gy = w[0, 1] - w[0, 0], w[1, 0] - w[0, 0]
    at = THERE(X, Y, w)
    step = 1e-4
    right, down = THERE(X + step, Y, w + gx * step), THERE(X, Y + step, w + gy * step)
    expected = [(q - p) / step for p, q in (
        (at.u, right.u), (at.u, down.u), (at.v, right.v), (at.v, down.v))]  # fmt: skip
    for slope, numeric in zip(THERE.slopes(at, gx, gy), expected, strict=True):
        assert torch.allclose(slope, numeric, atol=1e-4)


def test_true_depths_come_home() -> None:
    w = inverse_depth_at(REFERENCE)
    pixels, share = round_trip(THERE, BACK, inverse_depth_at(SOURCE), X, Y, w)
    seen = THERE(X, Y, w).seen
    assert 0.5 < seen.double().mean() < 1
    assert pixels[seen].max() < 0.1  # the other map is read at its nearest pixel
    assert share[seen].abs().max() < 0.02
    assert torch.isinf(pixels[~seen]).all()


def test_wrong_and_unknown_depths_do_not() -> None:
    w = inverse_depth_at(REFERENCE)
    off, _ = round_trip(THERE, BACK, inverse_depth_at(SOURCE), X, Y, 1.2 * w)
    seen = torch.isfinite(off)
    assert off[seen].min() > 1.0
    unknown, _ = round_trip(THERE, BACK, torch.zeros(80, 96), X, Y, w)
    assert torch.isinf(unknown).all()


def test_a_point_behind_the_other_camera_is_not_seen() -> None:
    assert not THERE(X, Y, torch.full_like(X, -1.0)).seen.any()
