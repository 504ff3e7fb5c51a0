"""``frames.h5``: poses, cameras, priors and dense annotations of one session."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from scene.errors import HDF5_DAMAGE, InputError
from scene.geometry.camera import Camera
from scene.geometry.pose import FARTHEST_M, Pose
from scene.storage.files import inside, written_whole
from scene.storage.hdf5 import array, dataset

Layer = Literal["depth", "instance", "semantic", "normal"]
LAYERS: dict[Layer, np.dtype[Any]] = {
    "depth": np.dtype("f4"),
    "instance": np.dtype("u2"),
    "semantic": np.dtype("u1"),
    "normal": np.dtype("i1"),
}


@dataclass(frozen=True)
class Frames:
    """The frames of one session, N of them.

    What a real flight did not measure is NaN: a time, a position with its sigma, an attitude with
    its sigma.

    Attributes:
        names: image names, relative to the scene's ``sessions`` folder.
        cameras: one per frame.
        cam_from_world: (N, 4, 4) float64.
        time: (N,) seconds since 1970.
        gps_prior: (N, 3) camera centre as GNSS measured it, world metres.
        gps_sigma: (N, 3) its standard deviation per axis, metres.
        attitude_prior: (N, 4) quaternions w x y z of ``cam_from_world`` as measured.
        attitude_sigma_deg: (N,) its standard deviation, degrees.
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
        """All poses as one batch."""
        return Pose.from_matrix(self.cam_from_world)

    @property
    def has_gps(self) -> NDArray[np.bool_]:
        """Whether each frame's position was measured, (N,)."""
        return np.asarray(np.isfinite(self.gps_prior).all(1))

    @property
    def has_attitude(self) -> NDArray[np.bool_]:
        """Whether each frame's attitude was measured, (N,)."""
        return np.asarray(np.isfinite(self.attitude_prior).all(1))

    def __len__(self) -> int:
        return len(self.names)


_VECTORS = (
    "cam_from_world",
    "time",
    "gps_prior",
    "gps_sigma",
    "attitude_prior",
    "attitude_sigma_deg",
)
_SHAPES: dict[str, tuple[int, ...]] = {
    "cam_from_world": (4, 4),
    "time": (),
    "gps_prior": (3,),
    "gps_sigma": (3,),
    "attitude_prior": (4,),
    "attitude_sigma_deg": (),
}


# Measured together, or not at all.
_MEASURED = (("time",), ("gps_prior", "gps_sigma"), ("attitude_prior", "attitude_sigma_deg"))


class DenseLayers:
    """Reads annotations frame by frame from an open file."""

    def __init__(self, file: h5py.File, path: Path) -> None:
        self._file = file
        self._path = path

    def has(self, layer: Layer) -> bool:
        """Whether the session carries the layer at all."""
        return layer in self._file

    def read(self, layer: Layer, index: int) -> NDArray[Any]:
        """One frame of a layer: depth and the like (H, W), normal (H, W, 3).

        Raises:
            InputError: the layer is missing or its bytes are damaged.
        """
        try:
            if self.has(layer):
                return np.asarray(dataset(self._file, layer)[index])
        except HDF5_DAMAGE as error:
            raise InputError(
                f"{self._path}: frame {index} of {layer} is damaged: {error}"
            ) from None
        raise InputError(f"{self._path} has no {layer} layer")


def write_frames(
    path: Path, frames: Frames, dense: Sequence[Layer], images: Iterator[dict[Layer, NDArray[Any]]]
) -> None:
    """Write a session's ``frames.h5`` atomically.

    Args:
        path: of the file.
        frames: poses and the like.
        dense: layers to write.
        images: one dictionary of layers per frame, in order; consumed one at a time.

    Raises:
        ValueError: fewer images than frames.
        InputError: the file cannot be written.
    """
    cameras = list(dict.fromkeys(frames.cameras))
    with written_whole(path) as partial, h5py.File(partial, "w") as file:
        # Strings of fixed length: damaged ones of variable length make the HDF5 library crash.
        file["cameras"] = np.array([str(camera).encode() for camera in cameras], "S")
        file["names"] = np.array([name.encode() for name in frames.names], "S")
        file["camera_index"] = [cameras.index(camera) for camera in frames.cameras]
        for key in _VECTORS:
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
def _opened(path: Path) -> Iterator[h5py.File]:
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
    """Open the annotations of a ``frames.h5``.

    Raises:
        InputError: missing or damaged file.
    """
    with _opened(path) as file:
        yield DenseLayers(file, path)


def read_frames(path: Path) -> Frames:
    """Read everything but the dense layers.

    Raises:
        InputError: missing or damaged file, arrays of the wrong shape, or a number that is not
            finite or not on earth; the message names the first frame at fault.
    """
    with _opened(path) as file:
        try:
            names = tuple(name.decode() for name in array(file, "names"))
            table = [Camera.parse(text.decode().split()) for text in array(file, "cameras")]
            rows = array(file, "camera_index")
            if (rows < 0).any():
                raise IndexError("a camera index is negative")
            cameras = tuple(table[int(k)] for k in rows)
            arrays = {key: array(file, key).astype(np.float64) for key in _VECTORS}
        except HDF5_DAMAGE as error:
            raise InputError(f"{path} is damaged or incomplete: {error}") from None
    for key, values in arrays.items():
        if values.shape != (len(names), *_SHAPES[key]):
            raise InputError(
                f"{path}: {key} has shape {values.shape}, expected {(len(names), *_SHAPES[key])}"
            )
    absent = {key: np.zeros(len(names), bool) for key in _VECTORS}
    for group in _MEASURED:
        nowhere = [np.isnan(arrays[k]).all(tuple(range(1, arrays[k].ndim))) for k in group]
        absent |= dict.fromkeys(group, np.logical_and.reduce(nowhere))
    for key, values in arrays.items():
        finite = np.isfinite(values).all(tuple(range(1, values.ndim))) | absent[key]
        if not finite.all():
            raise InputError(f"{path}: {key} of frame {names[int(finite.argmin())]} is not finite")
        near = (np.abs(values) <= FARTHEST_M).all(tuple(range(1, values.ndim))) | absent[key]
        if key != "time" and not near.all():
            raise InputError(
                f"{path}: {key} of frame {names[int(near.argmin())]} is beyond {FARTHEST_M:g}"
            )
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError(f"{path}: frame {name!r} is there twice")
        if not inside(name):
            raise InputError(f"{path}: frame {name!r} does not lie in the scene")
    if len(cameras) != len(names):
        raise InputError(f"{path}: {len(names)} frames but {len(cameras)} cameras")
    return Frames(names, cameras, **arrays)
