from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.binary import Akaze, BinaryExtractor, Orb
from benchmark.gate.scene import GATE_SCENES
from objconnect.scene.maps.features import unit_bits
from objconnect.scene.storage.images import read_rgb

GATE = GATE_SCENES["gate"] / "images" / "map" / "images"
KINDS = [Orb(2000), Akaze(2000, 1e-4)]


@pytest.fixture(scope="module")
def photograph() -> NDArray[np.uint8]:
    # A width that no level of ORB's pyramid divides.
    return np.ascontiguousarray(read_rgb(GATE / "000000.jpg")[:, :-3])


@pytest.mark.parametrize("extract", KINDS, ids=["orb", "akaze"])
def test_keypoints_of_a_mirrored_photograph_are_mirrored(
    extract: BinaryExtractor, photograph: NDArray[np.uint8]
) -> None:
    """An offset of the pixel convention would show twice."""
    here = extract(photograph)
    there = extract(np.ascontiguousarray(photograph[:, ::-1]))
    mirrored = there.xy * [-1, 1] + [photograph.shape[1], 0]
    for size in np.unique(here.scale):
        a, b = here.xy[here.scale == size], mirrored[there.scale == size]
        if min(len(a), len(b)) < 20:
            continue
        step = a[:, None] - b
        nearest = step[np.arange(len(a)), np.square(step).sum(-1).argmin(1)]
        found = nearest[np.linalg.norm(nearest, axis=1) < 2]
        assert len(found) > 10
        assert np.abs(np.median(found, axis=0)).max() < 0.1


@pytest.mark.parametrize("extract", KINDS, ids=["orb", "akaze"])
def test_matches_are_those_of_hamming_distance(
    extract: BinaryExtractor, photograph: NDArray[np.uint8]
) -> None:
    noisy = cv2.GaussianBlur(photograph, (0, 0), 0.7).astype(np.uint8)
    a, b = extract(photograph), extract(noisy)
    pairs = extract.match(extract.unit(a.descriptors), extract.unit(b.descriptors), 0.8)
    bits = [np.unpackbits(f.descriptors, axis=1).astype(np.int64) for f in (a, b)]
    hamming = (bits[0][:, None] != bits[1][None]).sum(-1)
    best, rows = hamming.argmin(1), np.arange(len(hamming))
    there, back = np.sort(hamming, axis=1)[:, :2], np.sort(hamming, axis=0)[:2].T[best]
    passed = (there[:, 0] < 0.8 * there[:, 1]) & (back[:, 0] < 0.8 * back[:, 1])
    passed &= hamming.argmin(0)[best] == rows
    expected = set(zip(rows[passed].tolist(), best[passed].tolist(), strict=True))
    assert len(expected) > 30
    # Those at the very ratio may fall either way.
    assert len(expected ^ set(map(tuple, pairs.tolist()))) <= 2


def test_bits_of_unit_length_keep_hamming_distance() -> None:
    rng = np.random.default_rng(0)
    packed = rng.integers(0, 256, (5, 61), dtype=np.uint8)
    unit = unit_bits(packed)
    bits = np.unpackbits(packed, axis=1)
    hamming = (bits[:, None] != bits[None]).sum(-1)
    squared = np.square(unit.numpy()[:, None] - unit.numpy()[None]).sum(-1)
    np.testing.assert_allclose(squared, 4 * hamming / 488, atol=1e-5)


@pytest.mark.parametrize("extract", KINDS, ids=["orb", "akaze"])
def test_a_blank_photograph_has_no_features(extract: BinaryExtractor) -> None:
    features = extract(np.full((120, 160, 3), 90, np.uint8))
    assert features.xy.shape == (0, 2)
    assert len(extract.unit(features.descriptors)) == 0
    rng = np.random.default_rng(0)
    textured = extract(rng.integers(0, 256, (120, 160, 3), dtype=np.uint8))
    assert features.descriptors.shape[1] == textured.descriptors.shape[1]


@pytest.mark.parametrize("extract", [Orb(150), Akaze(150, 1e-4)], ids=["orb", "akaze"])
def test_no_more_features_than_asked_for(
    extract: BinaryExtractor, photograph: NDArray[np.uint8]
) -> None:
    assert 100 < len(extract(photograph).xy) <= 150
