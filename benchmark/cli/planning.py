"""The command that forecasts where along a planned flight a method localizes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli.arguments import check_folders, parse_settings
from benchmark.cli.options import Cache, Jobs, Json, Method, Settings, Start
from benchmark.cli.output import emit
from objconnect.scene.errors import InputError

app = typer.Typer(rich_markup_mode=None)


FlightMap = Annotated[Path, typer.Option("--map", metavar="SCENE", help="Scene with its map.")]
Folder = Annotated[
    Path,
    typer.Option(
        metavar="FOLDER", help="Folder for forecast.html, .geojson, .png, .json and the views."
    ),
]
Plan = Annotated[Path | None, typer.Option(metavar="FILE", help="Mission plan of QGroundControl.")]
Flight = Annotated[
    str | None,
    typer.Option(
        metavar="FLIGHT",
        help="Flight pattern of simulate instead of --plan: nadir, grid, oblique or corridor.",
    ),
]
Seasons = Annotated[
    list[str] | None,
    typer.Option(
        metavar="SEASON-LIGHT[-WEATHER]",
        help="Condition to forecast, such as snow-dusk; repeat the option for several.",
        show_default="summer-noon, winter-noon, snow-dusk",
    ),
]
Twin = Annotated[
    Path | None,
    typer.Option(
        metavar="TWIN",
        help="Finished rendered copy of the site (simulate --preset site). By default it is built "
        "from SCENE, whose photographs then need depth maps.",
    ),
]
Views = Annotated[
    int | None,
    typer.Option(
        help="Number of views to render at each waypoint in each season.",
        min=1,
        max=50,
        show_default="2",
    ),
]


@app.command()
# More than six parameters: each is an option or argument of the command.
def forecast(
    scene: FlightMap,
    out: Folder,
    plan: Plan = None,
    flight: Flight = None,
    season: Seasons = None,
    method: Method = "sift",
    twin: Twin = None,
    start: Start = "prior",
    views: Views = None,
    overrides: Settings = None,
    cache: Cache = None,
    jobs: Jobs = 1,
    as_json: Json = False,
) -> None:
    """Forecast where along a flight a method finds a fix, by season and light.

    By default a fix is an answer within 0.5 m and 5 degrees. Renders views of a copy of the site
    (its twin) at every waypoint, localizes them in the map of SCENE, and writes for each waypoint
    and season the probability of a fix, the expected sigmas and the risk of a false fix (an answer
    wrong by more than 5 m or 10 degrees): as a page, a picture, GeoJSON and JSON. An interrupted
    run goes on where it stopped.
    """
    from benchmark.forecasting.command import forecast as run
    from benchmark.forecasting.config import forecast_config, forecast_hint
    from objconnect.methods import create

    if (plan is None) == (flight is None):
        raise InputError("give the flight with --plan FILE, or with --flight")
    options = {"seasons": season or None, "views": views, "start": start}
    settings = parse_settings(overrides)
    config = forecast_config(settings, {k: v for k, v in options.items() if v is not None})
    try:
        localizer = create(method, settings)
    except InputError as error:
        raise InputError(f"{error}{forecast_hint(settings)}") from None
    check_folders([scene, *([twin] if twin is not None else [])], out, cache)
    route = f"plan={plan}" if plan is not None else str(flight)
    report = run(scene, route, localizer, out, config, twin=twin, cache=cache, jobs=jobs)
    emit(report, as_json)
