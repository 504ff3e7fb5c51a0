"""The configuration of a simulated scene."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from objconnect.scene.bundle.manifest import Origin
from objconnect.scene.config import Config, load_config
from objconnect.scene.geometry.camera import Camera
from simulate.camera.lens import CameraConfig, cover_by_pinhole
from simulate.camera.sensor import SensorConfig
from simulate.flight.config import (
    MAP_PLAN,
    QUERY_PLAN,
    Flight,
    FlightPlan,
    NadirFlight,
    StreetFlight,
)
from simulate.flight.context import MAX_PHOTOGRAPHS
from simulate.look.conditions import DEFAULT_ORIGIN, condition
from simulate.place.change import Change
from simulate.place.presets import SITE, preset
from simulate.place.tiles import MAX_TILED_SIDE_M
from simulate.render.job import Denoising
from simulate.seeds import MAX_SEED, change_generator
from simulate.session_syntax import Role, parse_session
from simulate.twin.options import MIN_SITE_SIDE_M, SiteConfig

# The most samples per pixel that Cycles accepts.
_MOST_SAMPLES = 1 << 24
_MIN_SIDE_M = 120.0  # least side of a procedural place, for streets and blocks
NotNegative = Annotated[float, Field(ge=0)]


class SessionConfig(Config):
    """One flight under one condition."""

    condition: str = Field(
        description="Condition, SEASON-LIGHT[-WEATHER], see ``simulate.look.conditions``."
    )
    flight: Flight = Field(
        description='Kind of flight with its options, or the kind alone, such as "nadir".'
    )
    role: Role = Field(description='Role of the frames, "map" or "query".')
    frames: int | None = Field(
        None,
        ge=1,
        le=MAX_PHOTOGRAPHS,
        description="Number of photographs. None takes the scene's ``frames``, or the number that "
        "the flight itself determines by overlaps, a mission plan or recorded poses.",
    )
    change: Change = Field(
        Change(), description="Objects that are moved, removed or added in this session."
    )
    camera: CameraConfig | None = Field(
        None, description="Camera of this session. None takes the scene's."
    )
    name: str | None = Field(
        None,
        pattern=r"^[a-z0-9]+(-[a-z0-9]+)*$",
        description="Name of the session's folder. None is condition-flight-role.",
    )

    @field_validator("condition")
    @classmethod
    def _check_condition(cls, name: str) -> str:
        return condition(name).name

    @property
    def world_change(self) -> Change:
        """Return the configured change, with bare trees in a leafless season."""
        if not condition(self.condition).season.bare:
            return self.change
        return self.change.model_copy(update={"bare_trees": True})

    @model_validator(mode="after")
    def _check_count(self) -> SessionConfig:
        if self.frames is not None and self.flight.determines_frames:
            raise ValueError(
                f"the {self.flight.kind} flight determines its number of frames: leave frames out"
            )
        return self


def _drive(condition: str, role: Role, offset_m: float = 0.0) -> tuple[SessionConfig, ...]:
    """Return two sessions of a drive along the longest road, one for each camera.

    Map drives go both ways. Query drives go back at another lateral offset.
    """
    return tuple(
        SessionConfig(
            condition=condition,
            flight=StreetFlight(
                roads=1,
                way="both" if role == "map" else "back",
                offset_m=offset_m,
                edge_m=25.0,
                yaws_deg=(yaw,),
            ),
            role=role,
            frames=None if role == "map" else 15,
            camera=CameraConfig(preset=f"cmu-{camera}"),
            name=f"{condition}-{role}-{camera}",
        )
        for yaw, camera in ((-45.0, "c0"), (45.0, "c1"))
    )


@cache
def _preset_defaults(preset: str) -> dict[str, Any]:
    """Return the defaults of a preset that replace the general ones.

    The defaults are made at first use, because validating a camera with distortion loads torch.
    """
    if preset != "street":
        return {}
    return {
        "area": 300.0,
        "frames": 120,  # a map session then has a frame every 4 m in both directions
        "sessions": (
            *_drive("summer-noon", "map"),
            *_drive("summer-noon", "query", -0.5),
            *_drive("winter-dusk", "query", 0.4),
        ),
    }


def _add_extent(values: dict[str, Any]) -> dict[str, Any]:
    """Add the area and origin of a site where the configuration lacks them."""
    if values.get("site") is None or {"area", "origin"} <= values.keys():
        return values
    from simulate.twin.source import measure_extent  # late, because it loads torch

    site = SiteConfig.model_validate(values["site"])
    extent = measure_extent(site, has_side="area" in values)
    return {"area": extent.side_m, "origin": extent.origin} | values | {"site": site}


class SimulateConfig(Config):
    """A scene: a place, a camera, and flights over it.

    The preset street has its own defaults for area, frames and sessions, which are drives with two
    cameras. The preset site is a real place, reconstructed from the files of ``site``.
    """

    preset: str = Field("town", description="Kind of place to render, such as town or farmland.")
    seed: int = Field(
        0,
        ge=0,
        le=MAX_SEED,
        description="Random seed of the place and of all noise. Equal seeds give equal scenes.",
    )
    area: float = Field(
        200.0,
        ge=MIN_SITE_SIDE_M,
        le=MAX_TILED_SIDE_M,
        description="Side of the square place, m; at least 120, or 40 for a site. A procedural "
        "place of more than 2000 m consists of tiles, which are built where photographs show them.",
    )
    size: int = Field(
        512,
        ge=64,
        le=4096,
        description="Longer side of the photographs, px, unless the camera states its own size.",
    )
    fov_deg: float = Field(
        60.0,
        gt=5,
        lt=120,
        description="Horizontal field of view without a ``camera``, deg; photographs are square.",
    )
    camera: CameraConfig | None = Field(
        None,
        description="Camera of sessions without their own. None is a square pinhole of ``size`` "
        "and ``fov_deg``.",
    )
    spp: int = Field(
        4,
        ge=1,
        le=_MOST_SAMPLES,
        description="Rendering samples per pixel, before denoising.",
    )
    denoising: Denoising = Field(
        "fast",
        description='Quality of the denoiser, "fast" or "high". Rendering with "high" takes 7 % '
        "longer, and its PSNR against a picture of 64 samples is 0 to 0.2 dB higher. Use it with "
        'an ``spp`` below 4, where "fast" leaves noise that feature extractors take for texture.',
    )
    frames: int = Field(
        30,
        ge=1,
        le=MAX_PHOTOGRAPHS,
        description="Number of photographs of sessions without their own number.",
    )
    sessions: tuple[SessionConfig, ...] = Field(
        (
            SessionConfig(condition="summer-noon", flight=NadirFlight(), role="map"),
            SessionConfig(condition="summer-noon", flight=NadirFlight(), role="query", frames=10),
            SessionConfig(condition="winter-dusk", flight=NadirFlight(), role="query", frames=10),
        ),
        min_length=1,
        description='Flights; on the command line "condition:flight[:role][:change]". By default '
        "the first is a map session and the others are query sessions.",
    )
    map_plan: FlightPlan = Field(MAP_PLAN, description="Defaults of map flights.")
    query_plan: FlightPlan = Field(QUERY_PLAN, description="Defaults of query flights.")
    courses: Literal["shared", "own"] = Field(
        "shared",
        description='"shared": flights are drawn by seed and session, so that all presets of one '
        'seed have the same flights. "own": they are drawn by preset too, with any heading. '
        "Altitudes and radii that a flight does not state are then drawn within 15 % of those of "
        "its role. Use it for new tracks of the benchmark.",
    )
    change_share: float = Field(
        1.0,
        ge=0,
        le=1,
        description="Probability that the ``change`` of a session happens, drawn by preset, seed "
        "and session and not by condition, so that results separate the effect of changed objects "
        "from that of the condition.",
    )
    position_jitter_m: float = Field(
        0.7, ge=0, description="Standard deviation of positions by wind, per axis, m."
    )
    attitude_jitter_deg: float = Field(
        1.5, ge=0, description="Standard deviation of attitudes by wind, per axis, deg."
    )
    gps_sigma_m: tuple[NotNegative, NotNegative, NotNegative] = Field(
        (1.5, 1.5, 2.5),
        description="Standard deviation of the white noise of position priors east, north and up, "
        "m.",
    )
    gps_drift_m: tuple[NotNegative, NotNegative, NotNegative] = Field(
        (0.0, 0.0, 0.0),
        description="Standard deviation of the drift of position priors east, north and up, m. It "
        "has zero mean over many flights.",
    )
    attitude_sigma_deg: float = Field(
        2.0,
        ge=0,
        description="Standard deviation of the white noise of attitude priors, deg per axis.",
    )
    attitude_drift_deg: float = Field(
        0.0, ge=0, description="Standard deviation of the drift of attitude priors, deg per axis."
    )
    drift_s: float = Field(600.0, gt=0, description="Time constant of both drifts, s.")
    interval_s: float = Field(2.0, gt=0, description="Time between exposures, s.")
    sensor: SensorConfig = Field(
        SensorConfig(), description="Effects of lens and sensor on the photographs."
    )
    thermal: bool = Field(
        False,
        description="Whether each photograph has thermal pictures of 16 and 8 bits beside it.",
    )
    jpeg_quality: int = Field(95, ge=1, le=100, description="Quality of the JPEGs, 1 to 100.")
    origin: Origin = Field(
        DEFAULT_ORIGIN,
        description="Latitude (deg), longitude (deg) and altitude (m) of the origin.",
    )
    site: SiteConfig | None = Field(
        None,
        description="Files of the preset site. They determine ``area`` and ``origin`` if these are "
        "left out.",
    )

    @model_validator(mode="before")
    @classmethod
    def _add_defaults(cls, values: object) -> object:
        if not isinstance(values, dict) or not isinstance(values.get("preset"), str):
            return values
        if values["preset"] == SITE:
            return _add_extent(values)
        return _preset_defaults(values["preset"]) | values

    @field_validator("preset")
    @classmethod
    def _check_preset(cls, name: str) -> str:
        if name != SITE:
            preset(name)
        return name

    @field_validator("sessions", mode="before")
    @classmethod
    def _parse_sessions(cls, sessions: object) -> object:
        """Parse sessions of the command line, "condition:flight[:role][:change]"."""
        if not isinstance(sessions, list | tuple):
            return sessions
        return tuple(
            parse_session(item, first=k == 0) if isinstance(item, str) else item
            for k, item in enumerate(sessions)
        )

    @model_validator(mode="after")
    def _require_site(self) -> SimulateConfig:
        if self.preset == SITE and self.site is None:
            raise ValueError("the preset site needs --from SCENE, or --ortho and --dsm")
        if self.preset != SITE and self.site is not None:
            raise ValueError(f"files of a site need --preset site, got --preset {self.preset}")
        if self.preset != SITE and self.area < _MIN_SIDE_M:
            raise ValueError(f"area must be {_MIN_SIDE_M:.0f} m or more, got {self.area:g}")
        return self

    @model_validator(mode="after")
    def _require_map(self) -> SimulateConfig:
        if not any(session.role == "map" for session in self.sessions):
            raise ValueError("at least one session must have the role map")
        return self

    @model_validator(mode="after")
    def _check_rolling_shutter(self) -> SimulateConfig:
        cameras = (self.photo_camera(session) for session in self.sessions)
        if self.sensor.readout_s and any(cover_by_pinhole(c)[1] is not None for c in cameras):
            raise ValueError(
                "rolling shutter (sensor.readout_s) is not supported with lens distortion or two "
                "focal lengths: use a pinhole camera or set it to 0"
            )
        return self

    @model_validator(mode="after")
    def _require_unique_names(self) -> SimulateConfig:
        names = self.session_names()
        if len(set(names)) < len(names):
            raise ValueError(f"session names must be unique: {', '.join(names)}")
        return self

    @model_validator(mode="after")
    def _check_conditions(self) -> SimulateConfig:
        for session in self.sessions:
            condition(session.condition, self.origin)
        return self

    @staticmethod
    def load(path: Path | None, overrides: Mapping[str, Any]) -> SimulateConfig:
        """Load a configuration from a YAML file and overrides, which ``load_config`` describes.

        Overrides that are None are ignored.

        Raises:
            InputError: unreadable file, unknown key or bad value.
        """
        options = {key: value for key, value in overrides.items() if value is not None}
        return load_config(SimulateConfig, path, options)

    def photo_camera(self, session: SessionConfig | None = None) -> Camera:
        """Return the camera of a session, or the default camera without a session."""
        camera = (session.camera if session is not None else None) or self.camera
        if camera is not None:
            return camera.build(self.size)
        focal = 0.5 * self.size / np.tan(np.radians(0.5 * self.fov_deg))
        centre = 0.5 * self.size
        return Camera("PINHOLE", self.size, self.size, (float(focal), float(focal), centre, centre))

    def drawn_sessions(self) -> tuple[SessionConfig, ...]:
        """Return the sessions, without the changes that do not happen (``change_share``)."""

        def happens(index: int) -> bool:
            rng = change_generator(self.seed, index, self.preset)
            return bool(rng.random() < self.change_share)

        return tuple(
            session if happens(k) else session.model_copy(update={"change": Change()})
            for k, session in enumerate(self.sessions)
        )

    def session_names(self) -> tuple[str, ...]:
        """Return the folder names; repeated names are numbered from 2."""
        seen: dict[str, int] = {}
        names = []
        for session in self.sessions:
            base = session.name or f"{session.condition}-{session.flight.kind}-{session.role}"
            seen[base] = seen.get(base, 0) + 1
            names.append(base if seen[base] == 1 else f"{base}-{seen[base]}")
        return tuple(names)
