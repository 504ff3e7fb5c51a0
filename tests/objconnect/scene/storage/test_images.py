from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.storage.exif import Exif, read_exif, resize_file, write_jpeg
from objconnect.scene.storage.images import read_rgb

TIME = datetime(2026, 1, 15, 16, 30, 5, tzinfo=UTC)


def picture() -> np.ndarray:
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    return np.stack([4 * x, 5 * y, 2 * (x + y)], -1).astype(np.uint8)


@pytest.fixture
def jpeg(tmp_path: Path) -> Path:
    path = tmp_path / "photo.jpg"
    write_jpeg(path, picture(), Exif(Geodetic(46.8, -92.0, 198.5), TIME))
    return path


def test_pixels_survive_compression(jpeg: Path) -> None:
    pixels = read_rgb(jpeg, Camera("PINHOLE", 64, 48, (50.0, 50.0, 32.0, 24.0)))
    assert pixels.dtype == np.uint8
    difference = np.abs(pixels.astype(int) - picture())
    assert difference.mean() < 1.5
    assert difference.max() < 12


@given(
    st.builds(
        Geodetic,
        st.floats(-90, 90),
        st.floats(-180, 180),
        st.floats(-400, 9000),
    ),
    st.datetimes(datetime(1990, 1, 1), datetime(2100, 1, 1), timezones=st.just(UTC)),
    st.floats(8, 300),
)
def test_exif_round_trip(
    tmp_path_factory: pytest.TempPathFactory, place: Geodetic, time: datetime, focal: float
) -> None:
    assume(max(abs(place.latitude), abs(place.longitude)) > 1e-6)  # a receiver without a fix
    path = tmp_path_factory.getbasetemp() / "exif.jpg"
    write_jpeg(path, picture(), Exif(place, time, "Maker", "Drone 3", focal))
    exif = read_exif(path)
    assert exif.position is not None
    assert exif.position.latitude == pytest.approx(place.latitude, abs=1e-6)
    assert exif.position.longitude == pytest.approx(place.longitude, abs=1e-6)
    assert exif.position.altitude == pytest.approx(place.altitude, abs=1e-3)
    assert exif.time == time.replace(microsecond=0)
    assert (exif.make, exif.model) == ("Maker", "Drone 3")
    assert exif.focal_35mm == pytest.approx(focal, abs=0.5)  # EXIF keeps whole millimetres


def test_time_is_written_as_universal_time(tmp_path: Path) -> None:
    local = TIME.astimezone(timezone(timedelta(hours=-6)))
    write_jpeg(tmp_path / "a.jpg", picture(), Exif(None, local))
    assert read_exif(tmp_path / "a.jpg").time == TIME


def take_with(tag: ExifTags.Base, value: str, folder: Path) -> Path:
    """A photograph taken at ``TIME``, with one more tag or another value of it."""
    path = folder / "a.jpg"
    write_jpeg(path, picture(), Exif(None, TIME))
    with Image.open(path) as image:
        tags = image.getexif()
        tags.get_ifd(ExifTags.IFD.Exif)[tag] = value
        image.save(path, exif=tags.tobytes())
    return path


@pytest.mark.parametrize(
    ("digits", "seconds"),
    [("25", 0.25), ("025", 0.025), ("5\0", 0.5), (" 123456 ", 0.123456), ("", 0), ("-5", 0)],
)
def test_fractions_of_seconds(digits: str, seconds: float, tmp_path: Path) -> None:
    path = take_with(ExifTags.Base.SubsecTimeOriginal, digits, tmp_path)
    assert read_exif(path).time == TIME + timedelta(seconds=seconds)


@pytest.mark.parametrize("size", [(400, 300), (300, 400)])
def test_the_relative_focal_length_refers_to_the_longer_side(
    size: tuple[int, int], tmp_path: Path
) -> None:
    rgb = np.zeros((size[1], size[0], 3), np.uint8)
    write_jpeg(tmp_path / "a.jpg", rgb, Exif(None, None, focal_35mm=36 * 500 / 400))
    focal = read_exif(tmp_path / "a.jpg").relative_focal
    assert focal == pytest.approx(500 / 400, rel=1e-4)
    resize_file(tmp_path / "a.jpg", tmp_path / "b.jpg", 200)
    assert read_exif(tmp_path / "b.jpg").relative_focal == pytest.approx(focal)


@pytest.mark.parametrize(("offset", "hours"), [("+02:00", 2), ("-05:30", -5.5), ("", 0), ("?", 0)])
def test_offset_from_universal_time(offset: str, hours: float, tmp_path: Path) -> None:
    path = take_with(ExifTags.Base.OffsetTimeOriginal, offset, tmp_path)
    assert read_exif(path).time == TIME - timedelta(hours=hours)


def test_absent_fields_are_none(tmp_path: Path) -> None:
    write_jpeg(tmp_path / "a.jpg", picture(), Exif(None, None))
    exif = read_exif(tmp_path / "a.jpg")
    assert (exif.position, exif.time, exif.focal_35mm) == (None, None, None)
    Image.fromarray(picture()).save(tmp_path / "plain.png")
    assert read_exif(tmp_path / "plain.png") == Exif(None, None, "", "", None)


@pytest.mark.parametrize(
    "gps",
    [
        {},
        {ExifTags.GPS.GPSLatitudeRef: "N", ExifTags.GPS.GPSLatitude: (46.0, 48.0, 0.0)},
        # These are the values that receivers without a fix write.
        {
            ExifTags.GPS.GPSLatitudeRef: "N",
            ExifTags.GPS.GPSLatitude: (IFDRational(0, 0),) * 3,
            ExifTags.GPS.GPSLongitudeRef: "E",
            ExifTags.GPS.GPSLongitude: (IFDRational(0, 0),) * 3,
        },
        {
            ExifTags.GPS.GPSLatitudeRef: "N",
            ExifTags.GPS.GPSLatitude: (0.0, 0.0, 0.0),
            ExifTags.GPS.GPSLongitudeRef: "E",
            ExifTags.GPS.GPSLongitude: (0.0, 0.0, 0.0),
        },
        {
            ExifTags.GPS.GPSLatitudeRef: "N",
            ExifTags.GPS.GPSLatitude: (99.0, 0.0, 0.0),
            ExifTags.GPS.GPSLongitudeRef: "E",
            ExifTags.GPS.GPSLongitude: (9.0, 0.0, 0.0),
        },
    ],
    ids=["empty", "half", "no_fix", "all_zero", "beyond_the_pole"],
)
def test_a_position_that_is_none_is_none(tmp_path: Path, gps: dict[int, object]) -> None:
    tags = Image.Exif()
    tags.get_ifd(ExifTags.IFD.GPSInfo).update(gps)
    Image.fromarray(picture()).save(tmp_path / "a.jpg", exif=tags.tobytes())
    assert read_exif(tmp_path / "a.jpg").position is None


def test_an_altitude_without_a_fix_reads_as_an_absent_one(tmp_path: Path) -> None:
    tags = Image.Exif()
    tags.get_ifd(ExifTags.IFD.GPSInfo).update(
        {
            ExifTags.GPS.GPSLatitudeRef: "S",
            ExifTags.GPS.GPSLatitude: (46.0, 48.0, 0.0),
            ExifTags.GPS.GPSLongitudeRef: "E",
            ExifTags.GPS.GPSLongitude: (9.0, 0.0, 36.0),
            ExifTags.GPS.GPSAltitude: IFDRational(0, 0),
        }
    )
    Image.fromarray(picture()).save(tmp_path / "a.jpg", exif=tags.tobytes())
    exif = read_exif(tmp_path / "a.jpg")
    assert exif.position == pytest.approx((-46.8, 9.01, np.nan), nan_ok=True)
    assert exif.doubts == ("GPSAltitude is not a number of metres",)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_damaged_exif_is_no_crash(jpeg: Path) -> None:
    """Each byte of the EXIF segment is inverted, one at a time."""
    whole = jpeg.read_bytes()
    end = whole.index(b"\xff\xdb")
    for at in range(24, end, 2):
        jpeg.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        try:
            exif = read_exif(jpeg)
        except InputError as error:
            assert "\n" not in str(error)
        else:
            assert exif.position is None or np.isfinite(exif.position[:2]).all()


def test_real_photographs_tell_where_they_were_taken(beach: Path) -> None:
    """Values agree with gps.csv, which another program made from the same EXIF."""
    rows = (beach / "gps.csv").read_text().splitlines()[1:4]
    for row in rows:
        name, _, latitude, longitude, altitude = row.split(",")[:5]
        exif = read_exif(beach / "photos" / name)
        assert exif.position is not None
        assert exif.position.latitude == pytest.approx(float(latitude), abs=1e-7)
        assert exif.position.longitude == pytest.approx(float(longitude), abs=1e-7)
        assert exif.position.altitude == pytest.approx(float(altitude), abs=1e-2)
        assert exif.make
        assert exif.time is not None


def expect_error(path: Path, camera: Camera | None = None) -> str:
    with pytest.raises(InputError) as caught:
        read_rgb(path, camera)
    message = str(caught.value)
    assert path.name in message
    assert "\n" not in message
    return message


def test_a_missing_image_is_refused(tmp_path: Path) -> None:
    assert "does not exist" in expect_error(tmp_path / "missing.jpg")
    with pytest.raises(InputError, match=r"missing\.jpg does not exist"):
        read_exif(tmp_path / "missing.jpg")


def test_not_an_image(tmp_path: Path) -> None:
    (tmp_path / "notes.jpg").write_text("these are not pixels")
    (tmp_path / "empty.jpg").touch()
    for name in ("notes.jpg", "empty.jpg"):
        assert "not an image" in expect_error(tmp_path / name)
        with pytest.raises(InputError, match="not an image"):
            read_exif(tmp_path / name)


def test_a_truncated_jpeg_is_refused(jpeg: Path) -> None:
    whole = jpeg.read_bytes()
    jpeg.write_bytes(whole[: len(whole) * 2 // 3])
    assert "damaged" in expect_error(jpeg)


def test_a_truncated_png_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    Image.fromarray(picture()).save(path)
    whole = path.read_bytes()
    for length in (20, len(whole) // 2):
        path.write_bytes(whole[:length])
        expect_error(path)


def test_a_folder_is_no_image(tmp_path: Path) -> None:
    (tmp_path / "folder.jpg").mkdir()
    expect_error(tmp_path / "folder.jpg")


def test_an_image_of_a_wrong_size_is_refused(jpeg: Path) -> None:
    camera = Camera("PINHOLE", 128, 96, (50.0, 50.0, 32.0, 24.0))
    assert "is 64 x 48 pixels but its camera is 128 x 96" in expect_error(jpeg, camera)


def test_grey_and_transparent_images_become_rgb(tmp_path: Path) -> None:
    for mode in ("L", "RGBA", "P", "I;16"):
        path = tmp_path / f"{mode[0]}.png"
        Image.new(mode, (8, 6), 7).save(path)
        assert read_rgb(path).shape == (6, 8, 3)


@pytest.mark.parametrize("degrees", [1.6 - 4e-16, 59.99999999, 0.9999999999, 179.9999999999])
def test_no_seconds_are_rounded_to_60(tmp_path: Path, degrees: float) -> None:
    path = tmp_path / "a.jpg"
    write_jpeg(path, picture(), Exif(Geodetic(degrees / 2, -degrees, 5.0), None))
    position = read_exif(path).position
    assert position is not None
    assert position[:2] == pytest.approx((degrees / 2, -degrees), abs=1e-7)
