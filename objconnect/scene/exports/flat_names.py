"""File names of photographs for formats without folders."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath

from objconnect.scene.bundle.frames import Frames
from objconnect.scene.errors import InputError


def flat_names(sessions: Mapping[str, Frames], stems: bool = False) -> dict[str, str]:
    """Return the file name of each photograph without its folders, by its name in the scene.

    Args:
        sessions: frames by session.
        stems: omit the suffixes.

    Raises:
        InputError: two photographs would have the same name, or a name holds white space.
    """
    names: dict[str, str] = {}
    owners: dict[str, str] = {}
    for frames in sessions.values():
        for name in frames.names:
            path = PurePosixPath(name)
            names[name] = path.stem if stems else path.name
            other = owners.setdefault(names[name], name)
            if other != name:
                raise InputError(
                    f"{other} and {name} have the same file name, and this format has no folders: "
                    "export one session with --session"
                )
            if names[name].split() != [names[name]]:
                raise InputError(f"{name!r} contains white space, which this format cannot hold")
    return names
