"""Columns of positions are told by their names, or refused by name."""

from __future__ import annotations

import pytest

from objconnect.scene.quantities.position_columns import CoordinateFrame, position_columns

MAP, EARTH = CoordinateFrame


@pytest.mark.parametrize(
    ("header", "frame", "horizontal", "vertical"),
    [
        ("name,e,n,u", MAP, ("e", "n"), "u"),
        ("u_m,n_m,e_m,name", MAP, ("e_m", "n_m"), "u_m"),
        ("name,e,n", MAP, ("e", "n"), None),
        ("name,lat,lon,alt", EARTH, ("lat", "lon"), "alt"),
        ("lon,lat,name", EARTH, ("lat", "lon"), None),
        (
            "name,longitude,latitude,altitude",
            EARTH,
            ("latitude", "longitude"),
            "altitude",
        ),
        (
            "name,lat_deg,lon_deg,altitude_m,",
            EARTH,
            ("lat_deg", "lon_deg"),
            "altitude_m",
        ),
    ],
)
def test_the_frame_is_told_by_name(
    header: str, frame: CoordinateFrame, horizontal: tuple[str, str], vertical: str | None
) -> None:
    found = position_columns(header.split(","), ["name"]).value
    assert found is not None
    assert (found.frame, found.horizontal, found.vertical) == (frame, horizontal, vertical)


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ("name,lat,lon,alt_ft", "'alt_ft'"),
        ("name,lat,lon,altitude_feet", "'altitude_feet'"),
        ("name,x,y,z", "'x'"),
        ("name,x,y", "'y'"),
        ("name,easting,northing", "'easting'"),
        ("name,lat,lon,height", "'height'"),
        ("name,lat,lon,alt_rel", "'alt_rel'"),
        ("name,Lat,Lon", "'Lat'"),
        ("name,lat_rad,lon_rad", "'lat_rad'"),
        ("name,e,n,u,sigma_ft", "'sigma_ft'"),
        ("name,lat", "lon is missing"),
        ("name,u", "e is missing"),
        ("name,lon,alt", "lat is missing"),
        ("name", "no columns of a position"),
        ("name,e,n,u,lat,lon,alt", "two frames"),
        ("name,e,n,alt", "two frames"),
        ("name,lat,latitude,lon", "lat and latitude"),
    ],
)
def test_what_has_no_known_meaning_is_named(header: str, said: str) -> None:
    found = position_columns(header.split(","), ["name"])
    assert not found.is_known
    assert said in found.why
