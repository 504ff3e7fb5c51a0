"""Focal lengths of pictures that programs have resized, turned or cropped."""

from __future__ import annotations

import math

import pytest

from objconnect.scene.quantities.focal import FocalLength, Lens, is_rotated, read_focal

# 8.8 mm on 13.2 mm of 5472 pixels: 24 mm of film.
PLANE = {
    "FocalLength": 8.8,
    "FocalPlaneXResolution": 4145.4545,
    "FocalPlaneResolutionUnit": 3,
    "ExifImageWidth": 5472,
    "ExifImageHeight": 3648,
}
FILM = {"FocalLengthIn35mmFilm": 24}
SMALL = {"ExifImageWidth": 1000, "ExifImageHeight": 667}
TRUE = pytest.approx(8.8 / 13.2, rel=0.002)


def read(size: tuple[int, int], *parts: dict[str, object], lens: Lens | None = None) -> FocalLength:
    detail: dict[str, object] = {}
    for part in parts:
        detail |= part
    return read_focal(detail, size, lens)


@pytest.mark.parametrize("more", [{}, FILM])
@pytest.mark.parametrize("size", [(1000, 667), (2736, 1824), (667, 1000)])
def test_a_picture_with_the_tags_of_its_camera(
    size: tuple[int, int], more: dict[str, object]
) -> None:
    assert read(size, PLANE, more).reading.value == TRUE


@pytest.mark.parametrize(
    "plane", [PLANE | SMALL, PLANE | SMALL | {"ExifImageHeight": 0}], ids=["both", "width"]
)
def test_a_program_that_updates_the_width_alone(plane: dict[str, object]) -> None:
    found = read((1000, 667), plane, FILM)
    assert not found.reading.is_known
    assert {"FocalPlaneXResolution", "FocalLengthIn35mmFilm"} < set(found.reading.why.split())
    # The equivalent comes first, for it does not depend on the size.
    assert found.candidates == (TRUE, pytest.approx(5.472 * 8.8 / 13.2, rel=0.002))
    alone = read((1000, 667), plane)
    assert not alone.reading.is_known
    assert alone.candidates == (pytest.approx(5.472 * 8.8 / 13.2, rel=0.002),)


def test_the_camera_s_own_file_with_a_second_source() -> None:
    assert read((5472, 3648), PLANE, FILM).reading.value == TRUE
    size_confirmed = Lens(0.6667, size_confirmed=True)
    assert read((5472, 3648), PLANE, lens=size_confirmed).reading.value == TRUE
    # Two numbers of pixels are wrong by one factor where the size is.
    both = read((1000, 667), PLANE, SMALL, lens=Lens(0.6667 * 5.472, size_confirmed=False))
    assert not both.reading.is_known
    assert not both.calibration_applies


@pytest.mark.parametrize("size", [(5472, 3078), (2736, 2736), (1000, 562), (1000, 1000)])
def test_a_part_of_a_picture_has_no_focal_length(size: tuple[int, int]) -> None:
    found = read(size, PLANE, FILM)
    assert not found.reading.is_known
    assert "ExifImageWidth" in found.reading.why
    assert "cropped" in found.reading.why


@pytest.mark.parametrize("ratio", [0.0, 1.0, math.nan, None])
def test_no_zoom(ratio: float | None) -> None:
    assert read((1000, 667), PLANE, FILM, {"DigitalZoomRatio": ratio}).reading.value == TRUE


def test_a_zoom() -> None:
    zoom = {"DigitalZoomRatio": 2.0}
    doubled = pytest.approx(2 * 8.8 / 13.2, rel=0.002)
    # The number for film has it, the other one not.
    found = read((1000, 667), PLANE, zoom, {"FocalLengthIn35mmFilm": 48})
    assert found.reading.value == doubled
    for parts in ([PLANE, FILM], [PLANE], [FILM]):
        unclear = read((1000, 667), zoom, *parts)
        assert not unclear.reading.is_known
        assert "DigitalZoomRatio" in unclear.reading.why
        assert len(unclear.candidates) == 2


@pytest.mark.parametrize(
    ("unit", "per_unit"), [(2, 10529.45), (3, 4145.4545), (4, 414.54545), (None, 10529.45)]
)
def test_units_of_the_focal_plane(unit: int | None, per_unit: float) -> None:
    plane = PLANE | {"FocalPlaneXResolution": per_unit, "FocalPlaneResolutionUnit": unit}
    assert read((1000, 667), plane, FILM).reading.value == TRUE
    # A unit that is missing is not an inch where nothing else says so.
    assert read((1000, 667), plane).reading.is_known == (unit is not None)
    assert read((1000, 667), plane | {"FocalPlaneResolutionUnit": 1}, FILM).reading.value == TRUE


def test_nothing_is_no_doubt() -> None:
    found = read((1000, 667), SMALL, {"FocalLength": 8.8, "FocalLengthIn35mmFilm": 0})
    assert (found.reading.value, found.reading.doubts, found.candidates) == (None, (), ())


@pytest.mark.parametrize("parts", [[FILM], [PLANE, FILM], [PLANE | {"ExifImageWidth": 8000}]])
def test_a_panorama_has_no_focal_length(parts: list[dict[str, object]]) -> None:
    """No sensor is so wide; the number for film is that of the pictures it was made of."""
    found = read((8000, 2000), *parts)
    assert not found.reading.is_known and not found.calibration_applies and not found.candidates
    assert "panorama" in found.reading.why


def test_resolutions_of_two_sizes_contradict_each_other() -> None:
    """A program that updates one of two fields."""
    other = PLANE | {"FocalPlaneYResolution": 2072.7}
    alone = read((1000, 667), other)
    assert not alone.reading.is_known and len(alone.candidates) == 2
    assert "FocalPlaneYResolution" in alone.reading.why
    assert read((1000, 667), other, FILM).reading.value == TRUE


@pytest.mark.parametrize(
    ("size", "orientation", "turned"),
    [
        ((1000, 667), 1, False),
        ((667, 1000), 1, True),
        ((667, 1000), None, True),
        # A program that writes the size as it is shown.
        ((667, 1000), 6, False),
    ],
)
def test_pictures_that_were_turned(
    size: tuple[int, int], orientation: int | None, turned: bool
) -> None:
    assert is_rotated(PLANE, size, orientation) is turned
    assert not is_rotated({}, size, orientation)
