"""Metadata that marks images written by this program.

``objconnect.scene.storage.outputs.OutputFile`` recognizes files by these marks.
"""

from __future__ import annotations

from typing import Final

SOFTWARE: Final = "ObjConnect"
PNG_METADATA: Final = {"Software": SOFTWARE}
"""Metadata that Matplotlib writes into a PNG."""

PNG_MARK: Final = b"Software\0ObjConnect"
"""Bytes near the beginning of a PNG with this metadata."""

JPEG_MARK: Final = b"drawn by ObjConnect"
"""Comment of a JPEG drawn by this program."""
