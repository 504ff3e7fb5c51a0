from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
import torch
from numpy.typing import NDArray

from objconnect.scene.colmap.absolute_pose import PnpResult, estimate_absolute_pose
from objconnect.scene.colmap.database import MappingJob
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.colmap.sift import SiftExtractor, extract_sift
from objconnect.scene.colmap.triangulation import triangulate
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Prior
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.maps.sparse_map import SparseMap

Array = NDArray[np.float64]
CAMERA = Camera("OPENCV", 640, 480, (500.0, 505.0, 322.0, 237.5, -0.1, 0.02, 1e-3, -5e-4))


@dataclass(frozen=True)
class Matches:
    """Make points seen by a camera that looks down obliquely from about 40 m."""

    pose: Pose
    xyz: Array
    xy: Array

    def solve(self, noise: float, seed: int = 0, prior: Prior | None = None) -> PnpResult | None:
        noisy = self.xy + np.random.default_rng(seed).normal(0, noise, self.xy.shape)
        return estimate_absolute_pose(noisy, self.xyz, CAMERA, 6.0, prior)


def make_matches(n: int, seed: int = 0) -> Matches:
    rng = np.random.default_rng(seed)
    pose = Pose.exp(torch.tensor([2.3, 0.6, -0.4, 60.0, -35.0, 42.0], dtype=torch.float64))
    xy = rng.uniform([0, 0], [CAMERA.width, CAMERA.height], (n, 2))
    rays, valid = CAMERA.unproject(torch.from_numpy(xy))
    assert valid.all()
    local = rays * torch.from_numpy(rng.uniform(30, 50, (n, 1)))
    return Matches(pose, pose.inverse().transform(local).numpy(), xy)


def test_exact_matches_give_the_exact_pose() -> None:
    matches = make_matches(50)
    result = matches.solve(0.0)
    assert result is not None
    metres, degrees = result.cam_from_world.error_to(matches.pose)
    assert metres < 1e-6
    assert degrees < 1e-6
    assert result.inliers.all()


def test_outliers_are_found_out() -> None:
    matches = make_matches(80)
    wrong = np.arange(80) < 40
    rng = np.random.default_rng(5)
    xy = matches.xy + rng.normal(0, 0.5, (80, 2))
    xy[wrong] = rng.uniform(0, 480, (40, 2))
    result = estimate_absolute_pose(xy, matches.xyz, CAMERA, 4.0)
    assert result is not None
    metres, degrees = result.cam_from_world.error_to(matches.pose)
    assert metres < 0.3
    assert degrees < 0.3
    assert result.inliers[~wrong].mean() > 0.95
    assert result.inliers[wrong].mean() < 0.1


def test_the_same_seed_gives_the_same_pose() -> None:
    matches = make_matches(60)
    xy = matches.xy.copy()
    xy[:40] = np.random.default_rng(1).uniform(0, 480, (40, 2))
    first, second = (estimate_absolute_pose(xy, matches.xyz, CAMERA, 4.0, seed=7) for _ in range(2))
    assert first is not None
    assert second is not None
    assert torch.equal(first.cam_from_world.matrix(), second.cam_from_world.matrix())
    assert np.array_equal(first.inliers, second.inliers)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_matches_have_no_pose(n: int) -> None:
    matches = make_matches(2)
    assert estimate_absolute_pose(matches.xy[:n], matches.xyz[:n], CAMERA, 4.0) is None


def test_matches_on_one_point_have_no_pose() -> None:
    matches = make_matches(30)
    xyz = np.repeat(matches.xyz[:1], 30, axis=0)
    assert estimate_absolute_pose(matches.xy, xyz, CAMERA, 1.0) is None


def test_a_pose_without_redundancy_claims_no_covariance() -> None:
    """Any three matches fit some pose exactly, so there is no covariance."""
    matches = make_matches(3)
    result = estimate_absolute_pose(matches.xy, matches.xyz, CAMERA, 4.0)
    assert result is not None
    assert result.covariance is None


def errors_and_covariances(
    runs: int, matches: Matches, noise: float, sigma: Array | None = None
) -> tuple[Array, Array]:
    """Return tangents from estimate to truth (runs, 6) and the covariances (runs, 6, 6)."""
    errors, covariances = [], []
    centre = matches.pose.centre().numpy()
    for seed in range(runs):
        prior = None
        if sigma is not None:
            measured = centre + np.random.default_rng(9000 + seed).normal(0, sigma)
            prior = Prior(measured, sigma)
        result = matches.solve(noise, seed, prior)
        assert result is not None
        assert result.covariance is not None
        errors.append((matches.pose @ result.cam_from_world.inverse()).log().numpy())
        covariances.append(result.covariance)
    return np.array(errors), np.array(covariances)


def nees(errors: Array, covariances: Array) -> float:
    """Return the mean normalised squared error: the dimension, if the covariance is right."""
    return float(np.einsum("ri,rij,rj->r", errors, np.linalg.inv(covariances), errors).mean())


def test_covariance_is_honest() -> None:
    matches = make_matches(40)
    errors, covariances = errors_and_covariances(200, matches, noise=0.6)
    assert 4.5 < nees(errors, covariances) < 7.5
    claimed = np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2).mean())
    assert claimed == pytest.approx(np.sqrt((errors[:, :3] ** 2).sum(1).mean()), rel=0.25)
    # To first order the centre moves by -R^T v, so its standard deviation is that of v.
    claimed = np.sqrt(np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2).mean())
    rotation = matches.pose.rotation.numpy()
    moved = errors[:, 3:] @ rotation
    assert claimed == pytest.approx(np.sqrt((moved**2).sum(1).mean()), rel=0.25)


@pytest.mark.parametrize(
    ("noise", "sigma"),
    [
        (0.3, 0.5),
        (1.5, 0.02),
        pytest.param(0.3, 0.02, marks=pytest.mark.thorough),
        pytest.param(1.5, 0.5, marks=pytest.mark.thorough),
    ],
)
def test_covariance_is_honest_with_a_position_prior(noise: float, sigma: float) -> None:
    errors, covariances = errors_and_covariances(
        200, make_matches(25), noise, np.array([sigma, sigma, 20 * sigma])
    )
    assert 4.5 < nees(errors, covariances) < 7.5


def test_a_position_prior_steadies_few_noisy_matches() -> None:
    matches = make_matches(8)
    sigma = np.full(3, 0.05)
    alone, _ = errors_and_covariances(40, matches, noise=1.5)
    helped, _ = errors_and_covariances(40, matches, 1.5, sigma)
    spread_alone, spread_helped = (np.sqrt((e[:, 3:] ** 2).sum(1).mean()) for e in (alone, helped))
    assert spread_alone > 0.3
    assert spread_helped < 0.12


def test_a_prior_of_no_known_sigma_changes_nothing() -> None:
    matches = make_matches(20)
    with_prior = matches.solve(1.0, prior=Prior(np.array([1e3, 1e3, 1e3])))
    without = matches.solve(1.0)
    assert with_prior is not None
    assert without is not None
    assert torch.equal(with_prior.cam_from_world.matrix(), without.cam_from_world.matrix())


@pytest.mark.parametrize("sigma", [2.0, np.inf])
def test_a_position_that_contradicts_the_matches_takes_no_part(sigma: float) -> None:
    """A position that contradicts the matches, or has no weight, does not change the pose."""
    matches = make_matches(20)
    far = matches.pose.centre().numpy() + np.array([1000.0, 0, 0])
    with_prior = matches.solve(1.0, prior=Prior(far, np.full(3, sigma)))
    without = matches.solve(1.0)
    assert with_prior is not None
    assert without is not None
    metres, _ = with_prior.cam_from_world.error_to(without.cam_from_world)
    assert metres < 1e-4


def test_a_prior_said_to_be_perfect_is_taken_at_its_word() -> None:
    matches = make_matches(20)
    position = matches.pose.centre().numpy()
    result = matches.solve(1.0, prior=Prior(position, np.zeros(3)))
    assert result is not None
    assert np.linalg.norm(result.cam_from_world.centre().numpy() - position) < 0.01


# Rendered photographs of a plane: the truth is exact and no file is needed.


def draw_texture(seed: int, size: int) -> NDArray[np.uint8]:
    """Make noise at several scales, which gives SIFT many keypoints, (size, size, 3)."""
    rng = np.random.default_rng(seed)
    layers = [
        cv2.resize(rng.random((size // step, size // step, 3)), (size, size)) / 4
        for step in (2, 8, 16, 32)
    ]
    return np.asarray(255 * sum(layers), np.uint8)


PHOTO = Camera("PINHOLE", 320, 240, (260.0, 260.0, 160.0, 120.0))


@pytest.fixture(scope="module")
def plane_flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[PosedImage]]:
    """Render four photographs of a textured plane, 60 m wide, from 20 m, with exact poses."""
    root = tmp_path_factory.mktemp("plane")
    texture = draw_texture(0, 1200)
    world_from_texel = np.array([[0.05, 0, -30], [0, -0.05, 30], [0, 0, 1]])
    images = []
    for k, (east, north, tilt) in enumerate(
        [(-2, 0, 0.05), (0, 1, 0.0), (2, -1, -0.05), (0, -3, 0.1)]
    ):
        turn = Pose.exp(torch.tensor([tilt, -tilt, 0.2 * k, 0, 0, 0], dtype=torch.float64))
        rotation = turn.rotation.numpy() @ np.diag([1.0, -1.0, -1.0])
        cam_from_world = np.eye(4)
        cam_from_world[:3, :3] = rotation
        cam_from_world[:3, 3] = -rotation @ [east, north, 20 + k]
        pixel_from_plane = PHOTO.calibration @ cam_from_world[:3][:, [0, 1, 3]]
        half = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])  # from COLMAP's pixels to OpenCV's
        photo = cv2.warpPerspective(
            texture,
            half @ pixel_from_plane @ world_from_texel @ np.linalg.inv(half),
            (PHOTO.width, PHOTO.height),
        )
        cv2.imwrite(str(root / f"{k}.png"), photo)
        images.append(PosedImage(f"{k}.png", PHOTO, cam_from_world))
    return root, images


PAIRS = [("0.png", "1.png"), ("1.png", "2.png"), ("0.png", "2.png"), ("1.png", "3.png")]


@pytest.fixture(scope="module")
def plane_map(
    plane_flight: tuple[Path, list[PosedImage]], tmp_path_factory: pytest.TempPathFactory
) -> tuple[SparseMap, Path]:
    root, images = plane_flight
    out = tmp_path_factory.mktemp("map")
    sparse_map, features = triangulate(
        MappingJob(root, PAIRS, SiftOptions(max_features=800), images=images), out
    )
    assert set(features) == set(sparse_map.images)
    return sparse_map, out


def test_triangulated_points_lie_on_the_plane(plane_map: tuple[SparseMap, Path]) -> None:
    sparse_map, _ = plane_map
    assert len(sparse_map.xyz) > 200
    assert np.median(np.abs(sparse_map.xyz[:, 2])) < 0.05
    assert sparse_map.reprojection_error() < 1


def test_triangulation_leaves_poses_and_cameras(
    plane_flight: tuple[Path, list[PosedImage]], plane_map: tuple[SparseMap, Path]
) -> None:
    sparse_map, _ = plane_map
    for image in plane_flight[1]:
        mapped = sparse_map.images[image.name]
        np.testing.assert_allclose(mapped.cam_from_world, image.cam_from_world, atol=1e-9)
        assert mapped.camera == image.camera


def test_triangulated_model_is_one_colmap_reads(plane_map: tuple[SparseMap, Path]) -> None:
    sparse_map, out = plane_map
    native = pycolmap.Reconstruction(out)
    assert native.num_reg_images() == 4
    assert native.num_points3D() == len(sparse_map.xyz)
    assert read_model(out).sha256 == sparse_map.sha256


def test_photographs_without_overlap_have_no_map(
    plane_flight: tuple[Path, list[PosedImage]], tmp_path: Path
) -> None:
    _, images = plane_flight
    (tmp_path / "out").mkdir()
    for k in range(2):
        cv2.imwrite(str(tmp_path / f"{k}.png"), draw_texture(10 + k, 320)[:240])
    with pytest.raises(InputError, match="no point could be triangulated from the 2 images"):
        triangulate(
            MappingJob(tmp_path, PAIRS[:1], SiftOptions(400), images=images[:2]), tmp_path / "out"
        )


def test_batch_extraction_equals_one_image_at_a_time(
    plane_flight: tuple[Path, list[PosedImage]],
) -> None:
    root, _ = plane_flight
    options = SiftOptions(max_features=300)
    batch = extract_sift(root, ["1.png", "0.png"], options)
    assert set(batch) == {"0.png", "1.png"}
    single = SiftExtractor(options)(cv2.imread(str(root / "0.png"))[..., ::-1])
    np.testing.assert_allclose(batch["0.png"].xy, single.xy, atol=1e-4)
    np.testing.assert_allclose(batch["0.png"].scale, single.scale, rtol=1e-4)
    np.testing.assert_array_equal(batch["0.png"].descriptors, single.descriptors)


def test_keypoints_count_pixels_from_the_corner() -> None:
    """A blob centred on the centre of pixel (60, 40) lies at (60.5, 40.5)."""
    x, y = np.meshgrid(np.arange(160), np.arange(120))
    blob = 40 + 200 * np.exp(-((x - 60) ** 2 + (y - 40) ** 2) / (2 * 4.0**2))
    features = SiftExtractor(SiftOptions())(np.repeat(blob[..., None], 3, 2).astype(np.uint8))
    nearest = np.abs(features.xy - [60.5, 40.5]).max(1).min()
    assert nearest < 0.1


def test_a_blank_image_has_no_features() -> None:
    features = SiftExtractor(SiftOptions())(np.full((120, 160, 3), 128, np.uint8))
    assert features.xy.shape == (0, 2)
    assert features.scale.shape == (0,)
    assert features.descriptors.shape == (0, 128)


@pytest.mark.parametrize("content", [None, b"not an image"], ids=["missing", "damaged"])
def test_an_image_that_cannot_be_read_is_named(
    plane_flight: tuple[Path, list[PosedImage]], tmp_path: Path, content: bytes | None
) -> None:
    shutil.copy(plane_flight[0] / "0.png", tmp_path)
    if content is not None:
        (tmp_path / "1.png").write_bytes(content)
    with pytest.raises(InputError, match=r"1\.png"):
        extract_sift(tmp_path, ["0.png", "1.png"], SiftOptions())
    with pytest.raises(InputError, match=r"1\.png"):
        triangulate(
            MappingJob(tmp_path, PAIRS[:1], SiftOptions(), images=plane_flight[1][:2]), tmp_path
        )


def test_more_images_than_one_call_of_the_extractor_takes(
    plane_flight: tuple[Path, list[PosedImage]], tmp_path: Path
) -> None:
    names = [f"{k:02d}.png" for k in range(18)]
    for name in names:
        cv2.imwrite(str(tmp_path / name), cv2.imread(str(plane_flight[0] / "0.png"))[:48, :64])
    done: list[int] = []
    features = extract_sift(tmp_path, names, SiftOptions(), done.append)
    assert sorted(features) == names
    assert done == sorted(done)
    assert done[-1] == 18
    for name in names:
        np.testing.assert_array_equal(features[name].descriptors, features["00.png"].descriptors)


def test_triangulation_repeats_itself_and_keeps_one_camera_for_all(
    plane_flight: tuple[Path, list[PosedImage]],
    plane_map: tuple[SparseMap, Path],
    tmp_path: Path,
) -> None:
    root, images = plane_flight
    again, _ = triangulate(
        MappingJob(root, PAIRS, SiftOptions(max_features=800), images=images), tmp_path
    )
    assert again.sha256 == plane_map[0].sha256
    assert pycolmap.Reconstruction(tmp_path).num_cameras() == 1
