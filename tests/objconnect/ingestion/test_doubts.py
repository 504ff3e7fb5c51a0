"""What ``ingest`` says of photographs whose fields contradict each other."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from objconnect.ingestion.photographs import make_photographs, read_flight, warn_of_doubts
from objconnect.ingestion.positions import replace_positions
from objconnect.ingestion.report import describe_lenses
from objconnect.scene.geometry.camera import Camera
from tests.objconnect.localization.pipeline.test_doubts import CONTRADICTION, FIELDS
from tests.objconnect.scene.quantities import raw_exif as raw

NAMES = [f"{k}.jpg" for k in range(3)]
UNSAID = {"GPSLatitude": raw.rational(47.0001), "GPSLongitude": raw.rational(8.0001)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k, name in enumerate(NAMES):
        detail = CONTRADICTION | {"FocalLength": raw.rational(8.8 + k / 1e6)}
        raw.write(tmp_path / name, (96, 64), raw.exif(detail, UNSAID))
    return tmp_path


def test_a_table_leaves_nothing_to_doubt_of_positions(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    flight = read_flight(folder)
    warn_of_doubts(flight, with_lenses=True)
    assert "GPSLatitudeRef is missing" in caplog.text and FIELDS[0] in caplog.text
    caplog.clear()
    table = folder / "gps.csv"
    table.write_text("name,lat,lon,alt\n" + "".join(f"{name},47,8,500\n" for name in NAMES))
    placed = replace_positions(flight, table)
    warn_of_doubts(placed, with_lenses=True)
    assert "GPS" not in caplog.text and FIELDS[0] in caplog.text
    caplog.clear()
    warn_of_doubts(placed, with_lenses=False)
    assert not caplog.text


class _Adjusted:
    """A model that changed nothing."""

    def __init__(self, cameras: dict[str, Camera]) -> None:
        self.model = type("Model", (), {"images": {}})()
        for name, camera in cameras.items():
            self.model.images[name] = type("Image", (), {"camera": camera})()
        self.refined = type("Refined", (), {"focal": frozenset()})()


def test_the_report_names_fields_that_contradict_each_other(folder: Path) -> None:
    photographs = make_photographs(read_flight(folder).images, 96, None)
    assert not any(photograph.focal_known for photograph in photographs)
    adjusted = _Adjusted({photograph.name: photograph.camera for photograph in photographs})
    (lens,) = describe_lenses(photographs, adjusted)  # type: ignore[arg-type]
    assert all(field in lens.origin for field in FIELDS)
    assert "no focal length in EXIF" not in lens.origin and "guessed" in lens.origin
    assert np.isfinite(photographs[0].camera.focal[0])
