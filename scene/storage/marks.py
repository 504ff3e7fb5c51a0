"""How pictures say that this program drew them, so that none of somebody else's is replaced: the
marks of ``scene.storage.outputs.Output``."""

from __future__ import annotations

from typing import Final

SOFTWARE: Final = "ObjConnect"
PNG_METADATA: Final = {"Software": SOFTWARE}
"""What Matplotlib writes into a PNG of ours."""

PNG_MARK: Final = b"Software\0ObjConnect"
"""What stands near the beginning of such a PNG."""

JPEG_MARK: Final = b"drawn by ObjConnect"
"""The comment of a JPEG of ours."""
