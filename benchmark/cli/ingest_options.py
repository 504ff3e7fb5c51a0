"""Options of the command ``ingest``: its input, and two orthophotos of different dates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Photographs = Annotated[
    Path,
    typer.Argument(
        metavar="PHOTOS",
        help="Folder of JPEG files with GPS positions in their EXIF or in a table. With --pair, an "
        "orthophoto.",
    ),
]
PositionTable = Annotated[
    Path | None,
    typer.Option(
        metavar="CSV",
        help="Table of positions with the columns name,lat,lon,alt. Without it, positions are read "
        "from EXIF.",
    ),
]
MapOrthophoto = Annotated[
    Path | None,
    typer.Option(
        metavar="MAP",
        help="Orthophoto (GeoTIFF) to make the map from. PHOTOS is then an orthophoto of another "
        "date, from which queries with exact poses are drawn, and SCENE is a flight data set; see "
        "docs/pairs.md.",
    ),
]
Homography = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Nine numbers, row by row: the homography from pixels of PHOTOS to pixels of --pair, "
        "as cv2.findHomography returns it. PHOTOS may then be any image file.",
    ),
]
PairSurface = Annotated[
    Path | None,
    typer.Option(
        metavar="GEOTIFF",
        help="Surface model of --pair: heights in metres, with buildings and trees. Without it, "
        "the ground is taken as level.",
    ),
]
Residual = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="90th percentile of the error with which the two orthophotos are registered, over the "
        "ground. Without it, the error is measured.",
        show_default="measured",
        min=0,
        max=1000,
    ),
]
