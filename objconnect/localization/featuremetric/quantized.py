"""Quantization of a network to 8-bit integers, with value ranges from the map's photographs."""

from __future__ import annotations

from typing import Final

from torch import nn

from objconnect.learning.quantization import Channelwise, largest_values, quantize
from objconnect.localization.featuremetric.maps import MapExtractor
from objconnect.localization.featuremetric.references import MapViews, ReferenceSource

# Numerical guard for a layer that returns only zeros.
_MIN_LARGEST: Final = 1e-6
# Number of photographs from which the largest values are taken; more would hardly raise them.
_PHOTOGRAPHS: Final = 8
# Lower bound of the largest value of a channel, as a share of the largest value of its layer. A
# query may show things that the map's photographs do not.
_MIN_SHARE: Final = 0.02


def channel_scales(largest: Channelwise) -> Channelwise:
    """Return the quantization steps of the channels of each layer, given their largest values."""
    return {
        name: values.clamp(min=max(_MIN_SHARE * float(values.max()), _MIN_LARGEST)) * (1 / 255)
        for name, values in largest.items()
    }


def quantize_extractor(source: ReferenceSource) -> MapExtractor:
    """Return an extractor with a network that is quantized for a map's photographs.

    Args:
        source: the map, its photographs, and the extractor in floating point.

    Raises:
        InputError: a photograph is missing or broken, or the network cannot be quantized on this
            processor.
    """
    sparse_map, extract, views = source.map_cache.sparse_map, source.extract, MapViews(source)
    names = sparse_map.names
    network = extract.network
    assert isinstance(network, nn.Module)
    with largest_values(network) as largest:
        for name in names[:: -(-len(names) // _PHOTOGRAPHS)]:
            views(sparse_map.images[name])
    return extract.with_network(quantize(network, channel_scales(largest), network.config.strides))
