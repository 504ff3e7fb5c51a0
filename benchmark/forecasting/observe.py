"""Localization of the views of a forecast, and the count of map points in each."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.datasets.dataset import BenchmarkQuery, Dataset
from benchmark.datasets.simulated import TRACK
from benchmark.evaluation.starts import Start, parse_start
from benchmark.forecasting.config import ForecastConfig
from benchmark.scoring.score import Threshold, is_correct, is_false_fix
from objconnect.localization.pipeline.answers import ImageEstimate
from objconnect.localization.pipeline.failures import localize_safely
from objconnect.localization.pipeline.journal import Journal, journal_path
from objconnect.localization.pipeline.localize import journal_key
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Localizer, Prior, Status
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.answers import NamedRecord
from objconnect.scene.storage.digests import digest_of

# A point counts as visible if the rendered surface in front of it is nearer by at most this share
# of the surface's depth plus this many metres, because maps and twins are not exact.
_DEPTH_SHARE, _DEPTH_M = 0.03, 1.0


class Observation(NamedRecord):
    """The answer to one view.

    Attributes:
        name: photograph of the view, relative to the folder ``sessions`` of the views.
        season: condition of the view.
        view: number of the view, from 0.
        waypoint: number of the waypoint, from 0.
        status: status of the estimate.
        reason: why there is no pose.
        t_err_m: position error, metres; None without a pose.
        r_err_deg: rotation error, degrees; None without a pose.
        sigma_across_m: predicted horizontal standard deviation relative to the map, metres; None if
            unknown.
        sigma_up_m: predicted vertical standard deviation relative to the map, metres; None if
            unknown.
        h_err_m: horizontal error, metres; None without a pose.
        v_err_m: vertical error, metres; None without a pose.
        inliers: number of inliers of the estimate.
        points: points of the map in view.
    """

    season: str
    view: int
    waypoint: int
    status: Status
    reason: str = ""
    t_err_m: float | None = None
    r_err_deg: float | None = None
    sigma_across_m: float | None = None
    sigma_up_m: float | None = None
    h_err_m: float | None = None
    v_err_m: float | None = None
    inliers: int = 0
    points: int = 0

    def is_fix(self, fix_m: float, fix_deg: float) -> bool:
        """Return whether the pose is correct within these errors (m, degrees)."""
        return is_correct(self, Threshold(fix_m, fix_deg))

    @property
    def is_false(self) -> bool:
        """Whether the answer is a false fix."""
        return is_false_fix(self)


def start_of(text: str) -> Start:
    """Read the starting information on a view.

    Raises:
        InputError: there is no such start, or it is a pair list, which cannot name the views.
    """
    start = parse_start(text)
    if start.kind == "pairs":
        raise InputError("a pair list cannot name rendered views: forecast with another start")
    return start


def observe(
    scene: Scene, views: Scene, localizer: Localizer, config: ForecastConfig, cache: Path
) -> list[Observation]:
    """Localize every view in the map of a scene.

    Answers are kept in a hidden journal in the folder above the views until the last one, so that
    an interrupted run goes on where it stopped.

    Raises:
        InputError: the map or a view is missing or damaged.
    """
    start = start_of(config.start)
    sparse_map = scene.sparse_map()
    queries = [query for session in views.sessions for query in _queries(views, session)]
    dataset = Dataset(
        name=scene.name,
        track=TRACK,
        parts={},
        map_conditions=(),
        model=scene.map_path,
        load_map=scene.sparse_map,
        images=scene.images_root,
        queries=tuple(queries),
    )
    out = views.path.parent
    key = _journal_key(scene, views, localizer, start, sparse_map)
    done: dict[str, Observation]
    with Journal(journal_path(out / "forecast.json"), key, Observation) as journal:
        done = journal.done
        localizer.prepare(sparse_map, scene.images_root, cache)
        load = start.loader(dataset, sparse_map, cache)
        with progress_bar(f"forecast with {localizer.name}", len(queries)) as advance:
            for query, points in zip(queries, _points_in_view(views, sparse_map), strict=True):
                if query.name not in done:
                    estimate = localize_safely(localizer, load(query))
                    journal.add(_observation(views, query, estimate, points))
                advance(len(done))
    return [done[query.name] for query in queries]


def _journal_key(
    scene: Scene, views: Scene, localizer: Localizer, start: Start, sparse_map: SparseMap
) -> str:
    map_and_method = journal_key(sparse_map, scene.images_root, localizer)
    return digest_of(map_and_method, start.name, *views.manifest.sha256.values())


def _queries(views: Scene, session: str) -> Iterator[BenchmarkQuery]:
    """Yield the views of a session as queries, whatever their role."""
    frames = views.frames(session)
    for row, name in enumerate(frames.names):
        attitude = Pose.from_quaternion(frames.attitude_prior[row], [0, 0, 0]).rotation.numpy()
        yield BenchmarkQuery(
            name=name,
            condition=views.sessions[session].condition,
            group=session,
            camera=frames.cameras[row],
            image=views.images_root / name,
            prior=Prior(
                frames.gps_prior[row],
                frames.gps_sigma[row],
                attitude,
                float(frames.attitude_sigma_deg[row]),
            ),
            reference=Pose.from_matrix(frames.cam_from_world[row]),
        )


def _observation(
    views: Scene, query: BenchmarkQuery, estimate: Estimate, points: int
) -> Observation:
    """Return the answer to a view; names of session and file hold numbers of view and waypoint."""
    session, view = query.group, int(query.group.rpartition("-")[2]) - 1
    create = partial(
        Observation,
        name=query.name,
        season=views.sessions[session].condition,
        view=view,
        waypoint=int(Path(query.name).stem),
        status=estimate.status,
        reason=for_terminal(estimate.reason),
        inliers=estimate.inliers,
        points=points,
    )
    pose = estimate.cam_from_world
    if pose is None:
        return create()
    t_err, r_err = pose.error_to(query.reference)
    error = (pose.centre() - query.reference.centre()).numpy()
    sigmas = ImageEstimate(query.name, estimate, None).sigmas
    across, up = (None, None) if sigmas is None or not np.isfinite(sigmas).all() else sigmas
    return create(
        t_err_m=float(t_err),
        r_err_deg=float(r_err),
        sigma_across_m=across,
        sigma_up_m=up,
        h_err_m=float(np.hypot(*error[:2])),
        v_err_m=abs(float(error[2])),
    )


def _points_in_view(views: Scene, sparse_map: SparseMap) -> Iterator[int]:
    """Yield for each view, in order, the number of map points visible in it."""
    points = torch.from_numpy(np.asarray(sparse_map.xyz, np.float64))
    for session in views.sessions:
        frames = views.frames(session)
        with views.layers(session) as layers:
            for row, camera in enumerate(frames.cameras):
                in_camera = Pose.from_matrix(frames.cam_from_world[row]).transform(points)
                projected = camera.project(in_camera)
                depth = layers.read("depth", row)
                yield _count_visible(
                    projected.xy.numpy(), projected.valid.numpy(), in_camera.numpy()[:, 2], depth
                )


def _count_visible(
    xy: NDArray[np.float64],
    valid: NDArray[np.bool_],
    point_depth: NDArray[np.float64],
    depth: NDArray[np.float32],
) -> int:
    """Count the map points that project into a view and are not behind its surface.

    Args:
        xy: (M, 2) pixels of the points.
        valid: (M,) whether a point can be projected.
        point_depth: (M,) depth of the points along the optical axis, metres.
        depth: (H, W) rendered depth of the surface, metres; 0 without a surface.
    """
    height, width = depth.shape
    inside = valid & (xy >= 0).all(1) & (xy[:, 0] < width) & (xy[:, 1] < height)
    column, row = xy[inside].astype(int).T
    surface = depth[row, column]
    farthest = surface * (1 + _DEPTH_SHARE) + _DEPTH_M
    return int(((surface <= 0) | (point_depth[inside] <= farthest)).sum())
