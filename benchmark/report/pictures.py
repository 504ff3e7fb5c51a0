"""Picture of a query with map points at its reference pose and at an estimated pose."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.datasets.dataset import BenchmarkQuery
from benchmark.results.query_result import QueryResult
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Status
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.escaping import for_figure
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.provenance import PNG_METADATA

# Side of the cells, pixels; one point is drawn in each, so that the ground stays visible.
_CELL = 48
_REFERENCE, _ESTIMATE = "#00e5ff", "#ff2d95"
_WIDTH_INCHES, _DPI = 9.0, 130


def median_query(queries: Sequence[QueryResult]) -> QueryResult | None:
    """Return the localized query (status ``ok``) of median position error; None without any."""
    localized = [query for query in queries if query.status is Status.OK]
    ranked = sorted(localized, key=lambda query: query.t_err_m or 0.0)
    return ranked[(len(ranked) - 1) // 2] if ranked else None


def query_overlay(
    query: BenchmarkQuery, sparse_map: SparseMap, estimated: Pose, path: Path, method: str
) -> None:
    """Draw map points into a query at its reference pose and at an estimated pose.

    Rings show the points at the reference pose, crosses at the estimated pose; lines join the two.

    Args:
        query: the photograph, its camera and its reference pose.
        sparse_map: map of the points, which are thinned to one per cell.
        estimated: estimated pose ``cam_from_world``, float64.
        path: path of the PNG file.
        method: name of the method for the title.

    Raises:
        InputError: the photograph cannot be read or the picture cannot be written.
    """
    # Imported here, because matplotlib takes half a second and the leaderboard draws nothing.
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    image = read_rgb(query.image, query.camera)
    truth, visible = project_points(sparse_map.xyz, query.camera, query.reference)
    rows = thin_points(truth, visible, sparse_map.track_length, _CELL)
    truth = truth[rows]
    estimated_xy, valid = project_points(sparse_map.xyz[rows], query.camera, estimated)

    height, width = image.shape[:2]
    figure = Figure(figsize=(_WIDTH_INCHES, _WIDTH_INCHES * height / width + 0.75), dpi=_DPI)
    figure.set_layout_engine("constrained")
    axes = figure.add_subplot()
    # The photograph is faded so that markers stand out. In COLMAP's pixel coordinates the corner of
    # the picture is (0, 0).
    faded = (255 - 0.75 * (255.0 - image)).astype(np.uint8)
    axes.imshow(faded, extent=(0, width, height, 0))
    axes.add_collection(
        LineCollection(
            list(np.stack([truth[valid], estimated_xy[valid]], 1)), colors=_ESTIMATE, linewidths=0.6
        )
    )
    axes.scatter(
        truth[:, 0],
        truth[:, 1],
        s=34,
        facecolors="none",
        edgecolors=_REFERENCE,
        linewidths=0.9,
        label=f"map points at the reference pose ({len(rows)} shown)",
    )
    axes.scatter(
        estimated_xy[valid, 0],
        estimated_xy[valid, 1],
        s=20,
        marker="x",
        c=_ESTIMATE,
        linewidths=0.9,
        label="the same points at the estimated pose",
    )
    axes.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[])
    metres, degrees = estimated.error_to(query.reference)
    axes.set_title(
        for_figure(f"{query.name}  ({query.condition}), {method}: ")
        + f"{float(metres):.3f} m, {float(degrees):.3f}° from the reference",
        fontsize=10,
    )
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    with atomic_write(path) as partial:
        figure.savefig(partial, format="png", metadata=PNG_METADATA)


def project_points(
    points: NDArray[np.float64], camera: Camera, pose: Pose
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the pixels (M, 2) of world points (M, 3) and whether each lies in the picture (M,)."""
    projected = camera.project(pose.transform(torch.from_numpy(points)))
    inside = projected.valid & camera.contains(projected.xy)
    return projected.xy.numpy(), inside.numpy()


def thin_points(
    xy: NDArray[np.float64],
    visible: NDArray[np.bool_],
    track_length: NDArray[np.int64],
    cell: float,
) -> NDArray[np.int64]:
    """Return the rows of the points to draw: the one with the longest track in every cell.

    Args:
        xy: (M, 2) pixels.
        visible: (M,) whether a point may be drawn.
        track_length: (M,) number of observations of each point.
        cell: side of the cells, pixels.
    """
    rows = np.flatnonzero(visible)
    rows = rows[np.argsort(-track_length[rows], kind="stable")]
    cells = np.floor(xy[rows] / cell).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return rows[first]
