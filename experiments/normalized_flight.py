"""Copy a flight data set with pictures that are made more alike before localization.

    python -m experiments.normalized_flight FLIGHT OUT --by histogram

``--by`` is one of these changes:

- *histogram*: each colour channel of a query gets the histogram of the map's photographs.
- *statistics*: each Lab channel of a query gets the mean and deviation of the map's photographs.
- *grey*: all pictures become grey.
- *clahe*: the lightness of all pictures is equalized locally (contrast-limited adaptive histogram
  equalization, Zuiderveld, 1994).
- *blur*: all pictures are blurred by a Gaussian of one pixel.

FLIGHT has its map's photographs in a folder below ``images/``, and its queries in ``images/``.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

# Of the map's pixels, one of this many along each axis gives the statistics.
_STRIDE: Final = 8


def match_histogram(picture: Picture, reference: Picture) -> Picture:
    """Give each channel of a picture (H, W, 3) the histogram of reference pixels (N, 3)."""
    matched = np.empty_like(picture)
    for channel in range(3):
        _, rows, counts = np.unique(picture[..., channel], return_inverse=True, return_counts=True)
        wanted, wanted_counts = np.unique(reference[:, channel], return_counts=True)
        shares = np.cumsum(counts) / counts.sum()
        wanted_shares = np.cumsum(wanted_counts) / wanted_counts.sum()
        new_values = np.interp(shares, wanted_shares, wanted)
        matched[..., channel] = new_values[rows].reshape(picture.shape[:2])
    return matched


def match_statistics(picture: Picture, reference: Picture) -> Picture:
    """Give each Lab channel of a picture (H, W, 3) mean and deviation of pixels (N, 3)."""
    lab = cv2.cvtColor(picture, cv2.COLOR_BGR2LAB).astype(np.float32)
    wanted = cv2.cvtColor(reference[None], cv2.COLOR_BGR2LAB)[0].astype(np.float32)
    lab = (lab - lab.mean((0, 1))) / lab.std((0, 1)).clip(1e-3) * wanted.std(0) + wanted.mean(0)
    return np.asarray(cv2.cvtColor(lab.clip(0, 255).astype(np.uint8), cv2.COLOR_LAB2BGR), np.uint8)


def make_grey(picture: Picture) -> Picture:
    """Make a picture grey."""
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    return np.repeat(np.asarray(grey, np.uint8)[..., None], 3, axis=-1)


def equalize(picture: Picture) -> Picture:
    """Equalize the lightness of a picture locally."""
    lab = cv2.cvtColor(picture, cv2.COLOR_BGR2LAB)
    lab[..., 0] = cv2.createCLAHE(2, (4, 4)).apply(lab[..., 0])
    return np.asarray(cv2.cvtColor(lab, cv2.COLOR_LAB2BGR), np.uint8)


def blur(picture: Picture) -> Picture:
    """Blur a picture by a Gaussian of one pixel."""
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.0), np.uint8)


TO_MAP: Final[dict[str, Callable[[Picture, Picture], Picture]]] = {
    "histogram": match_histogram,
    "statistics": match_statistics,
}
"""Changes of queries toward the pixels of the map."""
OF_ALL: Final[dict[str, Callable[[Picture], Picture]]] = {
    "grey": make_grey,
    "clahe": equalize,
    "blur": blur,
}
"""Changes of all pictures."""


def normalize_flight(flight: Path, out: Path, by: str) -> None:
    """Copy a flight, and change its pictures.

    Args:
        flight: folder of the flight.
        out: folder to write; it must not exist.
        by: a key of ``TO_MAP`` or ``OF_ALL``.
    """
    # Contents without permissions, because the original may be read-only.
    shutil.copytree(flight, out, copy_function=shutil.copyfile)
    pictures = sorted(path for path in (out / "images").rglob("*") if path.is_file())
    queries = [path for path in pictures if path.parent == out / "images"]
    map_pixels = np.concatenate(
        [
            _read(path)[::_STRIDE, ::_STRIDE].reshape(-1, 3)
            for path in pictures
            if path not in queries
        ]
    )
    for path in queries if by in TO_MAP else pictures:
        picture = _read(path)
        changed = TO_MAP[by](picture, map_pixels) if by in TO_MAP else OF_ALL[by](picture)
        cv2.imwrite(str(path), changed, [cv2.IMWRITE_JPEG_QUALITY, 95])


def _read(path: Path) -> Picture:
    return np.asarray(cv2.imread(str(path)), np.uint8)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("flight", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--by", choices=[*TO_MAP, *OF_ALL], required=True)
    args = parser.parse_args()
    normalize_flight(args.flight, args.out, args.by)
