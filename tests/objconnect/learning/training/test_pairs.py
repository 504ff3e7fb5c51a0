from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from objconnect.learning.training.augment import augment
from objconnect.learning.training.crops import crop
from objconnect.learning.training.pairs import Pair, Pinhole, collate
from objconnect.learning.training.planes import PlanePairs
from objconnect.learning.training.rendered import RenderedPairs
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError

SIZE, POINTS = 128, 96


def generator(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pictures of blobs of many sizes."""
    folder = tmp_path_factory.mktemp("photographs")
    for number in range(2):
        rng = generator(number)
        picture = sum(
            cv2.resize(rng.uniform(0, 1, (n, n, 3)), (400, 300), interpolation=cv2.INTER_CUBIC)
            for n in (6, 24, 96)
        )
        cv2.imwrite(str(folder / f"{number}.png"), np.clip(picture * 85, 0, 255).astype(np.uint8))
    return folder


def colours(image: NDArray[np.uint8], xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Grey values at pixels, (N,)."""
    blurred = cv2.GaussianBlur(image.mean(2).astype(np.float32), (0, 0), 1.0)
    where = (xy - 0.5).astype(np.float32)
    return cv2.remap(blurred, where[None, :, 0], where[None, :, 1], cv2.INTER_LINEAR)[0]


def agreement(pair: Pair) -> float:
    """Correlation of what the two images show at corresponding pixels."""
    a, b = colours(pair.image_a, pair.xy_a), colours(pair.image_b, pair.xy_b)
    return float(np.corrcoef(a[pair.valid], b[pair.valid])[0, 1])


def assert_consistent(pair: Pair) -> None:
    """Points, pixels and the relative pose tell the same story."""
    np.testing.assert_allclose(pair.camera_a.project(pair.points), pair.xy_a, atol=1e-6)
    in_b = pair.points @ pair.b_from_a[:3, :3].T + pair.b_from_a[:3, 3]
    np.testing.assert_allclose(pair.camera_b.project(in_b), pair.xy_b, atol=1e-6)
    assert pair.image_a.shape == pair.image_b.shape == (SIZE, SIZE, 3)
    assert pair.valid.sum() >= 64
    for xy in (pair.xy_a, pair.xy_b):
        assert xy.min() >= 4
        assert xy.max() <= SIZE - 4


def test_planes_are_seen_where_the_poses_say(photographs: Path) -> None:
    source = PlanePairs([photographs], SIZE, POINTS, 0.0)
    for seed in range(5):
        pair = source.draw(generator(seed))
        assert_consistent(pair)
        assert agreement(pair) > 0.97


def test_rendered_frames_are_cut_where_the_poses_say(rendered: Scene) -> None:
    source = RenderedPairs([rendered], SIZE, POINTS, 0.0)
    pairs = [source.draw(generator(seed)) for seed in range(12)]
    for pair in pairs:
        assert_consistent(pair)
    # Two in three cross from summer to winter, where colours agree less.
    wrong = [agreement(p._replace(xy_b=np.roll(p.xy_b, 7, 0))) for p in pairs]
    right = [agreement(pair) for pair in pairs]
    assert np.mean(right) > np.mean(wrong) + 0.25


def test_starts_are_wrong_but_near(rendered: Scene) -> None:
    source = RenderedPairs([rendered], SIZE, POINTS, 0.0)
    for seed in range(5):
        pair = source.draw(generator(seed))
        apart = pair.start @ np.linalg.inv(pair.b_from_a)
        degrees = np.degrees(np.arccos(np.clip((np.trace(apart[:3, :3]) - 1) / 2, -1, 1)))
        depth = np.median(pair.points[:, 2])
        assert 0 < degrees <= 10
        assert 0 < np.linalg.norm(apart[:3, 3]) <= 0.081 * depth


def test_the_same_seed_draws_the_same_pair(rendered: Scene) -> None:
    first, second = (
        RenderedPairs([rendered], SIZE, POINTS, 0.5).draw(generator(3)) for _ in range(2)
    )
    np.testing.assert_array_equal(first.image_a, second.image_a)
    np.testing.assert_array_equal(first.points, second.points)


@pytest.mark.parametrize(
    ("scale", "angle"), [(2.0, 0.0), (1.0, np.pi / 2), (0.7, -2.3), (1.4, 0.6)]
)
def test_crops_move_and_turn_and_scale_the_camera(scale: float, angle: float) -> None:
    image = np.zeros((100, 120, 3), np.uint8)
    image[40:44, 60:64] = 255
    camera = Pinhole(np.full(2, 80.0), np.array([61.0, 48.0]))
    point = camera.lift(np.array([[62.0, 42.0]]), np.array([3.0]))
    cut = crop(image, camera, np.array([58.0, 46.0]), scale, 64, angle)
    x, y = cut.camera.project(point @ cut.crop_from_camera[:3, :3].T)[0]
    rows, columns = np.nonzero(cut.image.max(2) > 120)
    assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx((x, y), abs=0.4)
    assert np.linalg.det(cut.crop_from_camera) == pytest.approx(1)


def test_crops_of_different_flights_have_one_up(rendered: Scene) -> None:
    """Whatever way the frames were flown, their crops are turned alike to a few degrees."""
    source = RenderedPairs([rendered], SIZE, POINTS, 0.0)
    for seed in range(12):
        R = source.draw(generator(seed)).b_from_a[:3, :3]
        assert abs(np.degrees(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]))) < 15


def test_light_moves_nothing(photographs: Path) -> None:
    image = cv2.imread(str(photographs / "0.png"))
    assert image is not None
    changed = augment(image.astype(np.uint8), generator(0))
    assert changed.shape == image.shape
    assert not np.array_equal(changed, image)
    np.testing.assert_array_equal(augment(image.astype(np.uint8), generator(0), 0.0), image)


def test_batches_project_as_pairs_do(rendered: Scene) -> None:
    source = RenderedPairs([rendered], SIZE, POINTS, 0.0)
    batch = collate([source.draw(generator(seed)) for seed in range(3)])
    seen = batch.intrinsics_b.project(batch.b_from_a.transform(batch.points))
    assert torch.allclose(seen.xy, batch.xy_b, atol=1e-2)
    assert batch.image_a.shape == (3, 3, SIZE, SIZE)
    assert batch.image_a.max() <= 1


def test_a_folder_without_photographs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no photographs"):
        PlanePairs([tmp_path], SIZE, POINTS, 0.0)
