"""The command ``view``, which shows a scene as an interactive page and as a picture.

Both show cameras, points, objects and queries. ``templates/view.*`` draws hundreds of thousands of
points on a 2D canvas, so that the page needs no graphics card, no library and no network.
"""

from __future__ import annotations

import base64
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.report.album import webp
from benchmark.report.self_contained import fill
from benchmark.report.view_content import (
    Cloud,
    MapObject,
    MethodEstimates,
    QueryEstimate,
    ViewContent,
)
from benchmark.report.view_picture import draw
from benchmark.results.results import Results
from benchmark.results.results_files import load, results_files
from benchmark.scoring.score import FALSE_FIX, is_correct
from objconnect.mapping.dense.command import DENSE
from objconnect.mapping.dense.workspace import Workspace
from objconnect.network.scene_landmarks import read_landmarks
from objconnect.scene.bundle.object_points import objects_of_points
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.outputs import OutputFile, check_outputs
from objconnect.scene.storage.provenance import PNG_MARK

LANDMARK_RGB: Final = np.array([178, 120, 255], np.uint8)
"""The colour of landmarks, the objects that the command ``landmarks`` finds in a map."""
PAGE = Path("pictures", "view.html")
PICTURE = Path("pictures", "view.png")
MOST_POINTS: Final = {"sparse": 150_000, "added": 20_000, "landmarks": 20_000, "dense": 250_000}
"""Largest number of points of each kind on a page; if there are more, a random subset is shown."""
MOST_PHOTOGRAPHS: Final = 300
"""Largest number of photographs on a page; if there are more, evenly spaced ones are shown."""

log = logging.getLogger(__name__)

_ENDINGS = (".html", ".htm")
# Bytes near the beginning of every page, by which an earlier page is recognized and replaced.
_MARK = b"<title>ObjConnect scene</title>"
_SIDE = 360  # longer side of a photograph on the page, pixels
# Points are rounded to a grid with this many steps along each side of their cloud.
_STEPS = 65535


@dataclass(frozen=True)
class SceneView:
    """The files that ``view`` wrote.

    Attributes:
        page: HTML file that contains everything it shows.
        picture: PNG file of the scene from above.
        points: number of points by kind, "sparse", "added", "landmarks" and "dense", where there
            are any.
    """

    page: Path
    picture: Path
    points: dict[str, int]


def view(path: Path, results: Sequence[Path] = (), out: Path | None = None) -> SceneView:
    """Write a scene as an interactive page and as a picture.

    Args:
        path: folder of a finished scene with its map.
        results: files that ``evaluate`` wrote for this scene, or folders with such files.
        out: HTML file of the page; the picture is written beside it as PNG. None writes both into
            the scene's folder of pictures. Files are replaced only if this command wrote them.

    Raises:
        InputError: the path is not a finished scene with a map, a file is damaged, the results are
            of other photographs or only of other scenes, or ``out`` cannot be written.
    """
    scene = Scene.open(path)
    page, picture = _check_outputs(path, results, out)
    sparse_map = scene.sparse_map()
    added = scene.is_added_point(sparse_map)
    poses = {
        name: pose
        for session in scene.sessions
        for name, pose in zip(*_read_poses(scene, session), strict=True)
    }
    methods, other_datasets = [], []
    for source in results:
        for file in results_files(source):
            run = load(file)
            # A folder may also contain results of other data sets.
            if source.is_file() or run.dataset.name == scene.name:
                methods.append(_make_estimates(run, poses, file))
            else:
                other_datasets.append(run.dataset.name)
    if other_datasets:
        dataset_names = ", ".join(for_terminal(name) for name in dict.fromkeys(other_datasets))
        if not methods:
            raise InputError(
                f"the results are of {dataset_names}, not of the scene {scene.name}: give results "
                "on this scene"
            )
        log.warning("%d results of %s are not shown", len(other_datasets), dataset_names)
    query_paths = [
        np.array([poses[name].centre().numpy() for name in names])
        for names in scene.splits.queries.values()
        if names
    ]
    content = ViewContent(
        _clouds(scene, sparse_map, added),
        _map_objects(scene, sparse_map, added),
        query_paths,
        methods,
    )
    write_text(page, fill("view", _data(scene, sparse_map, poses, content)))
    draw(scene.name, sparse_map.centres, content, picture)
    return SceneView(page, picture, {cloud.layer: len(cloud.xyz) for cloud in content.clouds})


def _check_outputs(path: Path, results: Sequence[Path], out: Path | None) -> tuple[Path, Path]:
    """Return the paths of the page and the picture, after checking that they may be written."""
    if out is None:
        outputs = [OutputFile(path / PAGE, _MARK), OutputFile(path / PICTURE, PNG_MARK)]
        check_outputs(outputs, within=path)
        return path / PAGE, path / PICTURE
    if out.suffix.lower() not in _ENDINGS:
        raise InputError(f"{out} must end in .html: the view is an HTML page")
    picture = out.with_suffix(".png")
    check_outputs([OutputFile(out, _MARK), OutputFile(picture, PNG_MARK)], [path, *results])
    return out, picture


def _read_poses(scene: Scene, session: str) -> tuple[tuple[str, ...], list[Pose]]:
    """Return the names of a session's photographs and their true poses."""
    frames = scene.frames(session)
    return frames.names, [Pose.from_matrix(matrix) for matrix in frames.cam_from_world]


def _make_estimates(results: Results, poses: dict[str, Pose], path: Path) -> MethodEstimates:
    """Return the estimates of a results file; ``poses`` are the true ones by photograph."""
    queries = []
    for query in results.queries:
        if query.name not in poses:
            raise InputError(
                f"{path} is not of this scene, which has no photograph {query.name}: evaluate on "
                "this scene"
            )
        numbers = query.cam_from_world
        estimate = None if numbers is None else Pose.from_quaternion(numbers[:4], numbers[4:])
        queries.append(
            QueryEstimate(
                name=query.name,
                truth=poses[query.name].centre().numpy(),
                centre=None if estimate is None else estimate.centre().numpy(),
                error=query.t_err_m,
                angle=query.r_err_deg,
                status=query.status.value,
                found=is_correct(query, FALSE_FIX),
            )
        )
    return MethodEstimates(results.method.name, tuple(queries))


def _clouds(scene: Scene, sparse_map: SparseMap, added: NDArray[np.bool_]) -> list[Cloud]:
    """Return the clouds of points that the scene has."""
    clouds = [Cloud("sparse", sparse_map.xyz[~added], sparse_map.rgb[~added])]
    if added.any():
        clouds.append(Cloud("added", sparse_map.xyz[added], sparse_map.rgb[added]))
    landmarks = read_landmarks(scene, sparse_map)
    if landmarks is not None:
        xyz = landmarks[0].xyz
        clouds.append(Cloud("landmarks", xyz, np.tile(LANDMARK_RGB, (len(xyz), 1))))
    dense = Workspace(scene.path / DENSE)
    if dense.cloud.is_file():
        clouds.append(Cloud("dense", *dense.read_cloud()))
    return clouds


def _map_objects(scene: Scene, sparse_map: SparseMap, added: NDArray[np.bool_]) -> list[MapObject]:
    """Return the objects that are visible in the map's photographs."""
    visible_ids: set[int] = set()

    def instances() -> Iterator[tuple[MapImage, NDArray[np.uint16]]]:
        for image, layers in scene.layers_of_map(sparse_map, "instance"):
            visible_ids.update(np.unique(layers["instance"]).tolist())
            yield image, layers["instance"]

    owners = objects_of_points(len(added), instances())
    before, after = set(owners[~added].tolist()), set(owners.tolist())
    return [
        MapObject(item, item.id in before, item.id in after)
        for item in scene.objects.objects
        if item.id in visible_ids
    ]


def _data(
    scene: Scene, sparse_map: SparseMap, poses: Mapping[str, Pose], content: ViewContent
) -> dict[str, Any]:
    """Return the data of the page, which ``templates/view.js`` reads."""
    # The view is fitted to the points between the 2nd and the 98th percentile, because a few far
    # points would make everything else small.
    extent = np.concatenate([np.percentile(sparse_map.xyz, [2, 98], axis=0), sparse_map.centres])
    low, high = extent.min(0), extent.max(0)
    return {
        "name": scene.name,
        "target": (0.5 * (low + high)).tolist(),
        "distance": 1.3 * float(np.linalg.norm(high - low)),
        "clouds": [_pack(cloud) for cloud in content.clouds],
        "objects": [
            {
                "size": shown.item.size_class,
                "corners": shown.corners.tolist(),
                "low": shown.item.centre[2] - shown.item.size[2] / 2,
                "high": shown.item.centre[2] + shown.item.size[2] / 2,
                "before": shown.before,
                "after": shown.after,
            }
            for shown in content.objects
        ],
        "cameras": _cameras(scene, sparse_map, poses),
        "photographs": _photographs(scene, sparse_map),
        "ways": [path.tolist() for path in content.query_paths],
        "methods": [
            {
                "name": method.name,
                "queries": [
                    {
                        "name": query.name,
                        "truth": query.truth.tolist(),
                        "centre": None if query.centre is None else query.centre.tolist(),
                        "error": query.error,
                        "angle": query.angle,
                        "status": query.status,
                        "found": query.found,
                    }
                    for query in method.queries
                ],
            }
            for method in content.methods
        ],
    }


def _pack(cloud: Cloud) -> dict[str, Any]:
    """Encode a cloud with 16 bits per coordinate; along 250 m a step is four millimetres."""
    total, most = len(cloud.xyz), MOST_POINTS[cloud.layer]
    rows = np.arange(total)
    if total > most:
        rows = np.sort(np.random.default_rng(0).choice(total, most, replace=False))
    xyz = cloud.xyz[rows]
    low = xyz.min(0) if len(xyz) else np.zeros(3)
    step = np.maximum(np.ptp(xyz, axis=0) if len(xyz) else 0, 1e-9) / _STEPS
    grid = np.round((xyz - low) / step).astype("<u2")
    return {
        "layer": cloud.layer,
        "total": total,
        "low": low.tolist(),
        "step": np.broadcast_to(step, 3).tolist(),
        "xyz": base64.b64encode(grid.tobytes()).decode(),
        "rgb": base64.b64encode(np.ascontiguousarray(cloud.rgb[rows]).tobytes()).decode(),
    }


def _list_names(scene: Scene, sparse_map: SparseMap) -> list[str]:
    """Return the names of the map's photographs, then of the queries."""
    queries = [name for names in scene.splits.queries.values() for name in names]
    return [*sparse_map.names, *queries]


def _cameras(
    scene: Scene, sparse_map: SparseMap, poses: Mapping[str, Pose]
) -> list[dict[str, Any]]:
    """Return the cameras as the page draws them: centre, axes and corner rays in the world."""
    cameras: dict[str, Camera] = {}
    for session in scene.sessions:
        frames = scene.frames(session)
        cameras.update(zip(frames.names, frames.cameras, strict=True))
    page_cameras = []
    for name in _list_names(scene, sparse_map):
        map_image = sparse_map.images.get(name)
        pose = poses[name] if map_image is None else map_image.pose
        camera = cameras[name] if map_image is None else map_image.camera
        world_from_cam = pose.rotation.T.numpy()
        # Half of the width and height of the image plane at depth 1.
        x, y = camera.width / camera.focal[0] / 2, camera.height / camera.focal[1] / 2
        corners = np.array([[-x, -y, 1], [x, -y, 1], [x, y, 1], [-x, y, 1]])
        centre = pose.centre().numpy()
        page_cameras.append(
            {
                "name": name,
                "session": name.partition("/")[0],
                "role": "query" if map_image is None else "map",
                "centre": centre.tolist(),
                "ahead": world_from_cam[:, 2].tolist(),
                "up": (-world_from_cam[:, 1]).tolist(),
                "rays": (corners @ world_from_cam.T).tolist(),
                "depth": max(1.0, sparse_map.height_above(centre)),
            }
        )
    return page_cameras


def _photographs(scene: Scene, sparse_map: SparseMap) -> dict[str, str]:
    """Return small photographs as data URLs by name."""
    names = _list_names(scene, sparse_map)
    count = min(len(names), MOST_PHOTOGRAPHS)
    chosen = [names[k] for k in np.linspace(0, len(names) - 1, count).astype(int)]
    packed = {}
    with progress_bar("photographs", len(chosen)) as advance:
        for done, name in enumerate(chosen, 1):
            small = webp(read_rgb(scene.images_root / name), _SIDE)
            packed[name] = "data:image/webp;base64," + base64.b64encode(small).decode()
            advance(done)
    return packed
