"""Preview pictures of published scenes: a few photographs of each session."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.runtime.escaping import for_figure
from objconnect.scene.storage.images import read_rgb

# Photographs per session, the longer side of each, and the gap between them, pixels.
_COLUMNS: Final = 5
_SIDE: Final = 224
_GAP: Final = 4
_QUALITY: Final = 85  # quality of the JPEG file, 0 to 100


def preview_name(scene: str) -> str:
    """Return the path of a scene's preview in the published folder."""
    return f"pictures/{scene}.jpg"


def draw_preview(path: Path, images: Path, frames: Mapping[str, Frames]) -> None:
    """Write a row of photographs for each session as one JPEG file.

    Args:
        path: file to write; its folder exists.
        images: folder that the names of photographs are relative to.
        frames: frames by session.

    Raises:
        InputError: a photograph is missing or damaged.
        OSError: the file cannot be written.
    """
    size = (_COLUMNS * (_SIDE + _GAP) - _GAP, len(frames) * (_SIDE + _GAP) - _GAP)
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    for row, (session, session_frames) in enumerate(frames.items()):
        top, names = row * (_SIDE + _GAP), session_frames.names
        chosen = np.linspace(0, len(names) - 1, min(_COLUMNS, len(names))).astype(int)
        for column, index in enumerate(chosen):
            picture = Image.fromarray(read_rgb(images / names[index]))
            picture.thumbnail((_SIDE, _SIDE))
            sheet.paste(picture, (column * (_SIDE + _GAP), top))
        label = (0, top, draw.textlength(for_figure(session)) + 8, top + 16)
        draw.rectangle(label, fill="white")
        draw.text((4, top + 2), for_figure(session), fill="black")
    sheet.save(path, format="JPEG", quality=_QUALITY)
