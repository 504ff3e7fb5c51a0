from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from PIL import Image

from objconnect.ingestion.photographs import make_photographs, read_flight
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import Camera


def test_a_folder_with_everything_wrong_in_it(photographs: Path, tmp_path: Path) -> None:
    first, second, third = sorted(photographs.iterdir())[:3]
    (tmp_path / "100MEDIA").mkdir()
    shutil.copy(first, tmp_path / "100MEDIA" / "a one.JPG")
    shutil.copy(first, tmp_path / "copy of it.jpg")
    shutil.copy(second, tmp_path / "b.jpeg")
    (tmp_path / "text.jpg").write_text("no picture")
    (tmp_path / "notes.txt").write_text("notes")
    (tmp_path / "empty.jpg").touch()
    (tmp_path / "._b.jpg").write_bytes(b"of another file system")
    Image.open(third).save(tmp_path / "bare.jpg")
    flight = read_flight(tmp_path)
    assert {image.file for image in flight.images} == {"100MEDIA/a one.JPG", "b.jpeg", "bare.jpg"}
    assert flight.images[0].name == "flight/images/100MEDIA/a_one.JPG"
    assert flight.left_out.keys() == {"copy of it.jpg", "text.jpg", "empty.jpg"}
    assert flight.left_out["copy of it.jpg"] == "the same file as 100MEDIA/a one.JPG"
    assert "not an image" in flight.left_out["text.jpg"]


def test_order_is_that_of_time(photographs: Path, tmp_path: Path) -> None:
    files = sorted(photographs.iterdir())[:4]
    for path, name in zip(files, "dbca", strict=True):
        shutil.copy(path, tmp_path / f"{name}.jpg")
    assert [image.file[0] for image in read_flight(tmp_path).images] == list("dbca")
    Image.open(files[0]).save(tmp_path / "d.jpg")  # no time: then names tell the order
    assert [image.file[0] for image in read_flight(tmp_path).images] == list("abcd")


def test_a_folder_without_photographs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no photograph"):
        read_flight(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        read_flight(tmp_path / "missing")


def test_names_that_become_one(photographs: Path, tmp_path: Path) -> None:
    first, second = sorted(photographs.iterdir())[:2]
    shutil.copy(first, tmp_path / "a b.jpg")
    shutil.copy(second, tmp_path / "a_b.jpg")
    with pytest.raises(InputError, match="'a b.jpg' and 'a_b.jpg' would have the same name"):
        read_flight(tmp_path)


def test_focal_lengths_of_real_cameras(flights: Path, tmp_path: Path) -> None:
    """Within 3 % of the calibrations the flights were given, at 1024 pixels."""
    truth = {"brighton_beach": 597.0, "caliterra": 765.2}
    for name in truth:
        path = min((flights / name / "photos").iterdir())
        shutil.copy(path, tmp_path / path.name)
    photographs = make_photographs(read_flight(tmp_path).images, 1024, None)
    assert len({photograph.lens for photograph in photographs}) == 2
    for photograph in photographs:
        expected = truth["brighton_beach" if "DJI" in photograph.name else "caliterra"]
        assert photograph.focal_known
        assert photograph.camera.focal[0] == pytest.approx(expected, rel=0.03)
        assert max(photograph.camera.width, photograph.camera.height) == 1024


def test_a_given_camera_is_scaled_to_the_photographs(photographs: Path) -> None:
    flight = read_flight(photographs)
    calibration = Camera("SIMPLE_RADIAL", 4000, 2250, (2330.0, 2000.0, 1125.0, 0.004))
    (first, *_) = make_photographs(flight.images, 400, calibration)
    assert first.calibrated
    assert first.camera.focal[0] == pytest.approx(233.0)
    assert (first.camera.width, first.camera.height) == (400, 225)
    with pytest.raises(InputError, match="give a calibration of the same aspect ratio"):
        make_photographs(
            flight.images, 400, Camera("PINHOLE", 400, 300, (300.0, 300.0, 200.0, 150.0))
        )
