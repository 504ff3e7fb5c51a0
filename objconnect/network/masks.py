"""Readers of object masks: label pictures, and COCO's run-length encoding."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from objconnect.network.segmentation import NOTHING, Labels, keep_largest
from objconnect.scene.errors import InputError
from objconnect.scene.storage.files import parse_json, read_text, require_readable

# Maximum number of objects if all are kept: a label picture of 16 bits has fewer.
_MAX_LABELS = 1 << 16
# Maximum size of a label picture or mask (33 megapixels), whose labels (int64) take 0.27 GB.
_MAX_PIXELS = 1 << 25
# Modes of Pillow with one number per pixel.
_ONE_CHANNEL = ("1", "L", "P", "I", "I;16")


def read_label_png(path: Path, count: int) -> Labels:
    """Read the labels of a picture of one channel, in which 0 means no object.

    Args:
        path: PNG of 8 or 16 bits. For a palette, the labels are the indices and not the colours.
        count: largest number N of objects; the largest objects are kept.

    Returns:
        Labels (H, W) int64, 0 to N - 1, or ``NOTHING``.

    Raises:
        InputError: the file is missing, damaged or too large, or has colours.
    """
    if os.path.lexists(path):
        require_readable(path, "label picture")
    try:
        with Image.open(path, formats=("PNG",)) as image:
            _check_size(image.width, image.height, f"label picture {path}")
            if not image.tile:
                raise InputError(f"label picture {path} has no pixels: write it again")
            # A damaged chunk may claim 4 GB, which a decoder would allocate. ``verify`` checks the
            # chunks without decoding.
            image.verify()
        with Image.open(path, formats=("PNG",)) as image:
            mode, values = image.mode, np.asarray(image)
    except FileNotFoundError:
        raise InputError(f"label picture {path} does not exist") from None
    except InputError:
        raise
    except UnidentifiedImageError:
        raise InputError(f"label picture {path} is not a PNG file: convert it to PNG") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"label picture {path} is damaged ({error}): write it again") from None
    if mode not in _ONE_CHANNEL:
        raise InputError(
            f"label picture {path} has colours ({mode}): write one label per pixel, as a grey or "
            "palette PNG"
        )
    labels = values.astype(np.int64)
    labels[values == 0] = NOTHING
    return keep_largest(labels, count)


def _check_size(width: int, height: int, subject: str) -> None:
    if width * height > _MAX_PIXELS:
        raise InputError(
            f"{subject} has {width} x {height} pixels; the maximum is {_MAX_PIXELS} pixels: make "
            "photographs and masks smaller"
        )


def read_coco(path: Path, image: str, count: int) -> Labels:
    """Read the labels of one photograph from COCO annotations with run-length masks.

    Where masks overlap, the smaller mask is on top.

    Args:
        path: JSON with ``images`` (``id``, ``file_name``) and ``annotations`` (``image_id``,
            ``segmentation`` with ``size`` and ``counts``, in numbers or as COCO's string).
        image: ``file_name`` of the photograph.
        count: largest number N of objects; those with the most visible pixels are kept.

    Returns:
        Labels (H, W) int64, 0 to N - 1, or ``NOTHING``.

    Raises:
        InputError: the file cannot be read, does not have the photograph, or has a mask that does
            not fit.
    """
    try:
        content = parse_json(read_text(path, "COCO annotations"))
        ids = [entry["id"] for entry in content["images"] if entry["file_name"] == image]
        segmentations = [a["segmentation"] for a in content["annotations"] if a["image_id"] in ids]
    except (ValueError, KeyError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise _not_coco(path, error) from None
    if not ids:
        raise InputError(f"{path} has no image {image!r}: compare the names of its images")
    if not segmentations:
        raise InputError(f"{path} has no masks of {image!r}: add annotations with its image_id")
    masks = [
        _mask(segmentation, f"{path}, mask {k} of {image!r}")
        for k, segmentation in enumerate(segmentations, 1)
    ]
    if len({mask.shape for mask in masks}) > 1:
        raise InputError(
            f"{path}: the masks of {image!r} have several sizes: write all in the photograph's size"
        )
    labels = np.full(masks[0].shape, NOTHING, np.int64)
    for number in np.argsort([-int(mask.sum()) for mask in masks], kind="stable"):
        labels[masks[number]] = number
    return keep_largest(labels, count)


def _mask(segmentation: Any, subject: str) -> NDArray[np.bool_]:
    """Decode a mask (H, W) from lengths of alternating runs of zeros and ones, column by column.

    ``subject`` names the file and the mask in errors.
    """
    if not isinstance(segmentation, dict):
        raise InputError(f"{subject} is a polygon: convert masks to run lengths (RLE)")
    try:
        height, width = (int(side) for side in segmentation["size"])
        counts = segmentation["counts"]
        runs = _runs(counts) if isinstance(counts, str) else [int(run) for run in counts]
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise InputError(f"{subject} cannot be read ({error!r}): write the masks again") from None
    if min(height, width, *runs) < 0:
        raise InputError(f"{subject} has a negative side or run length: write the masks again")
    if sum(runs) != height * width:
        raise InputError(
            f"{subject} has {sum(runs)} pixels, its size is {width} x {height}: write the masks "
            "again"
        )
    _check_size(width, height, subject)
    values = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
    return values.reshape(width, height).T


def _runs(text: str) -> list[int]:
    """Decode the run lengths of COCO's string.

    A character minus 48 holds five bits of a number, and a sixth bit that is set if more
    characters follow. The fifth bit of the last character is the sign. From the fourth number on,
    the string holds differences to the number two places before.
    """
    runs: list[int] = []
    position = 0
    while position < len(text):
        value = shift = 0
        more = True
        while more:
            bits = ord(text[position]) - 48
            if not 0 <= bits < 64:
                raise ValueError(f"character {text[position]!r} in its run lengths")
            value |= (bits & 31) << shift
            shift += 5
            position += 1
            more = bool(bits & 32)
        if bits & 16:
            value -= 1 << shift
        runs.append(value + (runs[-2] if len(runs) > 2 else 0))
    return runs


def read_masks(source: Path, names: Iterable[str]) -> Iterator[tuple[str, Labels]]:
    """Yield the name and the label map of every photograph that has masks, with all objects.

    Args:
        source: folder of label pictures, NAME.png for the photograph NAME.jpg, or a file of COCO
            annotations.
        names: names of the photographs. If a name has no masks, its last part is tried, the
            name of the file.

    Raises:
        InputError: the source is missing or has masks of none of the photographs, or a file of
            masks cannot be read, is damaged, is too large or has masks that do not fit.
    """
    if not source.is_dir():
        require_readable(source, "masks")
    coco_names = frozenset() if source.is_dir() else _coco_names(source)
    has_masks = False
    for name in names:
        for candidate in (name, name.rpartition("/")[2]):
            picture = source / Path(candidate).with_suffix(".png")
            if candidate in coco_names:
                labels = read_coco(source, candidate, _MAX_LABELS)
            elif os.path.lexists(picture):
                labels = read_label_png(picture, _MAX_LABELS)
            else:
                continue
            has_masks = True
            yield name, labels
            break
    if not has_masks:
        raise InputError(
            f"{source} has masks of none of the map's photographs: name label pictures NAME.png "
            "for the photograph NAME.jpg, or give COCO annotations with its file_name"
        )


def _coco_names(path: Path) -> frozenset[str]:
    """Return the names of the images that have masks; COCO lists images without masks too."""
    try:
        content = parse_json(read_text(path, "COCO annotations"))
        ids = {annotation["image_id"] for annotation in content["annotations"]}
        return frozenset(
            str(entry["file_name"]) for entry in content["images"] if entry["id"] in ids
        )
    except InputError:
        raise
    except (ValueError, KeyError, TypeError) as error:
        raise _not_coco(path, error) from None


def _not_coco(path: Path, error: Exception) -> InputError:
    return InputError(
        f'{path} is not a file of COCO annotations ({error!r}): write "images" with id and '
        'file_name, and "annotations" with image_id and segmentation'
    )
