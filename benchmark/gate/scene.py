"""The command ``gate-scene``, which writes a small flight data set that comes with the package.

It needs no renderer and no download.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Final

from objconnect.scene.errors import InputError
from objconnect.scene.storage.atomic import atomic_folder
from objconnect.scene.storage.outputs import check_output_folder, require_empty

_NAMES: Final = ("gate", "gate-snow")
GATE_SCENES: Final = {name: Path(__file__).with_name(name) for name in _NAMES}
"""The folders of the data sets by name: a town in one season, and a town with queries in snow."""


def gate_scene(out: Path, name: str = "gate") -> Path:
    """Copy a data set of the regression tests to a new folder.

    Every copy has the same digest, so results on different machines can be compared.

    Args:
        out: folder to write, new or empty. Its name becomes the name of the data set.
        name: name of the scene, see ``GATE_SCENES``.

    Returns:
        ``out``.

    Raises:
        InputError: there is no such scene, or the folder is not empty or cannot be written.
    """
    if name not in GATE_SCENES:
        raise InputError(
            f"no gate scene has the name {name!r}: choose from {', '.join(GATE_SCENES)}"
        )
    require_empty(out)
    check_output_folder(out)
    with atomic_folder(out) as folder:
        shutil.copytree(
            GATE_SCENES[name], folder, dirs_exist_ok=True, copy_function=shutil.copyfile
        )
    return out
