"""Mutations of intact files: of their bytes, and of their content."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from random import Random
from typing import Any, Final

import h5py
import numpy as np

Mutation = Callable[[Random, bytes], bytes]

_INTEGERS: Final = (0, 1, 0xFF, 0x7FFF, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**60, 2**63, 2**64 - 1)
_FLOATS: Final = (0.0, -0.0, 1e-320, 1e300, -1e300, float("nan"), float("inf"), 1e9)
_WORDS: Final = (
    *("", "0", "-1", "nan", "inf", "-inf", "1e999", "1e308", "9" * 40, "9" * 5000, "0x10", "1_0"),
    *("../../../../etc/passwd", "/etc/passwd", "..", ".", "a/../../b", "a\\..\\b", "~", "con\0x"),
    *("\ud7ff\U0010ffff", "é" * 300, "a" * 5000, "[" * 1000, "%s%n", "{0.__class__}", "null"),
    *("!!python/object/apply:os.system [id]", "&a [*a]", "2001-99-99", "१२", "--", "1:2:3"),
)
_VALUES: Final[tuple[Any, ...]] = (
    *(None, True, [], {}, "", 0, -1, 1.5, 2**31, 2**63, 2**70, 10**400, 1e308, float("nan")),
    *(float("inf"), [None], [[]] * 9, {"a": {"b": []}}, [0] * 3000, "x" * 9000, *_WORDS),
)


def spoil_bytes(rng: Random, data: bytes, until: int | None = None) -> bytes:
    """One change to the bytes, of the first ``until`` if given."""
    spoiled = bytearray(data)
    end = min(len(data), until or len(data))
    at = rng.randrange(end) if end else 0
    match rng.randrange(9):
        case 0:
            del spoiled[at:]
        case 1 if spoiled:
            spoiled[at] ^= 1 << rng.randrange(8)
        case 2 if spoiled:
            spoiled[at] = rng.randrange(256)
        case 3 | 4:
            size = rng.choice((1, 2, 4, 8))
            number = rng.choice(_INTEGERS) % 256**size
            spoiled[at : at + size] = number.to_bytes(size, rng.choice(("little", "big")))
        case 5:
            spoiled[at : at + 8] = struct.pack(rng.choice("<>") + "d", rng.choice(_FLOATS))
        case 6:
            del spoiled[at : at + rng.choice((1, 2, 4, 8, 24, 64))]
        case 7:
            other = rng.randrange(end) if end else 0
            spoiled[at:at] = data[other : other + rng.choice((1, 8, 64, 512))]
        case _:
            spoiled[at:at] = rng.randbytes(rng.choice((1, 4, 8, 100)))
    return bytes(spoiled)


def spoil_text(rng: Random, data: bytes) -> bytes:
    """One word, number or line."""
    if rng.random() < 0.15:
        return spoil_bytes(rng, data)
    text = data.decode("utf-8", "replace")
    lines = text.splitlines(keepends=True)
    match rng.randrange(6):
        case 0 if lines:
            del lines[rng.randrange(len(lines))]
            text = "".join(lines)
        case 1 if lines:
            lines.insert(rng.randrange(len(lines)), rng.choice(lines))
            text = "".join(lines)
        case 2:
            separator = rng.choice(("\r", "\0", "\ufeff", "\u2028", '"', "'", "#", ",", "\t", ": "))
            at = rng.randrange(len(text) + 1)
            text = text[:at] + separator + text[at:]
        case _:
            words = list(re.finditer(r"[^\s,:{}\[\]]+", text))
            if words:
                word = rng.choice(words)
                text = text[: word.start()] + rng.choice(_WORDS) + text[word.end() :]
    return text.encode("utf-8", "surrogatepass")


def spoil_json(rng: Random, data: bytes) -> bytes:
    """One value, key or entry anywhere in the tree."""
    if rng.random() < 0.15:
        return spoil_text(rng, data)
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return spoil_text(rng, data)
    places: list[tuple[Any, Any]] = []
    stack = [tree]
    while stack and len(places) < 2000:
        node = stack.pop()
        keys = list(node) if isinstance(node, dict) else range(len(node))
        for key in keys:
            places.append((node, key))
            if isinstance(node[key], dict | list):
                stack.append(node[key])
    if not places:
        return json.dumps(rng.choice(_VALUES)).encode()
    node, key = rng.choice(places)
    match rng.randrange(6):
        case 0:
            del node[key]
        case 1 if isinstance(node, dict):
            node[rng.choice(_WORDS)] = node.pop(key)
        case 2 if isinstance(node, list):
            node.insert(key, node[key])
        case 3:
            other, where = rng.choice(places)
            if not _holds(other[where], node):
                node[key] = other[where]
        case _:
            node[key] = rng.choice(_VALUES)
    return json.dumps(tree).encode("utf-8", "surrogatepass")


def _holds(tree: Any, node: Any) -> bool:
    if tree is node:
        return True
    inner = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else ()
    return any(_holds(part, node) for part in inner)


def spoil_jpeg(rng: Random, data: bytes) -> bytes:
    """Mostly its EXIF, which stands at the beginning."""
    return spoil_bytes(rng, data, None if rng.random() < 0.2 else 700)


def spoil_png(rng: Random, data: bytes) -> bytes:
    """A chunk with a checksum that is right all the same."""
    if rng.random() < 0.3:
        return spoil_bytes(rng, data)
    chunks = []
    at = 8
    while at + 12 <= len(data):
        (size,) = struct.unpack_from(">I", data, at)
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    if not chunks:
        return spoil_bytes(rng, data)
    k = rng.randrange(len(chunks))
    kind, content = chunks[k]
    chunks[k] = (kind, spoil_bytes(rng, content) if content else rng.randbytes(4))
    if rng.random() < 0.1:
        chunks.insert(k, rng.choice(chunks))
    packed = [
        struct.pack(">I", len(content))
        + kind
        + content
        + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in chunks
    ]
    return data[:8] + b"".join(packed)


def spoil_safetensors(rng: Random, data: bytes) -> bytes:
    """Its header, of a length that is right all the same."""
    if rng.random() < 0.3:
        return spoil_bytes(rng, data)
    (size,) = struct.unpack_from("<Q", data) if len(data) >= 8 else (0,)
    header = data[8 : 8 + size]
    if rng.random() < 0.3 and b'\\"' in header:  # what is configured stands in it as text
        tree = json.loads(header)
        config = tree.get("__metadata__", {}).get("config", "{}")
        tree["__metadata__"] = {"config": spoil_json(rng, str(config).encode()).decode()}
        header = json.dumps(tree).encode()
    else:
        header = spoil_json(rng, header)
    return struct.pack("<Q", len(header)) + header + data[8 + size :]


def spoil_torch(rng: Random, data: bytes) -> bytes:
    """A file of the archive, with a checksum that is right all the same."""
    if rng.random() < 0.2:
        return spoil_bytes(rng, data)
    out = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            files = [(info.filename, archive.read(info)) for info in archive.infolist()]
    except (zipfile.BadZipFile, OSError, NotImplementedError, RuntimeError, zlib.error, EOFError):
        return spoil_bytes(rng, data)
    k = 0 if rng.random() < 0.7 else rng.randrange(len(files))
    name, content = files[k]
    files[k] = (name, spoil_bytes(rng, content))
    if rng.random() < 0.05:
        files.pop(rng.randrange(len(files)))
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files:
            archive.writestr(name, content)
    return out.getvalue()


def spoil_hdf5(rng: Random, data: bytes) -> bytes:
    """A data set, attribute or link."""
    if rng.random() < 0.25:
        return spoil_bytes(rng, data)
    buffer = io.BytesIO(data)
    try:
        with h5py.File(buffer, "r+") as file:
            names: list[str] = []
            file.visit(names.append)
            if names:
                _spoil_node(rng, file, rng.choice(names))
    except (KeyError, OSError, RuntimeError, TypeError, ValueError):
        return spoil_bytes(rng, data)
    return buffer.getvalue()


def _spoil_node(rng: Random, file: h5py.File, name: str) -> None:
    node = file[name]
    if node.attrs and rng.random() < 0.5:
        key = rng.choice(list(node.attrs))
        if rng.random() < 0.2:
            del node.attrs[key]
        else:
            node.attrs[key] = rng.choice(
                (
                    "",
                    "x" * 900,
                    "../../x",
                    -1,
                    2**63,
                    1.5,
                    np.nan,
                    [1, 2, 3],
                    h5py.Empty("f"),
                    b"\xff",
                )
            )
        return
    shape = getattr(node, "shape", None) or (3,)
    # A virtual one that a change before has damaged may be its own source, without end.
    small = isinstance(node, h5py.Dataset) and node.size and node.size < 10_000
    old = node[()] if small and not node.is_virtual else None
    del file[name]
    match rng.randrange(14):
        case 0:
            pass
        case 1:
            huge = rng.choice(((2**40,), (2**60,), (2**31, 2**31), (2**28,), (3, 2**30, 4)))
            file.create_dataset(
                name, huge, rng.choice(("f8", "u1", "i8", "S9")), chunks=(1,) * len(huge)
            )
        case 2:
            chunks = (2**30,)
            file.create_dataset(name, (2**30,), "u1", chunks=chunks, compression="gzip")
        case 3:
            file[name] = h5py.Empty(rng.choice(("f8", "i4", "S5")))
        case 4:
            file.create_group(name)
        case 5:
            file[name] = h5py.SoftLink(rng.choice((f"/{name}", "/nowhere", "/", "/names")))
        case 6:
            file[name] = h5py.ExternalLink("/etc/passwd", "/names")
        case 7:
            file.create_dataset(name, (64,), "u1", external=[("/etc/passwd", 0, 64)])
        case 8:
            layout = h5py.VirtualLayout(shape, "f8")
            layout[...] = h5py.VirtualSource("/etc/passwd", "names", shape)
            file.create_virtual_dataset(name, layout)
        case 9:
            file[name] = np.full(shape, rng.choice((np.nan, np.inf, -1, 2**53, -(2**63))))
        case 10:
            dtype = rng.choice(("f2", "c16", "?", "u8", "i1", "S1", [("a", "f8"), ("b", "S3")]))
            file[name] = np.zeros(shape, dtype)
        case 11:
            strings = np.full(shape, rng.choice(_WORDS).replace("\0", ""), object)
            file.create_dataset(name, data=strings, dtype=h5py.string_dtype())
        case 12:
            if old is not None and np.ndim(old):
                file[name] = rng.choice(
                    (old[:0], old[:-1], np.concatenate([old, old]), old[..., None], old.T)
                )
        case _:
            if old is not None:
                raw = bytearray(np.ascontiguousarray(old).tobytes())
                raw = bytearray(spoil_bytes(rng, bytes(raw)).ljust(len(raw), b"\0")[: len(raw)])
                file[name] = np.frombuffer(bytes(raw), old.dtype).reshape(old.shape)


KINDS: Final[dict[str, Mutation]] = {
    "bytes": spoil_bytes,
    "text": spoil_text,
    "json": spoil_json,
    "jpeg": spoil_jpeg,
    "png": spoil_png,
    "safetensors": spoil_safetensors,
    "torch": spoil_torch,
    "hdf5": spoil_hdf5,
}


def spoil(rng: Random, kind: str, data: bytes) -> bytes:
    """One to four changes."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        try:
            data = KINDS[kind](rng, data)
        except Exception:  # what is spoiled already cannot always be understood again
            data = spoil_bytes(rng, data)
    return data
