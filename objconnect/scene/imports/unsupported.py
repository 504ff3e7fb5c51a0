"""Detection of unsupported pose files by their contents, for a helpful error message.

Supported formats have the same suffixes, so the contents are compared.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from objconnect.scene.errors import InputError
from objconnect.scene.storage.files import parse_json, read_text

_HEAD_BYTES: Final = 4096
_SHOWN_KEYS: Final = 4
_ODM_REMEDY: Final = (
    "give the project's reconstruction.topocentric.json, or its reconstruction.json if it has none"
)

# Pattern of a text's beginning, its format, and what to do.
_TEXTS: Final = (
    (r"# Bundle file", "a bundle of Bundler", "export to COLMAP"),
    (r"NVM_V3", "a model of VisualSFM", "export to COLMAP"),
    (r"imageName\s+X\s+Y\s+Z\s+Omega", "Pix4D's external parameters", "export to COLMAP"),
    (r"#(name|cameras)\b.*[,;]", "a table of RealityCapture", "export to COLMAP"),
    (r"Label\b.*\b(Omega|Yaw)", "a table of Metashape's reference", "use Export Cameras"),
    (r"(<\?xml[^>]*>\s*)?<BlocksExchange", "blocks of ContextCapture", "export to COLMAP"),
)


def refuse_unsupported(path: Path) -> None:
    """Refuse a file of an unsupported format; damaged files and folders are left to the readers.

    Raises:
        InputError: the file is of another format, which the message names if it is known.
    """
    if not path.is_file():
        return
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES).decode("utf-8", "replace").lstrip("\ufeff \t\r\n")
    except OSError:
        return
    described = _describe_json(path) if head[:1] in ("{", "[") else _describe_text(head)
    if described is not None:
        what, remedy = described
        raise InputError(f"{path} is not supported as a file of poses: it is {what}: {remedy}")


def _describe_text(head: str) -> tuple[str, str] | None:
    for pattern, what, remedy in _TEXTS:
        if re.match(pattern, head, re.IGNORECASE):
            return what, f"{remedy} and give the exported file"
    return None


def _describe_json(path: Path) -> tuple[str, str] | None:
    try:
        value = parse_json(read_text(path, "file of poses"))
    except (ValueError, InputError):
        return None
    if isinstance(value, list):
        first = value[0] if value and isinstance(value[0], dict) else None
        if first is None or "shots" in first or "cameras" in first or _is_splatting(first):
            return None
        return _describe_keys(first)
    if not isinstance(value, dict) or "frames" in value:
        return None
    if value.get("type") == "FeatureCollection":
        return "GeoJSON, such as ODM's shots.geojson", _ODM_REMEDY
    lenses = value.values()
    if value and all(isinstance(one, dict) and "projection_type" in one for one in lenses):
        return "lenses without poses, as cameras.json of ODM", _ODM_REMEDY
    return _describe_keys(value)


def _is_splatting(first: Mapping[str, Any]) -> bool:
    return {"img_name", "position", "rotation"} <= first.keys()


def _describe_keys(keys: Mapping[str, Any]) -> tuple[str, str]:
    names = ", ".join(repr(key) for key in list(keys)[:_SHOWN_KEYS]) or "nothing"
    return f"JSON with {names[:200]}", "give a file of COLMAP, ODM, nerfstudio or Metashape"
