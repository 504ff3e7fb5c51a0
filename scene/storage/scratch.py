"""A folder for files that nobody needs afterwards."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scene.errors import WriteError
from scene.storage.files import MARK, PARTIAL, require_room


@contextmanager
def scratch(beside: Path | None = None, needed: int = 0) -> Iterator[Path]:
    """A new folder, removed when the block ends, however that ends.

    It lies where there is room for results: a small folder for temporary files must not end a run
    whose cache and output lie elsewhere. What a killed process left goes with the next
    ``scene.storage.files.remove_partial`` of the folder above.

    Args:
        beside: folder of the cache or the output to work for; made when it is not there, and gone
            again when it stays empty. None takes the system's folder for temporary files.
        needed: bytes that will be written.

    Raises:
        WriteError: there is less room, or the folder cannot be written.
    """
    root = Path(tempfile.gettempdir()) if beside is None else beside
    made = [path for path in (root, *root.parents) if not path.exists()]
    try:
        root.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=MARK, suffix=PARTIAL, dir=root))
    except OSError as error:
        raise WriteError(f"cannot write {root}: {error.strerror or error}") from None
    try:
        require_room(folder / "any", needed)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        for path in made:
            try:
                path.rmdir()
            except OSError:  # it holds something
                break


@contextmanager
def kept_or_scratch(cache: Path | None, beside: Path | None) -> Iterator[Path]:
    """The folder of a cache; where there is none, a scratch folder beside what a run writes."""
    if cache is not None:
        yield cache
        return
    with scratch(beside) as folder:
        yield folder
