"""The one module that speaks to pycolmap, whose interface changes between releases.

Written for pycolmap 4.2.
"""

from __future__ import annotations

import signal
import sqlite3
import threading
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pycolmap
import torch
from numpy.typing import NDArray

from scene.camera import Camera
from scene.cluster import crew
from scene.colmap_files import read_model
from scene.errors import InputError
from scene.features import Features, unit_descriptors
from scene.files import require_room, write_text, written_whole
from scene.images import check_photographs
from scene.matching import match
from scene.pose import Pose, transform_jacobian
from scene.scratch import scratch
from scene.sparse_map import SparseMap

VERSION: str = pycolmap.__version__
ADJUSTMENTS = 4
"""Rounds of robust adjustment at the end of ``reconstruct``."""

# Images per call of the extractor: enough to keep the cores busy, few enough to show progress.
_CHUNK = 16
# Images that a worker of a cluster is handed at once.
_UNIT = 4
# Every random choice of COLMAP is seeded: the same photographs make the same map.
_SEED = 0
# Nearest over second nearest descriptor distance, COLMAP's own default.
_MAX_RATIO = 0.8
# A similarity needs three camera centres, and holds those within so many metres of the truth.
_ALIGNABLE = 3
_ALIGN_M = 1.0

# Pairs matched between two progress reports; what is done by then survives an interruption.
_PAIR_CHUNK = 32
# COLMAP ends the process when the disk is full: a chunk of pairs with its journal takes less (B).
_ROOM = 64 << 20
# A keypoint with its descriptor in a database (B); and no photograph has more of them.
_KEYPOINT = 160
_MOST_KEYPOINTS = 1 << 16
# Matches within this distance of the epipolar line agree with it (px).
_VERIFIED_PX = 2.0
# The same before the lens is calibrated; COLMAP's own.
_GUESSED_PX = 4.0
# Robust adjustment: the outliers' least residual in standard deviations, the least angle between
# the rays of a point (COLMAP's own), and the relative change of cost that ends a round.
_OUTLIER = 5.0
_MIN_ANGLE_DEG = 1.5
_CONVERGED = 1e-8

# Matches that determine a pose: their residuals are zero, whatever the matches are.
_MINIMAL = 3
# COLMAP's refinement has a Cauchy loss, which at this scale (in standard deviations of the noise)
# loses 5 % against least squares where there are no outliers.
_CAUCHY = 2.385
# A condition number beyond which nothing is left of double precision.
_SINGULAR = 1e15
# Squared deviation in standard deviations, of three degrees of freedom, beyond which a position and
# the matches are not of one camera: one in ten billion.
_CONTRADICTS = 50.0
# Matches whose residuals say nothing, or too little to be true, are taken to be this exact (px^2).
_LEAST_VARIANCE = 0.01
# No GNSS is better than this (m), a sigma of zero would leave nothing to solve for; and one of so
# much says nothing, as an infinite one does.
_LEAST_SIGMA = 1e-3
_LARGEST_SIGMA = 1e6

# COLMAP logs every step; a person reads our progress bar and our one line instead. What would be
# logged goes to standard error, for it leaves log files in the system's folder otherwise.
pycolmap.logging.minloglevel = pycolmap.logging.FATAL
pycolmap.logging.logtostderr = True


def _take_back_sigterm() -> None:
    """Importing pycolmap puts a handler of its logger in the place of Python's, which prints a
    native stack and ends the process at once: nothing would be cleaned up."""
    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGTERM)
        if handler is not None:  # None: not installed from Python
            signal.signal(signal.SIGTERM, handler)


_take_back_sigterm()

Progress = Callable[[int], None]
Mapper = Literal["incremental", "global"]


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
    on_progress: Progress | None = None,
    threads: int = -1,
    beside: Path | None = None,
) -> dict[str, Features]:
    """SIFT of many images.

    Args:
        root: folder the names are relative to.
        names: images.
        options: of the detector.
        on_progress: called with the number of images done.
        threads: to use; -1 for as many as there are cores.
        beside: folder for temporary files, as ``scene.scratch.scratch`` takes it.

    Raises:
        InputError: an image is missing or cannot be read.
        WriteError: there is no room for temporary files.
    """
    native = options.native()
    native.num_threads = threads
    with scratch(beside) as folder:
        database = folder / "database.db"
        for start in range(0, len(names), _CHUNK):
            chunk = list(names[start : start + _CHUNK])
            most = min(options.max_features, _MOST_KEYPOINTS)
            require_room(database, _ROOM + 2 * len(chunk) * most * _KEYPOINT)
            pycolmap.extract_features(
                database,
                root,
                chunk,
                extraction_options=native,
                device=pycolmap.Device.cpu,
            )
            if on_progress is not None:
                on_progress(start + len(chunk))
        features = _read_features(database, root)
    for name in names:
        if name not in features:
            raise InputError(f"image {root / name} cannot be read or is damaged")
    return features


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
        position_sigma: (3,) its standard deviation per axis, metres, infinite where not measured;
            with it the position takes part in the refinement, weighed against the inliers' own
            residuals, unless the two contradict one another.
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
    # Again with a loss, and with a position, weighed by the noise the matches turned out to have.
    refinement.loss_function_scale = _CAUCHY * np.sqrt(variance)
    sigma = None
    if position is not None and position_sigma is not None:
        sigma = np.clip(position_sigma, _LEAST_SIGMA, _LARGEST_SIGMA)
        alone = _pose_covariance(xyz[inliers], camera, pose, variance, None)
        if alone is not None and _contradicts(pose, alone, position, sigma):
            sigma = None
    if sigma is not None:
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


@dataclass(frozen=True)
class RelativePose:
    """How one camera stands to another, as far as 2D-2D matches tell.

    Attributes:
        b_from_a: its translation has length one: how far apart the cameras are stays unknown.
        inliers: (N,) bool.
    """

    b_from_a: Pose
    inliers: NDArray[np.bool_]


def estimate_relative_pose(
    xy_a: NDArray[np.float64],
    xy_b: NDArray[np.float64],
    camera_a: Camera,
    camera_b: Camera,
    max_error: float,
    seed: int = 0,
) -> RelativePose | None:
    """Essential matrix by LO-RANSAC, decomposed and refined; None when none has support.

    Args:
        xy_a: (N, 2) pixels of the matches in one picture.
        xy_b: (N, 2) and in the other.
        camera_a: of the one.
        camera_b: of the other.
        max_error: inlier threshold of the Sampson error, pixels.
        seed: of the sampling; the same seed gives the same pose.
    """
    options = pycolmap.RANSACOptions(max_error=max_error, random_seed=seed)
    a, b = _native_camera(camera_a), _native_camera(camera_b)
    answer = pycolmap.estimate_relative_pose(a, xy_a, b, xy_b, options)
    if answer is None:
        return None
    inliers = np.asarray(answer["inlier_mask"], bool)
    native = answer["cam2_from_cam1"]
    refined = pycolmap.refine_relative_pose(native, a, xy_a, b, xy_b, inliers)
    if refined is not None:
        native = refined["cam2_from_cam1"]
    pose = _pose_from_native(native)
    length = pose.translation.norm()
    if not bool(length > 0) or not bool(pose.matrix().isfinite().all()):
        return None
    return RelativePose(Pose(pose.rotation, pose.translation / length), inliers)


def _pose_covariance(
    xyz: NDArray[np.float64],
    camera: Camera,
    pose: Pose,
    variance: float,
    position_sigma: NDArray[np.float64] | None,
) -> NDArray[np.float64] | None:
    """Inverse of the information of the inliers and of the position; None where singular.

    COLMAP's own covariance takes residuals to be one pixel and counts those that the robust loss
    plays down for less, so that it is honest at no other noise.
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


def _contradicts(
    pose: Pose,
    covariance: NDArray[np.float64],
    position: NDArray[np.float64],
    sigma: NDArray[np.float64],
) -> bool:
    """Whether a pose and a measured position cannot both be true: least squares would settle on a
    place that is neither."""
    rotation = pose.rotation.numpy()
    off = pose.centre().numpy() - position
    spread = rotation.T @ covariance[3:, 3:] @ rotation + np.diag(sigma**2)
    return float(off @ np.linalg.solve(spread, off)) > _CONTRADICTS


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
        # Verification then finds an essential matrix, which forgives far less than a fundamental.
        has_prior_focal_length=True,
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
    database: Path | None = None,
    cluster: str | None = None,
) -> tuple[SparseMap, dict[str, Features]]:
    """Build a map by triangulating SIFT matches with known poses, and write the model to ``out``.

    Args:
        root: folder the image names are relative to.
        images: with exact poses, which stay as they are.
        pairs: names to match.
        out: existing folder for the model.
        options: of the detector.
        on_progress: called with the number of images and pairs done.
        database: file that keeps features and matches, new or left by an interrupted call for the
            same photographs, pairs and options; None keeps none.
        cluster: whose cores find the features, as ``scene.cluster.crew`` takes it; its nodes see
            ``root`` under the same path.

    Returns:
        The map as written, and the features it was built from by image name.

    Raises:
        InputError: an image is missing, damaged or not of its camera's size, or no point could be
            triangulated.
    """
    with scratch(out) as folder:
        database = database or folder / "database.db"
        posed, features = _match_all(root, images, pairs, database, options, on_progress, cluster)
        return _triangulate(posed, database, root, out), features


def _triangulate(
    posed: pycolmap.Reconstruction, database: Path, root: Path, out: Path
) -> SparseMap:
    result = pycolmap.triangulate_points(
        posed, database, root, out, clear_points=True, options=_pipeline_options()
    )
    if not result.num_points3D():
        raise InputError(
            f"no point could be triangulated from the {posed.num_images()} images of {root}: "
            "they need overlap and texture"
        )
    _write_model(result, out)
    return read_map(out)


def reconstruct(
    root: Path,
    images: Sequence[PosedImage],
    pairs: Sequence[tuple[str, str]],
    out: Path,
    options: SiftOptions,
    on_progress: Progress | None = None,
    database: Path | None = None,
    cluster: str | None = None,
) -> tuple[SparseMap, dict[str, Features]]:
    """Build a map by incremental structure from motion, calibration known and poses not.

    The largest model is adjusted with a robust loss, then moved, turned and scaled onto the known
    camera centres; its poses stay what the photographs say, and images that could not be
    registered are missing from it.

    Args:
        root: folder the image names are relative to.
        images: with the poses to align to.
        pairs: names to match.
        out: existing folder for the model.
        options: of the detector.
        on_progress: called with the number of images and pairs done, then of images registered,
            then of adjustments.
        database: as ``triangulate``.
        cluster: as ``triangulate``.

    Returns:
        The map as written, and the features it was built from by image name.

    Raises:
        InputError: an image is missing, damaged or not of its camera's size, or fewer than three
            images could be registered.
    """
    with scratch(out) as folder:
        database = database or folder / "database.db"
        _, features = _match_all(root, images, pairs, database, options, on_progress, cluster)
        matched, registered = len(images) + len(pairs), 2  # the pair every model starts from

        def report(done: int) -> None:
            if on_progress is not None:
                on_progress(matched + done)

        def on_image() -> None:
            nonlocal registered
            registered += 1
            report(registered)

        models = pycolmap.incremental_mapping(
            database, root, folder, _pipeline_options(), next_image_callback=on_image
        )
    model = max(models.values(), key=lambda m: m.num_reg_images(), default=None)
    if model is None or model.num_reg_images() < _ALIGNABLE:
        raise InputError(
            f"structure from motion could not register {_ALIGNABLE} of the {len(images)} "
            f"images of {root}: they need overlap and texture"
        )
    _adjust_robustly(model, lambda done: report(len(images) + done))
    robust = pycolmap.RANSACOptions(max_error=_ALIGN_M, random_seed=_SEED)
    centres = [Pose.from_matrix(image.cam_from_world).centre().numpy() for image in images]
    similarity = pycolmap.align_reconstruction_to_locations(
        model, [image.name for image in images], np.array(centres), _ALIGNABLE, robust
    )
    if similarity is None:
        raise InputError(f"the model of {root} does not fit the known camera centres")
    model.transform(similarity)
    _write_model(model, out)
    return read_map(out), features


def _adjust_robustly(model: pycolmap.Reconstruction, on_round: Progress) -> None:
    """Adjust poses and points again, wrong matches playing ever less of a part.

    COLMAP's mapper ends with least squares over everything within four pixels, where a wrong match
    weighs a hundred times what the noise of a right one does.
    """
    options = pycolmap.BundleAdjustmentOptions(
        print_summary=False,
        refine_focal_length=False,
        refine_principal_point=False,
        refine_extra_params=False,
    )
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.function_tolerance = _CONVERGED
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    for done in range(ADJUSTMENTS):
        on_round(done)
        sigma = _residual_sigma(model)
        options.ceres.loss_function_scale = _CAUCHY * sigma
        pycolmap.create_default_bundle_adjuster(options, config, model).solve()
        pycolmap.ObservationManager(model).filter_all_points3D(_OUTLIER * sigma, _MIN_ANGLE_DEG)
    on_round(ADJUSTMENTS)
    model.update_point_3d_errors()


def _residual_sigma(model: pycolmap.Reconstruction) -> float:
    """Standard deviation of one pixel coordinate (px), from the median point: outliers do not
    matter."""
    model.update_point_3d_errors()
    error = np.median([point.error for point in model.points3D.values()])
    # A two-dimensional normal has its mean distance at sqrt(pi / 2).
    return float(max(error / np.sqrt(np.pi / 2), np.sqrt(_LEAST_VARIANCE)))


@dataclass(frozen=True)
class Photograph:
    """A photograph whose pose nobody knows: what structure from motion of a flight starts from.

    Attributes:
        name: path relative to the folder of all images.
        camera: its calibration, or a first guess of it.
        lens: photographs of one lens share one camera, and it is refined from all of them.
        calibrated: the camera is right, and stays as it is.
        focal_known: the guess of the focal length was measured, as EXIF says it.
    """

    name: str
    camera: Camera
    lens: str
    calibrated: bool = False
    focal_known: bool = False


def match_photographs(
    root: Path,
    photographs: Sequence[Photograph],
    pairs: Sequence[tuple[str, str]],
    database: Path,
    options: SiftOptions,
    on_progress: Progress | None = None,
) -> None:
    """Fill ``database`` with features and verified matches; goes on with what an interrupted call
    of the same arguments left in it.

    Args:
        root: folder the names are relative to.
        photographs: all of them, whole files of the size of their cameras.
        pairs: names to match.
        database: file, new or left by an interrupted call.
        options: of the detector.
        on_progress: called with the number of photographs and pairs done.

    Raises:
        InputError: a photograph is missing or damaged, or the file cannot be written.
    """
    ids = {photograph.name: k for k, photograph in enumerate(photographs, 1)}
    numbers = _lens_ids(photographs)
    cameras = {p.lens: _native_camera(p.camera, numbers[p.lens]) for p in photographs}
    for photograph in photographs:
        cameras[photograph.lens].has_prior_focal_length = photograph.focal_known
    model = _empty_model(cameras.values())
    for photograph in photographs:
        native = pycolmap.Image(
            name=photograph.name,
            camera_id=numbers[photograph.lens],
            image_id=ids[photograph.name],
        )
        model.add_image_with_trivial_frame(native)
    _require_database(database, model)
    _fill_database(database, root, ids, pairs, options, _GUESSED_PX, on_progress)


def map_photographs(
    root: Path,
    photographs: Sequence[Photograph],
    database: Path,
    out: Path,
    mapper: Mapper,
    on_progress: Progress | None = None,
) -> list[Path]:
    """Structure from motion, poses and calibration unknown.

    Args:
        root: folder the names are relative to.
        photographs: of ``database``.
        database: filled by ``match_photographs``.
        out: existing folder for the models.
        mapper: "incremental" (one photograph after the other) or "global" (all at once).
        on_progress: called with the number of photographs registered; never by the global mapper.

    Returns:
        Folders of the models, each in a frame and scale of its own, those of most photographs
        first. Photographs that do not hang together are in several models, or in none.
    """
    numbers = _lens_ids(photographs)
    # A focal length refined early, from few photographs, may lead the whole model astray.
    refine_focal = not all(p.focal_known for p in photographs)
    fixed = {
        numbers[p.lens] for p in photographs if p.calibrated or (refine_focal and p.focal_known)
    }
    with scratch(out, _ROOM) as folder:
        if mapper == "global":
            pipeline = _global_options()
            adjustment = pipeline.mapper.bundle_adjustment
            adjustment.refine_focal_length = refine_focal
            adjustment.refine_extra_params = len(fixed) < len(numbers)
            models = pycolmap.global_mapping(database, root, folder, pipeline)
        else:
            pipeline = _pipeline_options()
            pipeline.ba_refine_focal_length = refine_focal
            pipeline.mapper.abs_pose_refine_focal_length = refine_focal
            pipeline.ba_refine_extra_params = True
            pipeline.constant_cameras = pipeline.mapper.constant_cameras = fixed
            pipeline.min_model_size = _ALIGNABLE
            models = _map_incrementally(database, root, folder, pipeline, on_progress)
    ordered = sorted(models.values(), key=lambda m: -m.num_reg_images())
    folders = [out / str(k) for k in range(len(ordered))]
    for model, folder in zip(ordered, folders, strict=True):
        folder.mkdir()
        _write_model(model, folder)
    return folders


def _map_incrementally(
    database: Path,
    root: Path,
    folder: Path,
    pipeline: pycolmap.IncrementalPipelineOptions,
    on_progress: Progress | None,
) -> dict[int, pycolmap.Reconstruction]:
    registered = 0

    def on_image(number: int) -> None:
        nonlocal registered
        registered += number
        if on_progress is not None:
            on_progress(registered)

    return dict(
        pycolmap.incremental_mapping(
            database,
            root,
            folder,
            pipeline,
            initial_image_pair_callback=lambda: on_image(2),
            next_image_callback=lambda: on_image(1),
        )
    )


def _global_options() -> pycolmap.GlobalPipelineOptions:
    pipeline = pycolmap.GlobalPipelineOptions()
    pipeline.random_seed = pipeline.mapper.random_seed = _SEED
    pipeline.mapper.rotation_averaging.random_seed = _SEED
    pipeline.mapper.global_positioning.random_seed = _SEED
    pipeline.mapper.retriangulation.random_seed = _SEED
    pipeline.num_threads = pipeline.mapper.num_threads = 1
    pipeline.mapper.global_positioning.use_gpu = False
    pipeline.mapper.bundle_adjustment.ceres.use_gpu = False
    return pipeline


def adjust_to_positions(
    model: Path,
    photographs: Sequence[Photograph],
    world_from_model: NDArray[np.float64],
    positions: Mapping[str, NDArray[np.float64]],
    sigma: NDArray[np.float64],
    refined: Collection[str],
    out: Path,
    *,
    principal_point: bool = False,
) -> SparseMap:
    """Move a model into the world, then adjust poses, points and lenses to the pixels and to
    measured positions together, with a robust loss on the positions.

    Args:
        model: folder of ``map_photographs``.
        photographs: of the model, and others.
        world_from_model: (3, 4) similarity, scale times rotation and translation.
        positions: (3,) measured camera centres by name, world metres.
        sigma: (3,) their standard deviation per axis, metres.
        refined: lenses whose focal length is adjusted too; with none, only the distortion of those
            that are not calibrated.
        out: existing folder for the adjusted model.
        principal_point: adjust the principal points of the lenses that are adjusted at all.
    """
    native = pycolmap.Reconstruction(model)
    native.transform(pycolmap.Sim3d(np.ascontiguousarray(world_from_model)))
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in native.reg_image_ids():
        config.add_image(image_id)
    numbers = _lens_ids(photographs)
    for photograph in photographs:
        if photograph.calibrated or (refined and photograph.lens not in refined):
            config.set_constant_cam_intrinsics(numbers[photograph.lens])
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.refine_focal_length = bool(refined)
    options.refine_principal_point = principal_point
    options.ceres.solver_options.num_threads = 1
    with_priors = pycolmap.PosePriorBundleAdjustmentOptions()
    with_priors.ceres.prior_position_loss_function_type = pycolmap.LossFunctionType.CAUCHY
    with_priors.alignment_ransac.random_seed = _SEED
    priors = [
        pycolmap.PosePrior(
            corr_data_id=image.data_id,
            position=positions[image.name],
            position_covariance=np.diag(sigma**2),
            coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
        )
        for image in native.images.values()
        if image.name in positions
    ]
    pycolmap.create_pose_prior_bundle_adjuster(options, with_priors, config, priors, native).solve()
    native.update_point_3d_errors()
    _write_model(native, out)
    return read_map(out)


def triangulate_matched(
    root: Path, images: Sequence[PosedImage], database: Path, out: Path
) -> tuple[SparseMap, dict[str, Features]]:
    """Triangulate some of the images of a filled database anew, with poses that stay as they are.

    Args:
        root: folder the names are relative to.
        images: some of those of ``database``; matches with others are left out.
        database: filled by ``match_photographs``.
        out: existing folder for the model.

    Returns:
        The map as written, and the features it was built from by image name.

    Raises:
        InputError: no point could be triangulated.
    """
    features = _read_features(database, root)
    wanted = {image.name: features[image.name] for image in images}
    size = sum(24 * len(item.xy) for item in wanted.values())
    with scratch(out, _ROOM + 2 * size) as folder:
        part = folder / "database.db"
        posed, ids = _posed_model(images, {name: item.xy for name, item in wanted.items()})
        _write_database(part, posed)
        with pycolmap.Database.open(database) as db, pycolmap.Database.open(part) as copy:
            old = {image.name: image.image_id for image in db.read_all_images()}
            for name, item in wanted.items():
                copy.write_keypoints(ids[name], item.xy)
            for a, b in combinations(wanted, 2):
                if db.exists_two_view_geometry(old[a], old[b]):
                    geometry = db.read_two_view_geometry(old[a], old[b])
                    copy.write_two_view_geometry(ids[a], ids[b], geometry)
        return _triangulate(posed, part, root, out), wanted


def write_posed(images: Sequence[PosedImage], sparse_map: SparseMap | None, out: Path) -> None:
    """Write images with their poses as a binary model.

    Args:
        images: of the model, in the order of their identifiers.
        sparse_map: whose keypoints the images take, and those of whose points they observe.
        out: existing folder for the model.
    """
    mapped = sparse_map.images if sparse_map is not None else {}
    nothing = np.zeros((0, 2))
    keypoints = {i.name: mapped[i.name].xy if i.name in mapped else nothing for i in images}
    model, ids = _posed_model(images, keypoints)
    if sparse_map is not None:
        tracks: dict[int, list[pycolmap.TrackElement]] = {}
        for name in [image.name for image in images if image.name in mapped]:
            rows = mapped[name].point_rows
            for keypoint in np.flatnonzero(rows >= 0).tolist():
                element = pycolmap.TrackElement(ids[name], keypoint)
                tracks.setdefault(int(rows[keypoint]), []).append(element)
        for row, elements in sorted(tracks.items()):
            track = pycolmap.Track(elements)
            model.add_point3D(sparse_map.xyz[row], track, sparse_map.rgb[row])
        model.update_point_3d_errors()
    _write_model(model, out)


@dataclass(frozen=True)
class NewPoint:
    """A point to add to a model.

    Attributes:
        xyz: (3,) world metres.
        rgb: (3,) uint8.
        xy: (2,) COLMAP pixels of its observation by name of the image; no two points share one.
    """

    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]
    xy: Mapping[str, NDArray[np.float64]]


def add_points(model: Path, points: Sequence[NewPoint], out: Path) -> list[int]:
    """Write a model with more points; what it has keeps its identifiers, its order and its values.

    Args:
        model: folder of a binary model.
        points: whose observations become keypoints after those that the images have.
        out: existing folder.

    Returns:
        COLMAP's identifiers of the new points.

    Raises:
        InputError: the model is damaged, or an observation is in an image it does not have.
    """
    native = _whole_model(model)
    images = {image.name: image for image in native.images.values()}
    ids = []
    for point in points:
        track = []
        for name, xy in point.xy.items():
            if name not in images:
                raise InputError(f"model {model} has no image {name!r}")
            keypoints = images[name].points2D
            track.append(pycolmap.TrackElement(images[name].image_id, len(keypoints)))
            keypoints.append(pycolmap.Point2D(xy))
        ids.append(int(native.add_point3D(point.xyz, pycolmap.Track(track), point.rgb)))
        native.points3D[ids[-1]].error = _mean_error(native, ids[-1])
    native.write(out)
    return ids


def _mean_error(model: pycolmap.Reconstruction, point_id: int) -> float:
    """Mean reprojection error (px) of a point, as COLMAP keeps it with each."""
    point = model.points3D[point_id]
    errors = []
    for element in point.track.elements:
        image = model.images[element.image_id]
        projected = image.project_point(point.xyz)
        if projected is None:
            raise InputError(f"point {point_id} lies behind image {image.name}, which observes it")
        errors.append(np.linalg.norm(projected - image.points2D[element.point2D_idx].xy))
    return float(np.mean(errors))


def remove_points(model: Path, ids: Sequence[int], out: Path) -> None:
    """Undo ``add_points``: the files are those of before, byte for byte.

    Args:
        model: folder of a binary model.
        ids: what ``add_points`` returned, whose keypoints are the last ones of their images.
        out: existing folder.

    Raises:
        InputError: the model is damaged, lacks a point, or was changed in between.
    """
    native = _whole_model(model)
    added: dict[int, set[int]] = {}
    for point_id in ids:
        if point_id not in native.points3D:
            raise InputError(f"model {model} has no point {point_id}")
        for element in native.points3D[point_id].track.elements:
            added.setdefault(element.image_id, set()).add(element.point2D_idx)
    for point_id in ids:
        native.delete_point3D(point_id)
    for image_id, keypoints in added.items():
        image = native.images[image_id]
        left = image.num_points2D() - len(keypoints)
        if min(keypoints) != left:
            raise InputError(
                f"the keypoints of points added to {model} are not the last of image {image.name}: "
                "the model was changed since, build it again"
            )
        del image.points2D[left:]
    native.write(out)


def _whole_model(folder: Path) -> pycolmap.Reconstruction:
    """A model for COLMAP, which ends the process on a damaged one, after our own reader."""
    read_map(folder)
    return pycolmap.Reconstruction(folder)


def _lens_ids(photographs: Sequence[Photograph]) -> dict[str, int]:
    return {lens: k for k, lens in enumerate(dict.fromkeys(p.lens for p in photographs), 1)}


def _pipeline_options() -> pycolmap.IncrementalPipelineOptions:
    pipeline = pycolmap.IncrementalPipelineOptions()
    pipeline.random_seed = pipeline.triangulation.random_seed = _SEED
    pipeline.mapper.random_seed = _SEED
    pipeline.num_threads = 1  # sums over threads round differently from run to run
    pipeline.ba_refine_focal_length = False
    pipeline.ba_refine_extra_params = False
    # The first image of every camera would otherwise bend it to itself.
    pipeline.mapper.abs_pose_refine_focal_length = False
    pipeline.mapper.abs_pose_refine_extra_params = False
    return pipeline


def _match_all(
    root: Path,
    images: Sequence[PosedImage],
    pairs: Sequence[tuple[str, str]],
    database: Path,
    options: SiftOptions,
    on_progress: Progress | None,
    cluster: str | None,
) -> tuple[pycolmap.Reconstruction, dict[str, Features]]:
    """Fill a database with verified matches; the posed images as a model, and their features."""
    check_photographs(root, {image.name: image.camera for image in images})
    empty, ids = _posed_model(images, {image.name: np.zeros((0, 2)) for image in images})
    _require_database(database, empty)
    _fill_database(database, root, ids, pairs, options, _VERIFIED_PX, on_progress, cluster)
    features = _read_features(database, root)
    return _posed_model(images, {name: item.xy for name, item in features.items()})[0], features


def _fill_database(
    database: Path,
    root: Path,
    ids: Mapping[str, int],
    pairs: Sequence[tuple[str, str]],
    options: SiftOptions,
    max_error: float,
    on_progress: Progress | None,
    cluster: str | None = None,
) -> None:
    """Extract, match and verify what a database of images does not hold yet."""

    def report(done: int) -> None:
        if on_progress is not None:
            on_progress(done)

    with pycolmap.Database.open(database) as db:
        left = [name for name in ids if not db.exists_keypoints(ids[name])]
        done = len(ids) - len(left)
        with closing(_find_features(root, left, options, database.parent, cluster)) as found:
            for features in found:
                size = sum(
                    item.descriptors.nbytes + 24 * len(item.xy) for item in features.values()
                )
                require_room(database, _ROOM + 2 * size)
                with pycolmap.DatabaseTransaction(db):
                    for name, item in features.items():
                        sift = pycolmap.FeatureExtractorType.SIFT
                        native = pycolmap.FeatureDescriptors(sift, item.descriptors)
                        db.write_descriptors(ids[name], native)
                        shape = item.scale[:, None] * np.eye(2, dtype=np.float32).reshape(1, 4)
                        db.write_keypoints(ids[name], np.hstack([item.xy, shape]))
                done += len(features)
                report(done)
    descriptors = {
        name: unit_descriptors(item.descriptors)
        for name, item in _read_features(database, root).items()
    }
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = _SEED
    verification.ransac.max_error = max_error
    pair_list = database.with_suffix(".pairs")
    for start in range(0, len(pairs), _PAIR_CHUNK):
        chunk_of_pairs = pairs[start : start + _PAIR_CHUNK]
        with pycolmap.Database.open(database) as db:
            left_pairs = [
                (a, b) for a, b in chunk_of_pairs if not db.exists_two_view_geometry(ids[a], ids[b])
            ]
            for a, b in left_pairs:
                require_room(database, _ROOM)
                if not db.exists_matches(ids[a], ids[b]):
                    matches = match(descriptors[a], descriptors[b], _MAX_RATIO)
                    db.write_matches(ids[a], ids[b], matches.astype(np.uint32))
        if left_pairs:
            require_room(database, _ROOM)
            write_text(pair_list, "".join(f"{a} {b}\n" for a, b in left_pairs))
            pycolmap.verify_matches(database, pair_list, verification)
        report(len(ids) + start + len(chunk_of_pairs))
    pair_list.unlink(missing_ok=True)


def _find_features(
    root: Path, names: Sequence[str], options: SiftOptions, beside: Path, cluster: str | None
) -> Generator[dict[str, Features], None, None]:
    """SIFT of many images, some at a time. Nodes of a cluster need not see ``beside``."""
    size = _CHUNK if cluster is None else _UNIT
    chunks = [names[start : start + size] for start in range(0, len(names), size)]
    threads, temporary = (-1, beside) if cluster is None else (1, None)
    find = partial(_sift_of, root, options, threads, temporary)
    with crew(cluster if chunks else None, find) as workers:
        yield from workers.spread(chunks)


def _sift_of(
    root: Path, options: SiftOptions, threads: int, beside: Path | None, names: Sequence[str]
) -> Iterator[dict[str, Features]]:
    yield extract_sift(root, names, options, threads=threads, beside=beside)


def _require_database(database: Path, model: pycolmap.Reconstruction) -> None:
    """A database of the model's images, unless a sound one is there."""
    if not _is_sound(database):
        for journal in ("-journal", "-wal", "-shm"):
            database.with_name(database.name + journal).unlink(missing_ok=True)
        require_room(database, _ROOM)
        _write_database(database, model)


def _is_sound(database: Path) -> bool:
    """Whether a database is there and whole: COLMAP ends the process on a damaged one."""
    if not database.is_file():
        return False
    try:
        with closing(sqlite3.connect(database)) as connection:
            return connection.execute("PRAGMA quick_check").fetchall() == [("ok",)]
    except sqlite3.DatabaseError:
        return False


def _write_model(model: pycolmap.Reconstruction, out: Path) -> None:
    """Write a model's files; COLMAP says nothing when they end up shorter than they should be."""
    keypoints = sum(image.num_points2D() for image in model.images.values())
    require_room(out, (1 << 20) + 40 * keypoints + 100 * model.num_points3D())
    model.write(out)


def _posed_model(
    images: Sequence[PosedImage], keypoints: Mapping[str, NDArray[Any]]
) -> tuple[pycolmap.Reconstruction, dict[str, int]]:
    """A model of keypoints (K, 2) and poses without points, and the identifier of each image."""
    numbers = {camera: k for k, camera in enumerate(dict.fromkeys(i.camera for i in images), 1)}
    cameras = [_native_camera(camera, number) for camera, number in numbers.items()]
    model, ids = _empty_model(cameras), {image.name: k for k, image in enumerate(images, 1)}
    for image in images:
        native = pycolmap.Image(
            name=image.name,
            keypoints=keypoints[image.name].astype(np.float64),
            camera_id=numbers[image.camera],
            image_id=ids[image.name],
        )
        model.add_image_with_trivial_frame(native, _native_pose(image.cam_from_world))
    return model, ids


def _empty_model(cameras: Iterable[pycolmap.Camera]) -> pycolmap.Reconstruction:
    model = pycolmap.Reconstruction()
    for camera in cameras:
        model.add_camera_with_trivial_rig(camera)
    return model


def _write_database(path: Path, model: pycolmap.Reconstruction) -> None:
    """A database of the model's own identifiers: COLMAP's extractor numbers images as it
    happens to finish them, and the numbers decide the order of everything after."""
    with written_whole(path) as partial, pycolmap.Database.open(partial) as db:
        for camera in model.cameras.values():
            db.write_camera(camera, use_camera_id=True)
        for rig in model.rigs.values():
            db.write_rig(rig, use_rig_id=True)
        for frame in model.frames.values():
            db.write_frame(frame, use_frame_id=True)
        for image in model.images.values():
            db.write_image(image, use_image_id=True)


def patch_match_stereo(workspace: Path) -> None:
    """COLMAP's own dense stereo in a workspace of undistorted photographs, on a CUDA device.

    Raises:
        InputError: this pycolmap was built without CUDA.
    """
    if not pycolmap.has_cuda:
        raise InputError(
            "COLMAP's stereo needs a CUDA build of pycolmap, and this is none: leave out "
            "'--stereo colmap'"
        )
    pycolmap.patch_match_stereo(workspace)


def fuse_depth_maps(
    workspace: Path, out: Path, min_views: int
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Fuse a workspace's depth and normal maps into a cloud, and write it as PLY to ``out``.

    COLMAP ends the process on a damaged workspace: hand it one whose files were just read.

    Args:
        workspace: in COLMAP's layout, with ``*.geometric.bin`` of every image it lists.
        out: the PLY file; its list of visible images lies beside it as ``.vis``.
        min_views: a point is kept when so many maps have it.

    Returns:
        Points (M, 3), world metres, and their colours (M, 3).
    """
    options = pycolmap.StereoFusionOptions()
    options.min_num_pixels = min_views
    options.num_threads = 1  # threads take pixels from one another in another order each time
    model = pycolmap.stereo_fusion(out, workspace, options=options, output_type="PLY")
    points = list(model.points3D.values())
    xyz = np.array([point.xyz for point in points], np.float64).reshape(-1, 3)
    return xyz, np.array([point.color for point in points], np.uint8).reshape(-1, 3)
