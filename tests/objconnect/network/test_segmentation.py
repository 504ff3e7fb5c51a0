from __future__ import annotations

import numpy as np
import pytest
import torch

from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.segmentation import (
    NOTHING,
    keep_largest,
    sample_cells,
    sample_pixels,
    segment,
)
from objconnect.scene.errors import InputError
from tests.objconnect.network.made import pictures


def config(**values: object) -> ObjConnectNetConfig:
    return ObjConnectNetConfig.model_validate(values)


@pytest.mark.parametrize("kind", ["slic", "felzenszwalb", "grid"])
@pytest.mark.parametrize("most", [1, 7, 64])
def test_never_more_segments_than_asked_for(kind: str, most: int) -> None:
    images = pictures(2, 128, 192)
    labels = segment(images, config(segmentation=kind, segments=most, segment_side=16))
    assert labels.shape == (2, 64, 96) and labels.dtype == torch.int64
    assert int(labels.min()) >= NOTHING and 0 <= int(labels.max()) < most
    if kind != "felzenszwalb":
        assert (labels >= 0).float().mean() > 0.9
    if most == 64:
        assert int(labels.max()) > 16


def test_segments_are_reduced_and_of_like_size_at_any_picture_size() -> None:
    assert segment(pictures(1, 320, 640), config(segmentation="grid")).shape == (1, 96, 192)
    areas = []
    for side in (128, 256):
        labels = segment(pictures(1, side, side), config(segmentation="grid", segments=500))
        areas.append(side**2 / (int(labels.max()) + 1))
    assert areas == [32.0**2] * 2


def test_slic_follows_the_picture_and_a_grid_does_not() -> None:
    images = torch.zeros(1, 3, 64, 64)
    images[..., 24:] = 1  # not where squares would end
    across = {}
    for kind in ("slic", "grid"):
        labels = segment(images, config(segmentation=kind, segment_side=16))[0]
        across[kind] = set(labels[:, :11].unique().tolist()) & set(labels[:, 13:].unique().tolist())
    assert across["grid"] and not across["slic"]


@pytest.mark.parametrize("kind", ["slic", "felzenszwalb", "grid"])
@pytest.mark.parametrize("size", [(16, 16), (33, 100)])
def test_a_constant_picture_has_segments(kind: str, size: tuple[int, int]) -> None:
    labels = segment(torch.full((1, 3, *size), 0.5), config(segmentation=kind))
    assert int(labels.max()) >= 0


@pytest.mark.parametrize("kind", ["learned", "given", "none"])
def test_what_cannot_be_segmented_is_refused(kind: str) -> None:
    off = dict.fromkeys(("attention", "object_graph", "scene_graph"), False)
    with pytest.raises(InputError, match="give label maps"):
        segment(pictures(1, 32, 32), config(segmentation=kind, detector={}, **off))


def test_the_largest_are_kept() -> None:
    labels = np.array([[9, 9, 9, 4], [4, 7, -3, -3]])
    expected = [[0, 0, 0, 1], [1, NOTHING, NOTHING, NOTHING]]
    np.testing.assert_array_equal(keep_largest(labels, 2), expected)
    assert keep_largest(labels, 10).max() == 2
    assert (keep_largest(np.full((2, 2), -1), 3) == NOTHING).all()


def test_levels_take_the_label_at_the_centre_of_their_cells() -> None:
    # One label per pixel of a picture 40 x 24, of which a level of stride 16 covers 32 x 16.
    labels = torch.arange(40 * 24).view(1, 24, 40)
    found = sample_cells(labels, torch.zeros(1, 3, 24, 40), torch.zeros(1, 8, 1, 2), 16)
    assert found.tolist() == [[[8 * 40 + 8, 8 * 40 + 24]]]
    halved = sample_cells(labels[:, ::2, ::2], torch.zeros(24, 40), torch.zeros(6, 10), 4)
    assert torch.equal(halved, labels[:, 2::4, 2::4])


def test_labels_under_pixels() -> None:
    labels = torch.arange(6).view(1, 2, 3)
    xy = torch.tensor([[[0.5, 0.5], [29.9, 0.1], [10.1, 19.9], [-5.0, 50.0]]])
    assert sample_pixels(labels, torch.zeros(20, 30), xy).tolist() == [[0, 2, 4, 3]]
