"""The views of a forecast: the site's rendered copy (*twin*) along a flight in every season."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from benchmark.forecasting.config import ForecastConfig
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.config import describe
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import MODELS, Camera
from objconnect.scene.geometry.geodesy import is_same_place
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.storage.names import is_utf8
from simulate.base_place import base_place
from simulate.config import SessionConfig, SimulateConfig
from simulate.flight.config import QUERY_PLAN, PlanFlight
from simulate.flight.gimbal import camera_centres
from simulate.flight.qgroundcontrol import read_plan
from simulate.place.presets import SITE
from simulate.planner import plan_session
from simulate.twin.options import SiteConfig

Array = NDArray[np.float64]

# The heights of the origins of a map and its twin differ by at most this, metres.
_ORIGIN_HEIGHT_TOLERANCE_M = 0.1
# Standard deviation of the views' positions from the waypoint per axis (m), and of their attitudes
# (deg).
_DEVIATION_M: Final = 0.7
_DEVIATION_DEG: Final = 1.5
# A flight with more waypoints is refused, because its views would take hours to render.
# ``_check_plan`` says which flights are not checked.
_MOST_WAYPOINTS: Final = 300
_SECONDS_PER_VIEW: Final = 3  # rough estimate of the rendering time


def views_config(
    scene: Scene, sparse_map: SparseMap, flight: str, config: ForecastConfig, twin: Scene | None
) -> SimulateConfig:
    """Return the configuration of the scene that holds all views.

    A session is one view of every waypoint in one season, and is called SEASON-NUMBER. The first
    session has the role "map", because every scene needs a session of this role.

    Args:
        scene: the scene of the map.
        sparse_map: its map.
        flight: the flight, as in a session of ``simulate``, such as "plan=FILE" or "nadir".
        config: options of the forecast.
        twin: a finished twin; None builds one from ``scene``.

    Raises:
        InputError: the flight, a season or the site cannot be used.
    """
    if not is_utf8(flight):
        raise InputError(f"flight {for_terminal(flight)}: its name is not UTF-8: rename the file")
    site: Any = {"scene": scene.path}
    values: dict[str, Any] = {}
    if twin is not None:
        site = _site_of(twin, scene)
        values = {"area": twin.manifest.config["area"], "origin": twin.manifest.origin}
    sessions = [
        {"condition": season, "flight": flight, "role": "query", "name": f"{season}-{view + 1}"}
        for season in config.seasons
        for view in range(config.views)
    ]
    sessions[0]["role"] = "map"
    values |= {
        "preset": SITE,
        "seed": config.seed,
        "frames": config.waypoints,
        "camera": most_common_camera(sparse_map, config.size),
        "site": site,
        "sessions": sessions,
        "map_plan": QUERY_PLAN,
        "position_jitter_m": _DEVIATION_M,
        "attitude_jitter_deg": _DEVIATION_DEG,
    }
    try:
        render_config = SimulateConfig.model_validate(values)
    except ValidationError as error:
        raise InputError(describe(error, SimulateConfig, "forecast")) from None
    _check_plan(render_config, config)
    return render_config


def route_of(render_config: SimulateConfig, folder: Path) -> Array:
    """Return the waypoints (N, 3) of rendered views, which deviate from them, world metres.

    Args:
        render_config: configuration of the views.
        folder: scene of the views.
    """
    world, _ = base_place(render_config, folder)
    exact = render_config.model_copy(update={"position_jitter_m": 0.0, "attitude_jitter_deg": 0.0})
    session = _as_query(exact.sessions[0])
    camera = exact.photo_camera(session)
    poses = plan_session(session, exact, camera, world, np.random.default_rng(0))
    return camera_centres(poses)


def _as_query(session: SessionConfig) -> SessionConfig:
    """Return a session with the role "query"."""
    return session.model_copy(update={"role": "query"})


def most_common_camera(sparse_map: SparseMap, size: int) -> dict[str, Any]:
    """Return the camera of most photographs of a map, at most ``size`` pixels on a side."""
    cameras: list[Camera] = [image.camera for image in sparse_map.images.values()]
    common = max(cameras, key=cameras.count)
    # One scale for both axes, because some models have a single focal length.
    scale = min(1.0, size / max(common.width, common.height))
    lengths = ("f", "fx", "fy", "cx", "cy")
    return {
        "model": common.model,
        "width": max(16, round(scale * common.width)),
        "height": max(16, round(scale * common.height)),
        "params": tuple(
            value * scale if name in lengths else value
            for name, value in zip(MODELS[common.model], common.params, strict=True)
        ),
    }


def _site_of(twin: Scene, scene: Scene) -> SiteConfig:
    """Return the site of a twin.

    Raises:
        InputError: the scene is not a twin, or is the twin of another site than the map's.
    """
    site = twin.manifest.config.get("site")
    if twin.manifest.preset != SITE or site is None:
        raise InputError(
            f"{twin.path} is not the twin of a site: make one with 'simulate --preset site --from "
            f"{scene.path}', or leave --twin out"
        )
    if not is_same_place(twin.manifest.origin, scene.manifest.origin, _ORIGIN_HEIGHT_TOLERANCE_M):
        raise InputError(
            f"{twin.path} is the twin of another site than {scene.path}: their origins differ; "
            "leave --twin out"
        )
    return SiteConfig.model_validate(site)


def _check_plan(render_config: SimulateConfig, config: ForecastConfig) -> None:
    """Check that a mission plan lies inside the site, and that a flight has not too many waypoints.

    A flight that is no mission plan but determines its number of waypoints is not checked.

    Raises:
        InputError: a waypoint of a mission plan lies outside, or a flight has more than
            ``_MOST_WAYPOINTS``.
    """
    session, area = render_config.sessions[0], render_config.area
    flight = session.flight
    count = session.frames or render_config.frames
    if isinstance(flight, PlanFlight):
        aims = read_plan(
            flight.file,
            render_config.origin,
            area,
            lambda x, y: np.zeros(np.shape(x)),
            flight.pitch_deg,
            flight.undulation_m,
        )
        count = len(aims.centres)
        is_outside = np.abs(np.asarray(aims.centres)[:, :2]).max(1) > 0.5 * area
        if is_outside.any():
            raise InputError(
                f"mission plan {flight.file}: photograph {int(np.argmax(is_outside)) + 1} and "
                f"{int(is_outside.sum()) - 1} more lie outside the map's square of "
                f"{area:.0f} m: plan inside it, or map more"
            )
    elif flight.determines_frames:
        return
    if count > _MOST_WAYPOINTS:
        views = count * config.views * len(config.seasons)
        hours = math.ceil(views * _SECONDS_PER_VIEW / 3600)
        raise InputError(
            f"the flight has {count} waypoints, about {hours} h of rendering: trigger less often, "
            f"at most {_MOST_WAYPOINTS} times, or fly the plan in parts"
        )
