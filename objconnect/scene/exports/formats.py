"""The registry of export formats; the module of a format is imported on demand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from objconnect.scene.registry import Lazy, Registry

if TYPE_CHECKING:
    from objconnect.scene.bundle.frames import Frames
    from objconnect.scene.bundle.scene import Scene

    Writer = Callable[[Scene, Mapping[str, Frames], Path, Path], None]
    """A function that writes sessions of a scene into an empty folder.

    Its arguments are the scene, the frames of the chosen sessions by name, the folder to write to,
    and the final path of that folder, from which relative paths inside the files start. Options of
    the format follow. It raises InputError for what the format cannot hold.
    """

FORMATS: Final[Registry[Writer]] = Registry(
    "format",
    "objconnect.exports",
    {
        "colmap": Lazy(
            "objconnect.scene.exports.colmap:write", "a model of all poses, with the map's points"
        ),
        "colmap-database": Lazy(
            "objconnect.scene.exports.colmap:write_with_database",
            "as colmap, with the database of the map's features and verified matches",
        ),
        "nerfstudio": Lazy("objconnect.scene.exports.nerfstudio:write", "transforms.json"),
        "nerfstudio-depth": Lazy(
            "objconnect.scene.exports.nerfstudio:write_with_depth", "as nerfstudio, with depth maps"
        ),
        "tum": Lazy("objconnect.scene.exports.tum:write", "a trajectory per session"),
        "hloc": Lazy(
            "objconnect.scene.exports.hloc:write",
            "query list with intrinsics, and pair lists from the covisibility",
        ),
        "hloc-features": Lazy(
            "objconnect.scene.exports.hloc:write_features",
            "features, verified matches and pairs of the map as HDF5",
        ),
        "opensfm": Lazy(
            "objconnect.scene.exports.opensfm:write",
            "reconstruction.json and geo.txt of ODM and OpenSfM",
        ),
        "metashape": Lazy(
            "objconnect.scene.exports.metashape:write", "cameras.xml of Agisoft Metashape"
        ),
        "rerun": Lazy(
            "objconnect.scene.exports.rerun:write", "cameras, trajectories and points as .rrd"
        ),
        "rerun-images": Lazy(
            "objconnect.scene.exports.rerun:write_with_images", "as rerun, with the photographs"
        ),
        "cmu": Lazy(
            "objconnect.scene.exports.cmu:write",
            "the tree of Extended CMU Seasons, with the photographs; a slice each for the urban, "
            "suburban and park part of --preset street",
        ),
        "video": Lazy(
            "objconnect.scene.exports.video:write",
            "an MP4 with DJI's telemetry as SRT for each session, and its poses as text",
        ),
        "ortho": Lazy(
            "objconnect.scene.exports.ortho:write",
            "an orthophoto and a surface model as GeoTIFFs, from exact depth or the depth maps of "
            "the command dense",
        ),
    },
)
