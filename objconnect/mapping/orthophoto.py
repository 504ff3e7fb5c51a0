"""Build a scene with its map from an orthophoto and a surface model, or resume a run."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from objconnect.ingestion.virtual.command import (
    VirtualReport,
    open_source,
    remove_views,
    render_views,
)
from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.mapping.build import Method, build_locked
from objconnect.mapping.report import MapReport
from objconnect.scene.bundle.georeference import Georeference
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError, NoPointsError
from objconnect.scene.storage.locks import write_lock
from objconnect.scene.storage.outputs import check_output_folder

_DEFAULTS: Final = ViewOptions()


# More than six parameters: they are options of the command ``map``.
def map_orthophoto(
    orthophoto: Path,
    dsm: Path,
    out: Path,
    *,
    undulation: float | None = None,
    options: ViewOptions = _DEFAULTS,
    georeference: Georeference | None = None,
    method: Method = "triangulate",
    cluster: str | None = None,
) -> tuple[VirtualReport, MapReport]:
    """Render the views of an orthophoto and build their map, or continue an interrupted run.

    Views that are complete are not rendered again. If ``out`` holds the finished scene, its map is
    built again.

    Args:
        orthophoto: as for ``photograph_orthophoto``, and so are ``dsm``, ``undulation``,
            ``options`` and ``georeference``.
        out: new folder, or one left by a run of the same files, options and method.
        method: as for ``build_map``, and so is ``cluster``.

    Raises:
        InputError: for the reasons of ``photograph_orthophoto`` and ``build_map``. If no point can
            be triangulated and ``out`` had no map, what was written is removed.
    """
    source = open_source(orthophoto, dsm, undulation, options, None, georeference, method)
    check_output_folder(out, [orthophoto, dsm])
    with write_lock(out):
        virtual = render_views(source, out)
        scene = Scene.open(out)
        try:
            return virtual, build_locked(scene, method, cluster)
        except NoPointsError:
            if not scene.map_path.exists():  # nothing of use is left, and nothing to continue
                remove_views(out, virtual.views)
            raise InputError(
                f"no point could be triangulated from the {virtual.views} views of {orthophoto}: "
                "its surface shows no texture to match, or they overlap too little; give another "
                "orthophoto or a larger --overlap"
            ) from None
