"""A scene in space, as one page for a browser and as a picture: cameras, points, objects, queries.

``templates/view.*`` draws on a plain 2D canvas: some hundred thousand points need no graphics card,
and so the page opens wherever a browser does, without a library and without a network.
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
from benchmark.report.view_content import Cloud, Found, Method, Thing
from benchmark.report.view_picture import draw
from benchmark.results import Results, load, results_files
from dense.command import DENSE
from dense.workspace import Workspace
from scene.bundle.object_points import objects_of_points
from scene.bundle.scene import Scene
from scene.errors import InputError
from scene.geometry.camera import Camera
from scene.geometry.pose import Pose
from scene.maps.sparse_map import MapImage, SparseMap
from scene.runtime.printed import printed
from scene.runtime.progress import progress_bar
from scene.storage.files import write_text
from scene.storage.images import read_rgb
from scene.storage.marks import PNG_MARK
from scene.storage.outputs import Output, claim

PAGE = Path("pictures", "view.html")
PICTURE = Path("pictures", "view.png")
MOST_POINTS: Final = {"sparse": 150_000, "added": 20_000, "dense": 250_000}
"""Points of a kind that a page holds; of more, so many are chosen at random."""
MOST_PHOTOGRAPHS: Final = 300
"""Photographs that a page holds; of more, so many evenly spread over their order."""

log = logging.getLogger(__name__)

_ENDINGS = (".html", ".htm")
# Stands near the beginning of every page.
_MARK = b"<title>ObjConnect scene</title>"
_SIDE = 360
# Points stand on a grid of so many steps along each side of their cloud.
_STEPS = 65535


@dataclass(frozen=True)
class SceneView:
    """What ``view`` wrote.

    Attributes:
        page: opens as a file, and holds everything it shows.
        picture: the same from above.
        points: of the map, those added to it, and of the dense cloud, as far as there are any.
    """

    page: Path
    picture: Path
    points: dict[str, int]


def view(path: Path, results: Sequence[Path] = (), out: Path | None = None) -> SceneView:
    """Write a scene as a page in which one can move, and as a picture.

    Args:
        path: of a finished scene with its map.
        results: files that ``evaluate`` wrote for this scene, or folders with such files.
        out: of the page, an HTML file, the picture beside it as PNG; else both lie among the
            scene's pictures. Files there are replaced only if this command wrote them.

    Raises:
        InputError: not a finished scene, no map, a damaged file, results of other photographs or
            of other scenes alone, or ``out`` cannot be written.
    """
    scene = Scene.open(path)
    page, picture = _outputs(path, results, out)
    sparse_map = scene.sparse_map()
    added = scene.added_points(sparse_map)
    poses = {
        name: pose
        for session in scene.sessions
        for name, pose in zip(*_posed(scene, session), strict=True)
    }
    found, others = [], []
    for source in results:
        for file in results_files(source):
            read = load(file)
            # A folder may hold other data sets beside this one.
            if source.is_file() or read.dataset.name == scene.name:
                found.append(_method(read, poses, file))
            else:
                others.append(read.dataset.name)
    if others:
        named = ", ".join(printed(name) for name in dict.fromkeys(others))
        if not found:
            raise InputError(f"the results are of {named}, none of the scene {scene.name}")
        log.warning("not shown are %d results of %s", len(others), named)
    clouds = _clouds(scene, sparse_map, added)
    things = _things(scene, sparse_map, added)
    ways = [
        np.array([poses[name].centre().numpy() for name in names])
        for names in scene.splits.queries.values()
        if names
    ]
    write_text(page, fill("view", _data(scene, sparse_map, poses, clouds, things, ways, found)))
    draw(scene.name, sparse_map.centres, clouds, things, ways, found, picture)
    return SceneView(page, picture, {cloud.layer: len(cloud.xyz) for cloud in clouds})


def _outputs(path: Path, results: Sequence[Path], out: Path | None) -> tuple[Path, Path]:
    """Page and picture, none of which may replace what this command did not write."""
    if out is None:
        claim([path / PAGE, path / PICTURE], within=path)
        return path / PAGE, path / PICTURE
    if out.suffix.lower() not in _ENDINGS:
        raise InputError(f"{out} is no name for a page: let it end in .html")
    picture = out.with_suffix(".png")
    claim([Output(out, _MARK), Output(picture, PNG_MARK)], [path, *results])
    return out, picture


def _posed(scene: Scene, session: str) -> tuple[tuple[str, ...], list[Pose]]:
    frames = scene.frames(session)
    return frames.names, [Pose.from_matrix(matrix) for matrix in frames.cam_from_world]


def _method(results: Results, poses: dict[str, Pose], path: Path) -> Method:
    queries = []
    for query in results.queries:
        if query.name not in poses:
            raise InputError(f"{path} is not of this scene, which has no photograph {query.name}")
        numbers = query.cam_from_world
        estimate = None if numbers is None else Pose.from_quaternion(numbers[:4], numbers[4:])
        queries.append(
            Found(
                name=query.name,
                truth=poses[query.name].centre().numpy(),
                centre=None if estimate is None else estimate.centre().numpy(),
                error=query.t_err_m,
                angle=query.r_err_deg,
                status=query.status.value,
            )
        )
    return Method(results.method.name, tuple(queries))


def _clouds(scene: Scene, sparse_map: SparseMap, added: NDArray[np.bool_]) -> list[Cloud]:
    clouds = [Cloud("sparse", sparse_map.xyz[~added], sparse_map.rgb[~added])]
    if added.any():
        clouds.append(Cloud("added", sparse_map.xyz[added], sparse_map.rgb[added]))
    dense = Workspace(scene.path / DENSE)
    if dense.cloud.is_file():
        clouds.append(Cloud("dense", *dense.read_cloud()))
    return clouds


def _things(scene: Scene, sparse_map: SparseMap, added: NDArray[np.bool_]) -> list[Thing]:
    seen: set[int] = set()

    def instances() -> Iterator[tuple[MapImage, NDArray[np.uint16]]]:
        for image, layers in scene.mapped_layers(sparse_map, "instance"):
            seen.update(np.unique(layers["instance"]).tolist())
            yield image, layers["instance"]

    owners = objects_of_points(len(added), instances())
    before, after = set(owners[~added].tolist()), set(owners.tolist())
    return [
        Thing(item, item.id in before, item.id in after)
        for item in scene.objects.objects
        if item.id in seen
    ]


def _data(
    scene: Scene,
    sparse_map: SparseMap,
    poses: Mapping[str, Pose],
    clouds: Sequence[Cloud],
    things: Sequence[Thing],
    ways: Sequence[NDArray[np.float64]],
    methods: Sequence[Method],
) -> dict[str, Any]:
    """Everything of the page, for ``templates/view.js``."""
    # A few points far away, as on the horizon, would make everything small.
    around = np.concatenate([np.percentile(sparse_map.xyz, [2, 98], axis=0), sparse_map.centres])
    low, high = around.min(0), around.max(0)
    return {
        "name": scene.name,
        "target": (0.5 * (low + high)).tolist(),
        "distance": 1.3 * float(np.linalg.norm(high - low)),
        "clouds": [_packed(cloud) for cloud in clouds],
        "objects": [
            {
                "size": thing.item.size_class,
                "corners": thing.corners.tolist(),
                "low": thing.item.centre[2] - thing.item.size[2] / 2,
                "high": thing.item.centre[2] + thing.item.size[2] / 2,
                "before": thing.before,
                "after": thing.after,
            }
            for thing in things
        ],
        "cameras": _cameras(scene, sparse_map, poses),
        "photographs": _photographs(scene, sparse_map),
        "ways": [way.tolist() for way in ways],
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
                    }
                    for query in method.queries
                ],
            }
            for method in methods
        ],
    }


def _packed(cloud: Cloud) -> dict[str, Any]:
    """A cloud on a grid of 65536 steps a side: of 250 m, four millimetres each."""
    total, most = len(cloud.xyz), MOST_POINTS[cloud.layer]
    kept = np.arange(total)
    if total > most:
        kept = np.sort(np.random.default_rng(0).choice(total, most, replace=False))
    xyz = cloud.xyz[kept]
    low = xyz.min(0) if len(xyz) else np.zeros(3)
    step = np.maximum(np.ptp(xyz, axis=0) if len(xyz) else 0, 1e-9) / _STEPS
    grid = np.round((xyz - low) / step).astype("<u2")
    return {
        "layer": cloud.layer,
        "total": total,
        "low": low.tolist(),
        "step": np.broadcast_to(step, 3).tolist(),
        "xyz": base64.b64encode(grid.tobytes()).decode(),
        "rgb": base64.b64encode(np.ascontiguousarray(cloud.rgb[kept]).tobytes()).decode(),
    }


def _shown(scene: Scene, sparse_map: SparseMap) -> list[str]:
    """Photographs of the map and queries, in this order."""
    queries = [name for names in scene.splits.queries.values() for name in names]
    return [*sparse_map.names, *queries]


def _cameras(
    scene: Scene, sparse_map: SparseMap, poses: Mapping[str, Pose]
) -> list[dict[str, Any]]:
    cameras: dict[str, Camera] = {}
    for session in scene.sessions:
        frames = scene.frames(session)
        cameras.update(zip(frames.names, frames.cameras, strict=True))
    listed = []
    for name in _shown(scene, sparse_map):
        mapped = sparse_map.images.get(name)
        pose = poses[name] if mapped is None else mapped.pose
        camera = cameras[name] if mapped is None else mapped.camera
        world_from_cam = pose.rotation.T.numpy()
        wide, high = camera.width / camera.focal[0] / 2, camera.height / camera.focal[1] / 2
        corners = np.array([[-wide, -high, 1], [wide, -high, 1], [wide, high, 1], [-wide, high, 1]])
        centre = pose.centre().numpy()
        listed.append(
            {
                "name": name,
                "session": name.partition("/")[0],
                "role": "query" if mapped is None else "map",
                "centre": centre.tolist(),
                "ahead": world_from_cam[:, 2].tolist(),
                "up": (-world_from_cam[:, 1]).tolist(),
                "rays": (corners @ world_from_cam.T).tolist(),
                "depth": max(1.0, sparse_map.height_above(centre)),
            }
        )
    return listed


def _photographs(scene: Scene, sparse_map: SparseMap) -> dict[str, str]:
    names = _shown(scene, sparse_map)
    count = min(len(names), MOST_PHOTOGRAPHS)
    chosen = [names[k] for k in np.linspace(0, len(names) - 1, count).astype(int)]
    packed = {}
    with progress_bar("photographs", len(chosen)) as advance:
        for done, name in enumerate(chosen, 1):
            small = webp(read_rgb(scene.images_root / name), _SIDE)
            packed[name] = "data:image/webp;base64," + base64.b64encode(small).decode()
            advance(done)
    return packed
