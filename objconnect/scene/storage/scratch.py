"""Temporary folders in the folder of the cache or of a run's output."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from objconnect.scene.errors import WriteError
from objconnect.scene.storage.files import require_disk_space
from objconnect.scene.storage.leftovers import make_folder_in_use, remove_abandoned


@contextmanager
def scratch(parent: Path | None = None, needed: int = 0) -> Iterator[Path]:
    """Make a temporary folder for the duration of the block.

    With ``parent``, it lies on the disk of the results, because the system's temporary folder may
    be small. Temporary folders of killed processes beside it are removed.

    Args:
        parent: folder of the cache or output, in which the temporary folder lies. If it does not
            exist, it is created, and removed after the block if it is empty then. None uses the
            system's temporary folder.
        needed: bytes that the block writes.

    Raises:
        WriteError: the disk has less space, or the folder cannot be written.

    Examples:
        >>> with scratch() as folder:
        ...     _ = (folder / "part.txt").write_text("temporary")
        >>> folder.exists()
        False
    """
    root = Path(tempfile.gettempdir()) if parent is None else parent
    new_folders = [path for path in (root, *root.parents) if not path.exists()]
    try:
        root.mkdir(parents=True, exist_ok=True)
        remove_abandoned(root)
        folder, lock = make_folder_in_use(root)
    except OSError as error:
        raise WriteError(f"cannot write {root}: {error.strerror or error}") from None
    try:
        require_disk_space(folder / "any", needed)
        yield folder
    finally:
        lock.release()
        shutil.rmtree(folder, ignore_errors=True)
        for path in new_folders:
            try:
                path.rmdir()
            except OSError:  # the folder is not empty
                break


@contextmanager
def cache_or_scratch(cache: Path | None, parent: Path | None) -> Iterator[Path]:
    """Yield the folder of the cache, or without one a temporary folder in ``parent``."""
    if cache is not None:
        yield cache
        return
    with scratch(parent) as folder:
        yield folder
