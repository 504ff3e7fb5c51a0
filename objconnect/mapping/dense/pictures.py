"""Draw overview pictures of a dense reconstruction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from objconnect.mapping.dense.report import RELATIVE_TOLERANCE, Truth
from objconnect.mapping.dense.workspace import Workspace
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.images import read_rgb

_DPI = 110
# Oblique view of the cloud from the south-west, degrees.
_ELEVATION, _BEARING = 35.0, 45.0
# Side of the cloud's pictures, pixels.
_SIDE = 900


def draw_maps(
    workspace: Workspace,
    names: Sequence[str],
    confirmations: Mapping[str, NDArray[np.int64]],
    truth: Mapping[str, Truth],
    path: Path,
) -> None:
    """Draw a row per photograph: picture, depth, confirmations, and true depth and error if known.

    Raises:
        InputError: the folder cannot be written.
    """
    columns = 5 if truth else 3
    figure = Figure(figsize=(2.6 * columns, 2.6 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), columns, squeeze=False)
    for row, name in zip(axes, names, strict=True):
        depth = workspace.depth(name, "geometric")
        surface = truth[name].depth if name in truth else depth
        low, high = np.percentile(surface[surface > 0], [1, 99]) if surface.any() else (0, 1)
        shown = row[1].imshow(_valid(depth), vmin=low, vmax=high, cmap="viridis")
        figure.colorbar(shown, ax=row[1], shrink=0.8)
        row[0].imshow(read_rgb(workspace.images / name))
        row[2].imshow(confirmations[name], vmin=0, cmap="magma")
        if name in truth:
            true = truth[name]
            row[3].imshow(_valid(true.depth), vmin=low, vmax=high, cmap="viridis")
            error = np.abs(depth / np.where(true.depth > 0, true.depth, 1) - 1)
            error = np.where((depth > 0) & true.evaluable, error, np.nan)
            # The scale ends at four times the tolerance, in percent.
            shown = row[4].imshow(
                100 * error, vmin=0, vmax=400 * RELATIVE_TOLERANCE, cmap="inferno"
            )
            figure.colorbar(shown, ax=row[4], shrink=0.8)
    titles = ("photograph", "depth (m)", "sources that confirm it", "true depth", "error (%)")
    for ax, title in zip(axes[0], titles, strict=False):
        ax.set_title(title, fontsize=9)
    for ax in axes.flat:
        ax.set_axis_off()
        ax.set_facecolor("0.85")
    _save(figure, path)


def draw_cloud(xyz: NDArray[np.float64], rgb: NDArray[np.uint8], path: Path) -> None:
    """Draw the cloud from above and from the south-west, nearer points in front of farther ones.

    Args:
        xyz: (M, 3) world metres.
        rgb: colours (M, 3).
        path: file of the picture.

    Raises:
        InputError: the folder cannot be written.
    """
    figure = Figure(figsize=(12, 6), layout="constrained")
    views = ((90.0, 0.0, "from above"), (_ELEVATION, _BEARING, "from the south-west"))
    for ax, (elevation, bearing, title) in zip(figure.subplots(1, 2), views, strict=True):
        ax.imshow(_splat(xyz, rgb, elevation, bearing))
        ax.set_title(f"{len(xyz)} points, {title}", fontsize=10)
        ax.set_axis_off()
    _save(figure, path)


def _splat(
    xyz: NDArray[np.float64], rgb: NDArray[np.uint8], elevation: float, bearing: float
) -> NDArray[np.uint8]:
    """Return an orthographic picture (H, W, 3), which is white where there are no points."""
    e, b = np.radians([elevation, bearing])
    right = np.array([np.cos(b), -np.sin(b), 0])
    ahead = np.array([np.sin(b) * np.cos(e), np.cos(b) * np.cos(e), -np.sin(e)])
    up = np.cross(right, ahead)
    picture = np.full((_SIDE, _SIDE, 3), 255, np.uint8)
    if not len(xyz):
        return picture
    flat = np.stack([xyz @ right, -xyz @ up], 1)
    low, high = np.percentile(flat, [0.5, 99.5], axis=0)
    scale = (_SIDE - 1) / max(float((high - low).max()), 1e-9)
    order = np.argsort(-(xyz @ ahead), kind="stable")  # farthest first, nearer on top
    pixels = np.round((flat - 0.5 * (low + high)) * scale + 0.5 * _SIDE).astype(int)[order]
    for dx in range(2):
        for dy in range(2):
            x, y = pixels[:, 0] + dx, pixels[:, 1] + dy
            inside = (x >= 0) & (x < _SIDE) & (y >= 0) & (y < _SIDE)
            picture[y[inside], x[inside]] = rgb[order][inside]
    return picture


def _valid(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.where(depth > 0, depth, np.nan)


def _save(figure: Figure, path: Path) -> None:
    with atomic_write(path) as partial:
        figure.savefig(partial, format="png", dpi=_DPI)
