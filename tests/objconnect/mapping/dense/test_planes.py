from __future__ import annotations

import numpy as np
import torch

from objconnect.mapping.dense.planes import (
    move,
    normals_of,
    planes_at_nearest,
    planes_of,
    planes_through,
    resize,
)
from tests.objconnect.mapping.dense.made_views import CAMERA, PLANE, REFERENCE, inverse_depth_at


def true_planes() -> torch.Tensor:
    w = inverse_depth_at(REFERENCE)
    gx = (w[:, 1:] - w[:, :-1]).mean().expand_as(w)
    gy = (w[1:] - w[:-1]).mean().expand_as(w)
    return torch.stack([w, gx, gy])


def test_a_plane_is_linear_in_inverse_depth() -> None:
    planes = true_planes()
    shifted = move(planes[:, :-2, :-3], 3, 2)
    assert torch.allclose(shifted, planes[:, 2:, 3:], rtol=0, atol=1e-14)


def test_normals_face_the_camera() -> None:
    normals = normals_of(true_planes(), CAMERA)
    expected = -PLANE / PLANE.norm()  # the reference stands at the origin, unturned
    assert torch.allclose(normals, expected[:, None, None].expand_as(normals), atol=1e-10)


def test_planes_of_depth_and_normals_are_the_planes() -> None:
    planes = true_planes()
    back = planes_of(1 / planes[0], normals_of(planes, CAMERA), CAMERA)
    assert torch.allclose(back, planes, rtol=1e-9, atol=1e-14)


def test_resizing_stays_on_the_plane() -> None:
    """Also to a size that is not a multiple."""
    planes = true_planes()
    small = resize(planes, 27, 41)
    assert small.shape == (3, 27, 41)
    assert torch.allclose(resize(small, *planes.shape[1:]), planes, rtol=1e-6, atol=1e-9)


def test_planes_through_seeds_of_one_plane() -> None:
    w = inverse_depth_at(REFERENCE)
    rng = np.random.default_rng(0)
    rows, columns = rng.integers(0, 80, 60), rng.integers(0, 96, 60)
    seeds = np.column_stack([columns + 0.5, rows + 0.5, w[rows, columns].numpy()])
    fitted, nearest = planes_through(seeds, 80, 96), planes_at_nearest(seeds, 80, 96)
    error = (fitted[0] / w - 1).abs()
    assert error.median() < 0.002
    assert error.max() < 0.05  # in the corners, beyond the seeds
    assert (nearest[0] / w - 1).abs().median() < 0.05
    assert torch.equal(nearest[1:], torch.zeros_like(nearest[1:]))


def test_a_single_seed_is_enough() -> None:
    seed = np.array([[3.0, 4.0, 0.02]])
    fitted, nearest = planes_through(seed, 8, 9), planes_at_nearest(seed, 8, 9)
    assert torch.allclose(nearest[0], torch.tensor(0.02))
    assert torch.isfinite(fitted).all()


def test_the_nearest_seed_is_the_nearest() -> None:
    rng = np.random.default_rng(1)
    rows, columns = rng.permutation(40)[:12], rng.permutation(50)[:12]
    seeds = np.column_stack([columns + 0.5, rows + 0.5, rng.uniform(0.01, 0.02, 12)])
    nearest = planes_at_nearest(seeds, 40, 50)
    x, y = np.meshgrid(np.arange(50) + 0.5, np.arange(40) + 0.5)
    away = np.hypot(x[..., None] - seeds[:, 0], y[..., None] - seeds[:, 1])
    shown = np.abs(nearest[0].numpy()[..., None] - seeds[:, 2]).argmin(-1)
    picked = np.take_along_axis(away, shown[..., None], -1)[..., 0]
    # Distances are counted in steps of pixels: where two are about as far, either will do.
    assert (picked <= 1.03 * away.min(-1) + 1e-6).all()
    assert not nearest[1:].any()
