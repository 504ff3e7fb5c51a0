"""The export of a scene's frames to the formats of other programs."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.exports.formats import FORMATS
from objconnect.scene.storage.atomic import atomic_folder
from objconnect.scene.storage.outputs import check_output_folder, require_empty


def export(
    path: Path,
    file_format: str,
    out: Path,
    sessions: Sequence[str] = (),
    **settings: float | str | None,
) -> dict[str, Any]:
    """Write the frames of a scene in another program's format, atomically.

    The module ``objconnect.scene.exports.<format>`` documents the files of a built-in format.

    Args:
        path: path of a finished scene.
        file_format: a name of ``objconnect.scene.exports.formats.FORMATS``.
        out: folder, new or empty.
        sessions: names of the sessions (flights) to write; empty means all.
        settings: options of the format, which are the parameters of its writer after the first
            four; None means the default.

    Returns:
        The folder ("out"), the format ("format"), the number of frames written ("frames") and the
        names of their sessions ("sessions").

    Raises:
        InputError: the format is unknown, lacks an option or cannot hold these frames, the scene is
            not finished or has no such session, or ``out`` is not empty, lies in the scene or
            cannot be written.
    """
    write = FORMATS.load(file_format)
    options = {name: value for name, value in settings.items() if value is not None}
    for name in options.keys() - inspect.signature(write).parameters.keys():
        raise InputError(f"--{name} is not an option of the format {file_format}")
    scene = Scene.open(path)
    if out.resolve().is_relative_to(path.resolve()):
        raise InputError(f"{out} lies in the scene itself: choose a folder outside it")
    chosen = {name: scene.frames(name) for name in dict.fromkeys(sessions or scene.sessions)}
    require_empty(out)
    check_output_folder(out, [path])
    with atomic_folder(out) as folder, FORMATS.convert_errors(file_format, "cannot be written"):
        partial(write, **options)(scene, chosen, folder, out)
    frames = sum(len(frames) for frames in chosen.values())
    return {"out": str(out), "format": file_format, "frames": frames, "sessions": list(chosen)}
