"""Build or load the place (rendered world) of a scene, before its sessions (flights) change it."""

from __future__ import annotations

from pathlib import Path

from objconnect.scene.bundle.manifest import read_json, write_json
from objconnect.scene.errors import InputError
from simulate.config import SimulateConfig
from simulate.place.presets import preset
from simulate.place.site_files import load_site, save_site
from simulate.place.world import World
from simulate.twin.build import build_site
from simulate.twin.report import PLACE_FILE, REPORT_FILE, SiteReport


def check_site(config: SimulateConfig, out: Path, cluster: str | None) -> None:
    """Check that a site, a real place, can be rendered into a folder; other presets pass.

    Raises:
        InputError: The folder lies in the source scene of the site, or a cluster is given.
    """
    if config.site is None:
        return
    if cluster is not None:
        raise InputError("--cluster cannot render a site: leave it out")
    scene = config.site.scene
    if scene is not None and out.resolve().is_relative_to(scene.resolve()):
        raise InputError(f"{out} lies in the scene of the site: choose a folder outside it")


def base_place(
    config: SimulateConfig, out: Path, twin: Path | None = None
) -> tuple[World, SiteReport | None]:
    """Return the place of a scene, and the report of a site that must be written into ``out``.

    The report is None for other presets, and for a site that ``out`` holds already.

    Args:
        config: configuration of the scene.
        out: folder of the scene.
        twin: folder of a finished scene of the same site, whose place is reused.

    Raises:
        InputError: The place cannot be built.
    """
    if config.site is None:
        return preset(config.preset)(config.seed, config.area), None
    if (out / REPORT_FILE).is_file():  # written after the place
        return load_site(out / PLACE_FILE, config.seed), None
    if twin is not None:
        report = read_json(twin / REPORT_FILE, SiteReport, "report of the site")
        return load_site(twin / PLACE_FILE, config.seed), report
    return build_site(config.site, config.area, config.origin, config.seed, out)


def write_site(out: Path, place: World, report: SiteReport) -> None:
    """Write the place and the report of a site into the folder of the scene."""
    save_site(out / PLACE_FILE, place)
    write_json(out / REPORT_FILE, report)


def site_file(config: SimulateConfig, out: Path) -> Path | None:
    """Return the file of a site's place for rendering processes; None for other presets."""
    return None if config.site is None else (out / PLACE_FILE).resolve()
