"""Figures of a scene: a contact sheet and a top view of the flights."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.rectangle import rectangle
from objconnect.scene.runtime.escaping import for_figure
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.images import read_rgb

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Frames per session (flight) on the contact sheet.
_FRAMES = 2
_MARKERS = {"map": "o", "query": "^"}
_FOOTPRINT_COLOURS = {"building": "0.45", "tree": "#9fbf8f", "hedge": "#9fbf8f", "car": "#c05050"}


def draw_pictures(scene: Scene) -> None:
    """Write ``pictures/contact-sheet.png`` and ``pictures/flights.png`` into the scene.

    Raises:
        InputError: a file of the scene is damaged, or the folder cannot be written.
    """
    _save(_contact_sheet(scene), scene.path / "pictures" / "contact-sheet.png")
    _save(_flight_map(scene), scene.path / "pictures" / "flights.png")


def _save(figure: Figure, path: Path) -> None:
    with atomic_write(path) as partial:
        figure.savefig(partial, format="png", dpi=110)


def _contact_sheet(scene: Scene) -> Figure:
    """Draw one row per session: photographs, each with its depth and its instances."""
    from matplotlib.figure import Figure

    rows, columns = len(scene.sessions), 3 * _FRAMES
    figure = Figure(figsize=(2.2 * columns + 1, 2.45 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat:
        ax.set_axis_off()
    for row, session in zip(axes, scene.sessions, strict=True):
        frames = scene.frames(session)
        chosen = np.linspace(0, len(frames) - 1, min(_FRAMES, len(frames))).astype(int)
        with scene.layers(session) as layers:
            depth = [layers.read("depth", k) for k in chosen]
            instance = [layers.read("instance", k) for k in chosen]
        surface = np.concatenate([image[image > 0] for image in depth])
        low, high = np.percentile(surface, [1, 99]) if len(surface) else (0.0, 1.0)
        row[0].set_title(for_figure(session), fontsize=10, loc="left")
        for k, index in enumerate(chosen):
            photograph, planar, objects = row[3 * k : 3 * k + 3]
            photograph.imshow(read_rgb(scene.images_root / frames.names[index]))
            depth_image = planar.imshow(
                np.where(depth[k] > 0, depth[k], np.nan), vmin=low, vmax=high, cmap="viridis"
            )
            objects.imshow(_colour(instance[k]))
        figure.colorbar(depth_image, ax=list(row), label="depth (m)", shrink=0.9, aspect=15)
    return figure


def _colour(instance: NDArray[Any]) -> NDArray[Any]:
    """Return a colour for each instance id, (H, W, 3); neighbouring ids differ, the ground is
    black."""
    import matplotlib as mpl

    # Multiples of the golden ratio spread evenly over the hues.
    hues = mpl.colormaps["hsv"]((instance.astype(np.int64) * 0.6180339887) % 1.0)[..., :3]
    return np.where(instance[..., None] > 0, hues, 0.0)


def _flight_map(scene: Scene) -> Figure:
    """Draw camera positions and headings from above, over the map's points or the objects."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon

    figure = Figure(figsize=(8, 8), layout="constrained")
    ax = figure.subplots()
    if scene.map_path.is_dir():
        sparse_map = scene.sparse_map()
        xyz, rgb = sparse_map.xyz, sparse_map.rgb / 255
        # Dots cover about the same area in every map.
        size = float(np.clip(2e4 / len(xyz), 0.5, 8))
        ax.scatter(xyz[:, 0], xyz[:, 1], s=size, c=rgb, linewidths=0)
        ax.set_title(f"{for_figure(scene.name)}: flights over the map's {len(xyz)} points")
    else:
        for item in scene.objects.objects:
            colour = _FOOTPRINT_COLOURS.get(item.class_name, "0.7")
            box = rectangle(item.centre[:2], item.size[:2], np.radians(item.yaw_deg))
            ax.add_patch(Polygon(box, facecolor=colour, edgecolor="none"))
        ax.set_title(f"{for_figure(scene.name)}: flights over the objects' footprints")
    for k, (name, session) in enumerate(scene.sessions.items()):
        poses = scene.frames(name).poses
        centres, rotation = poses.centre().numpy(), poses.rotation.numpy()
        marker = _MARKERS[session.role]
        colour = f"C{k}"
        ax.plot(centres[:, 0], centres[:, 1], color=colour, linewidth=0.8, alpha=0.7)
        ax.scatter(
            centres[:, 0],
            centres[:, 1],
            marker=marker,
            color=colour,
            s=26,
            zorder=3,
            label=for_figure(name),
        )
        # The image's up direction (-y) gives a heading even for a camera that looks straight down.
        image_up = -rotation[:, 1, :2]
        ax.quiver(*centres[:, :2].T, *image_up.T, color=colour, width=0.003, scale=30, zorder=3)
    # Half of the side of the site, with a margin.
    half_width = 0.62 * float(scene.manifest.config["area"])
    ax.set(xlim=(-half_width, half_width), ylim=(-half_width, half_width), aspect="equal")
    ax.set_xlabel("east (m)")
    ax.set_ylabel("north (m)")
    ax.legend(loc="upper left", fontsize=8)
    return figure
