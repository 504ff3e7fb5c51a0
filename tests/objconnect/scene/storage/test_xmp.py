"""What drones say in XMP, in the forms in which they and other programs write it."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import ExifTags, Image

from objconnect.scene.geometry.camera import Camera
from objconnect.scene.storage.exif import read_exif
from objconnect.scene.storage.xmp import DroneXmp, parse_xmp

# As a Phantom 4 RTK writes them, with angles of our own.
SIZE = (5472, 3648)
LENS = "3659.78,3653.17,-7.71,45.9,-0.269478,0.115681,-8.75619e-05,-0.000306177,-0.0357628"
FIELDS = {
    "AbsoluteAltitude": "+116.56",
    "RelativeAltitude": "+69.95",
    "GimbalRollDegree": "+0.10",
    "GimbalYawDegree": "-79.00",
    "GimbalPitchDegree": "-89.90",
    "FlightXSpeed": "+3.0",
    "FlightYSpeed": "-4.0",
    "CalibratedFocalLength": "3666.666504",
    "CalibratedOpticalCenterX": "2736.000000",
    "CalibratedOpticalCenterY": "1824.000000",
    "RtkFlag": "50",
    "RtkStdLon": "0.01052",
    "RtkStdLat": "0.01187",
    "RtkStdHgt": "0.02534",
    "DewarpData": f"2018-03-13;{LENS}",
    "DewarpFlag": "0",
    "ShutterType": "Mechanical",
}
DJI = "http://www.dji.com/drone-dji/1.0/"
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"


def packet(fields: dict[str, str] = FIELDS, elements: bool = False) -> bytes:
    """An XMP packet written by a library of XML."""
    ElementTree.register_namespace("drone-dji", DJI)
    ElementTree.register_namespace("rdf", RDF)
    root = ElementTree.Element("{adobe:ns:meta/}xmpmeta")
    rdf = ElementTree.SubElement(root, f"{{{RDF}}}RDF")
    about = ElementTree.SubElement(rdf, f"{{{RDF}}}Description")
    for name, value in fields.items():
        if elements:
            ElementTree.SubElement(about, f"{{{DJI}}}{name}").text = f"\n {value}\n"
        else:
            about.set(f"{{{DJI}}}{name}", value)
    text = ElementTree.tostring(root)
    return (
        b'<?xpacket begin="\xef\xbb\xbf" id="W5M0"?>\n' + text + b'\n<?xpacket end="w"?>' + bytes(9)
    )


def without(*names: str, **others: str) -> bytes:
    return packet({k: v for k, v in FIELDS.items() if k not in names} | others)


@pytest.mark.parametrize("elements", [False, True])
def test_every_field(elements: bool) -> None:
    said = parse_xmp(packet(elements=elements), SIZE)
    assert said.gimbal == (-79.0, -89.9, 0.1)
    assert said.position_texts["AbsoluteAltitude"] == "+116.56"
    assert said.rtk_sigma == (0.01052, 0.01187, 0.02534)
    assert said.speed == 5
    assert said.shutter == "Mechanical"
    assert said.camera is not None
    assert said.camera.model == "FULL_OPENCV"
    assert said.camera.focal == (3659.78, 3653.17)
    assert said.camera.principal == (5472 / 2 - 7.71, 3648 / 2 + 45.9)
    assert said.camera.distortion == (*map(float, LENS.split(",")[4:]), 0.0, 0.0, 0.0)


def test_the_lens_is_that_of_opencv() -> None:
    """OpenCV projects with all five coefficients."""
    camera = parse_xmp(packet(), SIZE).camera
    assert camera is not None
    fx, fy, cx, cy, *distortion = map(float, LENS.split(","))
    matrix = np.array([[fx, 0, SIZE[0] / 2 + cx], [0, fy, SIZE[1] / 2 + cy], [0, 0, 1]])
    xy = np.random.default_rng(0).uniform(-0.95, 0.95, (2000, 2))
    rays = np.column_stack([xy, np.ones(len(xy))])
    pixels = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(distortion))[0][
        :, 0
    ]
    seen = camera.contains(torch.from_numpy(pixels)).numpy()
    assert seen.sum() > 1000
    off = np.linalg.norm(camera.project(torch.from_numpy(rays)).xy.numpy() - pixels, axis=1)[seen]
    assert off.max() < 1e-6
    plain = without(DewarpData=",".join([*LENS.split(",")[:-1], "0"]))
    assert getattr(parse_xmp(plain, SIZE).camera, "model", None) == "OPENCV"


def test_pictures_that_were_dewarped_have_the_designed_lens() -> None:
    designed = Camera("SIMPLE_PINHOLE", *SIZE, (3666.666504, 2736.0, 1824.0))
    assert parse_xmp(without(DewarpFlag="1"), SIZE).camera == designed
    assert parse_xmp(without("DewarpData"), SIZE).camera == designed
    for damaged in ("", "2018;1,2,3", f"{LENS},1", LENS.replace("3659.78", "nan"), "0" * 5000):
        assert parse_xmp(without(DewarpData=damaged), SIZE).camera == designed
    nothing = without("DewarpData", "CalibratedFocalLength")
    assert parse_xmp(nothing, SIZE).camera is None


def test_a_calibration_of_another_size_is_none() -> None:
    """Programs that resize a photograph and its tags leave the drone's fields as they are."""
    assert parse_xmp(packet(), (1368, 912)).camera is None
    far = LENS.replace("-7.71", "2736.0")
    assert parse_xmp(without("CalibratedFocalLength", DewarpData=far), SIZE).camera is None


@pytest.mark.parametrize("flag", ["0", "16", "34", "", "fifty"])
def test_only_fixed_rtk_has_sigmas(flag: str) -> None:
    assert parse_xmp(without(RtkFlag=flag), SIZE).rtk_sigma is None


@pytest.mark.parametrize("sigma", ["0", "-0.01", "nan", "inf", "1e9", "0.01 m"])
def test_sigmas_that_are_none(sigma: str) -> None:
    assert parse_xmp(without(RtkStdHgt=sigma), SIZE).rtk_sigma is None


def test_hostile_packets_say_nothing() -> None:
    lol = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 9))
    bomb = f'<!DOCTYPE x [<!ENTITY l0 "9">{lol}]><x GimbalYawDegree="1" a="&l8;">&l8;</x>'
    outside = '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><x><ShutterType>&e;</ShutterType></x>'
    for text in (bomb, outside):
        for encoding in ("utf-8", "utf-16"):
            assert parse_xmp(text.encode(encoding), SIZE) == DroneXmp()
    for nothing in (
        b"",
        b"\0" * 99,
        b"<",
        b"no XML",
        b'<?xml version="1.0" encoding="magic"?><x/>',
    ):
        assert parse_xmp(nothing, SIZE) == DroneXmp()
    assert parse_xmp(b"<a>" * 100_000, SIZE) == DroneXmp()


def test_a_damaged_end_does_not_hide_the_beginning() -> None:
    whole = packet()
    assert parse_xmp(whole[: whole.index(b"</rdf")], SIZE) == parse_xmp(whole, SIZE)
    undeclared = (
        b'<x drone-dji:GimbalYawDegree="1" drone:GimbalPitchDegree="2" GimbalRollDegree="3"/>'
    )
    assert parse_xmp(undeclared, SIZE).gimbal == (1, 2, 3)


@given(st.binary(max_size=200), st.integers(0, 1500), st.booleans())
def test_damage_is_no_crash(noise: bytes, at: int, elements: bool) -> None:
    whole = packet(elements=elements)
    said = parse_xmp(whole[:at] + noise + whole[at + len(noise) :], SIZE)
    assert said.gimbal is None or np.isfinite(said.gimbal).all()
    assert said.rtk_sigma is None or min(said.rtk_sigma) > 0


def test_of_a_resized_photograph(tmp_path: Path) -> None:
    """EXIF keeps the size in which it was taken."""
    tags = Image.Exif()
    detail = tags.get_ifd(ExifTags.IFD.Exif)
    detail[ExifTags.Base.ExifImageWidth], detail[ExifTags.Base.ExifImageHeight] = SIZE
    gps = tags.get_ifd(ExifTags.IFD.GPSInfo)
    gps[ExifTags.GPS.GPSLatitudeRef], gps[ExifTags.GPS.GPSLatitude] = "N", (47.0, 0.0, 0.0)
    gps[ExifTags.GPS.GPSLongitudeRef], gps[ExifTags.GPS.GPSLongitude] = "E", (8.0, 0.0, 0.0)
    path = tmp_path / "a.jpg"
    Image.new("RGB", (96, 64)).save(path, exif=tags.tobytes(), xmp=packet())
    exif = read_exif(path)
    assert exif.xmp == parse_xmp(packet(), SIZE)
    assert exif.gimbal == (-79.0, -89.9, 0.1)
    assert exif.position == pytest.approx((47, 8, 116.56)), "EXIF has no altitude"


def test_a_real_photograph(beach: Path) -> None:
    said = read_exif(beach / "photos" / "DJI_0018.jpg").xmp
    assert said == DroneXmp(gimbal=(45.0, -89.9, 0.0), position_texts=said.position_texts)
    assert said.position_texts["AbsoluteAltitude"] == "+198.31"
