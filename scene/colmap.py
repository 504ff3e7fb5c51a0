"""The one module that speaks to pycolmap, whose interface changes between releases.

Written for pycolmap 4.2.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
import torch
from numpy.typing import NDArray

from scene.camera import Camera
from scene.colmap_files import read_model
from scene.errors import InputError
from scene.features import Features
from scene.pose import Pose, transform_jacobian
from scene.sparse_map import SparseMap

VERSION: str = pycolmap.__version__

# Images and pairs per call of COLMAP: enough to keep the cores busy, few enough to show progress.
_CHUNK = 16
_PAIR_CHUNK = 64

# Matches that determine a pose: their residuals are zero, whatever the matches are.
_MINIMAL = 3

# A condition number beyond which nothing is left of double precision.
_SINGULAR = 1e15
# Matches whose residuals say nothing, or too little to be true, are taken to be this exact (px^2).
_LEAST_VARIANCE = 0.01
# No GNSS is better than this (m); a sigma of zero would leave nothing to solve for.
_LEAST_SIGMA = 1e-3

# COLMAP logs every step on standard error; a person reads our progress bar instead.
pycolmap.logging.minloglevel = pycolmap.logging.ERROR

Progress = Callable[[int], None]


def read_map(folder: Path) -> SparseMap:
    """Read a binary COLMAP model; see ``read_model`` for what is refused.

    Raises:
        InputError: missing, damaged or empty.
    """
    return read_model(folder)


@dataclass(frozen=True)
class SiftOptions:
    """COLMAP's SIFT: difference of Gaussians, RootSIFT (L1-root) descriptors."""

    max_features: int = 8192
    peak_threshold: float = 0.02 / 3
    upright: bool = False

    def native(self) -> pycolmap.FeatureExtractionOptions:
        options = pycolmap.FeatureExtractionOptions()
        options.use_gpu = False
        options.sift.max_num_features = self.max_features
        options.sift.peak_threshold = self.peak_threshold
        options.sift.upright = self.upright
        return options


class SiftExtractor:
    """Extracts SIFT from one image at a time."""

    def __init__(self, options: SiftOptions) -> None:
        self._native = pycolmap.FeatureExtractor.create(options.native(), pycolmap.Device.cpu)

    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        """Features of an (H, W, 3) uint8 image."""
        grey = pycolmap.Bitmap.from_array(np.ascontiguousarray(rgb)).clone_as_grey()
        keypoints, descriptors = self._native.extract(grey)
        x, y, scale, _ = pycolmap.keypoints_to_matrix(keypoints).T
        return Features(np.stack([x, y], -1), scale.copy(), np.array(descriptors.data))


def extract_sift(
    root: Path,
    names: Sequence[str],
    options: SiftOptions,
    database: Path | None = None,
    cameras: Mapping[str, Camera] | None = None,
    on_progress: Progress | None = None,
) -> dict[str, Features]:
    """SIFT of many images on all cores.

    Args:
        root: folder the names are relative to.
        names: images.
        options: of the detector.
        database: where to leave COLMAP's database, or None to leave none.
        cameras: calibration by name for the database; COLMAP guesses when absent.
        on_progress: called with the number of images done.

    Raises:
        InputError: an image is missing or cannot be read.
    """
    with tempfile.TemporaryDirectory(prefix="objconnect-") as scratch:
        target = database or Path(scratch) / "database.db"
        groups: dict[Camera | None, list[str]] = {}
        for name in names:
            groups.setdefault(cameras[name] if cameras else None, []).append(name)
        done = 0
        for camera, members in groups.items():
            reader = pycolmap.ImageReaderOptions()
            mode = pycolmap.CameraMode.AUTO
            for start in range(0, len(members), _CHUNK):
                if camera is not None:
                    mode = pycolmap.CameraMode.SINGLE
                    reader.camera_model = camera.model
                    reader.camera_params = ",".join(repr(p) for p in camera.params)
                chunk = members[start : start + _CHUNK]
                pycolmap.extract_features(
                    target,
                    root,
                    chunk,
                    camera_mode=mode,
                    reader_options=reader,
                    extraction_options=options.native(),
                    device=pycolmap.Device.cpu,
                )
                if camera is not None and start == 0:
                    # The first chunk creates the camera; later ones join it by its identifier.
                    reader.existing_camera_id = _newest_camera(target)
                done += len(chunk)
                if on_progress is not None:
                    on_progress(done)
        features = _read_features(target, root)
    for name in names:
        if name not in features:
            raise InputError(f"image {root / name} is missing or cannot be read")
    return features


def _newest_camera(database: Path) -> int:
    with pycolmap.Database.open(database) as db:
        return max((camera.camera_id for camera in db.read_all_cameras()), default=-1)


def _read_features(database: Path, root: Path) -> dict[str, Features]:
    features = {}
    with pycolmap.Database.open(database) as db:
        for image in db.read_all_images():
            if not db.exists_keypoints(image.image_id):
                raise InputError(f"image {root / image.name} cannot be read or is damaged")
            # Rows are x y and a 2x2 affine shape, whose determinant is the squared scale.
            rows = db.read_keypoints(image.image_id)
            scale = np.sqrt(np.abs(np.linalg.det(rows[:, 2:].reshape(-1, 2, 2))))
            descriptors = np.array(db.read_descriptors(image.image_id).data)
            features[image.name] = Features(rows[:, :2].copy(), scale, descriptors)
    return features


@dataclass(frozen=True)
class PnpResult:
    """A pose from 2D-3D matches.

    Attributes:
        cam_from_world: refined on the inliers.
        inliers: (N,) bool.
        covariance: (6, 6) of the left tangent of ``cam_from_world`` (rotation rad, translation
            m), scaled by the inliers' own residuals; None where the problem is singular or has
            no more matches than it needs.
    """

    cam_from_world: Pose
    inliers: NDArray[np.bool_]
    covariance: NDArray[np.float64] | None


def estimate_absolute_pose(
    xy: NDArray[np.float64],
    xyz: NDArray[np.float64],
    camera: Camera,
    max_error: float,
    position: NDArray[np.float64] | None = None,
    position_sigma: NDArray[np.float64] | None = None,
    seed: int = 0,
) -> PnpResult | None:
    """LO-RANSAC P3P and non-linear refinement; None when no pose has support.

    Args:
        xy: (N, 2) pixels.
        xyz: (N, 3) world metres.
        camera: of the query.
        max_error: inlier threshold, pixels.
        position: (3,) camera centre measured by GNSS, world metres.
        position_sigma: (3,) its standard deviation per axis, metres; with it the position takes
            part in the refinement, weighed against the inliers' own residuals.
        seed: of the sampling; the same seed gives the same pose.
    """
    estimation = pycolmap.AbsolutePoseEstimationOptions()
    estimation.ransac.max_error = max_error
    estimation.ransac.random_seed = seed
    refinement = pycolmap.AbsolutePoseRefinementOptions()
    native = _native_camera(camera)
    answer = pycolmap.estimate_and_refine_absolute_pose(xy, xyz, native, estimation, refinement)
    if answer is None:
        return None
    inliers = np.asarray(answer["inlier_mask"], bool)
    pose = _pose_from_native(answer["cam_from_world"])
    variance = _residual_variance(xy[inliers], xyz[inliers], camera, pose)
    sigma = None
    if position is not None and position_sigma is not None:
        sigma = np.maximum(position_sigma, _LEAST_SIGMA)
        refinement.use_position_prior = True
        refinement.position_prior_in_world = position
        # COLMAP takes every residual to be one pixel: in that unit sigma is smaller or larger.
        refinement.position_prior_covariance = np.diag(sigma**2) / variance
        refined = pycolmap.refine_absolute_pose(
            answer["cam_from_world"], xy, xyz, inliers, native, refinement
        )
        if refined is not None:
            pose = _pose_from_native(refined["cam_from_world"])
    covariance = None
    if inliers.sum() > _MINIMAL:
        covariance = _pose_covariance(xyz[inliers], camera, pose, variance, sigma)
    return PnpResult(pose, inliers, covariance)


def _pose_covariance(
    xyz: NDArray[np.float64],
    camera: Camera,
    pose: Pose,
    variance: float,
    position_sigma: NDArray[np.float64] | None,
) -> NDArray[np.float64] | None:
    """Inverse of the information of the inliers and of the position; None where singular.

    COLMAP's own covariance is not used: it weighs the residuals by a robust loss of one pixel, so
    that it claims up to twice the variance that inliers of a pixel's noise show.
    """
    local = pose.transform(torch.from_numpy(xyz))
    projected = camera.project(local, jacobian=True).jacobian
    assert projected is not None
    jacobian = (projected @ transform_jacobian(local)).reshape(-1, 6).numpy()
    information = jacobian.T @ jacobian / variance
    if position_sigma is not None:
        # The centre moves by -R^T v.
        rotation = pose.rotation.numpy()
        information[3:, 3:] += rotation @ np.diag(position_sigma**-2) @ rotation.T
    if np.linalg.cond(information) > _SINGULAR:
        return None
    return np.asarray(np.linalg.inv(information))


def _residual_variance(
    xy: NDArray[np.float64], xyz: NDArray[np.float64], camera: Camera, pose: Pose
) -> float:
    """Variance of one pixel coordinate, from the inliers."""
    projected = camera.project(pose.transform(torch.from_numpy(xyz))).xy.numpy()
    degrees_of_freedom = max(2 * len(xy) - 6, 1)
    return max(float(((projected - xy) ** 2).sum() / degrees_of_freedom), _LEAST_VARIANCE)


def _native_camera(camera: Camera, camera_id: int = 1) -> pycolmap.Camera:
    return pycolmap.Camera(
        model=camera.model,
        width=camera.width,
        height=camera.height,
        params=list(camera.params),
        camera_id=camera_id,
    )


def _pose_from_native(native: pycolmap.Rigid3d) -> Pose:
    return Pose.from_matrix(np.vstack([native.matrix(), [0, 0, 0, 1]]))


def _native_pose(cam_from_world: NDArray[np.float64]) -> pycolmap.Rigid3d:
    """pycolmap holds quaternions x y z w; going through the matrix needs no order at all."""
    return pycolmap.Rigid3d(np.ascontiguousarray(cam_from_world[:3]))


@dataclass(frozen=True)
class PosedImage:
    """A photograph with a known pose: what triangulation starts from."""

    name: str
    camera: Camera
    cam_from_world: NDArray[np.float64]


def triangulate(
    root: Path,
    images: Sequence[PosedImage],
    pairs: Sequence[tuple[str, str]],
    out: Path,
    options: SiftOptions,
    on_progress: Progress | None = None,
) -> tuple[SparseMap, dict[str, Features]]:
    """Build a map by triangulating SIFT matches with known poses, and write the model to ``out``.

    Args:
        root: folder the image names are relative to.
        images: with exact poses, which stay as they are.
        pairs: names to match.
        out: existing folder for the model.
        options: of the detector.
        on_progress: called with the number of images and pairs done.

    Returns:
        The map as written, and the features it was built from by image name.

    Raises:
        InputError: an image cannot be read, or no point could be triangulated.
    """
    with tempfile.TemporaryDirectory(prefix="objconnect-") as scratch:
        database = Path(scratch) / "database.db"
        pair_list = Path(scratch) / "pairs.txt"
        cameras = {image.name: image.camera for image in images}
        features = extract_sift(root, list(cameras), options, database, cameras, on_progress)
        for start in range(0, len(pairs), _PAIR_CHUNK):
            chunk = pairs[start : start + _PAIR_CHUNK]
            pair_list.write_text("".join(f"{a} {b}\n" for a, b in chunk), encoding="utf-8")
            pairing = pycolmap.ImportedPairingOptions()
            pairing.match_list_path = pair_list
            pycolmap.match_image_pairs(
                database, pairing_options=pairing, device=pycolmap.Device.cpu
            )
            if on_progress is not None:
                on_progress(len(images) + start + len(chunk))
        posed = _reconstruction(database, {image.name: image for image in images})
        model = pycolmap.triangulate_points(posed, database, root, out, clear_points=True)
        if not model.num_points3D():
            raise InputError(
                f"no point could be triangulated from the {len(images)} images of {root}: "
                "they need overlap and texture"
            )
        model.write(out)
    return read_map(out), features


def _reconstruction(database: Path, posed: Mapping[str, PosedImage]) -> pycolmap.Reconstruction:
    """A model with the database's identifiers and our poses, without points."""
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as db:
        for native in db.read_all_cameras():
            model.add_camera_with_trivial_rig(native)
        for image in db.read_all_images():
            pose = _native_pose(posed[image.name].cam_from_world)
            model.add_image_with_trivial_frame(image, pose)
    return model
