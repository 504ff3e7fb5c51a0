"""Dense layers as lossless image files, which every image library reads."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from objconnect.scene.bundle.frames import Layer

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


LAYER_FILES: Final[Mapping[Layer, LayerFile]] = {
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
}
"""The file of each layer; the values are exact."""


def encode_layer(layer: Layer, image: NDArray[Any]) -> bytes:
    """Return the bytes of a layer's file.

    Args:
        layer: name of the layer.
        image: (H, W) of the type in ``LAYERS``. Normals are (H, W, 3) int8, components of unit
            vectors times 127.
    """
    stream = io.BytesIO()
    if layer == "depth":
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
