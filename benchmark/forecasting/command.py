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
from simulate.twin.report import REPORT_FILE, SiteReport

VIEWS = "views"
"""Folder of the rendered views, a scene."""

_DEFAULT_CONFIG = ForecastConfig()
_GEOJSON, _PICTURE, _PAGE, _REPORT = (
    f"forecast.{ending}" for ending in ("geojson", "png", "html", "json")
)


# More than six parameters: they are the options of the command ``forecast``.
def forecast(
    scene: Path,
    flight: str,
    localizer: Localizer,
    out: Path,
    config: ForecastConfig = _DEFAULT_CONFIG,
    *,
    twin: Path | None = None,
    cache: Path | None = None,
    jobs: int = 1,
) -> Forecast:
    """Forecast the fixes of a flight and write ``OUT/forecast.json``, .geojson, .png and .html.

    Views of a copy of the site (*twin*) are rendered at every waypoint in every season into
    ``OUT/views``, and are localized in the map of the scene. An interrupted run goes on where it
    stopped, and a second method reuses the views.

    Args:
        scene: scene with its map; without ``twin`` the map's photographs need depth maps.
        flight: "plan=FILE" (a plan of QGroundControl), or a flight of ``simulate`` such as "nadir".
        localizer: method to run.
        out: folder of the forecast.
        config: options.
        twin: finished twin of the site; None builds one from the scene.
        cache: folder for data that the method keeps per map; None for a scratch folder.
        jobs: number of rendering processes.

    Raises:
        InputError: the scene has no map, the flight lies outside it or has no waypoints, the twin
            is of another site, or ``out`` cannot be written.
    """
    opened_scene = Scene.open(scene)
    start_of(config.start)  # refuses an unknown start, and a list of pairs, which names no view
    sparse_map = opened_scene.sparse_map()
    opened_twin = None if twin is None else Scene.open(twin)
    render_config = views_config(opened_scene, sparse_map, flight, config, opened_twin)
    _check_outputs(out, scene, twin)
    with scratch(cache):
        pass  # fails if the cache cannot be written, before an hour of rendering
    with write_lock(out):
        remove_partial(out)  # leftovers of a killed run
        views = simulate(render_config, out / VIEWS, jobs, twin=twin)
        with cache_or_scratch(cache, out) as cache_folder:
            observations = observe(opened_scene, views, localizer, config, cache_folder)
        route = route_of(render_config, out / VIEWS)
        calibration = _calibration(localizer, config.calibrated)
        waypoints = waypoints_of(observations, route, render_config.origin, config, calibration)
        planned = render_config.sessions[0].flight
        report = Forecast(
            scene=opened_scene.name,
            scene_sha256=sparse_map.sha256,
            flight=planned.file.name if isinstance(planned, PlanFlight) else flight,
            flight_sha256=planned.sha256 if isinstance(planned, PlanFlight) else None,
            twin=None if opened_twin is None else opened_twin.name,
            method=Method.of(localizer),
            config=config,
            calibration=calibration,
            environment=Environment.current(),
            notes=_notes(out, render_config, localizer, calibration.queries),
            seasons=seasons_of(waypoints, config),
            waypoints=waypoints,
            photographs=request_photographs(waypoints, config),
            views=tuple(o.model_dump(mode="json") for o in observations),
        )
        _write(report, render_config, out)
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
    out: Path, render_config: SimulateConfig, localizer: Localizer, calibration_queries: int
) -> tuple[str, ...]:
    """Return notes on the twin and on the probabilities."""
    report = read_json(out / VIEWS / REPORT_FILE, SiteReport, "report of the site")
    notes = list(report.notes)
    if not calibration_queries:
        notes.append(
            f"{localizer.name} is not calibrated with these settings: probabilities are the "
            "smoothed shares of the twin's views with a fix"
        )
    camera = render_config.photo_camera()
    side = max(camera.width, camera.height)
    notes.append(f"views have {side} pixels on their longer side")
    return tuple(notes)


def _write(report: Forecast, render_config: SimulateConfig, out: Path) -> None:
    """Write all files; the report is the last."""
    world, _ = base_place(render_config, out / VIEWS)
    ground = ground_from_above(world)
    draw(report, ground, render_config.area, out / _PICTURE)
    write_text(out / _PAGE, page(report, ground, render_config.area))
    features = geojson(report.waypoints, report.seasons)
    write_text(out / _GEOJSON, json.dumps(features, indent=1, allow_nan=False) + "\n")
    write_text(out / _REPORT, report.model_dump_json(indent=1) + "\n")
