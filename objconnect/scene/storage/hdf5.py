"""Safe reads of HDF5 files of unknown origin.

A link or a data set may refer to another file on this machine, and a data set of a few bytes may
claim any size. These functions refuse such references, and compare claimed sizes with the stored
bytes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

# Largest compression ratio of Deflate.
_MAX_RATIO: Final = 1032


def dataset(group: h5py.Group, name: str) -> h5py.Dataset:
    """Return a data set of a group after checking that it can be read whole.

    Raises:
        KeyError: the group has no member of this name.
        ValueError: the member is not a data set, has no shape (HDF5's null data space), lies in
            another file, has elements of variable length, or claims more than its bytes can hold.
    """
    member = _member(group, name)
    if not isinstance(member, h5py.Dataset):
        raise ValueError(f"{name} is not an array")
    if member.shape is None:
        raise ValueError(f"{name} is empty")
    if member.is_virtual or member.external:
        raise ValueError(f"{name} lies in another file")
    # The HDF5 library can crash on damaged strings of variable length.
    if member.dtype.hasobject:
        raise ValueError(f"{name} has elements of variable length")
    stored = min(member.id.get_storage_size(), member.file.id.get_filesize())
    # Chunks are decompressed whole; an empty array has none.
    chunk = math.prod(member.chunks or (0,)) if member.size else 0
    claimed = member.dtype.itemsize * max(member.size, chunk)
    if claimed > _MAX_RATIO * stored:
        raise ValueError(f"{name} claims {claimed} bytes and {stored} are stored")
    return member


def array(group: h5py.Group, name: str) -> NDArray[Any]:
    """Read a whole data set; see ``dataset`` for the checks."""
    return np.asarray(dataset(group, name)[...])


def attribute(node: h5py.HLObject, name: str) -> Any:
    """Return an attribute; text of fixed length becomes ``str``.

    Raises:
        KeyError: there is no attribute of this name.
        ValueError: it is of variable length, or claims more than the file has.
    """
    stored = node.attrs.get_id(name)
    # The HDF5 library can crash or hang on damaged attributes of variable length.
    if stored.dtype.hasobject:
        raise ValueError(f"attribute {name} is of variable length")
    if stored.get_storage_size() > node.file.id.get_filesize():
        raise ValueError(f"attribute {name} claims more than the file has")
    value = node.attrs[name]
    return value.decode() if isinstance(value, bytes) else value


def set_text(node: h5py.HLObject, name: str, text: str) -> None:
    """Write text as an attribute of fixed length, which ``attribute`` can read."""
    data = text.encode()
    node.attrs.create(name, data, dtype=h5py.string_dtype("utf-8", len(data)))


def group(parent: h5py.Group, name: str) -> h5py.Group:
    """Return a group of another group.

    Raises:
        KeyError: the group has no member of this name.
        ValueError: the member is not a group, or lies in another file.
    """
    member = _member(parent, name)
    if not isinstance(member, h5py.Group):
        raise ValueError(f"{name} is not a group")
    return member


def groups(parent: h5py.Group) -> Iterator[tuple[str, h5py.Group]]:
    """Yield the groups of another group with their names.

    Raises:
        ValueError: a member is not a group, or lies in another file.
    """
    for name in parent:
        yield name, group(parent, name)


def _member(group: h5py.Group, name: str) -> Any:
    link = group.get(name, getlink=True)
    if link is None:
        raise KeyError(f"there is no {name}")
    if not isinstance(link, h5py.HardLink):
        raise ValueError(f"{name} is a link to another file or member")
    return group[name]
