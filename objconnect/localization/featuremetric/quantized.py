"""Networks that see queries in integers of eight bits, with the ranges of a map's photographs."""

from __future__ import annotations

from typing import Final

from pydantic import Field
from torch import nn

from objconnect.learning.quantization import Channelwise, largest_values, quantized
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.localization.featuremetric.references import MapViews, ReferenceSource
from objconnect.scene.config import Config

# Numerical guard: of a layer that returns nothing but zeros.
_SMALLEST: Final = 1e-6


class QuantizationOptions(Config):
    """How the scales of integers are chosen."""

    photographs: int = Field(
        8, ge=1, description="Photographs of the map in which the largest values are looked for."
    )
    margin: float = Field(
        1.0, gt=0, description="Values are cut off beyond this share of the largest ones."
    )
    least_share: float = Field(
        0.02,
        gt=0,
        le=1,
        description="A channel whose largest value is less than this share of that of all channels "
        "counts as if it had this one.",
    )

    def scales(self, largest: Channelwise) -> Channelwise:
        """Return what a step of each channel is worth, given the largest values."""
        return {
            name: values.clamp(min=max(self.least_share * float(values.max()), _SMALLEST))
            * (self.margin / 255)
            for name, values in largest.items()
        }


def quantized_extractor(source: ReferenceSource, options: QuantizationOptions) -> MapExtractor:
    """Return an extractor whose network is quantized for pictures like those of a map.

    Args:
        source: the map, its photographs, and the extractor in floating point.
        options: how scales are chosen.

    Raises:
        InputError: a photograph is missing or broken, or the network cannot be quantized here.
    """
    sparse_map, extract, views = source.kept.sparse_map, source.extract, MapViews(source)
    names = sparse_map.names
    network = extract.network
    assert isinstance(network, nn.Module)
    with largest_values(network) as largest:
        for name in names[:: -(-len(names) // options.photographs)]:
            views(sparse_map.images[name])
    return extract.of(quantized(network, options.scales(largest), network.config.strides))
