from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from objconnect.network.masks import read_coco, read_label_png, read_masks
from objconnect.scene.errors import InputError


def runs(mask: NDArray[np.bool_]) -> list[int]:
    """Lengths of zeros and ones in turn, down the columns."""
    made, value, length = [], False, 0
    for pixel in mask.T.flatten():
        if pixel != value:
            made.append(length)
            value, length = bool(pixel), 0
        length += 1
    return [*made, length]


def as_text(counts: list[int]) -> str:
    """COCO's compressed form."""
    text = ""
    for position, count in enumerate(counts):
        x = count - counts[position - 2] if position > 2 else count
        more = True
        while more:
            bits = x & 31
            x >>= 5
            more = x != (-1 if bits & 16 else 0)
            text += chr(48 + (bits | (32 if more else 0)))
    return text


def write(path: Path, masks: list[Any]) -> Path:
    content = {
        "images": [{"id": 5, "file_name": "a.jpg"}, {"id": 6, "file_name": "b.jpg"}],
        "annotations": [{"image_id": 5, "segmentation": mask} for mask in masks],
    }
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("compressed", [False, True])
def test_coco_masks_with_the_smaller_on_top(tmp_path: Path, compressed: bool) -> None:
    rng = np.random.default_rng(0)
    small = np.zeros((40, 70), bool)
    small[3:9, 30:34] = True
    large = rng.random((40, 70)) < 0.7
    segmentations = []
    for mask in (small, large):
        counts = runs(mask)
        counts_ = as_text(counts) if compressed else counts
        segmentations.append({"size": [40, 70], "counts": counts_})
    labels = read_coco(write(tmp_path / "masks.json", segmentations), "a.jpg", 8)
    np.testing.assert_array_equal(labels, np.where(small, 1, np.where(large, 0, -1)))
    only = read_coco(tmp_path / "masks.json", "a.jpg", 1)
    np.testing.assert_array_equal(only, np.where(large & ~small, 0, -1))


@pytest.mark.parametrize(
    ("mask", "why"),
    [
        ([[1, 2, 3, 4]], "polygon"),
        ({"size": [2, 2], "counts": [1, 2]}, "has 3 pixels, its size is 2 x 2"),
        ({"size": [2, 2], "counts": [5, -1]}, "has a negative side or run length"),
        ({"size": [2, 2], "counts": "\n"}, "cannot be read"),
        ({"size": [2, 2], "counts": "P"}, "cannot be read"),
        ({"size": [2], "counts": [4]}, "cannot be read"),
        ({"counts": [4]}, "cannot be read"),
    ],
)
def test_masks_that_do_not_fit(tmp_path: Path, mask: Any, why: str) -> None:
    with pytest.raises(InputError, match=why):
        read_coco(write(tmp_path / "masks.json", [mask]), "a.jpg", 8)


def test_files_that_are_no_annotations(tmp_path: Path) -> None:
    path = write(tmp_path / "masks.json", [])
    with pytest.raises(InputError, match="no image 'c.jpg'"):
        read_coco(path, "c.jpg", 8)
    with pytest.raises(InputError, match="no masks of 'b.jpg'"):
        read_coco(path, "b.jpg", 8)
    for text in ("{", "[]", '{"images": 3}', "5"):
        path.write_text(text)
        with pytest.raises(InputError, match="not a file of COCO"):
            read_coco(path, "a.jpg", 8)
    with pytest.raises(InputError, match=r"none.json"):
        read_coco(tmp_path / "none.json", "a.jpg", 8)
    sizes = [{"size": [2, 2], "counts": [4]}, {"size": [1, 4], "counts": [4]}]
    with pytest.raises(InputError, match="several sizes"):
        read_coco(write(path, sizes), "a.jpg", 8)


@pytest.mark.parametrize(
    ("size", "counts"),
    [([np.inf, 2], [4]), ([2, 2], [np.inf]), ([10**9, 10**9], [10**18]), ([2, 10**400], [4])],
)
def test_coco_masks_of_absurd_size(size: list[float], counts: list[float], tmp_path: Path) -> None:
    path = write(tmp_path / "masks.json", [{"size": size, "counts": counts}])
    with pytest.raises(InputError, match="mask 1"):
        read_coco(path, "a.jpg", 8)


def test_coco_nested_thousands_deep(tmp_path: Path) -> None:
    path = tmp_path / "masks.json"
    path.write_text("[" * 9000)
    with pytest.raises(InputError, match="nested too deeply"):
        read_coco(path, "a.jpg", 8)
    with pytest.raises(InputError, match="nested too deeply"):
        list(read_masks(path, ["a.jpg"]))


def test_images_without_annotations_are_passed_over(tmp_path: Path) -> None:
    path = write(tmp_path / "masks.json", [{"size": [1, 2], "counts": [1, 1]}])
    ((name, labels),) = read_masks(path, ["b.jpg", "summer/a.jpg"])
    assert name == "summer/a.jpg" and labels.tolist() == [[-1, 0]]
    with pytest.raises(InputError, match="has masks of none"):
        list(read_masks(path, ["b.jpg"]))


def test_masks_that_do_not_exist(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read masks .*nowhere: No such file"):
        list(read_masks(tmp_path / "nowhere", ["a.jpg"]))


def test_label_pictures_of_absurd_size(tmp_path: Path) -> None:
    """Sixty million pixels in a few kilobytes are refused before they are decoded."""
    path = tmp_path / "labels.png"
    Image.new("1", (10_000, 6_000)).save(path)
    assert path.stat().st_size < 20_000
    with pytest.raises(InputError, match="10000 x 6000 pixels.*smaller"):
        read_label_png(path, 8)


def test_label_pictures_that_claim_gigabytes(tmp_path: Path) -> None:
    path = tmp_path / "labels.png"
    Image.fromarray(np.ones((6, 8), np.uint16)).save(path)
    data = path.read_bytes()
    at = data.index(b"IDAT")
    path.write_bytes(data[: at - 4] + (2**31).to_bytes(4, "big") + data[at:])
    with pytest.raises(InputError, match=r"labels\.png is damaged"):
        read_label_png(path, 8)
    path.write_bytes(data[: at - 4] + data[-12:])
    with pytest.raises(InputError, match="no pixels"):
        read_label_png(path, 8)


def test_label_pictures(tmp_path: Path) -> None:
    path = tmp_path / "labels.png"
    values = np.array([[0, 300, 300], [2, 0, 0]])
    Image.fromarray(values.astype(np.uint16)).save(path)
    np.testing.assert_array_equal(read_label_png(path, 8), [[-1, 0, 0], [1, -1, -1]])
    Image.fromarray(values.astype(np.uint8)).convert("RGB").save(path)
    with pytest.raises(InputError, match="has colours"):
        read_label_png(path, 8)
    path.write_bytes(b"\x89PNG\r\n\x1a\n cut")
    with pytest.raises(InputError, match=r"labels.png"):
        read_label_png(path, 8)
    with pytest.raises(InputError, match="does not exist"):
        read_label_png(tmp_path / "none.png", 8)
