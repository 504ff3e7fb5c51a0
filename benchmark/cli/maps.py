"""Commands that build maps, measure them and add points to them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark.cli.options import ClusterAddress, DeviceName, Json, MappedScene, Undulation
from benchmark.cli.output import Summary, emit
from objconnect.scene.errors import InputError

if TYPE_CHECKING:
    from objconnect.scene.bundle.georeference import Georeference

app = typer.Typer(rich_markup_mode=None)

Masks = Annotated[
    Path | None,
    typer.Option(
        metavar="MASKS",
        help="Object masks of the map's photographs, for a scene without its own: a folder of "
        "label pictures, NAME.png for NAME.jpg, or a JSON file of COCO annotations with run-length "
        "masks. By default diagnose takes the objects of the scene, and supplement "
        "searches whole photographs.",
    ),
]


Orthophoto = Annotated[
    Path | None,
    typer.Option(
        metavar="GEOTIFF",
        help="8-bit orthophoto to build the scene and map from, instead of SCENE. Its coordinate "
        "reference system is in metres. Needs --dsm and --out.",
    ),
]

SurfaceModel = Annotated[
    Path | None,
    typer.Option(
        metavar="GEOTIFF",
        help="Surface model of the orthophoto: heights in metres, with buildings and trees.",
    ),
]

Altitude = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Height of the virtual cameras above the ground, such as that of your flights.",
        show_default="one pixel of a view covers one pixel of the orthophoto",
        min=1,
        max=10_000,
    ),
]

Overlap = Annotated[
    float | None,
    typer.Option(
        help="Share of a virtual view that overlaps with the next one.",
        show_default="0.7",
        min=0,
        max=0.95,
    ),
]

Tilt = Annotated[
    float | None,
    typer.Option(
        metavar="DEGREES",
        help="Tilt from the vertical of additional virtual views to the north, east, south and "
        "west; 0 adds none.",
        show_default="0",
        min=0,
        max=60,
    ),
]


HorizontalSigma = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Standard deviation of the orthophoto's horizontal position on earth: the root of the "
        "summed variances to the east and north. Without it, the accuracy of answers on earth "
        "(eph_m, epv_m) is unknown.",
        show_default="unknown",
        min=0,
        max=10_000,
    ),
]

VerticalSigma = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Standard deviation of the surface model's heights above the ellipsoid; needs "
        "--georeference.",
        show_default="unknown",
        min=0,
        max=10_000,
    ),
]


class MapMethod(StrEnum):
    """The methods that build a map."""

    TRIANGULATE = "triangulate"
    SFM = "sfm"


class Stereo(StrEnum):
    """The implementations of PatchMatch stereo."""

    OWN = "own"
    COLMAP = "colmap"


@app.command(name="map")
# More than six parameters: each is an option or argument of the command.
def build_map(
    scene: Annotated[
        Path | None, typer.Argument(metavar="SCENE", help="Scene to map.", show_default=False)
    ] = None,
    method: Annotated[
        MapMethod,
        typer.Option(
            help="Triangulate points with the scene's poses, or run structure from motion and "
            "align its result to these poses."
        ),
    ] = MapMethod.TRIANGULATE,
    ortho: Orthophoto = None,
    dsm: SurfaceModel = None,
    out: Annotated[
        Path | None, typer.Option(metavar="SCENE", help="Folder of the orthophoto's scene.")
    ] = None,
    undulation: Undulation = None,
    altitude: Altitude = None,
    overlap: Overlap = None,
    tilt: Tilt = None,
    georeference: HorizontalSigma = None,
    georeference_height: VerticalSigma = None,
    cluster: ClusterAddress = None,
    as_json: Json = False,
) -> None:
    """Build the sparse map of a scene, or of an orthophoto with a surface model.

    The map of a scene is built from its sessions of role map and measured against the true poses.
    Localization needs it; run this command after simulate. With --ortho, virtual photographs are
    rendered from the orthophoto and become a new scene with its map.
    """
    from objconnect.mapping.build import build_map as run

    views = {"altitude": altitude, "overlap": overlap, "tilt": tilt}
    accuracy = {"georeference": georeference, "georeference-height": georeference_height}
    if ortho is None:
        others = {"dsm": dsm, "out": out, "undulation": undulation, **views, **accuracy}
        for name, value in others.items():
            if value is not None:
                raise InputError(f"--{name} describes the map of an orthophoto: give --ortho too")
        if scene is None:
            raise InputError("give the SCENE to map, or --ortho, --dsm and --out")
        emit(run(scene, method.value, cluster), as_json)
        return
    if scene is not None:
        raise InputError("--ortho makes a new scene in --out: leave SCENE out")
    if dsm is None or out is None:
        raise InputError("--ortho needs --dsm and --out: give both")
    from objconnect.ingestion.virtual.options import ViewOptions
    from objconnect.mapping.orthophoto import map_orthophoto

    virtual, report = map_orthophoto(
        ortho,
        dsm,
        out,
        undulation=undulation,
        options=ViewOptions.model_validate({k: v for k, v in views.items() if v is not None}),
        georeference=_stated_accuracy(georeference, georeference_height),
        method=method.value,
        cluster=cluster,
    )
    summary = {"virtual": virtual.as_dict(), **report.as_dict()}
    emit(Summary(f"{virtual.text()}\n{report.text()}", summary), as_json)


def _stated_accuracy(horizontal_m: float | None, vertical_m: float | None) -> Georeference | None:
    """Return the absolute accuracy of an orthophoto's files; None if it is not stated."""
    from objconnect.scene.bundle.georeference import Georeference

    if horizontal_m is not None:
        return Georeference(horizontal_m=horizontal_m, vertical_m=vertical_m, source="stated")
    if vertical_m is not None:
        raise InputError("--georeference-height needs --georeference: give both")
    return None


@app.command()
def landmarks(
    scene: MappedScene,
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Weights of an object-connect network with a detector of objects.",
            show_default="the shipped ones",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Table of the objects to write: positions, sizes."),
    ] = None,
    device: DeviceName = "auto",
    as_json: Json = False,
) -> None:
    """Find the objects in a map: cars, trees, roofs, lamps and the like.

    A network detects the objects; they have no class. Each is seen in several photographs and has a
    position, a size, a height above ground and a descriptor. Writes SCENE/landmarks.h5, which view
    draws. The localizer objconnect finds them by itself and does not need the file.
    """
    from objconnect.network.scene_landmarks import find_landmarks as run

    emit(run(scene, weights, out, device), as_json)


@app.command()
# More than six parameters: each is an option or argument of the command.
def dense(
    scene: MappedScene,
    size: Annotated[
        int,
        typer.Option(
            help="Longer side of a depth map, pixels; photographs are never enlarged.", min=64
        ),
    ] = 1024,
    sources: Annotated[
        int,
        typer.Option(help="Largest number of photographs to match each photograph with.", min=2),
    ] = 6,
    stereo: Annotated[
        Stereo,
        typer.Option(
            help="PatchMatch stereo of this project, or of COLMAP (needs pycolmap with CUDA)."
        ),
    ] = Stereo.OWN,
    seed: Annotated[
        int, typer.Option(help="Random seed; the same seed gives the same depth maps.", min=0)
    ] = 0,
    cluster: ClusterAddress = None,
    device: DeviceName = "auto",
    as_json: Json = False,
) -> None:
    """Estimate depth maps of a map's photographs and fuse them into a point cloud.

    Writes SCENE/dense as a COLMAP workspace and measures it against the true depths where the scene
    has them. An interrupted run goes on where it stopped.
    """
    from objconnect.mapping.dense.command import dense as run

    report = run(
        scene,
        size=size,
        sources=sources,
        stereo=stereo.value,
        seed=seed,
        cluster=cluster,
        device=device,
    )
    emit(report, as_json)


@app.command()
def diagnose(
    scene: MappedScene,
    masks: Masks = None,
    cell: Annotated[
        float,
        typer.Option(
            help="Side of the ground cells in which points are counted, metres.",
            min=0.1,
            max=10_000,
        ),
    ] = 5.0,
    as_json: Json = False,
) -> None:
    """Report which objects in a map's photographs have points in the map.

    Also reports how many points each has, how far they lie from the true surface, and how evenly
    they cover the ground. Draws SCENE/pictures/diagnosis.png. If supplement added points, also
    reports and shows the map without them.
    """
    from objconnect.mapping.diagnosis.command import diagnose as run

    emit(run(scene, masks, cell), as_json)


@app.command()
def supplement(
    scene: MappedScene,
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Weights of an object-connect network, whose object centres are tried as points "
            "too. By default points come from the photographs alone.",
        ),
    ] = None,
    masks: Masks = None,
    remove: Annotated[
        bool,
        typer.Option("--remove", help="Remove the added points again."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Add points on small standing objects that have none in the map.

    Lists the new points in SCENE/map/supplement.json; another run replaces them. Nothing else in
    the map changes. Draws SCENE/pictures/diagnosis.png and reports figures of the map with and
    without the points.
    """
    from objconnect.mapping.supplement.command import supplement as run
    from objconnect.mapping.supplement.map import remove_from_map

    if remove:
        if weights is not None or masks is not None:
            raise InputError("--remove takes no other option: leave out --weights and --masks")
        removed = remove_from_map(scene)
        emit(Summary(f"{removed} points removed from the map", {"removed": removed}), as_json)
        return
    emit(run(scene, weights, masks), as_json)
