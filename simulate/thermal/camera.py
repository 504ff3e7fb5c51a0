"""The radiance that reaches a thermal camera from every pixel of a rendered picture.

The radiance is computed from layers that the renderer writes with the picture, so that both have
the same geometry. A surface emits by its temperature and emissivity, and reflects the sky and
surroundings that have the air's temperature. The air on the path absorbs a part of this radiance
and adds its own. Surfaces do not reflect each other, and every pixel shows one point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.labels import CLASSES
from objconnect.scene.geometry.geodesy import Geodetic
from simulate.look.conditions import Condition
from simulate.look.ground_images import GroundImages
from simulate.look.textures import facade_material, panes
from simulate.place.world import Facade, World
from simulate.thermal.engines import Engines
from simulate.thermal.planck import band_radiance
from simulate.thermal.shade import Shade
from simulate.thermal.substances import NAMES, property_array, substance_table
from simulate.thermal.surfaces import Surfaces
from simulate.thermal.weather import HOURS, ZERO_C, thermal_weather

Float = NDArray[np.float32]
Array = NDArray[Any]

_LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722], np.float32)
_MIN_ALBEDO, _MAX_ALBEDO = 0.03, 0.88
# Visible albedo of ground up to which it has no snow, and from which snow covers it fully.
_SNOW_ALBEDO: Final = (0.32, 0.55)
_SNOW_ON_OBJECTS: Final = 0.6  # share of level surfaces of objects under snow, in deep snow
_SNOW_EMISSIVITY: Final = 0.985
_WET_EMISSIVITY: Final = 0.97
_WATER_EMISSIVITY: Final = 0.985
_OPEN_GROUND: Final = ("grass", "field", "path")  # classes that floods cover


class ThermalCamera:
    """A thermal camera over a place under a condition (season, light and weather).

    Args:
        world: The place.
        condition: The condition.
        origin: The geodetic origin of the place.
        materials: Names of the renderer's materials, in the order of the indices in its material
            pass, which begin at 1.
        ground_images: The ground as the renderer shows it.
    """

    def __init__(
        self,
        world: World,
        condition: Condition,
        origin: Geodetic,
        materials: Sequence[str],
        ground_images: GroundImages,
    ) -> None:
        self._world, self._condition, self._ground_images = world, condition, ground_images
        self._materials = ("", *materials)
        self._weather = thermal_weather(condition, origin)
        self._surfaces = Surfaces(self._weather, condition.wet)
        self._shade = Shade(world, self._weather.sun)
        self._engines = Engines(world)
        self._substances = substance_table(materials)
        self._object_albedos = _object_albedos(world)

    def __call__(
        self, layers: Mapping[str, NDArray[Any]], directions: Array, centres: Array
    ) -> Float:
        """Return the radiance (H, W) in the band, W/(m2 sr), without effects of the sensor.

        Args:
            layers: "depth", "instance", "semantic" and "normal" as in a scene, "material", the
                indices (H, W) of the materials, and "uv", texture coordinates (H, W, 2).
            directions: Rays (H, W, 3) of the pixels in the world, with depth 1, metres.
            centres: Origins of the rays, of a shape that broadcasts to (H, W, 3), metres.

        Raises:
            ValueError: The substance of a surface is not known.
        """
        depth = layers["depth"]
        path = np.linalg.norm(directions, axis=-1)
        shown = depth > 0
        radiance = self._weather.sky_radiance(directions[..., 2] / path).astype(np.float32)
        points = np.asarray(centres + depth[..., None] * directions, np.float32)
        surface = self._emit(layers, points, shown)
        transmittance = np.exp(-self._weather.extinction * depth * path)
        air = band_radiance(self._weather.air_k[0])
        radiance[shown] = (air + transmittance * (surface - air))[shown]
        return radiance

    def _emit(self, layers: Mapping[str, NDArray[Any]], points: Float, shown: Array) -> Float:
        """Return the radiance (H, W) that leaves the surfaces at world points (H, W, 3)."""
        substance = self._find_substances(layers, shown)
        normal = layers["normal"].astype(np.float32) / 127
        albedo, snow, flood = self._find_albedo_and_cover(layers, substance, points, normal)
        sky_view = 0.5 * (1 + normal[..., 2])
        sunlight = self._gather_sunlight(substance, points, normal, sky_view)
        kelvin = self._surfaces.temperature(substance, albedo, sunlight, sky_view)
        kelvin += self._engines(layers["instance"], points)
        kelvin += flood * (np.float32(self._weather.water_k) - kelvin)
        kelvin -= snow * np.maximum(kelvin - np.float32(ZERO_C), 0)
        emissivity = property_array("emissivity")[substance]
        for share, covering in (
            (self._condition.wet * np.ones_like(flood), _WET_EMISSIVITY),
            (flood, _WATER_EMISSIVITY),
            (snow, _SNOW_EMISSIVITY),
        ):
            emissivity += share * np.maximum(covering - emissivity, 0)
        air = band_radiance(self._weather.air_k[0])
        ambient = air + sky_view * (self._weather.mean_sky_radiance - air)
        return np.asarray(ambient + emissivity * (band_radiance(kelvin) - ambient), np.float32)

    def _find_substances(
        self, layers: Mapping[str, NDArray[Any]], shown: Array
    ) -> NDArray[np.int16]:
        """Return the index (H, W) of the substance at each pixel; 0 in the sky."""
        material, label = layers["material"], layers["semantic"]
        substance = np.where(shown, self._substances[material, label], np.int16(0))
        if (substance < 0).any():
            row, column = np.argwhere(substance < 0)[0]
            name = next(n for n, k in CLASSES.items() if k == label[row, column])
            title = self._materials[material[row, column]]
            raise ValueError(
                f"no substance is known for the material {title!r} of the class {name!r}"
            )
        for style in Facade:
            wall = shown & (material == self._material_index(facade_material(style)))
            if wall.any():
                glazed = _glass(style)
                height, width = glazed.shape
                u, v = layers["uv"][wall].T
                row, column = np.floor(v * height).astype(int), np.floor(u * width).astype(int)
                is_pane = glazed[row % height, column % width]
                substance[wall] = np.where(is_pane, NAMES.index("pane"), substance[wall])
        return np.asarray(substance)

    def _material_index(self, material: str) -> int:
        return self._materials.index(material) if material in self._materials else -1

    def _find_albedo_and_cover(
        self,
        layers: Mapping[str, NDArray[Any]],
        substance: NDArray[np.int16],
        points: Float,
        normal: Float,
    ) -> tuple[Float, Float, Float]:
        """Return the solar albedo and the shares of snow and of standing water, each (H, W)."""
        material, instance = layers["material"], layers["instance"]
        season = self._condition.season
        albedo = property_array("albedo")[substance]
        solar_ratio = property_array("solar_ratio")[substance]
        flood = np.zeros(albedo.shape, np.float32)
        # Snow on objects is an even cover here, whereas the picture has patches.
        level = np.clip((normal[..., 2] - 0.35) / 0.4, 0, 1)
        snow = _SNOW_ON_OBJECTS * season.snow * (1 - season.thaw) * level
        visible_albedo = np.full(albedo.shape, np.nan, np.float32)
        for prefix, object_albedo in self._object_albedos.items():
            indices = [k for k, name in enumerate(self._materials) if name.startswith(prefix)]
            has_prefix = np.isin(material, indices)
            visible_albedo[has_prefix] = object_albedo[instance[has_prefix]]
        ground = material == self._material_index("ground")
        row, column = self._world.ground.texel(points[ground, 0], points[ground, 1])
        ground_albedo = _luminance(self._ground_images.albedo[row, column])
        visible_albedo[ground] = ground_albedo
        low, high = _SNOW_ALBEDO
        snow_cover = np.clip((ground_albedo - low) / (high - low), 0, 1) if season.snow > 0 else 0.0
        snow[ground] = snow_cover
        is_open = np.isin(layers["semantic"][ground], [CLASSES[name] for name in _OPEN_GROUND])
        flood[ground] = is_open * self._ground_images.specular[row, column] / np.float32(255)
        solar_albedo = np.clip(solar_ratio * visible_albedo, _MIN_ALBEDO, _MAX_ALBEDO)
        return np.where(np.isnan(visible_albedo), albedo, solar_albedo), snow, flood

    def _gather_sunlight(
        self, substance: NDArray[np.int16], points: Float, normal: Float, sky_view: Float
    ) -> Float:
        """Return the mean irradiance (H, W), W/m2, of past hours, weighted by the substance."""
        weights = self._surfaces.weights.astype(np.float32)
        gathered = np.zeros(substance.shape, np.float32)
        for k in range(HOURS):
            if self._weather.diffuse_w[k] <= 0:
                continue
            received = np.float32(self._weather.diffuse_w[k]) * sky_view
            if self._weather.direct_w[k] > 0:
                facing = np.maximum(normal @ self._weather.sun[k].astype(np.float32), 0)
                lit = 1 - self._shade(k, points, normal)
                received = received + np.float32(self._weather.direct_w[k]) * facing * lit
            gathered += weights[substance, k] * received
        return gathered


@cache
def _glass(style: Facade) -> NDArray[np.bool_]:
    """Return where the image of a facade (rows, columns) shows glass; row 0 is at the bottom."""
    return np.asarray(panes(style)[..., 0] > 0)


def _object_albedos(world: World) -> dict[str, Float]:
    """Return the visible albedo by object id, for materials whose names begin with the key."""
    count = max((item.id for item in world.objects), default=0) + 1
    albedos = {kind: np.full(count, np.nan, np.float32) for kind in ("paint", "facade_", "roof_")}
    for item in world.objects:
        albedos["paint"][item.id] = _LUMINANCE @ np.array(item.colour, np.float32)
        if item.style is not None:
            for kind, rgb in (("facade_", item.style.wall_rgb), ("roof_", item.style.roof_rgb)):
                albedos[kind][item.id] = _LUMINANCE @ np.array(rgb, np.float32)
    return albedos


def _luminance(srgb: NDArray[np.uint8]) -> Float:
    """Return the luminance (...) of sRGB bytes (..., 3), linear, 0 to 1."""
    s = np.arange(256, dtype=np.float32) / 255
    linear = np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4).astype(np.float32)
    return np.asarray(linear[srgb] @ _LUMINANCE)
