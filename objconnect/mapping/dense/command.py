"""The command ``dense``: depth maps and a fused cloud of a scene's map photographs."""

from __future__ import annotations

import json
import logging
import shutil
import time
import zlib
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from objconnect.mapping.dense.consistency import count_agreeing
from objconnect.mapping.dense.options import DEFAULTS, DenseOptions
from objconnect.mapping.dense.patchmatch import consistent_estimate, first_estimate
from objconnect.mapping.dense.pictures import draw_cloud, draw_maps
from objconnect.mapping.dense.planes import normals_of, planes_of
from objconnect.mapping.dense.report import DenseCloud, DenseReport, read_truth, report
from objconnect.mapping.dense.sources import choose_all, find_seeds
from objconnect.mapping.dense.undistort import pinhole_of, undistort_map, write_undistorted
from objconnect.mapping.dense.warp import StereoView
from objconnect.mapping.dense.workspace import KINDS, Stage, Workspace
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.colmap.models import write_with_poses
from objconnect.scene.colmap.stereo import fuse_depth_maps, patch_match_stereo
from objconnect.scene.config import take_recorded
from objconnect.scene.errors import InputError
from objconnect.scene.exports.depth_views import DENSE as DENSE
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.colmap_files import MODEL_FILES, RIG_FILES
from objconnect.scene.maps.photographs import PosedImage
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.cluster import worker_pool
from objconnect.scene.runtime.device import AUTO, torch_device
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import (
    TEMPORARY_PREFIX,
    atomic_folder,
    link_or_copy,
    replace_folder,
)
from objconnect.scene.storage.digests import digest_of, digests, require_unchanged
from objconnect.scene.storage.files import read_text, require_disk_space
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.locks import write_lock
from objconnect.scene.storage.lru_cache import LruCache
from objconnect.scene.storage.resumable import ResumableFolder

UNFINISHED = f"{TEMPORARY_PREFIX}dense"
KEY_FILE = "dense.json"
Stereo = Literal["own", "colmap"]

# Depth maps are first estimated one by one, then made consistent with their sources.
_STAGES: tuple[Stage, ...] = ("photometric", "geometric")

# Bytes of a point of the fused cloud with its visibility count, and of each visibility entry.
_POINT_BYTES, _VISIBILITY_BYTES = 31, 4
# Number of depth maps in the overview picture.
_SHOWN_MAPS = 3
# Times are reported for a depth map of this many pixels.
_REPORT_PIXELS = 512 * 512
# Capacity of each cache, in photographs or maps of the largest size.
_CACHE_ITEMS = 64
# Weights of red, green and blue in grey (ITU-R BT.601), for grey in 0..1.
_LUMA = np.array([0.299, 0.587, 0.114], np.float32) / 255

logger = logging.getLogger(__name__)


# More than six parameters: they are the options of the command ``dense``.
def dense(
    path: Path,
    *,
    size: int = 1024,
    sources: int = 6,
    stereo: Stereo = "own",
    seed: int = 0,
    cluster: str | None = None,
    device: str = AUTO,
    options: DenseOptions = DEFAULTS,
) -> DenseReport:
    """Estimate a depth map for every map photograph, fuse them, and measure the result.

    The result is the folder ``dense/`` of the scene, in the layout of COLMAP's workspaces. It is
    made map by map in a hidden folder. An interrupted run continues with the next map and gives
    the same bytes.

    Args:
        path: path of a finished scene with its map.
        size: longest side of the depth maps, pixels; photographs are never enlarged.
        sources: maximum number of source photographs of a depth map.
        stereo: "own" PatchMatch, or "colmap" where pycolmap has CUDA.
        seed: random seed; the same seed gives the same files.
        cluster: cluster that runs our PatchMatch, see ``worker_pool``. Its nodes must see the scene
            at the same path and write to it.
        device: device of our PatchMatch, as in ``objconnect.scene.runtime.device.Device``. On a
            cluster, whose jobs request CPU cores alone, auto is cpu.
        options: thresholds of consistency and fusion.

    Returns:
        Statistics of the depth maps, with accuracy where the scene has true depth.

    Raises:
        InputError: the scene is not finished, is being written by another run, has no map or a
            damaged photograph, no photograph has enough overlap with others, the folder cannot be
            written, or the device does not exist.
    """
    if cluster is not None and device == AUTO:
        device = "cpu"  # jobs of a cluster request CPU cores alone
    request = _Request(size, sources, stereo, seed, str(torch_device(device)), options)
    scene = Scene.open(path)
    with write_lock(path):
        return _estimate_and_fuse(scene, request, cluster)


@dataclass(frozen=True)
class _Request:
    """The arguments of ``dense``."""

    size: int
    sources: int
    stereo: Stereo
    seed: int
    device: str
    options: DenseOptions


def _estimate_and_fuse(scene: Scene, request: _Request, cluster: str | None) -> DenseReport:
    path = scene.path
    scene.check_readable()
    sparse_map = scene.sparse_map()
    cameras = {i.camera: pinhole_of(i.camera, request.size) for i in sparse_map.images.values()}
    pinhole_map = undistort_map(sparse_map, cameras)
    options = request.options
    min_sources = options.confirmed
    sources_of = choose_all(pinhole_map, request.sources, min_sources)
    if not sources_of:
        raise InputError(
            f"no photograph of the map of {path} overlaps enough with {min_sources} others: "
            "fly with more overlap"
        )
    skipped = sorted(set(sparse_map.names) - set(sources_of))
    if skipped:
        logger.warning(
            "%d of %d photographs overlap too little with others for a depth map, such as %s",
            len(skipped), len(sparse_map.names), skipped[0],
        )  # fmt: skip
    files = [scene.images_root / name for name in sparse_map.names]
    photographs = digests(files)
    key = {"map": sparse_map.sha256, "photographs": digest_of(*photographs), "size": request.size,
           "sources": request.sources, "stereo": request.stereo, "seed": request.seed,
           "device": request.device, "options": options.model_dump(mode="json")}  # fmt: skip
    workspace = _open_workspace(scene, key)
    _write_photographs(scene, sparse_map, cameras, workspace)
    try:
        require_unchanged(files, photographs)
    except InputError:
        shutil.rmtree(workspace.path)  # it may contain changed files
        raise
    _write_model(pinhole_map, workspace)
    workspace.write_lists(sources_of)
    maps = _Maps(pinhole_map, workspace, sources_of, request)
    seconds = None
    if request.stereo == "own":
        seconds = _make_maps(maps, cluster)
    else:
        patch_match_stereo(workspace.path)
    known_pixels = 0
    for name in sources_of:  # a damaged file ends the process in COLMAP's fusion, so read all first
        known_pixels += np.count_nonzero(workspace.depth(name, "geometric"))
        workspace.normals(name, "geometric")
    # COLMAP does not report a full disk. A point uses ``options.fused`` or more pixels of its own.
    fused_bytes = known_pixels // options.fused * _POINT_BYTES + known_pixels * _VISIBILITY_BYTES
    require_disk_space(workspace.cloud, fused_bytes)
    xyz, rgb = fuse_depth_maps(workspace.path, workspace.cloud, options.fused)
    truth = read_truth(scene, pinhole_map)
    names = tuple(sources_of)
    shown = [names[k] for k in np.linspace(0, len(names) - 1, _SHOWN_MAPS + 2).astype(int)[1:-1]]
    confirmations = {name: maps.confirmations(name) for name in shown}
    draw_maps(workspace, shown, confirmations, truth, path / "pictures" / "dense-maps.png")
    draw_cloud(xyz, rgb, path / "pictures" / "dense-cloud.png")
    cloud = DenseCloud(workspace, names, len(xyz), seconds)
    result = report(scene, len(pinhole_map.names), cloud, truth)
    _finish(scene, workspace)
    return result


def _open_workspace(scene: Scene, key: dict[str, Any]) -> Workspace:
    """Return the unfinished folder of an earlier run with the same key, or a new one.

    A finished folder keeps its record, so that the next run with the same key hard-links its
    complete files.
    """
    unfinished, finished_folder = (
        _resumable(scene.path / name, key) for name in (UNFINISHED, DENSE)
    )
    try:
        if not unfinished.has_same_request():
            shutil.rmtree(unfinished.path, ignore_errors=True)
            if finished_folder.has_same_request():
                _link_complete(finished_folder.path, unfinished.path)
    except OSError as error:
        raise InputError(f"cannot write {scene.path}: {error.strerror or error}") from None
    unfinished.begin()
    return Workspace(unfinished.path)


def _resumable(folder: Path, key: dict[str, Any]) -> ResumableFolder:
    request = json.dumps(key, indent=1) + "\n"

    def difference(record: Path) -> str | None:
        try:
            recorded = dict(json.loads(read_text(record, "dense key")))
            options = take_recorded(DenseOptions, dict(recorded.get("options", {})))
        except (ValueError, TypeError):
            return "key"
        # Options that did not exist when the folder was made have their defaults.
        recorded["options"] = DEFAULTS.model_dump(mode="json") | options
        recorded.setdefault("device", "cpu")
        return None if recorded == json.loads(request) else "key"

    return ResumableFolder(folder, folder / KEY_FILE, request, difference)


def list_own_files(workspace: Workspace) -> set[str]:
    """Return the files that ``dense`` writes into a workspace, as ``atomic_folder`` takes them."""
    lists = [KEY_FILE, "stereo/patch-match.cfg", "stereo/fusion.cfg", "fused.ply", "fused.ply.vis"]
    files = {*lists, *(f"sparse/{file}" for file in (*MODEL_FILES, *RIG_FILES))}
    for name in workspace.names():
        files.add(f"images/{name}")
        files |= {f"stereo/{kind}/{name}.{stage}.bin" for kind in KINDS for stage in _STAGES}
    return files


def _link_complete(finished_folder: Path, unfinished: Path) -> None:
    """Link finished files into the unfinished folder, without changing the finished one."""
    cloud = Workspace(finished_folder).cloud.name
    own_files = list_own_files(Workspace(finished_folder))
    for path in sorted(finished_folder.rglob("*")):
        name = path.relative_to(finished_folder).as_posix()
        # COLMAP overwrites the cloud in place, so it is not linked.
        if path.is_file() and name in own_files and not name.startswith(cloud):
            (unfinished / name).parent.mkdir(parents=True, exist_ok=True)
            link_or_copy(path, unfinished / name)


def _finish(scene: Scene, workspace: Workspace) -> None:
    """Move the finished folder to its final path, and record it in the scene's manifest."""
    finished_folder = scene.path / DENSE
    try:
        replace_folder(finished_folder, workspace.path, list_own_files(Workspace(finished_folder)))
    except OSError as error:
        raise InputError(f"cannot write {finished_folder}: {error.strerror or error}") from None
    finish_scene(scene.path, scene.manifest)


def _write_photographs(
    scene: Scene,
    sparse_map: SparseMap,
    cameras: Mapping[Camera, Camera],
    workspace: Workspace,
) -> None:
    with progress_bar("undistorted photographs", len(sparse_map.names)) as advance:
        for done, name in enumerate(sparse_map.names, 1):
            camera, out = sparse_map.images[name].camera, workspace.images / name
            if not out.is_file():
                write_undistorted(scene.images_root / name, camera, cameras[camera], out)
            advance(done)


def _write_model(sparse_map: SparseMap, workspace: Workspace) -> None:
    images = [sparse_map.images[name] for name in sparse_map.names]
    posed = [PosedImage(image.name, image.camera, image.cam_from_world) for image in images]
    with atomic_folder(workspace.sparse, (*MODEL_FILES, *RIG_FILES)) as folder:
        write_with_poses(posed, sparse_map, folder)


def _make_maps(maps: _Maps, cluster: str | None) -> float | None:
    """Make the missing depth maps; return CPU-seconds per ``_REPORT_PIXELS``, None if none."""
    finished = len(maps) - sum(len(maps.missing(stage)) for stage in _STAGES)
    pixels, seconds = 0, 0.0
    with (
        worker_pool(cluster, maps) as workers,
        progress_bar("depth maps", len(maps)) as advance,
    ):
        advance(finished)
        for stage in _STAGES:
            with closing(workers.map(maps.missing(stage))) as made:
                for size, took in made:
                    pixels, seconds, finished = pixels + size, seconds + took, finished + 1
                    advance(finished)
    # Each pixel was counted in both stages.
    return 2 * seconds / pixels * _REPORT_PIXELS if pixels else None


class _Maps:
    """Makes the missing depth maps of a workspace."""

    def __init__(
        self,
        sparse_map: SparseMap,
        workspace: Workspace,
        sources_of: dict[str, list[str]],
        request: _Request,
    ) -> None:
        self._map = sparse_map
        self._workspace = workspace
        self._sources_of = sources_of
        self._request = request
        self._options = request.options
        self._device = torch_device(request.device)
        images = sparse_map.images.values()
        pixels = max(image.camera.width * image.camera.height for image in images)
        floats = _CACHE_ITEMS * pixels * np.dtype(np.float32).itemsize
        self.view = LruCache(self._read_view, floats)
        # Planes of the first stage: inverse depth and two slopes.
        self.photometric = LruCache(self._read_photometric, 3 * floats)

    def __reduce__(self) -> tuple[type[_Maps], tuple[object, ...]]:
        """Pickle for a worker of a cluster, without the caches."""
        return _Maps, (self._map, self._workspace, self._sources_of, self._request)

    def missing(self, stage: Stage) -> list[tuple[Stage, str]]:
        """List the maps to make in a stage. The second stage needs all maps of the first."""
        return [(stage, name) for name in self._sources_of if not self._workspace.has(name, stage)]

    def __len__(self) -> int:
        """Count the maps of both stages."""
        return 2 * len(self._sources_of)

    @torch.inference_mode()
    def __call__(self, unit: tuple[Stage, str]) -> Iterator[tuple[int, float]]:
        """Make one map; yield its number of pixels and its CPU-seconds."""
        start = time.process_time()
        stage, name = unit
        is_first = stage == "photometric"
        estimate = self._estimate_photometric if is_first else self._estimate_geometric
        planes, depth = estimate(name)
        normals = normals_of(planes, self.view(name).camera)
        self._workspace.write(name, stage, depth.cpu().numpy(), normals.cpu().numpy())
        yield depth.numel(), time.process_time() - start

    @torch.inference_mode()
    def confirmations(self, name: str) -> NDArray[np.int64]:
        """Count the sources that confirm each pixel of a finished depth map, (H, W)."""
        depth = torch.from_numpy(self._workspace.depth(name, "geometric")).to(self._device)
        inverse = torch.where(depth > 0, 1 / depth, 0)
        return self._confirmations(name, inverse).cpu().numpy()

    def _confirmations(self, name: str, inverse: Tensor) -> Tensor:
        others = self._sources_of[name]
        return count_agreeing(
            self.view(name),
            [self.view(other) for other in others],
            inverse,
            [self.photometric(other)[0] for other in others],
            self._options,
        )

    def _estimate_photometric(self, name: str) -> tuple[Tensor, Tensor]:
        sources = [self.view(other) for other in self._sources_of[name]]
        seeds = find_seeds(self._map, name)
        planes, _ = first_estimate(self.view(name), sources, seeds, self._generator(name))
        return planes, 1 / planes[0]

    def _estimate_geometric(self, name: str) -> tuple[Tensor, Tensor]:
        others = self._sources_of[name]
        planes, _ = consistent_estimate(
            self.view(name),
            [self.view(other) for other in others],
            self.photometric(name),
            [self.photometric(other)[0] for other in others],
            self._generator(name),
        )
        confirmed = self._confirmations(name, planes[0]) >= self._options.confirmed
        return planes, torch.where(confirmed, 1 / planes[0], 0)

    def _generator(self, name: str) -> torch.Generator:
        """Return a generator seeded by photograph, so that the order of maps does not matter."""
        return torch.Generator().manual_seed(zlib.crc32(f"{self._request.seed} {name}".encode()))

    def _read_view(self, name: str) -> StereoView:
        image = self._map.images[name]
        rgb = read_rgb(self._workspace.images / name, image.camera)
        grey = torch.from_numpy(rgb.astype(np.float32) @ _LUMA)
        return StereoView(grey.to(self._device), image.camera, image.cam_from_world)

    def _read_photometric(self, name: str) -> Tensor:
        depth = torch.from_numpy(self._workspace.depth(name, "photometric")).to(self._device)
        normals = torch.from_numpy(self._workspace.normals(name, "photometric")).to(self._device)
        return planes_of(depth, normals, self._map.images[name].camera)
