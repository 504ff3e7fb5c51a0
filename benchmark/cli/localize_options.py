"""Options of the command ``localize``: its input, what is known beforehand, and its outputs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Poses = Annotated[
    Path,
    typer.Option(metavar="POSES", help="Text file of the poses; a CSV file is written beside it."),
]
Images = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of new photographs.")]
VideoFile = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Video of a flight, instead of photographs."),
]
Subtitles = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Subtitles of the video with the drone's telemetry. By default the file of the same "
        "name beside the video.",
    ),
]
Sequenced = Annotated[
    bool,
    typer.Option(
        "--sequence",
        help="Localize the photographs as one flight: earlier poses give the prior of the next.",
    ),
]
Rate = Annotated[
    float | None,
    typer.Option(
        help="Number of frames per second of the video to localize. With --sequence, number of "
        "photographs per second, in the order of their names, instead of the times in EXIF.",
        min=0.01,
        max=240,
        show_default="2 for a video",
    ),
]
Priors = Annotated[
    Path | None,
    typer.Option(
        metavar="CSV",
        help="Table of positions: name,e,n,u in metres in the map's frame or name,lat,lon,alt, "
        "optionally with sigma_m and attitudes. By default they are read from EXIF and XMP.",
    ),
]
GpsSigma = Annotated[
    float,
    typer.Option(
        help="Standard deviation of EXIF positions, metres, and of positions in --priors without "
        "sigma_m. Fixed RTK positions use the standard deviations in their XMP instead.",
        min=0.01,
        max=1e6,
    ),
]
GimbalSigma = Annotated[
    float,
    typer.Option(
        help="Standard deviation of gimbal attitudes in XMP, degrees, and of attitudes in "
        "--priors without sigma_deg.",
        min=0.01,
        max=180,
    ),
]
AdditionalOutputs = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FILE",
        help="Additional file to write: GeoJSON (.geojson) for a GIS, KML (.kml) for a globe, a "
        "MAVLink telemetry log (.tlog) for an autopilot's filter, or a ROS 2 bag (.mcap); repeat "
        "the option for several.",
    ),
]
Undulation = Annotated[
    float | None,
    typer.Option(
        help="Height of the geoid above the ellipsoid, metres, for heights above sea level. By "
        "default it is read from PROJ's grid us_nga_egm96_15.tif where that is installed; "
        "otherwise KML placemarks lie on the ground.",
        min=-200,
        max=200,
        show_default="unknown",
    ),
]
Crs = Annotated[
    str | None,
    typer.Option(
        metavar="EPSG:N",
        help="Add the columns x (east), y (north) and h to the table of poses, in this coordinate "
        "reference system, such as EPSG:32632, or EPSG:7415, which also defines heights.",
        show_default="none",
    ),
]
