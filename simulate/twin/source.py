"""Open the source of a real site: two GeoTIFFs, or a scene whose depth is fused into such files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.exports import ortho
from objconnect.scene.geo.local_coordinates import move_to_height
from objconnect.scene.geo.rasters import Raster
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.storage.scratch import scratch
from simulate.twin.options import MIN_SITE_SIDE_M, SiteConfig
from simulate.twin.photographs import Photograph, covered_square, map_photographs
from simulate.twin.sampling import inner_half_side

_MIN_PHOTOGRAPHS = 8  # minimum number of photographs of a site
# Photographs lie on one line if their extent across it is below this share of the extent along it.
_THIN_SHARE = 0.12
_GROUND_CELLS = 64  # cells along a side of the grid whose median is the height of the ground
_MAX_SIDE_M = 2000.0  # maximum side of a site if it is derived from rasters or photographs


class SiteRasters(NamedTuple):
    """The rasters of a site.

    Attributes:
        colours: orthophoto.
        heights: surface model.
        taken: time of the photographs, if known.
        photographs: map photographs, if the site is a scene.
        notes: remarks for the user.
    """

    colours: Raster
    heights: Raster
    taken: datetime | None
    photographs: tuple[Photograph, ...] = ()
    notes: tuple[str, ...] = ()


class Extent(NamedTuple):
    """The origin of a site's world, and the side of the square site around it, metres."""

    origin: Geodetic
    side_m: float


@contextmanager
def open_rasters(site: SiteConfig, temporary_root: Path) -> Iterator[SiteRasters]:
    """Open the rasters of a site. The rasters of a scene are fused into a temporary folder.

    Raises:
        InputError: A raster cannot be used, or the scene has too few photographs or no depth.
    """
    if site.scene is None:
        colours, heights = _rasters(site)
        stated = site.undulation or None
        notes = (*colours.notes(colours.grid.middle), *heights.notes(heights.grid.middle, stated))
        yield SiteRasters(colours, heights, site.taken, notes=notes)
        return
    scene = Scene.open(site.scene)
    notes, taken = _check_photographs(scene)
    with scratch(temporary_root) as folder:
        sessions = {name: scene.frames(name) for name in scene.sessions}
        ortho.write(scene, sessions, folder, folder)
        colours = Raster.open(folder / ortho.ORTHOPHOTO, "orthophoto")
        heights = Raster.open(folder / ortho.SURFACE, "surface model")
        photographs = tuple(map_photographs(scene))
        yield SiteRasters(colours, heights, site.taken or taken, photographs, notes)


def measure_extent(site: SiteConfig, has_side: bool = False) -> Extent:
    """Return the origin of a site and the side of its square.

    A scene keeps its origin. Two rasters have their origin on the ground, at the centre of their
    common area.

    Args:
        site: Files of the site.
        has_side: Whether the configuration states the side, so that a small common area is allowed.

    Raises:
        InputError: The rasters cannot be used or do not overlap, or the site is too small.
    """
    if site.scene is not None:
        scene = Scene.open(site.scene)
        return Extent(scene.manifest.origin, _side(scene))
    colours, heights = _rasters(site)
    origin = _middle(colours, heights, site.undulation)
    side_m = 2 * inner_half_side((colours, heights), origin)
    if side_m < MIN_SITE_SIDE_M and not has_side:
        raise InputError(
            f"{site.ortho} and {site.dsm} have a square of {max(side_m, 0):.0f} m in common, a "
            f"site needs {MIN_SITE_SIDE_M:.0f} m: give larger files"
        )
    return Extent(origin, float(min(np.floor(side_m), _MAX_SIDE_M)))


def _rasters(site: SiteConfig) -> tuple[Raster, Raster]:
    assert site.ortho is not None and site.dsm is not None
    return Raster.open(site.ortho, "orthophoto"), Raster.open(site.dsm, "surface model")


def _middle(colours: Raster, heights: Raster, undulation: float) -> Geodetic:
    """Return the centre of the common area of two rasters, on the ground."""
    box = heights.grid.box
    coarse = heights.patch(box, heights.grid.longer_side_m / _GROUND_CELLS).values
    known = coarse[np.isfinite(coarse)]
    if not known.size:
        raise InputError(f"surface model {heights.path} has no height: give another file")
    height = float(np.median(known))
    corners = [(x, y, height) for x in (box.left, box.right) for y in (box.bottom, box.top)]
    colour_crs, height_crs = colours.grid.projection, heights.grid.projection
    at = np.array(
        [colour_crs.from_geodetic(height_crs.to_geodetic(np.array(corner))) for corner in corners]
    )
    colour_box = colours.grid.box
    low = np.maximum(at.min(0)[:2], [colour_box.left, colour_box.bottom])
    high = np.minimum(at.max(0)[:2], [colour_box.right, colour_box.top])
    if (low >= high).any():
        raise InputError(
            f"{colours.path} and {heights.path} do not overlap: give files of one place"
        )
    middle = colour_crs.to_geodetic(np.array([*(low + high) / 2, height]))
    return move_to_height(height_crs, middle, height + undulation)


def _side(scene: Scene) -> float:
    """Return the recorded side of the site, or the side of the square that photographs cover."""
    recorded_side = scene.manifest.config.get("area")
    if isinstance(recorded_side, int | float):
        return float(recorded_side)
    photographs = map_photographs(scene)
    if not photographs:
        raise InputError(f"no photograph of {scene.path} belongs to its map: build a map of it")
    points = scene.sparse_map().xyz
    if not len(points):
        raise InputError(f"the map of {scene.path} has no points: build it again")
    max_side_m = min(2 * float(np.abs(points[:, :2]).max()), _MAX_SIDE_M)
    side_m = covered_square(photographs, float(np.median(points[:, 2])), max_side_m)
    if side_m < MIN_SITE_SIDE_M:
        raise InputError(
            f"at least two photographs of {scene.path} see a square of {side_m:.0f} m around its "
            f"origin, a site needs {MIN_SITE_SIDE_M:.0f} m: photograph more of it"
        )
    return float(np.floor(side_m))


def _check_photographs(scene: Scene) -> tuple[tuple[str, ...], datetime | None]:
    """Return notes on the photographs of a map, and their median time.

    Raises:
        InputError: There are too few photographs.
    """
    centres = np.array([photograph.centre for photograph in map_photographs(scene)])
    if len(centres) < _MIN_PHOTOGRAPHS:
        raise InputError(
            f"{scene.path} has {len(centres)} photographs in its map, a site needs "
            f"{_MIN_PHOTOGRAPHS}: photograph more of it"
        )
    extents = np.linalg.svd(centres[:, :2] - centres[:, :2].mean(0), compute_uv=False)
    notes = []
    if extents[1] < _THIN_SHARE * extents[0]:
        notes.append(
            "thin coverage: the photographs lie along one line, so surfaces beside it are seen "
            "from one side only"
        )
    mapped = set(scene.splits.map)
    times = [
        float(time)
        for session in scene.sessions
        for name, time in zip(scene.frames(session).names, scene.frames(session).time, strict=True)
        if name in mapped and np.isfinite(time)
    ]
    taken = datetime.fromtimestamp(float(np.median(times)), UTC) if times else None
    return tuple(notes), taken
