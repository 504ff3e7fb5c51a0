"""Build the shader graphs of all mesh materials for a condition.

The functions receive Blender's data and do not import ``bpy``, which only the renderer needs.
"""

from __future__ import annotations

from math import isfinite
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simulate.look import textures
from simulate.look.conditions import Condition
from simulate.look.seasons import SUMMER_LEAF
from simulate.place.world import Facade, Rgb

_SNOW: Rgb = (0.76, 0.79, 0.84)
# Colours of lamps at night.
_GLOWS: dict[str, Rgb] = {
    "street_light": (1.0, 0.80, 0.52),
    "headlight": (1.0, 0.95, 0.85),
    "tail_light": (1.0, 0.03, 0.02),
}
_LAMP_GLOW = 12.0  # radiance of lamps, on the scale of nights
# Colours of lit rooms, and the radiance of their windows on the scale of nights.
_ROOM_WARM: Rgb = (1.0, 0.46, 0.14)
_ROOM_COOL: Rgb = (1.0, 0.86, 0.68)
_ROOM_GLOW = 0.22
RANDOM_KEY: Final = "random_key"
"""Property of a Blender object: the number that seeds which windows of a building are lit."""
_WET_DARKENING = 0.35  # relative darkening of wet walls, roofs and paint


def build_materials(
    data: Any,
    condition: Condition,
    ground: NDArray[np.uint8],
    specular: NDArray[np.uint8],
    seed: int,
    origin: tuple[float, float] = (0.0, 0.0),
) -> dict[str, Any]:
    """Build the Blender materials, by the names that meshes use.

    The materials read the attribute "tint" and the texture coordinates "uv" of meshes, and the
    colour of objects, whose alpha is 1 for vehicles in traffic and 0 for other objects, and the
    property ``RANDOM_KEY`` of buildings. At night, windows and lamps glow, but do not light other
    surfaces; the spot lights of ``simulate.look.lamps`` do.

    Args:
        data: ``bpy.data``.
        condition: The season, light and weather.
        ground: Baked albedo (n, n, 3) of the ground, uint8 sRGB.
        specular: Specular share (n, n) of the ground, uint8.
        seed: Seed of the place; it selects the windows that are lit at night.
        origin: Position of the scene's origin in the place, metres. It moves the noise of
            surfaces, so that these look the same in every rendered part of a large place.
    """
    build = _Builder(data, condition, seed)
    image = build.image("ground", np.dstack([ground, specular]))
    materials = {"ground": build.ground(image, reflective=bool(specular.any()))}
    for style in Facade:
        name = textures.facade_material(style)
        materials[name] = build.from_image(name, textures.facade(style))
        if condition.night is not None:
            build.light_windows(materials[name], textures.panes(style), condition.night.windows)
    for kind in textures.ROOFINGS:
        materials[f"roof_{kind}"] = build.from_image(f"roof_{kind}", textures.roof(kind))
    materials["plain"] = build.plain("plain")
    for name, glow in _GLOWS.items():
        materials[name] = build.plain(name)
        if condition.night is not None:
            build.switch_on(materials[name], glow, only_driven=name != "street_light")
    materials["paint"] = build.paint()
    materials["glass"] = build.glass()
    materials["leaf"] = build.leaf("leaf", condition.season.leaf, condition.season.leaf_tip)
    materials["needle"] = build.leaf("needle", *SUMMER_LEAF)
    if any(origin):
        for material in materials.values():
            _move_noise(material, (*origin, 0.0))
    if isfinite(condition.weather.visibility_m):
        for material in materials.values():
            _add_fog(material, condition)
    return materials


def _move_noise(material: Any, offset: tuple[float, float, float]) -> None:
    """Add an offset, metres, to the positions at which a finished material samples noise."""
    graph = _Graph.from_material(material)
    links = [link for link in graph.tree.links if link.from_socket.name == "Position"]
    for link in links:
        position, noise = link.from_socket, link.to_socket
        graph.tree.links.new(graph.vector("ADD", position, offset), noise)


def _add_fog(material: Any, condition: Condition) -> None:
    """Add fog to a finished material: its colour fades into the sky's with distance.

    The contrast at d metres is exp(-3.912 d / visibility) (Koschmieder). Only camera rays are
    changed, so fog removes no light, adds no noise and keeps the depth of surfaces.
    """
    graph = _Graph.from_material(material)
    output, surface = graph.surface()
    distance = graph.node("ShaderNodeCameraData").outputs["View Distance"]
    depth = graph.math("MULTIPLY", distance, -3.912 / condition.weather.visibility_m)
    transmittance = graph.math("EXPONENT", depth, 0.0)
    is_camera_ray = graph.node("ShaderNodeLightPath").outputs["Is Camera Ray"]
    fog = graph.math("MULTIPLY", graph.math("SUBTRACT", 1.0, transmittance), is_camera_ray)
    glow = graph.node(
        "ShaderNodeEmission",
        Color=(*condition.sky.horizon, 1.0),
        Strength=condition.sky.strength,
    )
    fogged = graph.blend(fog, surface, glow.outputs[0])
    graph.tree.links.new(fogged, output)
    material.cycles.emission_sampling = "NONE"  # fog does not illuminate the scene


def _add_glow(graph: _Graph, colour: Any, strength: Any) -> None:
    """Add a glow to a finished material: visible, also in mirrors, but no light on other surfaces.

    Diffuse rays would hit these small surfaces so rarely that the picture became noisy.
    """
    diffuse = graph.node("ShaderNodeLightPath").outputs["Is Diffuse Ray"]
    seen = graph.math("MULTIPLY", strength, graph.math("SUBTRACT", 1.0, diffuse))
    glow = graph.node("ShaderNodeEmission", Color=colour, Strength=seen).outputs[0]
    output, surface = graph.surface()
    both = graph.node("ShaderNodeAddShader")
    for socket, value in zip(both.inputs, (surface, glow), strict=True):
        graph.tree.links.new(value, socket)
    graph.tree.links.new(both.outputs[0], output)
    graph.material.cycles.emission_sampling = "NONE"


class _Builder:
    """Builds the materials for one condition."""

    def __init__(self, data: Any, condition: Condition, seed: int) -> None:
        self.data = data
        self.seed = seed
        self.condition = condition

    def image(self, name: str, pixels: NDArray[np.uint8]) -> Any:
        """Make a Blender image of sRGB bytes (rows, columns, 4) whose row 0 is at the bottom."""
        rows, columns, _ = pixels.shape
        image = self.data.images.new(name, columns, rows, alpha=True)
        image.alpha_mode = "CHANNEL_PACKED"  # alpha is data here, not transparency
        image.pixels.foreach_set((pixels.astype(np.float32) / 255.0).ravel())
        image.update()
        return image

    def ground(self, image: Any, reflective: bool) -> Any:
        """Make the material of the ground from its baked image, mirrored beyond the area.

        The image contains snow and wetness. Its alpha is the share of a slightly rough mirror in
        the surface, which is 1 on water.
        """
        graph = _Graph(self.data, "ground")
        texture = graph.image(image, extension="MIRROR")
        surface = graph.diffuse(texture.outputs["Color"])
        if reflective:
            water = graph.glossy(texture.outputs["Color"], roughness=0.08)
            surface = graph.blend(texture.outputs["Alpha"], surface, water)
        graph.finish(surface)
        return graph.material

    def from_image(self, name: str, pixels: NDArray[np.uint8]) -> Any:
        """Make a material of an image.

        The alpha of the image is the share of its colour that the polygon's tint multiplies.
        """
        graph = _Graph(self.data, name)
        texture = graph.image(self.image(name, pixels), extension="REPEAT")
        tinted = graph.multiply(texture.outputs["Color"], graph.attribute("tint"))
        colour = graph.mix(texture.outputs["Alpha"], texture.outputs["Color"], tinted)
        graph.finish(graph.diffuse(self._add_weather(graph, colour)))
        return graph.material

    def plain(self, name: str) -> Any:
        """Make a material that has the polygon's tint."""
        graph = _Graph(self.data, name)
        graph.finish(graph.diffuse(self._add_weather(graph, graph.attribute("tint"))))
        return graph.material

    def light_windows(self, material: Any, panes: textures.Image, share: float) -> None:
        """Light a share of the windows of a finished facade.

        Whether a window is lit, and its colour, depend on the place, the building and the window.
        """
        graph = _Graph.from_material(material)
        image = self.image(f"panes of {material.name}", panes)
        pane = graph.red(graph.image(image, extension="REPEAT").outputs["Color"])
        cells = (textures.BAYS, textures.FLOORS, 1.0)
        window = graph.vector("MULTIPLY", graph.attribute("uv", "Vector"), cells)
        window = graph.vector("ADD", graph.vector("FLOOR", window), (0.5, 0.5, self.seed % 4096))
        building = graph.node("ShaderNodeAttribute")
        building.attribute_type, building.attribute_name = "OBJECT", RANDOM_KEY
        draw = graph.white_noise(window, building.outputs["Fac"])
        lit = graph.math("LESS_THAN", draw.outputs["Value"], share)
        warmth = graph.red(draw.outputs["Color"])
        colour = graph.mix(warmth, graph.rgb(_ROOM_WARM), graph.rgb(_ROOM_COOL))
        strength = graph.math("MULTIPLY", graph.math("MULTIPLY", pane, lit), _ROOM_GLOW)
        _add_glow(graph, colour, strength)

    def switch_on(self, material: Any, rgb: Rgb, *, only_driven: bool) -> None:
        """Let the lamps of a finished material shine; if ``only_driven``, only those of traffic."""
        graph = _Graph.from_material(material)
        on = graph.node("ShaderNodeObjectInfo").outputs["Alpha"] if only_driven else 1.0
        _add_glow(graph, graph.rgb(rgb), graph.math("MULTIPLY", on, _LAMP_GLOW))

    def paint(self) -> Any:
        """Make a slightly glossy material: the object's colour times the polygon's tint."""
        graph = _Graph(self.data, "paint")
        colour = graph.multiply(graph.object_colour(), graph.attribute("tint"))
        graph.finish(graph.glossy(self._add_weather(graph, colour), roughness=0.35))
        return graph.material

    def glass(self) -> Any:
        """Make dark, shiny glass."""
        graph = _Graph(self.data, "glass")
        colour = self._add_weather(graph, graph.attribute("tint"), share=0.6)
        graph.finish(graph.glossy(colour, roughness=0.12))
        return graph.material

    def leaf(self, name: str, inner: Rgb, tip: Rgb) -> Any:
        """Make a material: two leaf colours mixed by the tint's red, times the object's colour."""
        graph = _Graph(self.data, name)
        depth = graph.red(graph.attribute("tint"))
        between = graph.mix(depth, graph.rgb(inner), graph.rgb(tip))
        colour = graph.multiply(between, graph.object_colour())
        graph.finish(graph.diffuse(self._add_weather(graph, colour, share=0.75)))
        return graph.material

    def _add_weather(self, graph: _Graph, colour: Any, share: float = 1.0) -> Any:
        """Return the colour with wetness, and with patches of snow on surfaces that face up."""
        if self.condition.wet > 0:
            value = 1 - _WET_DARKENING * self.condition.wet
            colour = graph.multiply(colour, graph.rgb((value, value, value)))
        cover = share * self.condition.season.snow
        if cover <= 0:
            return colour
        up = graph.ramp(graph.up(), 0.35, 0.75)
        # The noise is centred on 0.5 and rarely leaves 0.25..0.75. More snow needs a lower
        # threshold.
        threshold = 0.75 - 0.5 * cover
        patches = graph.ramp(graph.noise(scale=0.3, detail=2.0), threshold - 0.1, threshold + 0.12)
        mask = graph.math("MULTIPLY", graph.math("MULTIPLY", up, patches), 0.9)
        thaw = self.condition.season.thaw
        if thaw > 0:  # surfaces that face the noon sun are bare
            azimuth, elevation = np.radians(self.condition.noon)
            level = np.cos(elevation)
            sun = (level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation))
            sunny = graph.ramp(graph.facing(sun), 0.1, 0.6)
            kept = graph.math("SUBTRACT", 1.0, graph.math("MULTIPLY", sunny, thaw))
            mask = graph.math("MULTIPLY", mask, kept)
        return graph.mix(mask, colour, graph.rgb(_SNOW))


class _Graph:
    """The node tree of a material while it is built.

    The methods return output sockets, except ``node``, ``image`` and ``white_noise``, which return
    nodes.
    """

    def __init__(self, data: Any, name: str) -> None:
        self.material = data.materials.new(name)
        self.material.use_nodes = True
        self.tree = self.material.node_tree
        self.tree.nodes.clear()

    @classmethod
    def from_material(cls, material: Any) -> _Graph:
        """Return the node tree of a finished material."""
        graph = cls.__new__(cls)
        graph.material, graph.tree = material, material.node_tree
        return graph

    def surface(self) -> tuple[Any, Any]:
        """Return the input of a finished material's surface, and the socket linked to it."""
        (node,) = (n for n in self.tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
        return node.inputs["Surface"], node.inputs["Surface"].links[0].from_socket

    def node(self, kind: str, **inputs: Any) -> Any:
        """Add a node. Inputs are values or sockets by name, with underscores for spaces."""
        node = self.tree.nodes.new(kind)
        for name, value in inputs.items():
            self._assign(node.inputs[name.replace("_", " ")], value)
        return node

    def _assign(self, socket: Any, value: Any) -> None:
        if hasattr(value, "is_output"):
            self.tree.links.new(value, socket)
        else:
            socket.default_value = value

    def image(self, image: Any, extension: str) -> Any:
        node = self.node("ShaderNodeTexImage", Vector=self.attribute("uv", "Vector"))
        node.image, node.extension = image, extension
        return node

    def attribute(self, name: str, output: str = "Color") -> Any:
        node = self.node("ShaderNodeAttribute")
        node.attribute_name = name
        return node.outputs[output]

    def object_colour(self) -> Any:
        return self.node("ShaderNodeObjectInfo").outputs["Color"]

    def rgb(self, colour: Rgb) -> Any:
        node = self.node("ShaderNodeRGB")
        node.outputs[0].default_value = (*colour, 1.0)
        return node.outputs[0]

    def red(self, colour: Any) -> Any:
        return self.node("ShaderNodeSeparateColor", Color=colour).outputs["Red"]

    def up(self) -> Any:
        normal = self.node("ShaderNodeNewGeometry").outputs["Normal"]
        return self.node("ShaderNodeSeparateXYZ", Vector=normal).outputs["Z"]

    def facing(self, direction: tuple[float, float, float]) -> Any:
        """Return the cosine of the angle between the surface's normal and a unit vector."""
        normal = self.node("ShaderNodeNewGeometry").outputs["Normal"]
        node = self.tree.nodes.new("ShaderNodeVectorMath")
        node.operation = "DOT_PRODUCT"
        self._assign(node.inputs[0], normal)
        self._assign(node.inputs[1], direction)
        return node.outputs["Value"]

    def noise(self, scale: float, detail: float) -> Any:
        at = self.node("ShaderNodeNewGeometry").outputs["Position"]
        return self.node("ShaderNodeTexNoise", Vector=at, Scale=scale, Detail=detail).outputs[0]

    def white_noise(self, at: Any, number: Any) -> Any:
        """Add a node that hashes a point and a number to random numbers."""
        node = self.tree.nodes.new("ShaderNodeTexWhiteNoise")
        node.noise_dimensions = "4D"
        self._assign(node.inputs["Vector"], at)
        self._assign(node.inputs["W"], number)
        return node

    def ramp(self, value: Any, low: float, high: float) -> Any:
        """Return the socket of a ramp: 0 below ``low``, 1 above ``high``."""
        return self.node("ShaderNodeMapRange", Value=value, From_Min=low, From_Max=high).outputs[
            "Result"
        ]

    def math(self, operation: str, a: Any, b: Any) -> Any:
        node = self.tree.nodes.new("ShaderNodeMath")
        node.operation = operation
        self._assign(node.inputs[0], a)
        self._assign(node.inputs[1], b)
        return node.outputs[0]

    def vector(self, operation: str, *values: Any) -> Any:
        node = self.tree.nodes.new("ShaderNodeVectorMath")
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            self._assign(socket, value)
        return node.outputs["Vector"]

    def mix(self, factor: Any, a: Any, b: Any, blend: str = "MIX") -> Any:
        node = self.tree.nodes.new("ShaderNodeMixRGB")
        node.blend_type = blend
        for socket, value in zip(node.inputs, (factor, a, b), strict=True):
            self._assign(socket, value)
        return node.outputs[0]

    def multiply(self, a: Any, b: Any) -> Any:
        return self.mix(1.0, a, b, blend="MULTIPLY")

    def blend(self, factor: Any, a: Any, b: Any) -> Any:
        """Mix two surfaces: ``a`` where ``factor`` is 0, ``b`` where it is 1."""
        node = self.tree.nodes.new("ShaderNodeMixShader")
        for socket, value in zip(node.inputs, (factor, a, b), strict=True):
            self._assign(socket, value)
        return node.outputs[0]

    def diffuse(self, colour: Any) -> Any:
        return self.node("ShaderNodeBsdfDiffuse", Color=colour).outputs[0]

    def glossy(self, colour: Any, roughness: float) -> Any:
        return self.node(
            "ShaderNodeBsdfPrincipled", Base_Color=colour, Roughness=roughness
        ).outputs[0]

    def finish(self, surface: Any) -> None:
        self.node("ShaderNodeOutputMaterial", Surface=surface)
