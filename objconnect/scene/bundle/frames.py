"""``frames.h5``: poses, cameras, priors and dense annotations of one session (flight)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import HDF5_DAMAGE, InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import FARTHEST_M
from objconnect.scene.storage.files import is_safe_path
from objconnect.scene.storage.hdf5 import array, dataset
from objconnect.scene.storage.hdf5_writing import hdf5_file

if TYPE_CHECKING:
    from objconnect.scene.geometry.pose import Pose

Layer = Literal["depth", "instance", "semantic", "normal"]
LAYERS: dict[Layer, np.dtype[Any]] = {
    "depth": np.dtype("f4"),
    "instance": np.dtype("u2"),
    "semantic": np.dtype("u1"),
    "normal": np.dtype("i1"),
}
"""The stored data type of every dense layer."""


@dataclass(frozen=True)
class Frames:
    """The N frames of one session; values that the flight did not measure are NaN.

    A position or an attitude is NaN together with its sigma.

    Attributes:
        names: image names, relative to the scene's ``sessions`` folder.
        cameras: one camera per frame.
        cam_from_world: (N, 4, 4) float64.
        time: (N,) seconds since 1970.
        gps_prior: (N, 3) camera centre measured by GNSS, world metres.
        gps_sigma: (N, 3) standard deviation of ``gps_prior`` per axis, metres.
        attitude_prior: (N, 4) measured rotation of ``cam_from_world``, quaternion w x y z.
        attitude_sigma_deg: (N,) standard deviation of ``attitude_prior``, degrees.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    cam_from_world: NDArray[np.float64]
    time: NDArray[np.float64]
    gps_prior: NDArray[np.float64]
    gps_sigma: NDArray[np.float64]
    attitude_prior: NDArray[np.float64]
    attitude_sigma_deg: NDArray[np.float64]

    @property
    def poses(self) -> Pose:
        """Return all poses as one batch."""
        from objconnect.scene.geometry.pose import Pose

        return Pose.from_matrix(self.cam_from_world)

    @property
    def has_gps(self) -> NDArray[np.bool_]:
        """Return whether each frame's position was measured, (N,)."""
        return np.asarray(np.isfinite(self.gps_prior).all(1))

    @property
    def has_attitude(self) -> NDArray[np.bool_]:
        """Return whether each frame's attitude was measured, (N,)."""
        return np.asarray(np.isfinite(self.attitude_prior).all(1))

    def __len__(self) -> int:
        return len(self.names)


FRAME_SHAPES: Final[Mapping[str, tuple[int, ...]]] = {
    "cam_from_world": (4, 4),
    "time": (),
    "gps_prior": (3,),
    "gps_sigma": (3,),
    "attitude_prior": (4,),
    "attitude_sigma_deg": (),
}
"""The shape per frame of each array of ``Frames``."""
# Groups of arrays that are measured together or not at all.
_GROUPS = (
    ("time",),
    ("gps_prior", "gps_sigma"),
    ("attitude_prior", "attitude_sigma_deg"),
)


class DenseLayers:
    """A reader of dense annotations, one frame at a time, from an open file."""

    def __init__(self, file: h5py.File, path: Path) -> None:
        self._file = file
        self._path = path

    def has(self, layer: Layer) -> bool:
        """Return whether the session has the layer."""
        return layer in self._file

    def stored_bytes(self, layer: Layer) -> int:
        """Return the bytes that a layer takes in the file, compressed; 0 without the layer."""
        return dataset(self._file, layer).id.get_storage_size() if self.has(layer) else 0

    def read(self, layer: Layer, index: int) -> NDArray[Any]:
        """Read one frame of a layer: (H, W), or (H, W, 3) for normals.

        Depth is planar, in metres; normals are in the world frame, times 127.

        Raises:
            InputError: the layer is missing or its bytes are damaged.
        """
        try:
            if self.has(layer):
                return np.asarray(dataset(self._file, layer)[index])
        except HDF5_DAMAGE as error:
            raise InputError(
                f"{self._path}: the {layer} of frame number {index + 1} is damaged: {error}"
            ) from None
        raise InputError(f"{self._path} has no {layer} layer")


def write_frames(
    path: Path, frames: Frames, dense: Sequence[Layer], images: Iterator[dict[Layer, NDArray[Any]]]
) -> None:
    """Write a session's ``frames.h5`` atomically.

    Args:
        path: file to write.
        frames: poses, cameras and priors.
        dense: layers to write.
        images: the layers of each frame in order, consumed one at a time.

    Raises:
        ValueError: there are fewer images than frames.
        InputError: the file cannot be written.
    """
    cameras = list(dict.fromkeys(frames.cameras))
    with hdf5_file(path) as file:
        # Fixed length, because HDF5 can crash on damaged strings of variable length.
        file["cameras"] = np.array([str(camera).encode() for camera in cameras], "S")
        file["names"] = np.array([name.encode() for name in frames.names], "S")
        file["camera_index"] = [cameras.index(camera) for camera in frames.cameras]
        for key in FRAME_SHAPES:
            file[key] = getattr(frames, key)
        done = 0
        for index, layers in enumerate(images):
            for layer in dense:
                image = layers[layer]
                if layer not in file:
                    file.create_dataset(
                        layer,
                        (len(frames), *image.shape),
                        LAYERS[layer],
                        chunks=(1, *image.shape),
                        compression="gzip",
                        compression_opts=4,
                        shuffle=True,
                    )
                file[layer][index] = image
            done = index + 1
        if dense and done < len(frames):
            raise ValueError(f"{path}: {len(frames)} frames but images of {done}")


@contextmanager
def _open(path: Path) -> Iterator[h5py.File]:
    if not path.is_file():
        raise InputError(f"{path} does not exist")
    try:
        file = h5py.File(path, "r")
    except OSError:
        raise InputError(f"{path} is damaged or not an HDF5 file") from None
    with file:
        yield file


@contextmanager
def dense_layers(path: Path) -> Iterator[DenseLayers]:
    """Open the dense annotations of a ``frames.h5``.

    Raises:
        InputError: the file is missing or damaged.
    """
    with _open(path) as file:
        yield DenseLayers(file, path)


def read_frames(path: Path) -> Frames:
    """Read a ``frames.h5`` without its dense layers.

    Raises:
        InputError: the file is missing or damaged, an array has the wrong shape, or a number is not
            finite or too large.
    """
    with _open(path) as file:
        try:
            names = tuple(name.decode() for name in array(file, "names"))
            table = [Camera.parse(text.decode().split()) for text in array(file, "cameras")]
            rows = array(file, "camera_index")
            if (rows < 0).any():
                raise IndexError("a camera index is negative")
            cameras = tuple(table[int(k)] for k in rows)
            arrays = {key: array(file, key).astype(np.float64) for key in FRAME_SHAPES}
        except HDF5_DAMAGE as error:
            raise InputError(f"{path} is damaged or incomplete: {error}") from None
    check_arrays(path, names, arrays)
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError(f"{path}: frame {name!r} is listed twice")
        if not is_safe_path(name):
            raise InputError(f"{path}: frame {name!r} does not lie in the scene")
    if len(cameras) != len(names):
        raise InputError(f"{path}: {len(names)} frames but {len(cameras)} cameras")
    return Frames(names, cameras, **arrays)


def check_arrays(
    path: Path, names: tuple[str, ...], arrays: Mapping[str, NDArray[np.float64]]
) -> None:
    """Refuse arrays with a wrong shape, a partly missing value or a value above ``FARTHEST_M``.

    Args:
        path: file that the arrays were read from.
        names: names of the frames.
        arrays: arrays by the names of the attributes of ``Frames``.

    Raises:
        InputError: an array is wrong; the message names it, and the frame.
    """
    for key, values in arrays.items():
        expected = (len(names), *FRAME_SHAPES[key])
        if values.shape != expected:
            raise InputError(f"{path}: {key} has shape {values.shape}, expected {expected}")
    absent = {key: np.zeros(len(names), bool) for key in arrays}
    for group in _GROUPS:
        unknown = [np.isnan(arrays[k]).all(tuple(range(1, arrays[k].ndim))) for k in group]
        absent |= dict.fromkeys(group, np.logical_and.reduce(unknown))
    for key, values in arrays.items():
        finite = np.isfinite(values).all(tuple(range(1, values.ndim))) | absent[key]
        if not finite.all():
            raise InputError(f"{path}: {key} of frame {names[int(finite.argmin())]} is not finite")
        is_small = (np.abs(values) <= FARTHEST_M).all(tuple(range(1, values.ndim))) | absent[key]
        if key != "time" and not is_small.all():
            frame = names[int(is_small.argmin())]
            raise InputError(f"{path}: {key} of frame {frame} is larger than {FARTHEST_M:g}")
