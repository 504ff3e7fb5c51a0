"""Structure from motion: maps from photographs with unknown or approximate poses."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pycolmap
from numpy.typing import NDArray

from objconnect.scene.colmap.database import MappingJob, match_with_poses
from objconnect.scene.colmap.models import lens_ids, write_model
from objconnect.scene.colmap.native import LEAST_VARIANCE, MIN_FREE_BYTES, SEED, Progress
from objconnect.scene.colmap.options import MAX_ALIGNMENT_ERROR_M, MIN_ANGLE_DEG, OUTLIER_SIGMAS
from objconnect.scene.colmap.triangulation import pipeline_options
from objconnect.scene.errors import InputError, NoPointsError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.geometry.robust import CAUCHY_SCALE
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.maps.features import Features
from objconnect.scene.maps.photographs import Photograph
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.scratch import scratch

ADJUSTMENTS = 4
"""Number of rounds of ``adjust_robustly``."""

MIN_ALIGNED_CENTRES = 3
"""Smallest number of camera centres for a similarity transform."""

# Relative change of the cost that ends a round of the robust adjustment.
_MIN_COST_CHANGE = 1e-8


Mapper = Literal["incremental", "global"]


def reconstruct(
    job: MappingJob, out: Path, on_progress: Progress | None = None
) -> tuple[SparseMap, dict[str, Features]]:
    """Build a map by incremental structure from motion with known calibration and unknown poses.

    The largest model is adjusted with a robust loss, then aligned to the known camera centres by a
    similarity transform. Images that could not be registered are missing from the map.

    Args:
        job: photographs; the map is aligned to the camera centres of their poses.
        out: existing folder for the model.
        on_progress: called with the number of steps done: images extracted and pairs matched, then
            images registered, then rounds of adjustment.

    Returns:
        The map as written, and the features it was built from by image name.

    Raises:
        InputError: an image is missing, damaged or not of its camera's size, or the model does not
            fit the known camera centres.
        NoPointsError: fewer than three images could be registered.
    """
    root, images = job.root, job.images
    with scratch(out) as folder:
        database = job.database or folder / "database.db"
        _, features = match_with_poses(job, database, on_progress)
        matched, registered = len(images) + len(job.pairs), 2  # a model starts from two images

        def report(done: int) -> None:
            if on_progress is not None:
                on_progress(matched + done)

        def on_image() -> None:
            nonlocal registered
            registered += 1
            report(registered)

        models = pycolmap.incremental_mapping(
            database, root, folder, pipeline_options(), next_image_callback=on_image
        )
    model = max(models.values(), key=lambda m: m.num_reg_images(), default=None)
    if model is None or model.num_reg_images() < MIN_ALIGNED_CENTRES:
        raise NoPointsError(
            f"structure from motion could not register {MIN_ALIGNED_CENTRES} of the {len(images)} "
            f"images of {root}: they need overlap and texture"
        )
    adjust_robustly(model, on_round=lambda done: report(len(images) + done))
    ransac = pycolmap.RANSACOptions(max_error=MAX_ALIGNMENT_ERROR_M, random_seed=SEED)
    centres = [Pose.from_matrix(image.cam_from_world).centre().numpy() for image in images]
    similarity = pycolmap.align_reconstruction_to_locations(
        model, [image.name for image in images], np.array(centres), MIN_ALIGNED_CENTRES, ransac
    )
    if similarity is None:
        raise InputError(
            f"the model of {root} does not fit the known camera centres: check these positions"
        )
    model.transform(similarity)
    write_model(model, out)
    return read_model(out), features


def adjust_robustly(
    model: pycolmap.Reconstruction,
    fixed: Collection[str] = (),
    on_round: Progress = lambda _: None,
) -> None:
    """Adjust poses and points in rounds with a robust loss; remove outliers after each round.

    COLMAP's mapper ends with least squares over all residuals up to four pixels, where one wrong
    match can outweigh many right ones.

    Args:
        model: model to adjust in place.
        fixed: names of images with constant poses; if empty, two cameras fix the gauge.
        on_round: called with the number of rounds done.
    """
    options = pycolmap.BundleAdjustmentOptions(
        print_summary=False,
        refine_focal_length=False,
        refine_principal_point=False,
        refine_extra_params=False,
    )
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.function_tolerance = _MIN_COST_CHANGE
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    for image in model.images.values():
        if image.name in fixed:
            config.set_constant_rig_from_world_pose(image.frame_id)
    if not fixed:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    for done in range(ADJUSTMENTS):
        on_round(done)
        sigma = _residual_sigma(model)
        options.ceres.loss_function_scale = CAUCHY_SCALE * sigma
        pycolmap.create_default_bundle_adjuster(options, config, model).solve()
        observations = pycolmap.ObservationManager(model)
        observations.filter_all_points3D(OUTLIER_SIGMAS * sigma, MIN_ANGLE_DEG)
    on_round(ADJUSTMENTS)
    model.update_point_3d_errors()


def _residual_sigma(model: pycolmap.Reconstruction) -> float:
    """Return the standard deviation of one pixel coordinate (px), from the median point error."""
    model.update_point_3d_errors()
    error = np.median([point.error for point in model.points3D.values()])
    # The mean length of a two-dimensional normal vector is sqrt(pi / 2) standard deviations. The
    # median is robust to outliers.
    return float(max(error / np.sqrt(np.pi / 2), np.sqrt(LEAST_VARIANCE)))


def map_photographs(
    root: Path,
    photographs: Sequence[Photograph],
    database: Path,
    out: Path,
    mapper: Mapper,
    on_progress: Progress | None = None,
) -> list[Path]:
    """Reconstruct photographs of unknown pose and calibration by structure from motion.

    Args:
        root: folder that the names are relative to.
        photographs: photographs of ``database``.
        database: file filled by ``match_photographs``.
        out: existing folder for the models.
        mapper: "incremental" (one photograph after the other) or "global" (all at once).
        on_progress: called with the number of photographs registered; never by the global mapper.

    Returns:
        Folders of the models, each with its own frame and scale, by decreasing number of
        photographs. Photographs without common points end in different models, or in none.
    """
    camera_ids = lens_ids(photographs)
    # A focal length that is refined early from few photographs can distort the whole model.
    refine_focal = not all(p.focal_known for p in photographs)
    fixed = {
        camera_ids[p.lens] for p in photographs if p.calibrated or (refine_focal and p.focal_known)
    }
    with scratch(out, MIN_FREE_BYTES) as folder:
        if mapper == "global":
            pipeline = _global_options()
            adjustment = pipeline.mapper.bundle_adjustment
            adjustment.refine_focal_length = refine_focal
            adjustment.refine_extra_params = len(fixed) < len(camera_ids)
            models = pycolmap.global_mapping(database, root, folder, pipeline)
        else:
            pipeline = pipeline_options()
            pipeline.ba_refine_focal_length = refine_focal
            pipeline.mapper.abs_pose_refine_focal_length = refine_focal
            pipeline.ba_refine_extra_params = True
            pipeline.constant_cameras = pipeline.mapper.constant_cameras = fixed
            pipeline.min_model_size = MIN_ALIGNED_CENTRES
            models = _map_incrementally(database, root, folder, pipeline, on_progress)
    ordered = sorted(models.values(), key=lambda m: -m.num_reg_images())
    folders = [out / str(k) for k in range(len(ordered))]
    for model, folder in zip(ordered, folders, strict=True):
        folder.mkdir()
        write_model(model, folder)
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
    pipeline.random_seed = pipeline.mapper.random_seed = SEED
    pipeline.mapper.rotation_averaging.random_seed = SEED
    pipeline.mapper.global_positioning.random_seed = SEED
    pipeline.mapper.retriangulation.random_seed = SEED
    pipeline.num_threads = pipeline.mapper.num_threads = 1
    pipeline.mapper.global_positioning.use_gpu = False
    pipeline.mapper.bundle_adjustment.ceres.use_gpu = False
    return pipeline


@dataclass(frozen=True)
class MeasuredPositions:
    """Measured camera centres, for example from GPS.

    Attributes:
        centres: measured camera centres by name of the photograph, (3,) world metres.
        sigma: standard deviation per axis, (3,) metres.
        up_sigma: standard deviation of the height, metres, by name of the photograph; it replaces
            the third value of ``sigma``.
    """

    centres: Mapping[str, NDArray[np.float64]]
    sigma: NDArray[np.float64]
    up_sigma: Mapping[str, float]

    def sigma_of(self, name: str) -> NDArray[np.float64]:
        """Return the standard deviations of a photograph's centre, (3,) metres."""
        return np.array([*self.sigma[:2], self.up_sigma.get(name, self.sigma[2])])


@dataclass(frozen=True)
class RefinedLenses:
    """The lens parameters to adjust.

    Attributes:
        focal: lenses whose focal length and distortion are adjusted; if empty, only the distortion
            of uncalibrated lenses is adjusted.
        principal_point: whether principal points of the adjusted lenses are adjusted too.
    """

    focal: Collection[str]
    principal_point: bool = False


def configure_adjustment(
    native: pycolmap.Reconstruction, photographs: Sequence[Photograph], refined: RefinedLenses
) -> tuple[pycolmap.BundleAdjustmentConfig, pycolmap.BundleAdjustmentOptions]:
    """Return configuration and options to adjust all images of a model of ``map_photographs``."""
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in native.reg_image_ids():
        config.add_image(image_id)
    camera_ids = lens_ids(photographs)
    for photograph in photographs:
        if photograph.calibrated or (refined.focal and photograph.lens not in refined.focal):
            config.set_constant_cam_intrinsics(camera_ids[photograph.lens])
    options = pycolmap.BundleAdjustmentOptions(print_summary=False)
    options.refine_focal_length = bool(refined.focal)
    options.refine_principal_point = refined.principal_point
    options.ceres.solver_options.num_threads = 1
    return config, options


def adjust_to_positions(
    model: Path,
    photographs: Sequence[Photograph],
    world_from_model: NDArray[np.float64],
    measured: MeasuredPositions,
    refined: RefinedLenses,
    out: Path,
) -> SparseMap:
    """Transform a model to the world and adjust it to keypoints and measured positions jointly.

    It adjusts poses, points and lenses, with a robust loss on the positions.

    Args:
        model: folder of a model of ``map_photographs``.
        photographs: photographs of the model; others are ignored.
        world_from_model: similarity transform, (3, 4): scale times rotation, and translation.
        measured: camera centres of some of the photographs.
        refined: lens parameters to adjust.
        out: existing folder for the adjusted model.
    """
    native = pycolmap.Reconstruction(model)
    native.transform(pycolmap.Sim3d(np.ascontiguousarray(world_from_model)))
    config, options = configure_adjustment(native, photographs, refined)
    with_priors = pycolmap.PosePriorBundleAdjustmentOptions()
    with_priors.ceres.prior_position_loss_function_type = pycolmap.LossFunctionType.CAUCHY
    with_priors.alignment_ransac.random_seed = SEED
    priors = [
        pycolmap.PosePrior(
            corr_data_id=image.data_id,
            position=measured.centres[image.name],
            position_covariance=np.diag(measured.sigma_of(image.name) ** 2),
            coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
        )
        for image in native.images.values()
        if image.name in measured.centres
    ]
    pycolmap.create_pose_prior_bundle_adjuster(options, with_priors, config, priors, native).solve()
    native.update_point_3d_errors()
    write_model(native, out)
    return read_model(out)
