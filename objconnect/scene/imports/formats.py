"""The registry of pose formats, and the detection of a file's format."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from objconnect.scene.errors import InputError
from objconnect.scene.imports.poses import CoordinateFrame, ForeignPoses, Format
from objconnect.scene.imports.unsupported import refuse_unsupported
from objconnect.scene.registry import Lazy, Registry

# Formats are tried in this order.
FORMATS: Final[Registry[Format]] = Registry(
    "pose format",
    "objconnect.imports",
    {
        "colmap": Lazy("objconnect.scene.imports.colmap:FORMAT", "folder of a binary COLMAP model"),
        "splatting": Lazy(
            "objconnect.scene.imports.splatting:FORMAT", "cameras.json of 3D Gaussian splatting"
        ),
        "opensfm": Lazy(
            "objconnect.scene.imports.opensfm:FORMAT", "reconstruction.json of ODM or OpenSfM"
        ),
        "nerfstudio": Lazy(
            "objconnect.scene.imports.nerfstudio:FORMAT", "transforms.json, or its folder"
        ),
        "metashape": Lazy("objconnect.scene.imports.metashape:FORMAT", "cameras.xml of Metashape"),
        "table": Lazy("objconnect.scene.imports.table:FORMAT", "CSV of positions"),
        "tum": Lazy("objconnect.scene.imports.tum:FORMAT", "TUM trajectory"),
    },
    accepts=lambda entry: isinstance(entry, Format),
)


FRAMELESS_FILES: Final = "a reconstruction.json of ODM or OpenSfM"
"""Phrase for the files that do not state the frame of their poses, so that the user may."""


def read_foreign(path: Path, frame: CoordinateFrame | None = None) -> ForeignPoses:
    """Read poses from a file or folder in any registered format.

    Args:
        path: file or folder.
        frame: frame of the poses, for files that do not state theirs; None detects it.

    Raises:
        InputError: the path does not exist, its format is unknown, its contents are invalid, or
            ``frame`` is given for a format whose frame is always known.
    """
    if not path.exists():
        raise InputError(f"file of poses {path} does not exist")
    refuse_unsupported(path)
    descriptions = []
    for name in FORMATS:
        form = FORMATS.load(name)
        with FORMATS.convert_errors(name, f"cannot read {path}"):
            if form.matches(path):
                if frame is None:
                    return form.read(path)
                if form.read_in_frame is not None:
                    return form.read_in_frame(path, frame)
                raise InputError(f"{path} is not {FRAMELESS_FILES}: leave out --poses-frame")
        descriptions.append(form.description)
    raise InputError(f"{path} is not a file of poses: it is neither {', nor '.join(descriptions)}")
