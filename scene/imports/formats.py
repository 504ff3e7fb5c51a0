"""The formats of poses by name, and the recognition of any of them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from scene.errors import InputError
from scene.imports.poses import ForeignPoses, Format
from scene.imports.strangers import refuse_stranger
from scene.registry import Lazy, Registry

# Formats are asked in this order.
FORMATS: Final[Registry[Format]] = Registry(
    "pose format",
    "objconnect.imports",
    {
        "colmap": Lazy("scene.imports.colmap:FORMAT", "folder of a binary COLMAP model"),
        "splatting": Lazy(
            "scene.imports.splatting:FORMAT", "cameras.json of 3D Gaussian splatting"
        ),
        "opensfm": Lazy("scene.imports.opensfm:FORMAT", "reconstruction.json of ODM or OpenSfM"),
        "nerfstudio": Lazy("scene.imports.nerfstudio:FORMAT", "transforms.json, or its folder"),
        "metashape": Lazy("scene.imports.metashape:FORMAT", "cameras.xml of Metashape"),
        "table": Lazy("scene.imports.table:FORMAT", "CSV of positions"),
        "tum": Lazy("scene.imports.tum:FORMAT", "TUM trajectory"),
    },
    accepts=lambda found: isinstance(found, Format),
)


def read_foreign(path: Path) -> ForeignPoses:
    """Read poses with the first format that knows a path.

    Raises:
        InputError: the path does not exist, no format knows it, or anything inside it is wrong.
    """
    if not path.exists():
        raise InputError(f"file of poses {path} does not exist")
    refuse_stranger(path)
    known = []
    for name in FORMATS:
        form = FORMATS.load(name)
        with FORMATS.blame(name, f"cannot read {path}"):
            if form.is_one(path):
                return form.read(path)
        known.append(form.holds)
    raise InputError(f"{path} is no file of poses: it is neither {', nor '.join(known)}")
