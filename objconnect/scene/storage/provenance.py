"""Marks of pictures that this program drew, so that it replaces no file of another program.

These are the marks of ``objconnect.scene.storage.outputs.OutputFile``.
"""

from __future__ import annotations

from typing import Final

SOFTWARE: Final = "ObjConnect"
PNG_METADATA: Final = {"Software": SOFTWARE}
"""The metadata that Matplotlib writes into a PNG."""

PNG_MARK: Final = b"Software\0ObjConnect"
"""The bytes near the beginning of a PNG with this metadata."""

JPEG_MARK: Final = b"drawn by ObjConnect"
"""The comment of a JPEG drawn by this program."""
