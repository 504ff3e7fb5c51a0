"""The workspace of dense stereo, a folder in COLMAP's layout.

https://colmap.github.io/format.html#dense-reconstruction
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.maps.depth_files import read_array, write_array
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.files import require_readable

Stage = Literal["photometric", "geometric"]
Kind = Literal["depth_maps", "normal_maps"]
KINDS: Final[tuple[Kind, ...]] = ("depth_maps", "normal_maps")
# The first lines of a fused cloud that COLMAP writes.
_PLY = ["ply", "format binary_little_endian 1.0"]
_VERTEX = np.dtype([("xyz", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)])


@dataclass(frozen=True)
class Workspace:
    """Paths and arrays of the workspace in a folder."""

    path: Path

    @property
    def images(self) -> Path:
        """Return the folder of undistorted photographs."""
        return self.path / "images"

    @property
    def sparse(self) -> Path:
        """Return the folder of the map with undistorted cameras."""
        return self.path / "sparse"

    @property
    def cloud(self) -> Path:
        """Return the file of the fused cloud."""
        return self.path / "fused.ply"

    def names(self) -> list[str]:
        """Return the photographs with a complete or partial depth map, in alphabetical order."""
        names = set()
        for kind in KINDS:
            folder = self.path / "stereo" / kind
            for path in folder.rglob("*.bin"):
                name = path.relative_to(folder).as_posix().removesuffix(".bin")
                names.add(name.rpartition(".")[0])
        return sorted(names - {""})

    def has(self, name: str, stage: Stage) -> bool:
        """Return whether a depth map is finished; it is written after its normals."""
        return self._file(name, stage, "depth_maps").is_file()

    def write(
        self, name: str, stage: Stage, depth: NDArray[np.float32], normals: NDArray[np.float32]
    ) -> None:
        """Write depth (H, W), 0 where unknown, and normals (3, H, W) in the camera's frame.

        Raises:
            InputError: the folder cannot be written, or the disk is full.
        """
        write_array(self._file(name, stage, "normal_maps"), normals)
        write_array(self._file(name, stage, "depth_maps"), depth[None])

    def depth(self, name: str, stage: Stage) -> NDArray[np.float32]:
        """Read a depth map (H, W), metres, 0 where unknown.

        Raises:
            InputError: the file is missing or damaged.
        """
        return read_array(self._file(name, stage, "depth_maps"), 1).squeeze(0)

    def normals(self, name: str, stage: Stage) -> NDArray[np.float32]:
        """Read a normal map (3, H, W) in the camera's frame.

        Raises:
            InputError: the file is missing or damaged.
        """
        return read_array(self._file(name, stage, "normal_maps"), 3)

    def read_cloud(self) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Read the points (M, 3), world metres, and colours (M, 3) of the fused cloud.

        Raises:
            InputError: the file is missing or damaged.
        """
        require_readable(self.cloud, "cloud")
        try:
            data = self.cloud.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {self.cloud}: {error.strerror}") from None
        head, end, body = data.partition(b"end_header\n")
        lines = head.decode("ascii", "replace").split("\n")
        if lines[: len(_PLY)] != _PLY or not end or len(body) % _VERTEX.itemsize:
            raise InputError(f"{self.cloud} is damaged: remove it and run dense again")
        table = np.frombuffer(body, _VERTEX)
        return table["xyz"].astype(np.float64), table["rgb"].copy()

    def write_lists(self, sources: dict[str, list[str]]) -> None:
        """Write the sources of each photograph, and the list of photographs to fuse."""
        stereo = self.path / "stereo"
        pairs = "".join(f"{name}\n{', '.join(others)}\n" for name, others in sources.items())
        write_text(stereo / "patch-match.cfg", pairs)
        write_text(stereo / "fusion.cfg", "".join(f"{name}\n" for name in sources))

    def _file(self, name: str, stage: Stage, kind: Kind) -> Path:
        return self.path / "stereo" / kind / f"{name}.{stage}.bin"
