"""Configuration of the object-connect network."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from objconnect.learning.unet import Channels, check_levels
from objconnect.scene.config import Config


class SegmentOptions(Config):
    """The segmentation of an image into objects.

    Attributes:
        long_side: images are segmented at half their size and with at most this many pixels on the
            long side. 192 is finer than the levels with objects of an image of 512 pixels. At 256,
            SLIC takes twice the time.
        slic_iterations: number of iterations of SLIC. It has converged after 5; 10 take twice the
            time.
        slic_compactness: weight of distances relative to colours in SLIC.
        felzenszwalb_scale: k of Felzenszwalb and Huttenlocher, for colours in 0..1; segments grow
            with it.
        felzenszwalb_blur: standard deviation of their blur, cells.
        learned_score: probability from which a learned object is one.
        learned_stride: pixels per cell of the label maps of learned objects.
    """

    long_side: int = Field(192, ge=8)
    slic_iterations: int = Field(5, ge=1)
    slic_compactness: float = Field(10.0, gt=0)
    felzenszwalb_scale: float = Field(100.0, gt=0)
    felzenszwalb_blur: float = Field(0.8, ge=0)
    learned_score: float = Field(0.35, ge=0, le=1)
    learned_stride: int = Field(2, ge=1)


class DetectorConfig(Config):
    """The configuration of a detector of objects.

    Attributes:
        stride: pixels per cell of its maps; one of the strides of the network's levels.
        size: number of channels of its convolutions.
        vector: number of channels of the vector of an object.
    """

    stride: int = Field(4, ge=1)
    size: int = Field(64, ge=4)
    vector: int = Field(32, ge=2)


class ConstellationConfig(Config):
    """The configuration of the graph over objects.

    Attributes:
        vector: number of channels of the objects' vectors.
        size: number of channels of the nodes.
        out: number of channels of the vectors that are compared.
        layers: number of times that nodes hear of their neighbours; 0 for no graph.
        neighbours: number of neighbours that a node hears of.
    """

    vector: int = Field(32, ge=2)
    size: int = Field(64, ge=4)
    out: int = Field(32, ge=2)
    layers: int = Field(2, ge=0)
    neighbours: int = Field(12, ge=1)


class ObjConnectNetConfig(Config):
    """The configuration of the network. Each block of the method can be switched off.

    Levels run from coarse to fine.

    Attributes:
        width: number of channels of the encoder as a share of VGG16's.
        decoder: decoder that combines coarse and fine features: ``fpn`` is the paper's feature
            pyramid and ``unet`` that of PixLoc.
        pyramid: number of channels of the feature pyramid.
        steps: numbers of channels of the U-Net, from stride 8 to stride 1.
        strides: strides of the levels, pixels of the image per cell.
        dims: numbers of channels of the features of each level.
        segmentation: method that makes the objects. ``slic`` and ``felzenszwalb`` segment the
            image, ``grid`` makes squares that do not depend on it, ``learned`` takes the objects of
            the detector, ``given`` expects label maps, and ``none`` makes no objects.
        segments: largest number N of objects of an image.
        segment_side: typical side of an object, pixels; images too small for N objects of this side
            have fewer.
        segmenter: options of the segmentation.
        finest_object_stride: finest stride of levels with objects, pixels per cell. On finer levels
            the object blocks would cost as much as the rest of the network and add nothing, because
            nearly all neighbouring cells share an object.
        attention: switches equations (1) to (3), which add features of the object to each cell.
        object_graph: switches equations (4) and (5), a graph over the points of each object.
        scene_graph: switches a graph over all objects.
        detector: detector of learned objects; None for none.
        constellation: graph over the learned objects of a photograph or a map; None for none.
    """

    width: float = Field(1.0, gt=0, le=2)
    decoder: Literal["fpn", "unet"] = "unet"
    pyramid: int = Field(64, ge=8, le=2048)
    steps: tuple[Channels, Channels, Channels, Channels] = (64, 64, 64, 32)
    strides: tuple[int, ...] = Field((16, 4, 2), min_length=1)
    dims: tuple[Channels, ...] = Field((128, 128, 32), min_length=1)
    segmentation: Literal["slic", "felzenszwalb", "grid", "learned", "given", "none"] = "slic"
    segments: int = Field(128, ge=1, le=1024)
    segment_side: float = Field(32.0, ge=4)
    segmenter: SegmentOptions = SegmentOptions()
    finest_object_stride: int = Field(4, ge=1)
    attention: bool = True
    object_graph: bool = True
    scene_graph: bool = True
    detector: DetectorConfig | None = None
    constellation: ConstellationConfig | None = None

    @model_validator(mode="after")
    def _levels(self) -> Self:
        check_levels(self.strides, self.dims)
        blocks = self.attention or self.object_graph or self.scene_graph
        if self.segmentation == "none" and blocks:
            raise ValueError(
                "without segmentation there are no objects: switch attention, object_graph and "
                "scene_graph off too"
            )
        if self.segmentation == "learned" and self.detector is None:
            raise ValueError("learned segmentation needs a detector")
        if self.detector is not None and self.detector.stride not in self.strides:
            raise ValueError("the stride of the detector is one of the levels' strides")
        return self
