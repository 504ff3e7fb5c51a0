"""Configuration of the object-connect network. Equations are numbered as in its paper."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal, Self

from pydantic import Field, model_validator

from objconnect.learning.unet import Channels, check_levels
from objconnect.scene.config import Config

# Constants that older weights record as options, with the only supported values.
_FIXED: Final[Mapping[str, object]] = {
    "finest_object_stride": 4,
    "segmenter": {
        "long_side": 192,
        "slic_iterations": 5,
        "slic_compactness": 10.0,
        "felzenszwalb_scale": 100.0,
        "felzenszwalb_blur": 0.8,
        "learned_score": 0.35,
        "learned_stride": 2,
    },
}


class DetectorConfig(Config):
    """Configuration of the object detector."""

    stride: int = Field(
        4,
        ge=1,
        description="Stride of the detector's maps, px per cell; one of the strides of the "
        "network's levels.",
    )
    size: int = Field(64, ge=4, description="Number of channels of the detector's convolutions.")
    vector: int = Field(32, ge=2, description="Number of channels of an object's vector.")


class ConstellationConfig(Config):
    """Configuration of the graph over objects."""

    vector: int = Field(32, ge=2, description="Number of channels of the objects' vectors.")
    size: int = Field(64, ge=4, description="Number of channels of the nodes.")
    out: int = Field(32, ge=2, description="Number of channels of the output vectors.")
    layers: int = Field(
        2, ge=0, description="Number of rounds of message passing; 0 for no messages."
    )
    neighbours: int = Field(12, ge=1, description="Number of neighbours of a node.")


class ObjConnectNetConfig(Config):
    """Configuration of the network. Each block of the method can be switched off.

    Levels run from coarse to fine.
    """

    width: float = Field(
        1.0, gt=0, le=2, description="Number of channels of the encoder as a share of VGG16's."
    )
    decoder: Literal["fpn", "unet"] = Field(
        "unet",
        description="Decoder that combines coarse and fine features: ``fpn`` is the feature "
        "pyramid of the object-connect paper and ``unet`` the decoder of PixLoc.",
    )
    pyramid: int = Field(
        64, ge=8, le=2048, description="Number of channels of the feature pyramid."
    )
    steps: tuple[Channels, Channels, Channels, Channels] = Field(
        (64, 64, 64, 32),
        description="Numbers of channels of the U-Net at strides 8, 4, 2 and 1.",
    )
    strides: tuple[int, ...] = Field(
        (16, 4, 2),
        min_length=1,
        description="Strides of the levels, px per cell.",
    )
    dims: tuple[Channels, ...] = Field(
        (128, 128, 32),
        min_length=1,
        description="Numbers of channels of the features of each level.",
    )
    segmentation: Literal["slic", "felzenszwalb", "grid", "learned", "given", "none"] = Field(
        "slic",
        description="Method that makes the objects. ``slic`` and ``felzenszwalb`` segment the "
        "image, ``grid`` makes squares that do not depend on it, ``learned`` takes the objects of "
        "the detector, ``given`` expects label maps, and ``none`` makes no objects.",
    )
    segments: int = Field(
        128, ge=1, le=1024, description="Largest number N of objects of an image."
    )
    segment_side: float = Field(
        32.0,
        ge=4,
        description="Typical side of an object, px; images too small for N objects of this side "
        "have fewer.",
    )
    attention: bool = Field(
        True,
        description="Equations (1) to (3), which add features of the object to each cell.",
    )
    object_graph: bool = Field(
        True,
        description="Equations (4) and (5), a graph over the points of each object.",
    )
    scene_graph: bool = Field(True, description="A graph over all objects.")
    detector: DetectorConfig | None = Field(
        None, description="Detector of learned objects; None for no detector."
    )
    constellation: ConstellationConfig | None = Field(
        None,
        description="Graph over the learned objects of a photograph or a map; None for no graph.",
    )

    @model_validator(mode="before")
    @classmethod
    def _drop_constants(cls, values: Any) -> Any:
        """Drop constants that older weights record as options, if their values are supported."""
        if not isinstance(values, Mapping):
            return values
        for name, fixed in _FIXED.items():
            if name in values and values[name] != fixed:
                raise ValueError(
                    f"{name} is {values[name]} in these weights; only {fixed} is supported"
                )
        return {name: value for name, value in values.items() if name not in _FIXED}

    @model_validator(mode="after")
    def _check_combination(self) -> Self:
        check_levels(self.strides, self.dims)
        has_object_blocks = self.attention or self.object_graph or self.scene_graph
        if self.segmentation == "none" and has_object_blocks:
            raise ValueError(
                "without segmentation there are no objects: switch attention, object_graph and "
                "scene_graph off too"
            )
        if self.segmentation == "learned" and self.detector is None:
            raise ValueError("segmentation 'learned' needs a detector: set detector too")
        if self.detector is not None and self.detector.stride not in self.strides:
            raise ValueError(
                f"detector.stride is {self.detector.stride}: set it to one of strides, "
                f"{', '.join(map(str, self.strides))}"
            )
        return self
