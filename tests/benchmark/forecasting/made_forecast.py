"""Observations and reports of a made flight of five waypoints, 30 m apart to the east."""

from __future__ import annotations

import numpy as np

from benchmark.forecasting.calibration import UNCALIBRATED
from benchmark.forecasting.config import ForecastConfig
from benchmark.forecasting.observe import Observation
from benchmark.forecasting.outlook import seasons_of, waypoints_of
from benchmark.forecasting.report import Forecast, request_photographs
from objconnect.localization.provenance import Environment, Method
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.localizer import Status

ORIGIN = Geodetic(47.0, 8.0, 450.0)
CENTRES = np.array([(30.0 * k - 60.0, 10.0, 70.0) for k in range(5)])
CONFIG = ForecastConfig(seasons=("summer-noon", "snow-dusk"), views=2, gap_m=50.0)
POINTS = (200, 200, 3, 2, 200)
# In snow, the last three are not found; waypoint 3 answers falsely once.
LOST = (2, 3, 4)


def observation(season: str, waypoint: int, view: int = 0, **more: object) -> Observation:
    """A view that was found, but for what is said."""
    told: dict[str, object] = {
        "name": f"{season}-{view + 1}/images/{waypoint:06d}.jpg",
        "season": season,
        "view": view,
        "waypoint": waypoint,
        "status": Status.OK,
        "t_err_m": 0.1,
        "r_err_deg": 0.1,
        "h_err_m": 0.08,
        "v_err_m": 0.06,
        "sigma_across_m": 0.2,
        "sigma_up_m": 0.1,
        "inliers": 80,
        "points": POINTS[waypoint],
    }
    return Observation.model_validate(told | more)


def observations() -> list[Observation]:
    made = []
    for season in CONFIG.seasons:
        for view in range(CONFIG.views):
            for waypoint in range(len(CENTRES)):
                lost = season == "snow-dusk" and waypoint in LOST
                false = lost and (waypoint, view) == (2, 1)
                more: dict[str, object] = {}
                if false:
                    more = {"t_err_m": 30.0, "inliers": 9}
                elif lost:
                    more = dict.fromkeys(
                        (
                            "t_err_m",
                            "r_err_deg",
                            "h_err_m",
                            "v_err_m",
                            "sigma_across_m",
                            "sigma_up_m",
                        )
                    )
                    more |= {"status": Status.FAILED, "inliers": 0}
                made.append(observation(season, waypoint, view, **more))
    return made


def report(config: ForecastConfig = CONFIG, scene: str = "hamlet") -> Forecast:
    waypoints = waypoints_of(observations(), CENTRES, ORIGIN, config, UNCALIBRATED)
    return Forecast(
        scene=scene,
        scene_sha256="0" * 64,
        flight="route.plan",
        flight_sha256=None,
        twin=None,
        method=Method(name="sift", config={}, weights_sha256=None),
        config=config,
        calibration=UNCALIBRATED,
        environment=Environment.current(),
        notes=("holes: 1.2 % of the place had no data",),
        seasons=seasons_of(waypoints, config),
        waypoints=waypoints,
        photographs=request_photographs(waypoints, config),
        views=tuple(o.model_dump(mode="json") for o in observations()),
    )
