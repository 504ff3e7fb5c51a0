"""HDF5 files from strangers: what may be read of them.

A link or a data set may lie in another file, anywhere on this machine, and a data set claims any
size in a few bytes. Here the one is refused, and the other held against the bytes that are stored.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

# Deflate makes at most so many bytes of one.
_MOST: Final = 1032


def dataset(group: h5py.Group, name: str) -> h5py.Dataset:
    """A data set of a group, safe to be read whole.

    Raises:
        KeyError: there is none of this name.
        ValueError: it is no data set or an empty one, lies in another file, has elements of
            variable length, or claims
            more than its bytes can hold.
    """
    found = _member(group, name)
    if not isinstance(found, h5py.Dataset):
        raise ValueError(f"{name} is no array")
    if found.shape is None:
        raise ValueError(f"{name} is empty")
    if found.is_virtual or found.external:
        raise ValueError(f"{name} lies in another file")
    # Damaged strings of variable length make the HDF5 library crash.
    if found.dtype.hasobject:
        raise ValueError(f"{name} has elements of variable length")
    stored = min(found.id.get_storage_size(), found.file.id.get_filesize())
    # Chunks are unpacked whole; of an array without elements there are none.
    chunk = math.prod(found.chunks or (0,)) if found.size else 0
    claimed = found.dtype.itemsize * max(found.size, chunk)
    if claimed > _MOST * stored:
        raise ValueError(f"{name} claims {claimed} bytes and {stored} are stored")
    return found


def array(group: h5py.Group, name: str) -> NDArray[Any]:
    """All of a data set; see ``dataset`` for what is refused."""
    return np.asarray(dataset(group, name)[...])


def attribute(node: h5py.HLObject, name: str) -> Any:
    """An attribute; text, which must be of fixed length, as ``str``.

    Raises:
        KeyError: there is none of this name.
        ValueError: it is of variable length, or claims more than the file has.
    """
    stored = node.attrs.get_id(name)
    # Damaged ones make the HDF5 library crash, or search for ever.
    if stored.dtype.hasobject:
        raise ValueError(f"attribute {name} is of variable length")
    if stored.get_storage_size() > node.file.id.get_filesize():
        raise ValueError(f"attribute {name} claims more than the file has")
    value = node.attrs[name]
    return value.decode() if isinstance(value, bytes) else value


def set_text(node: h5py.HLObject, name: str, text: str) -> None:
    """Write text as an attribute of fixed length; h5py's own are refused by ``attribute``."""
    data = text.encode()
    node.attrs.create(name, data, dtype=h5py.string_dtype("utf-8", len(data)))


def group(parent: h5py.Group, name: str) -> h5py.Group:
    """A group of another.

    Raises:
        KeyError: there is none of this name.
        ValueError: it is no group, or lies in another file.
    """
    found = _member(parent, name)
    if not isinstance(found, h5py.Group):
        raise ValueError(f"{name} is no group")
    return found


def groups(parent: h5py.Group) -> Iterator[tuple[str, h5py.Group]]:
    """The groups of another, by name.

    Raises:
        ValueError: something in it is no group, or lies in another file.
    """
    for name in parent:
        yield name, group(parent, name)


def _member(group: h5py.Group, name: str) -> Any:
    link = group.get(name, getlink=True)
    if link is None:
        raise KeyError(f"there is no {name}")
    if not isinstance(link, h5py.HardLink):
        raise ValueError(f"{name} is a link to something else")
    return group[name]
