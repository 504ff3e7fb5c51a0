"""The object-connect network: dense features that depend on the image's objects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

import objconnect.learning.pixloc_net as pixloc
import objconnect.learning.unet as unet
from objconnect.learning.checkpoint import load_into, read_weights
from objconnect.learning.damping import Damping
from objconnect.learning.training.contrastive import sample
from objconnect.learning.vgg import encode, initialise_convolutions, scale_to_unit, vgg16_encoder
from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.constellation import ConstellationGraph
from objconnect.network.detector import (
    Detections,
    DetectorMaps,
    ObjectDetector,
    extract_detections,
    label_map,
)
from objconnect.network.fpn import FeaturePyramid
from objconnect.network.graph import ObjectGraph, SceneGraph
from objconnect.network.objects import Attention, Objects, Occupancy, centres, occupancy
from objconnect.network.segmentation import sample_cells, segment
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError

_ENCODER: Final = "encoder."
# A field that only configurations of this network have.
_OWN_FIELD: Final = "segmentation"
# Finest stride of levels with objects. On finer levels the object blocks would cost as much as the
# rest of the network and add nothing: nearly all neighbouring cells share an object.
_FINEST_OBJECT_STRIDE: Final = 4
# Minimum score of a learned object.
_LEARNED_SCORE: Final = 0.35
# Pixels per cell of the label maps of learned objects.
_LEARNED_STRIDE: Final = 2

Level = unet.Level


class ObjectBlocks(nn.Module):
    """The enabled object blocks of one level. Each adds to the features.

    Attributes:
        residuals: norm of the last residual of each block in training, divided by the norm of its
            input, by name of the block.
    """

    def __init__(self, config: ObjConnectNetConfig, size: int) -> None:
        super().__init__()
        switches = (
            (config.attention, Attention),
            (config.object_graph, ObjectGraph),
            (config.scene_graph, SceneGraph),
        )
        self.blocks = nn.ModuleList(block(size) for on, block in switches if on)
        self.residuals: dict[str, Tensor] = {}

    def forward(self, maps: Tensor, objects: Occupancy) -> Tensor:
        """Return O of equation (3) plus the outputs of the graphs.

        Args:
            maps: the decoder's maps (B, C, h, w); the result has the same shape.
            objects: the objects of the B images.
        """
        if not len(self.blocks):
            return maps
        _, _, height, width = maps.shape
        cells = maps.permute(0, 2, 3, 1).flatten(1, 2)
        for block in self.blocks:
            before, cells = cells, block(cells, objects)
            if self.training:
                residual = (cells - before).detach().norm() / before.detach().norm()
                self.residuals[type(block).__name__] = residual
        return cells.view(len(maps), height, width, -1).permute(0, 3, 1, 2)


class ObjConnectNet(nn.Module):
    """The object-connect network, with the damping of the alignment that is trained with it.

    Attributes:
        damping: a module for each level, coarse to fine, that returns damping factors (6,).
    """

    def __init__(self, config: ObjConnectNetConfig) -> None:
        super().__init__()
        self.config = config
        # Encoder and decoder have the names of PixLoc's, so that its weights can be loaded.
        self.encoder = vgg16_encoder(config.width)
        self.decoder = (
            FeaturePyramid(config.width, config.pyramid, config.strides)
            if config.decoder == "fpn"
            else unet.Decoder(config.width, config.steps, config.strides)
        )
        sizes = self.decoder.sizes
        object_strides = [stride for stride in config.strides if stride >= _FINEST_OBJECT_STRIDE]
        self._object_levels = 0 if config.segmentation == "none" else len(object_strides)
        object_sizes = sizes[: self._object_levels]
        self.objects_of = nn.ModuleList(ObjectBlocks(config, size) for size in object_sizes)
        self.features = nn.ModuleList(map(_head, sizes, config.dims))
        self.confidence = nn.ModuleList(_head(size, 1) for size in sizes)
        self.trust = nn.Linear(object_sizes[-1], 1) if object_sizes else None
        self.damping = nn.ModuleList(Damping() for _ in config.strides)
        initialise_convolutions(self)
        self.detector = None
        if config.detector is not None:
            self.detector = ObjectDetector(config.detector, config.strides, config.dims)
        self.constellation = None
        if config.constellation is not None:
            self.constellation = ConstellationGraph(config.constellation)

    def forward(
        self,
        image: Tensor,
        labels: Tensor | None = None,
        levels: int | None = None,
        needed: NDArray[np.bool_] | None = None,
    ) -> list[Level]:
        """Return features, which are not normalised, and confidences in 0..1, coarse to fine.

        Args:
            image: images (B, 3, H, W), RGB in 0..1 or of bytes; H and W are at least 16.
            labels: int64 label maps (B, _, _) of any size that cover the image, see
                ``objconnect.network.segmentation``; None segments the image as configured.
            levels: number of levels from the coarsest; None for all.
            needed: cells of the finest level that are needed, as for ``unet.Decoder.levels``. A
                network with objects or with a feature pyramid computes all cells.

        Returns:
            Features (B, C, h, w) and confidences (B, 1, h, w) of each level. Cells are as many
            pixels wide as the level's stride and start at the top left corner. The part of an image
            beyond a multiple of 16 pixels is cut off.

        Raises:
            InputError: the configuration expects label maps, and ``labels`` is None.
        """
        return self.describe(image, labels, levels, needed)[0]

    def objects(self, image: Tensor, labels: Tensor | None = None) -> Objects:
        """Return the objects of images, on the finest level that has objects; see ``forward``.

        Raises:
            InputError: the network has no objects, or it expects label maps and ``labels`` is None.
        """
        objects = self.describe(image, labels)[1]
        if objects is None:
            raise InputError("this network has no objects: choose weights with a segmentation")
        return objects

    def describe(
        self,
        image: Tensor,
        labels: Tensor | None = None,
        levels: int | None = None,
        needed: NDArray[np.bool_] | None = None,
    ) -> tuple[list[Level], Objects | None]:
        """Return the results of both ``forward`` and ``objects`` in one pass.

        The objects are None if the network has none, or if ``levels`` leaves out the finest level
        that has objects. Arguments are those of ``forward``.
        """
        if not self._object_levels:
            return list(islice(self._levels(image, needed), levels)), None
        image = scale_to_unit(image)
        decoded = self._decode(image)
        if labels is None and self.config.segmentation == "learned":
            decoded = list(decoded)
            labels = self._to_labels(decoded)
        elif labels is None:
            labels = segment(image, self.config)
        output: list[Level] = []
        objects = None
        for number, maps in enumerate(islice(decoded, levels)):
            if number < self._object_levels:
                stride = self.config.strides[number]
                occupied = occupancy(
                    sample_cells(labels, image, maps, stride), self.config.segments
                )
                maps = self.objects_of[number](maps, occupied)
                if number == self._object_levels - 1:
                    objects = self._object_set(maps, occupied, stride)
            output.append(self._level(number, maps))
        return output, objects

    def residuals(self) -> dict[str, float]:
        """Return ``ObjectBlocks.residuals`` of all levels, for the training log."""
        residuals = {}
        for stride, blocks in zip(self.config.strides, self.objects_of, strict=False):
            assert isinstance(blocks, ObjectBlocks)
            for name, residual in blocks.residuals.items():
                residuals[f"residual {name} {stride}"] = float(residual)
        return residuals

    def segments(self, image: Tensor) -> Tensor:
        """Segment images (B, 3, H, W) as configured; result and errors are those of ``segment``."""
        if self.config.segmentation == "learned":
            return self.predict_segments(image)
        return segment(image, self.config)

    def predict_segments(self, image: Tensor) -> Tensor:
        """Return the detector's objects as label maps, as ``segment`` does.

        Raises:
            InputError: the network has no detector.
        """
        return self._to_labels(self._decode(image))

    def detect_objects(self, image: Tensor) -> list[Detections]:
        """Return the detector's objects of images (B, 3, H, W), the highest score first.

        Raises:
            InputError: the network has no detector.
        """
        decoded = self._decode(image)
        return [found for _, found in self._detect(decoded)]

    def _decode(self, image: Tensor) -> Iterable[Tensor]:
        """Yield the decoder's maps of images, coarse to fine."""
        maps: Iterable[Tensor] = self.decoder(self._encode(image))
        return maps

    def _levels(self, image: Tensor, needed: NDArray[np.bool_] | None) -> Iterable[Level]:
        """Yield the levels of images without objects, coarse to fine."""
        if not isinstance(self.decoder, unet.Decoder):
            return (self._level(*each) for each in enumerate(self._decode(image)))
        heads = [partial(self._level, number) for number in range(len(self.features))]
        levels = self.decoder.levels(self._encode(image), heads, needed)
        return ((features, confidence) for features, confidence in levels)

    def _encode(self, image: Tensor) -> list[Tensor]:
        return encode(self.encoder, image, self.config.strides[-1])

    def _to_labels(self, decoded: Iterable[Tensor]) -> Tensor:
        detected = self._detect(decoded)
        assert self.detector is not None
        stride, cell = self.detector.config.stride, _LEARNED_STRIDE
        return torch.stack([label_map(maps, found, stride, cell) for maps, found in detected])

    def _detect(self, decoded: Iterable[Tensor]) -> list[tuple[DetectorMaps, Detections]]:
        if self.detector is None:
            raise InputError("this network has no detector of objects: choose weights with one")
        # As in training, the detector sees the features without the object blocks.
        with torch.no_grad():
            maps = self.detector([self._level(*each) for each in enumerate(decoded)])
        count, stride = self.config.segments, self.detector.config.stride
        by_image = [
            DetectorMaps(each[number : number + 1] for each in maps)
            for number in range(len(maps.centre))
        ]
        return [
            (each, extract_detections(each, stride, count, _LEARNED_SCORE)) for each in by_image
        ]

    def _level(self, number: int, maps: Tensor) -> Level:
        # The sign is negative because PixLoc's head, whose weights can be loaded, predicts the
        # uncertainty.
        return self.features[number](maps), torch.sigmoid(-self.confidence[number](maps))

    def _object_set(self, maps: Tensor, occupied: Occupancy, stride: int) -> Objects:
        """Return the paper's set V: the vectors o_i are the features O at the centres c_i."""
        assert self.trust is not None
        cells = centres(occupied)
        vectors = sample(maps, cells)
        # The features are detached, so that the confidence head does not change them.
        confidence = torch.sigmoid(self.trust(vectors.detach()).float())[..., 0]
        return Objects(cells * stride, vectors, confidence, occupied.present)


def _head(size: int, dims: int) -> nn.Conv2d:
    return nn.Conv2d(size, dims, 1)


def read_network(path: Path) -> tuple[ObjConnectNet, str]:
    """Read a network from a file of weights; return it with the digest of the file.

    Raises:
        InputError: the file does not exist, is damaged, or belongs to another network.
    """
    weights = read_weights(path)
    if _OWN_FIELD not in weights.config:
        raise InputError(
            f"{path} holds no weights of objconnect: give a file from 'train objconnect'"
        )
    network = ObjConnectNet(load_config(ObjConnectNetConfig, None, weights.config))
    load_into(network, weights.tensors, path)
    # torch's annotations lack this argument.
    network = network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network, weights.sha256


def start_from(path: Path, settings: Mapping[str, Any]) -> ObjConnectNet:
    """Return a network for training, initialised from weights of this network or of PixLoc.

    All weights that fit the settings are loaded; if the settings have another decoder, only the
    weights of the encoder. A detector or a graph over objects in the settings is initialised at
    random.

    Args:
        path: file of weights.
        settings: fields of ``ObjConnectNetConfig`` that replace the file's.

    Raises:
        InputError: the file does not exist, or its weights do not fit the settings.
    """
    weights = read_weights(path)
    tensors, config = weights.tensors, weights.config
    if _OWN_FIELD not in config:
        pixloc_network, _ = pixloc.read_network(path)
        if pixloc_network.config.extra_convolutions:
            raise InputError(f"{path} has a VGG19 encoder: give weights with a VGG16 encoder")
        tensors, pixloc_config = pixloc_network.state_dict(), pixloc_network.config
        config = {"width": pixloc_config.width, "decoder": "unet"}
        config |= {"steps": pixloc_config.decoder, "strides": pixloc_config.strides}
        config |= {"dims": pixloc_config.dims}
    replaced = tuple(f"{part}." for part in ("detector", "constellation") if part in settings)
    tensors = {name: each for name, each in tensors.items() if not name.startswith(replaced)}
    if settings.get("decoder", config.get("decoder")) != config.get("decoder"):
        tensors = {name: each for name, each in tensors.items() if name.startswith(_ENCODER)}
    network = ObjConnectNet(load_config(ObjConnectNetConfig, None, {**config, **settings}))
    initial = network.state_dict()
    loaded = {name: tensor for name, tensor in tensors.items() if name in initial}
    random_weights = {name: each for name, each in initial.items() if not name.startswith(_ENCODER)}
    load_into(network, random_weights | loaded, path)
    return network
