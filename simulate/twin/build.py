"""Build a real site for rendering from its rasters: surface, ground, classes, albedo and snow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.geo.rasters import Raster
from objconnect.scene.geometry.geodesy import Geodetic
from simulate.look.conditions import condition
from simulate.look.ground import srgb
from simulate.look.sun import sun_position
from simulate.place.site_files import make_ground
from simulate.place.world import MIRRORED_M, Heightfield, Imagery, World
from simulate.twin.albedo import blur_walls, estimate_albedo, soften_shadows
from simulate.twin.classes import NAMES, apply_mask, classify
from simulate.twin.options import SiteConfig, file_digests
from simulate.twin.photographs import Photograph, sample_photographs
from simulate.twin.report import SiteReport
from simulate.twin.sampling import (
    Cells,
    inner_half_side,
    outer_half_side,
    sample_colours,
    sample_heights,
    sample_labels,
)
from simulate.twin.snow import snow_share
from simulate.twin.source import SiteRasters, open_rasters
from simulate.twin.terrain import close_holes, drop_islands, estimate_ground, find_sunlit, levelness

Float = NDArray[np.float32]

# Maximum sizes and minimum spacings of texture and surface; larger places have wider spacings.
_MAX_TEXELS, _MIN_TEXEL_M = 6144, 0.05
_MAX_NODES, _MIN_SPACING_M = 1601, 0.2
_NOTED_SHARE = 0.005  # a larger share of holes is noted in the report
_MIN_SUN_DEG = 3.0  # minimum elevation of the sun to locate shadows


class _Grids(NamedTuple):
    """The grids of a place: nodes of the surface, and texels of the texture."""

    nodes: Cells
    texels: Cells
    margin_m: float


def build_site(
    site: SiteConfig, side_m: float, origin: Geodetic, seed: int, temporary_root: Path
) -> tuple[World, SiteReport]:
    """Build the world of a site.

    Args:
        site: Files of the site.
        side_m: Side of the place, metres.
        origin: Origin of the world, at the centre of the place.
        seed: Random seed of snow and puddles.
        temporary_root: Folder in which temporary files are written.

    Raises:
        InputError: A file cannot be used or has changed, rasters do not overlap, or too much of the
            place has no data.
    """
    digests = file_digests(site.model_dump())
    if digests != site.sha256:
        changed = sorted({name for name, _ in digests.items() ^ site.sha256.items()})
        raise InputError(
            f"{', '.join(changed)} of the site has changed since the scene was configured: restore "
            "the file"
        )
    with open_rasters(site, temporary_root) as files:
        return _build(site, files, side_m, origin, seed)


def _build(
    site: SiteConfig, files: SiteRasters, side_m: float, origin: Geodetic, seed: int
) -> tuple[World, SiteReport]:
    grids = _grids(files, side_m, origin)
    surface = sample_heights(files.heights, origin, grids.nodes, site.undulation)
    surface = drop_islands(surface, grids.nodes.spacing_m)
    rgb = sample_colours(files.colours, origin, grids.texels)
    n, texel_m = len(rgb), grids.texels.spacing_m
    closed_share = _check_holes(
        surface, grids.nodes, grids.margin_m, site.max_missing_heights, "surface model"
    )
    surface, closed = close_holes(surface, grids.nodes.spacing_m)
    texel_heights = _interpolate(surface, n)
    rgb = _fill_from_photographs(rgb, texel_heights, grids.texels, files.photographs)
    hole_share = _check_holes(
        rgb[..., 0], grids.texels, grids.margin_m, site.max_missing_colours, "orthophoto"
    )
    rgb, _ = close_holes(rgb, texel_m)
    bare_ground = estimate_ground(surface, grids.nodes.spacing_m)
    unknown = _interpolate(closed.astype(np.float32), n) > 0.5
    classes = classify(rgb, texel_heights, _interpolate(bare_ground, n), texel_m, unknown)
    if site.classes is not None:
        mask = sample_labels(Raster.open(site.classes, "class mask"), origin, grids.texels)
        classes = apply_mask(mask, classes)
    report = SiteReport(
        texel_m=round(texel_m, 4),
        spacing_m=round(grids.nodes.spacing_m, 4),
        margin_m=round(grids.margin_m, 2),
        closed=round(closed_share, 4),
        holes=round(hole_share, 4),
        classes={name: round(float((classes == k).mean()), 4) for k, name in NAMES.items()},
    )
    albedo, report = _albedo(site, files, origin, (rgb, texel_heights, classes), report)
    above_ground = texel_heights - _interpolate(bare_ground, n)
    snow = snow_share(surface, grids.nodes.spacing_m, classes, above_ground, albedo, texel_m)
    world = World(
        seed=seed,
        side_m=float(side_m),
        terrain=Heightfield(surface.astype(float), grids.nodes.spacing_m),
        roads=(),
        ground=make_ground(classes, texel_m),
        objects=(),
        imagery=Imagery(srgb(albedo), np.rint(255 * snow).astype(np.uint8), site.season),
        bare_ground=Heightfield(bare_ground.astype(float), grids.nodes.spacing_m),
        margin_m=grids.margin_m,
        level_m=float(np.median(bare_ground)),
    )
    return world, report.model_copy(update={"notes": _notes(files, report)})


def _grids(files: SiteRasters, side_m: float, origin: Geodetic) -> _Grids:
    """Choose the grids of a place, with a margin around it where the rasters have data."""
    rasters = (files.colours, files.heights)
    known_m = inner_half_side(rasters, origin)
    if known_m <= 0:
        raise InputError(
            f"{files.colours.path.name} and {files.heights.path.name} do not both show the origin "
            f"at latitude {origin.latitude:.5f}, longitude {origin.longitude:.5f}: give rasters of "
            "that place, or leave the origin out"
        )
    if files.photographs:  # beyond the rasters, photographs give colours
        known_m = outer_half_side(files.colours, origin)
    margin_m = float(np.clip(known_m - 0.5 * side_m, 0.0, MIRRORED_M))
    half_m = 0.5 * side_m + margin_m
    pixel, height_pixel = max(files.colours.grid.ground_pixel), max(files.heights.grid.ground_pixel)
    texels = round(2 * half_m / max(pixel, _MIN_TEXEL_M, 2 * half_m / _MAX_TEXELS))
    spacing_m = max(height_pixel, _MIN_SPACING_M, 2 * half_m / (_MAX_NODES - 1))
    nodes = round(2 * half_m / spacing_m) + 1
    half_texel = half_m / texels
    height = _surface_height(files.heights, origin)
    return _Grids(
        Cells(np.linspace(-half_m, half_m, nodes), height),
        Cells(np.linspace(-half_m + half_texel, half_m - half_texel, texels), height),
        margin_m,
    )


def _surface_height(raster: Raster, origin: Geodetic) -> float:
    """Return the approximate height of the surface above the origin, metres."""
    box = raster.grid.box
    coarse = raster.patch(box, raster.grid.longer_side_m / 32).values
    known = coarse[np.isfinite(coarse)]
    return float(np.median(known)) - origin.altitude if known.size else 0.0


def _check_holes(values: Float, cells: Cells, margin_m: float, limit: float, what: str) -> float:
    """Return the share of the place without data in a raster, not counting the margin.

    Raises:
        InputError: The share is larger than ``limit``.
    """
    inside = np.abs(cells.axis) <= -cells.axis[0] - margin_m
    share = float((~np.isfinite(values[np.ix_(inside, inside)])).mean())
    if share > limit:
        raise InputError(
            f"{100 * share:.0f} % of the place have no data in the {what}, at most "
            f"{100 * limit:.0f} % are allowed: choose a smaller --area, or photograph "
            "more of it"
        )
    return share


def _fill_from_photographs(
    rgb: Float, texel_heights: Float, cells: Cells, photographs: Sequence[Photograph]
) -> Float:
    """Fill holes of the colours (n, n, 3) from photographs.

    The heights (n, n) are interpolated in such holes, so that objects appear flat there.
    """
    rows, columns = np.nonzero(~np.isfinite(rgb[..., 0]))
    if not photographs or not len(rows):
        return rgb
    x, y, z = cells.axis[columns], cells.axis[rows], texel_heights[rows, columns]
    filled = rgb.copy()
    filled[rows, columns] = sample_photographs(photographs, np.stack([x, y, z], -1).astype(float))
    return filled


def _interpolate(values: Float, n: int) -> Float:
    """Interpolate values at nodes (m, m) to the texels (n, n) between them."""
    m = len(values)
    at = ((np.arange(n, dtype=np.float32) + 0.5) / n * (m - 1)).astype(np.float32)
    x, y = np.meshgrid(at, at)
    return np.asarray(cv2.remap(values, x, y, cv2.INTER_LINEAR))


def _albedo(
    site: SiteConfig,
    files: SiteRasters,
    origin: Geodetic,
    layers: tuple[Float, Float, NDArray[np.uint8]],
    report: SiteReport,
) -> tuple[Float, SiteReport]:
    """Return the albedo of a place with softened shadows; ``layers``: colours, heights, classes."""
    rgb, surface, classes = layers
    albedo = estimate_albedo(rgb, condition(f"{site.season}-noon", origin), site.albedo)
    albedo = blur_walls(albedo, levelness(surface, report.texel_m), report.texel_m)
    if files.taken is None:
        return albedo, report
    sun = sun_position(files.taken, origin)
    if sun.elevation < _MIN_SUN_DEG:
        return albedo, report
    lit = find_sunlit(surface, report.texel_m, sun.azimuth, sun.elevation)
    albedo, gain = soften_shadows(albedo, classes, lit, report.texel_m)
    shadows = {
        "sun": (round(sun.azimuth, 2), round(sun.elevation, 2)),
        "shade": round(1 - float(lit.mean()), 4),
        "gain": round(gain, 3),
    }
    return albedo, report.model_copy(update=shadows)


def _notes(files: SiteRasters, report: SiteReport) -> tuple[str, ...]:
    notes = list(files.notes)
    if report.closed > _NOTED_SHARE:
        notes.append(
            f"closed: {100 * report.closed:.1f} % of the place had no height and were interpolated"
        )
    if report.holes > _NOTED_SHARE:
        notes.append(
            f"holes: {100 * report.holes:.1f} % of the place had no colours and were interpolated"
        )
    if report.sun is None:
        notes.append(
            "shadows of the orthophoto remain, because the sun was too low or the time of its "
            "photographs is unknown: give it by --taken"
        )
    return tuple(notes)
