"""XMP of other makers, of several writers, and of other pictures in one file."""

from __future__ import annotations

from pathlib import Path

import pytest

from objconnect.scene.storage.exif import read_exif
from objconnect.scene.storage.xmp import parse_xmp
from tests.objconnect.scene.quantities import raw_exif as raw

SIZE = (400, 300)
RDF = 'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"'
ANGLES = 'p:GimbalYawDegree="10" p:GimbalPitchDegree="-90" p:GimbalRollDegree="0"'
PLACE = 'd:GpsLatitude="46.8426" d:GpsLongitude="-91.9944"'
DJI = 'xmlns:d="http://www.dji.com/drone-dji/1.0/"'


def packet(inside: str) -> bytes:
    rdf = f"<rdf:RDF {RDF}>{inside}</rdf:RDF>"
    return f'<x:xmpmeta xmlns:x="adobe:ns:meta/">{rdf}</x:xmpmeta>'.encode()


def description(attributes: str, inside: str = "") -> str:
    return f"<rdf:Description {attributes}>{inside}</rdf:Description>"


@pytest.mark.parametrize(
    ("prefix", "space", "known"),
    [
        ("drone-dji", "http://www.dji.com/drone-dji/1.0/", True),
        ("drone-dji", "", True),
        ("dd", "http://www.dji.com/drone-dji/1.0/", True),
        ("drone", "http://www.autelrobotics.com/drone/1.0/", True),
        ("AutelDrone", "", True),
        ("drone-parrot", "http://www.parrot.com/drone-parrot/1.0/", False),
        ("Camera", "http://pix4d.com/camera/1.0", False),
        ("Yuneec", "http://yuneec.example/", False),
        ("drone-skydio", "https://www.skydio.com/drone-skydio/1.0/", False),
    ],
)
def test_attitudes_of_other_makers_are_not_those_of_dji(
    prefix: str, space: str, known: bool
) -> None:
    declared = f'xmlns:{prefix}="{space}" ' if space else ""
    said = parse_xmp(packet(description(declared + ANGLES.replace("p:", f"{prefix}:"))), SIZE)
    assert said.gimbal == ((10.0, -90.0, 0.0) if known else None)
    assert bool(said.doubts) is not known
    assert known or prefix in said.doubts[0]


@pytest.mark.parametrize("angles", [("100", "-900", "0"), ("3600", "-90", "0"), ("1", "2", "3e5")])
def test_numbers_that_are_no_angles_are_no_attitude(angles: tuple[str, str, str]) -> None:
    names = ("Yaw", "Pitch", "Roll")
    fields = {f"drone-dji:Gimbal{n}Degree": a for n, a in zip(names, angles, strict=True)}
    said = parse_xmp(raw.xmp(fields), SIZE)
    assert said.gimbal is None and "is not an angle" in said.doubts[0]


def test_a_field_with_two_values_has_none(tmp_path: Path) -> None:
    other = PLACE.replace("-91", "+91")
    for inside in (
        description(f"{DJI} {PLACE}") + description(f"{DJI} {other}"),
        description(f"{DJI} {PLACE}", "<d:GpsLongitude>+91.9944</d:GpsLongitude>"),
    ):
        raw.write(tmp_path / "a.jpg", SIZE, raw.exif({}, {}), packet(inside))
        exif = read_exif(tmp_path / "a.jpg")
        assert exif.position is None and "-91.9944 and +91.9944" in exif.place_doubts[0]
    same = description(f"{DJI} {PLACE}") + description(f"{DJI} {PLACE.replace('46', '+46')}")
    assert parse_xmp(packet(same), SIZE).position_texts["GpsLatitude"] == "46.8426"


@pytest.mark.parametrize("element", ["LocationShown", "Pantry", "LocationCreated"])
def test_fields_of_other_pictures_and_places_are_left_alone(element: str) -> None:
    inside = (
        f'<q:{element} xmlns:q="q"><rdf:Bag><rdf:li rdf:parseType="Resource">'
        "<e:GPSLatitude>10,0.5N</e:GPSLatitude></rdf:li></rdf:Bag>"
        f'<rdf:Description e:GPSLongitude="10,0.5E"/></q:{element}><d:AbsoluteAltitude>5'
        "</d:AbsoluteAltitude>"
    )
    said = parse_xmp(packet(description(f'{DJI} xmlns:e="e" {PLACE}', inside)), SIZE)
    assert set(said.position_texts) == {"GpsLatitude", "GpsLongitude", "AbsoluteAltitude"}


def test_packets_of_two_programs_are_read_together(tmp_path: Path) -> None:
    first, second = (
        packet(description(f"{DJI} {word}")) for word in (PLACE, 'd:AbsoluteAltitude="12.5"')
    )
    raw.write(tmp_path / "a.jpg", SIZE, raw.exif({}, {}), first)
    data = (tmp_path / "a.jpg").read_bytes()
    body = b"http://ns.adobe.com/xap/1.0/\0" + second
    segment = b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body
    (tmp_path / "a.jpg").write_bytes(data[:2] + segment + data[2:])
    assert read_exif(tmp_path / "a.jpg").position == (46.8426, -91.9944, 12.5)


def test_a_picture_that_was_turned_has_no_attitude(tmp_path: Path) -> None:
    fields = {"ExifImageWidth": raw.long(400), "ExifImageHeight": raw.long(300)}
    said = packet(description(f"{DJI} {ANGLES.replace('p:', 'd:')}"))
    for size, known in (((400, 300), True), ((300, 400), False)):
        raw.write(tmp_path / "a.jpg", size, raw.exif(fields, {}), said)
        exif = read_exif(tmp_path / "a.jpg")
        assert (exif.gimbal is not None) is known
        assert known or "rotated after capture" in exif.capture_doubts[0]


def test_a_spherical_panorama_has_no_lens(tmp_path: Path) -> None:
    said = packet(description('xmlns:GPano="g" GPano:ProjectionType="equirectangular"'))
    film = {"FocalLengthIn35mmFilm": raw.short(24)}
    raw.write(tmp_path / "a.jpg", (400, 200), raw.exif(film, {}), said)
    exif = read_exif(tmp_path / "a.jpg")
    assert exif.focal_35mm is None and "equirectangular" in exif.lens_doubts[0]


def test_a_position_without_a_fix_is_reported(tmp_path: Path) -> None:
    exact = {"GPSLatitude": raw.rational(46.8426), "GPSLatitudeRef": raw.text("N")}
    exact |= {"GPSLongitude": raw.rational(91.9944), "GPSLongitudeRef": raw.text("W")}
    for status, doubts in (("A", []), ("V", ["GPSStatus V means that the receiver had no fix"])):
        gps = {**exact, "GPSStatus": raw.text(status)}
        raw.write(tmp_path / "a.jpg", SIZE, raw.exif({}, gps))
        said = read_exif(tmp_path / "a.jpg").place_doubts
        assert [each for each in said if "Altitude" not in each] == doubts


def test_two_blocks_of_exif_are_reported(tmp_path: Path) -> None:
    path, first = tmp_path / "a.jpg", raw.exif({"FocalLengthIn35mmFilm": raw.short(24)}, {})
    for block, doubts in ((first, 0), (raw.exif({"FocalLengthIn35mmFilm": raw.short(50)}, {}), 1)):
        raw.write(path, SIZE, first)
        data, segment = path.read_bytes(), b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block
        path.write_bytes(data[:2] + segment + data[2:])
        assert len(read_exif(path).capture_doubts) == doubts
