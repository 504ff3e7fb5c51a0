"""The command ``forecast``, which predicts where along a flight a method finds fixes, by season."""

from __future__ import annotations

import json
from pathlib import Path

from benchmark.forecasting.calibration import UNCALIBRATED, Calibration, calibration_of
from benchmark.forecasting.config import ForecastConfig
from benchmark.forecasting.observe import observe, start_of
from benchmark.forecasting.outlook import geojson, seasons_of, waypoints_of
from benchmark.forecasting.page import MARK, page
from benchmark.forecasting.picture import draw, ground_from_above
from benchmark.forecasting.report import SCHEMA, Forecast, request_photographs
from benchmark.forecasting.views import route_of, views_config
from objconnect.localization.provenance import Environment, Method
from objconnect.scene.bundle.manifest import read_json
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Localizer
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.leftovers import remove_partial
from objconnect.scene.storage.locks import write_lock
from objconnect.scene.storage.outputs import OutputFile, check_outputs
from objconnect.scene.storage.provenance import PNG_MARK
from objconnect.scene.storage.scratch import cache_or_scratch, scratch
from simulate.base_place import base_place
from simulate.command import simulate
from simulate.config import SimulateConfig
from simulate.flight.config import PlanFlight
from simulate.twin.report import REPORT, SiteReport

VIEWS = "views"
"""Folder of the rendered views, a scene."""

_USUAL = ForecastConfig()
_GEOJSON, _PICTURE, _PAGE, _REPORT = (
    f"forecast.{ending}" for ending in ("geojson", "png", "html", "json")
)


# More than six parameters: they are the options of the command ``forecast``.
def forecast(
    scene: Path,
    flight: str,
    localizer: Localizer,
    out: Path,
    config: ForecastConfig = _USUAL,
    *,
    twin: Path | None = None,
    cache: Path | None = None,
    jobs: int = 1,
) -> Forecast:
    """Forecast the fixes of a flight and write ``OUT/forecast.json``, .geojson, .png and .html.

    Views of the site's twin are rendered at every waypoint in every season into ``OUT/views``, and
    are localized in the map of the scene. An interrupted run goes on where it stopped, and a second
    method reuses the views.

    Args:
        scene: scene with its map; without ``twin`` the map's photographs need depth maps.
        flight: "plan=FILE" (a plan of QGroundControl), or a flight of ``simulate``, as "nadir".
        localizer: method to run.
        out: folder of the forecast.
        config: options.
        twin: finished twin of the site; None builds one from the scene.
        cache: folder for what the method keeps per map; None for a scratch folder.
        jobs: number of rendering processes.

    Raises:
        InputError: the scene has no map, the flight lies outside it or has no waypoints, the twin
            is of another site, or ``out`` cannot be written.
    """
    opened = Scene.open(scene)
    start_of(config.start)
    sparse_map = opened.sparse_map()
    opened_twin = None if twin is None else Scene.open(twin)
    views = views_config(opened, sparse_map, flight, config, opened_twin)
    _check_outputs(out, scene, twin)
    with scratch(cache):
        pass  # fails if the cache cannot be written, before an hour of rendering
    with write_lock(out):
        remove_partial(out)  # leftovers of a killed run
        rendered = simulate(views, out / VIEWS, jobs, twin=twin)
        with cache_or_scratch(cache, out) as kept:
            observations = observe(opened, rendered, localizer, config, kept)
        route = route_of(views, out / VIEWS)
        calibration = _calibration(localizer, config.calibrated)
        waypoints = waypoints_of(observations, route, views.origin, config, calibration)
        first = views.sessions[0].flight
        report = Forecast(
            scene=opened.name,
            scene_sha256=sparse_map.sha256,
            flight=first.file.name if isinstance(first, PlanFlight) else flight,
            flight_sha256=first.sha256 if isinstance(first, PlanFlight) else None,
            twin=None if opened_twin is None else opened_twin.name,
            method=Method.of(localizer),
            config=config,
            calibration=calibration,
            environment=Environment.current(),
            notes=_notes(out, views, localizer, calibration.queries),
            seasons=seasons_of(waypoints, config),
            waypoints=waypoints,
            photographs=request_photographs(waypoints, config),
            views=tuple(o.model_dump(mode="json") for o in observations),
        )
        _write(report, views, out)
    return report


def _calibration(localizer: Localizer, wanted: bool) -> Calibration:
    """Return the calibration of a method, which holds for its default configuration only."""
    if localizer.config == type(localizer.config)():
        return calibration_of(localizer.name, wanted)
    return UNCALIBRATED


def _check_outputs(out: Path, scene: Path, twin: Path | None) -> None:
    """Refuse outputs that would replace or change other files.

    Raises:
        InputError: as for ``check_outputs``, or ``out`` lies in an input.
    """
    for folder in (scene, twin):
        if folder is not None and out.resolve().is_relative_to(folder.resolve()):
            raise InputError(f"{out} lies in {folder}: choose a folder outside it")
    outputs = [
        OutputFile(out / _REPORT, SCHEMA.encode()),
        OutputFile(out / _GEOJSON, b"objconnect forecast"),
        OutputFile(out / _PICTURE, PNG_MARK),
        OutputFile(out / _PAGE, MARK),
    ]
    check_outputs(outputs, [path for path in (scene, twin) if path is not None])


def _notes(
    out: Path, views: SimulateConfig, localizer: Localizer, calibrated_on: int
) -> tuple[str, ...]:
    """Return notes on the twin and on the probabilities."""
    report = read_json(out / VIEWS / REPORT, SiteReport, "report of the site")
    notes = list(report.notes)
    if not calibrated_on:
        notes.append(
            f"{localizer.name} is not calibrated with these settings: probabilities are the "
            "smoothed shares of localized views of the twin"
        )
    longest = max(views.photo_camera().width, views.photo_camera().height)
    notes.append(f"views have {longest} pixels on their longer side")
    return tuple(notes)


def _write(report: Forecast, views: SimulateConfig, out: Path) -> None:
    """Write all files; the report is the last."""
    world, _ = base_place(views, out / VIEWS)
    ground = ground_from_above(world)
    draw(report, ground, views.area, out / _PICTURE)
    write_text(out / _PAGE, page(report, ground, views.area))
    features = geojson(report.waypoints, report.seasons)
    write_text(out / _GEOJSON, json.dumps(features, indent=1, allow_nan=False) + "\n")
    write_text(out / _REPORT, report.model_dump_json(indent=1) + "\n")
