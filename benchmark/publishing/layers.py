"""Dense layers and thermal pictures as lossless image files, which every image library reads."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from objconnect.scene.bundle.frames import DenseLayers, Frames, Layer
from objconnect.scene.bundle.thermal import Thermal, counts_path, read_thermal
from objconnect.scene.errors import InputError

PublishedLayer = Layer | Literal["thermal"]

NORMAL_OFFSET: Final = 128
"""Number added to the components of int8 normals, because PNG has no negative values."""

# TIFF's tag of the predictor, and its value for differences of floating-point numbers, which halve
# the size of the file.
_PREDICTOR: Final = 317
_FLOATING_POINT: Final = 3


class LayerFile(NamedTuple):
    """The file that holds a layer of one photograph.

    Attributes:
        suffix: ending of its name.
        meaning: content of its pixels.
    """

    suffix: str
    meaning: str


LAYER_FILES: Final[Mapping[PublishedLayer, LayerFile]] = {
    "depth": LayerFile(
        ".tif", "planar depth along the optical axis, metres, 0 without a surface; 32-bit TIFF"
    ),
    "instance": LayerFile(".png", "id of the object in objects.json, 0 for the ground; 16-bit PNG"),
    "semantic": LayerFile(".png", "class of the surface in objects.json; 8-bit PNG"),
    "normal": LayerFile(
        ".png",
        f"unit normal of the surface in world axes: each component times 127, rounded, plus "
        f"{NORMAL_OFFSET}; RGB PNG",
    ),
    "thermal": LayerFile(
        ".tif",
        "brightness temperature between 8 and 14 micrometres in the same view, kelvin; 32-bit TIFF",
    ),
}
"""The file of each layer; the values are exact."""


@dataclass(frozen=True)
class SessionLayers:
    """The layers of a session that can be published.

    Attributes:
        dense: dense layers of its frames, an open file.
        frames: the frames.
        images_root: folder that the names of photographs are relative to.
        thermal: how its thermal pictures are coded; None without such pictures.
    """

    dense: DenseLayers
    frames: Frames
    images_root: Path
    thermal: Thermal | None

    def has(self, layer: PublishedLayer) -> bool:
        """Return whether the session has the layer."""
        return self.thermal is not None if layer == "thermal" else self.dense.has(layer)

    def stored_bytes(self, layer: PublishedLayer) -> int:
        """Return the bytes that a layer takes in the scene, compressed.

        Raises:
            InputError: a thermal picture is missing.
        """
        if layer == "thermal":
            names = self.frames.names
            return sum(file_size(counts_path(self.images_root, name)) for name in names)
        return self.dense.stored_bytes(layer)

    def encode(self, layer: PublishedLayer, index: int) -> bytes:
        """Return the bytes of the layer's file of one frame.

        Raises:
            InputError: the layer is missing or damaged, or a thermal picture has not the camera's
                size.
        """
        if layer != "thermal":
            return encode_layer(layer, self.dense.read(layer, index))
        if self.thermal is None:
            raise InputError(f"{self.images_root} has a session without thermal pictures")
        name, camera = self.frames.names[index], self.frames.cameras[index]
        return encode_layer(layer, read_thermal(self.images_root, name, camera, self.thermal))


def file_size(path: Path) -> int:
    """Return the bytes of a file.

    Raises:
        InputError: the file is missing.
    """
    try:
        return path.stat().st_size
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None


def encode_layer(layer: PublishedLayer, image: NDArray[Any]) -> bytes:
    """Return the bytes of a layer's file.

    Args:
        layer: name of the layer.
        image: (H, W) of the type in ``LAYERS``. Normals are (H, W, 3) int8, components of unit
            vectors times 127; temperatures are (H, W) float32.
    """
    stream = io.BytesIO()
    if layer in ("depth", "thermal"):
        Image.fromarray(image).save(
            stream,
            format="TIFF",
            compression="tiff_adobe_deflate",
            tiffinfo={_PREDICTOR: _FLOATING_POINT},
        )
        return stream.getvalue()
    if layer == "normal":
        image = (image.astype(np.int16) + NORMAL_OFFSET).astype(np.uint8)
    Image.fromarray(image).save(stream, format="PNG")
    return stream.getvalue()
