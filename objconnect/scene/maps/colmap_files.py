"""A reader of COLMAP's binary model that does not need COLMAP.

COLMAP's own reader ends the process (a failed CHECK, not an exception) on a truncated file, and
allocates as much memory as a damaged count claims. This reader compares every count with the bytes
that are left before it allocates anything.

The layout is the binary one of https://colmap.github.io/format.html. ``images.bin`` holds the pose
of every image, even if the model has files of rigs and frames.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import MODELS, Camera
from objconnect.scene.geometry.colmap_models import (
    CONVERTIBLE_MODELS,
    MODEL_IDS,
    convert_model,
    parameter_count,
)
from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.maps.sparse_map import MapImage, SparseMap
from objconnect.scene.storage.files import is_safe_path, require_folder, require_readable

MODEL_FILES: Final = ("cameras.bin", "images.bin", "points3D.bin")
"""Files that ``read_model`` reads."""

RIG_FILES: Final = ("rigs.bin", "frames.bin")
"""Further files of COLMAP from version 3.12 on."""

# The point identifier of a keypoint that observes no point.
_NO_POINT = np.uint64(2**64 - 1)
_OBSERVATION = np.dtype([("x", "<f8"), ("y", "<f8"), ("point", "<u8")])
# Largest deviation of a quaternion's length from one.
_UNIT_TOLERANCE = 1e-3


def read_model(folder: Path) -> SparseMap:
    """Read a map from ``cameras.bin``, ``images.bin`` and ``points3D.bin``.

    Args:
        folder: folder of the binary model.

    Raises:
        InputError: the folder or a file is missing, a file is truncated or damaged, a pose is not
            finite, a quaternion is not of unit length, or the map holds no image or no point.

    Examples:
        >>> sparse_map = read_model(Path("scene/map"))  # doctest: +SKIP
        >>> sparse_map.xyz.shape, len(sparse_map.images)  # doctest: +SKIP
        ((48213, 3), 214)
    """
    require_folder(folder, "map folder")
    cameras = _read_cameras(folder / "cameras.bin")
    ids, xyz, rgb, error, track_length = _read_points(folder / "points3D.bin")
    images = _read_images(folder / "images.bin", cameras, ids)
    if not images:
        raise InputError(f"map {folder} is empty: it has no registered image")
    if not len(xyz):
        raise InputError(f"map {folder} is empty: it has no 3D point")
    return SparseMap(images, xyz, rgb, error, track_length)


def read_point_ids(folder: Path) -> NDArray[np.uint64]:
    """Return COLMAP's identifiers of a model's points, (M,), in the order of ``SparseMap.xyz``.

    Raises:
        InputError: ``points3D.bin`` is missing or damaged.
    """
    return _read_points(folder / "points3D.bin")[0]


class _Reader:
    """A cursor over a file that refuses to run past its end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        text = path.with_suffix(".txt")
        if not path.exists() and text.exists():
            raise InputError(
                f"cannot read map file {path}: {path.parent} is a text model: convert it with "
                f"'colmap model_converter --input_path {path.parent} --output_path {path.parent} "
                "--output_type BIN'"
            )
        require_readable(path, "map file")
        try:
            self.data = path.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read map file {path}: {error.strerror}") from error
        self.offset = 0

    def take(self, size: int) -> int:
        """Advance by ``size`` bytes and return the offset at which they start."""
        start = self.offset
        if size < 0 or start + size > len(self.data):
            raise InputError(f"map file {self.path} is truncated or damaged at byte {start}")
        self.offset = start + size
        return start

    def unpack(self, layout: struct.Struct) -> tuple[float, ...]:
        """Read one record."""
        values: tuple[float, ...] = layout.unpack_from(self.data, self.take(layout.size))
        return values

    def count(self, record_size: int) -> int:
        """Read a number of records; refuse it if the rest of the file cannot hold them."""
        (n,) = self.unpack(_COUNT)
        if n * record_size > len(self.data) - self.offset:
            raise InputError(
                f"map file {self.path} is truncated or damaged: it claims {n} records of at least "
                f"{record_size} bytes and has {len(self.data) - self.offset} bytes left"
            )
        return int(n)

    def text(self) -> str:
        """Read a string that ends with a zero byte."""
        start = self.offset
        end = self.data.find(b"\0", start)
        if end < 0:
            raise InputError(f"map file {self.path} is truncated or damaged at byte {start}")
        try:
            value = self.data[start:end].decode("utf-8")
        except UnicodeDecodeError:
            raise InputError(f"map file {self.path} has a damaged name at byte {start}") from None
        self.offset = end + 1
        return value


# Records of the three files.
_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")
_IMAGE = struct.Struct("<I4d3dI")
_POINT = struct.Struct("<Q3d3BdQ")


def _read_cameras(path: Path) -> dict[int, Camera]:
    reader = _Reader(path)
    cameras = {}
    for _ in range(reader.count(_CAMERA.size)):
        camera_id, model_id, width, height = (int(v) for v in reader.unpack(_CAMERA))
        try:
            cameras[camera_id] = _camera(reader, model_id, width, height)
        except InputError as error:
            raise InputError(f"{path}: camera {camera_id}: {error}") from None
    return cameras


def _camera(reader: _Reader, model_id: int, width: int, height: int) -> Camera:
    """Read the parameters of a camera and return the equal supported model."""
    model = MODEL_IDS.get(model_id, f"number {model_id}")
    count = len(MODELS[model]) if model in MODELS else parameter_count(model)
    if count is None:
        supported = ", ".join((*MODELS, *CONVERTIBLE_MODELS))
        raise InputError(f"its model {model} is not supported; supported: {supported}")
    params = struct.unpack_from(f"<{count}d", reader.data, reader.take(8 * count))
    if not all(map(math.isfinite, params)):
        raise InputError(f"camera parameters must be finite, got {params}")
    model, params = convert_model(model, params)
    return Camera(model, width, height, params)


def _read_images(
    path: Path, cameras: dict[int, Camera], point_ids: NDArray[np.uint64]
) -> dict[str, MapImage]:
    from objconnect.scene.geometry.pose import Pose

    reader = _Reader(path)
    images: dict[str, MapImage] = {}
    for _ in range(reader.count(_IMAGE.size + 9)):
        record = reader.unpack(_IMAGE)
        quaternion, translation = np.array(record[1:5]), np.array(record[5:8])
        name = reader.text()
        count = reader.count(_OBSERVATION.itemsize)
        start = reader.take(count * _OBSERVATION.itemsize)
        observed = np.frombuffer(reader.data, _OBSERVATION, count, start)
        check_pose(quaternion, translation, f"{path}: image {name}")
        if record[8] not in cameras:
            raise InputError(f"{path}: image {name} has the unknown camera {record[8]:.0f}")
        if not is_safe_path(name):
            raise InputError(f"{path}: image {name!r} does not lie in the folder of images")
        if name in images:
            raise InputError(f"{path}: image {name} is listed twice")
        images[name] = MapImage(
            name=name,
            camera=cameras[int(record[8])],
            cam_from_world=Pose.from_quaternion(quaternion, translation).matrix().numpy(),
            xy=np.stack([observed["x"], observed["y"]], -1),
            point_rows=_find_rows(observed["point"], point_ids, path, name),
        )
    return images


def _find_rows(
    observed: NDArray[np.uint64], ids: NDArray[np.uint64], path: Path, name: str
) -> NDArray[np.int64]:
    """Return the row of each observed identifier in the sorted identifiers, -1 for no point."""
    rows = np.full(len(observed), -1, np.int64)
    if len(ids) == 0:
        return rows
    seen = observed != _NO_POINT
    nearest = np.searchsorted(ids, observed[seen])
    if (ids[np.minimum(nearest, len(ids) - 1)] != observed[seen]).any():
        raise InputError(f"{path}: image {name} observes a point that points3D.bin does not have")
    rows[seen] = nearest
    return rows


def _read_points(
    path: Path,
) -> tuple[
    NDArray[np.uint64],
    NDArray[np.float64],
    NDArray[np.uint8],
    NDArray[np.float64],
    NDArray[np.int64],
]:
    """Return identifiers (sorted), xyz, rgb, error and track length of every point."""
    reader = _Reader(path)
    n = reader.count(_POINT.size)
    table = np.empty((n, 8))
    ids = np.empty(n, np.uint64)  # a float64 cannot hold every 64-bit identifier
    for k in range(n):
        point_id, *values, track = reader.unpack(_POINT)
        reader.take(8 * int(track))
        ids[k] = point_id
        table[k, :7] = values
        table[k, 7] = track
    order = np.argsort(ids, kind="stable")
    ids, table = ids[order], table[order]
    if not np.isfinite(table[:, :3]).all():
        bad = int(ids[~np.isfinite(table[:, :3]).all(1)][0])
        raise InputError(f"{path}: point {bad} has a coordinate that is not finite")
    if n and np.abs(table[:, :3]).max() > FARTHEST_M:
        far = int(ids[(np.abs(table[:, :3]) > FARTHEST_M).any(1)][0])
        raise InputError(
            f"{path}: point {far} lies more than {FARTHEST_M:g} m away from the origin"
        )
    if (ids[1:] == ids[:-1]).any():
        raise InputError(f"{path}: two points share an identifier")
    return (
        ids,
        table[:, :3].copy(),
        table[:, 3:6].astype(np.uint8),
        table[:, 6].copy(),
        table[:, 7].astype(np.int64),
    )


def check_pose(
    quaternion: NDArray[np.float64], translation: NDArray[np.float64], where: str
) -> None:
    """Refuse a pose that no camera can have.

    Args:
        quaternion: (4,).
        translation: (3,) metres.
        where: subject of the message: file and image.

    Raises:
        InputError: a number is not finite, the camera is more than ``FARTHEST_M`` away from the
            origin, or the quaternion is not of unit length.
    """
    if not (np.isfinite(quaternion).all() and np.isfinite(translation).all()):
        raise InputError(f"{where} has a pose that is not finite")
    if np.abs(translation).max() > FARTHEST_M:
        raise InputError(f"{where} has a pose more than {FARTHEST_M:g} m away from the origin")
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1) > _UNIT_TOLERANCE:
        raise InputError(
            f"{where} has a quaternion of length {norm:.4f} instead of 1: "
            "check the order and number of its columns"
        )
