"""Faults of files and folders, by format. Each takes the path of an existing one."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np
from PIL import Image

Spoil = Callable[[Path], object]
Faults = Mapping[str, Spoil]

LONG = "n" * 300
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join(['*' + a] * 9)}]\n"
    for a, b in zip("abcdefghij", "bcdefghijk", strict=True)
)


def _clear(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif os.path.lexists(path):
        path.unlink()


def _replace(make: Spoil) -> Spoil:
    def spoil(path: Path) -> None:
        _clear(path)
        make(path)

    return spoil


def _edit(edit: Callable[[bytes], bytes]) -> Spoil:
    def spoil(path: Path) -> None:
        before = path.read_bytes()
        after = edit(before)
        assert after != before, f"the fault changes nothing in {path}"
        path.write_bytes(after)

    return spoil


def _text(edit: Callable[[str], str]) -> Spoil:
    return _edit(lambda data: edit(data.decode()).encode("utf-8", "surrogateescape"))


def _socket(path: Path) -> None:
    """Bound by a short relative name: the system allows no more than 108 bytes."""
    here = Path.cwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    finally:
        os.chdir(here)


def _cycle(path: Path) -> None:
    path.symlink_to(path.name)


def _garbage(data: bytes) -> bytes:
    return Random(len(data)).randbytes(max(len(data), 64))


# What may stand in the place of any file or folder.
ABSENT: Faults = {
    "missing": _clear,
    "dangling_link": _replace(lambda path: path.symlink_to("nowhere")),
    "cyclic_link": _replace(_cycle),
    "fifo": _replace(os.mkfifo),
    "socket": _replace(_socket),
}
NO_FILE: Faults = {
    **ABSENT,
    "folder": _replace(lambda path: path.mkdir()),
    "endless": _replace(lambda path: path.symlink_to("/dev/zero")),
}
NO_FOLDER: Faults = {
    **ABSENT,
    "file": _replace(lambda path: path.write_text("no folder\n")),
    "empty_folder": _replace(lambda path: path.mkdir()),
}
EMPTY: Faults = {"empty": _edit(lambda data: b"")}
BYTES: Faults = {
    **EMPTY,
    "truncated": _edit(lambda data: data[: len(data) // 2]),
    "zeroed": _edit(lambda data: bytes(len(data))),
    "garbage": _edit(_garbage),
    "text": _edit(lambda data: b"this is a text\n"),
}
TEXT: Faults = {
    **EMPTY,
    "not_utf8": _edit(lambda data: data + b"\xff\xfe\xe4\n"),
    "utf16": _edit(lambda data: data.decode().encode("utf-16")),
    "nul": _edit(lambda data: data.rstrip(b"\n") + b"\0\n"),
    "garbage": _edit(_garbage),
}
# What a spreadsheet or another system adds, and nobody sees.
HARMLESS_TEXT: Faults = {
    "bom": _edit(lambda data: b"\xef\xbb\xbf" + data),
    "crlf": _edit(lambda data: data.replace(b"\n", b"\r\n")),
    "blank_lines": _edit(lambda data: data + b"\n\n"),
}


def number(becomes: str) -> Spoil:
    """The last number of the last line becomes something else."""

    def edit(text: str) -> str:
        head, _, last = text.rstrip("\n").rpartition("\n")
        return f"{head}\n{re.sub(r'[-+.0-9e]+$', becomes, last)}\n"

    return _text(edit)


NUMBERS: Faults = {
    "nan": number("nan"),
    "inf": number("inf"),
    "word": number("west"),
    "huge": number("1e999"),
    "no_number": number(""),
}


def _columns(text: str) -> str:
    return "".join(f"{line} 1.5\n" for line in text.splitlines())


WORDS: Faults = {
    **TEXT,
    **NUMBERS,
    "columns": _text(_columns),
    "twice": _text(lambda text: text + text.rstrip("\n").splitlines()[-1] + "\n"),
}


def _header(edit: Callable[[str], str]) -> Spoil:
    def change(text: str) -> str:
        first, _, rest = text.partition("\n")
        return f"{edit(first)}\n{rest}"

    return _text(change)


CSV: Faults = {
    **TEXT,
    **NUMBERS,
    "no_header": _text(lambda text: text.partition("\n")[2]),
    "lacks_column": _header(lambda line: line.rpartition(",")[0]),
    "column_twice": _header(lambda line: f"{line},{line.split(',')[1]}"),
    "too_many": _text(lambda text: text.rstrip("\n") + ",1,2,3\n"),
    "stray_quote": _text(lambda text: text.replace(",", ',"', 1) + "x" * 200_000 + "\n"),
    "twice": _text(lambda text: text + text.rstrip("\n").splitlines()[-1] + "\n"),
}
JSON: Faults = {
    **TEXT,
    "truncated": _edit(lambda data: data[: len(data) // 2]),
    "list": _edit(lambda data: b"[1, 2]"),
    "null": _edit(lambda data: b"null"),
    "word": _edit(lambda data: b'"all is well"'),
    "no_keys": _edit(lambda data: b"{}"),
    "deep": _edit(lambda data: b"[" * 100_000),
}
# Of our own files, whose keys are known.
OUR_JSON: Faults = {
    **JSON,
    "unknown_key": _text(lambda text: text.replace("{", '{"colour": "red", ', 1)),
}


def _edit_json(edit: Callable[[Any], object]) -> Spoil:
    """An edit by hand of a JSON file."""

    def change(text: str) -> str:
        value = json.loads(text)
        edit(value)
        return json.dumps(value)

    return _text(change)


RESULTS: Faults = {
    **OUR_JSON,
    "unknown_schema": _edit_json(lambda r: r.update(schema=99)),
    "no_schema": _edit_json(lambda r: r.pop("schema")),
    "nan": _edit_json(lambda r: r["queries"][0].update(t_err_m=float("nan"))),
    "recall_is_text": _edit_json(lambda r: r["summary"]["recall"].update({"0.5m_5deg": "all"})),
    "better_recall": _edit_json(
        lambda r: r["summary"]["recall"].update({"5m_10deg": {"value": 99, "low": 9, "high": 99}})
    ),
    "query_twice": _edit_json(lambda r: r["queries"].append(r["queries"][0])),
    "no_query": _edit_json(lambda r: r["queries"].clear()),
    "fewer_queries": _edit_json(lambda r: r["queries"].pop()),
    "status": _edit_json(lambda r: r["queries"][0].update(status="great")),
    "negative_error": _edit_json(lambda r: r["queries"][0].update(t_err_m=-1.0)),
    "huge_pose": _edit_json(lambda r: r["queries"][0].update(cam_from_world=[1e308] * 7)),
    "no_method": _edit_json(lambda r: r.pop("method")),
    "name_is_path": _edit_json(lambda r: r["dataset"].update(name="../../x")),
}


def _rename(key: str, name: str) -> Callable[[Any], object]:
    """The first entry of a dictionary gets another name."""

    def edit(value: Any) -> None:
        value[key] = {name: next(iter(value[key].values()))}

    return edit


MANIFEST: Faults = {
    **OUR_JSON,
    "unknown_schema": _edit_json(lambda m: m.update(schema=99)),
    "no_session": _edit_json(lambda m: m["sessions"].clear()),
    "session_leaves": _edit_json(_rename("sessions", "../../mine")),
    "beyond_the_pole": _edit_json(lambda m: m["origin"].__setitem__(0, 999)),
    "huge_origin": _edit_json(lambda m: m["origin"].__setitem__(2, 1e308)),
}
SPLITS: Faults = {
    **OUR_JSON,
    "name_leaves": _edit_json(lambda s: s.update(map=["../../mine/notes.txt"])),
    "number": _edit_json(lambda s: s.update(map=[7])),
}


def _edit_hdf5(edit: Callable[[h5py.File], object]) -> Spoil:
    def spoil(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            edit(file)

    return spoil


def _put(name: str, value: Callable[[Any], Any]) -> Callable[[h5py.File], object]:
    """A data set gets other values."""

    def edit(file: h5py.File) -> None:
        before = file[name][()]
        del file[name]
        file[name] = value(before)

    return edit


FRAMES: Faults = {
    **BYTES,
    "no_poses": _edit_hdf5(lambda file: file.pop("cam_from_world")),
    "nan_pose": _edit_hdf5(_put("cam_from_world", lambda poses: poses * np.nan)),
    "huge_pose": _edit_hdf5(
        _put("cam_from_world", lambda poses: np.where(poses > 9, 1e308, poses))
    ),
    "fewer_poses": _edit_hdf5(_put("cam_from_world", lambda poses: poses[1:])),
    "poses_of_text": _edit_hdf5(
        _put("cam_from_world", lambda poses: np.full(poses.shape, b"west"))
    ),
    "name_leaves": _edit_hdf5(_put("names", lambda names: np.array([b"../../mine"] * len(names)))),
    "name_twice": _edit_hdf5(_put("names", lambda names: np.array([names[0]] * len(names)))),
    "no_such_camera": _edit_hdf5(_put("camera_index", lambda index: np.asarray(index) + 99)),
    "camera_of_text": _edit_hdf5(_put("cameras", lambda _: np.array([b"a camera"]))),
}
YAML: Faults = {
    **{name: spoil for name, spoil in TEXT.items() if name != "empty"},
    "broken": _edit(lambda data: data + b"\n x: [1, {\n"),
    "list": _edit(lambda data: b"- 1\n- 2\n"),
    "word": _edit(lambda data: b"all is well\n"),
    "bomb": _edit(lambda data: BOMB.encode()),
    "cycle": _edit(lambda data: b"a: &a [*a]\n"),
    "python": _edit(lambda data: b"!!python/object/apply:os.getcwd []\n"),
    "deep": _edit(lambda data: b"a: " + b"[" * 1000),  # with more, PyYAML takes a second
    "date": _edit(lambda data: b"a: 2001-99-99\n"),
    "unknown_key": _edit(lambda data: data + b"\ncolour: red\n"),
}


def _picture(mode: str, size: tuple[int, int], file_format: str) -> bytes:
    stream = io.BytesIO()
    picture = np.zeros((size[1], size[0]), np.uint16 if mode == "I;16" else np.uint8)
    Image.fromarray(picture).convert(mode if mode != "I;16" else None).save(stream, file_format)
    return stream.getvalue()


def _bomb(data: bytes) -> bytes:
    """A picture that says that it has 65500 x 65500 pixels."""
    at = data.find(b"\xff\xc0")
    if at < 0:
        at = data.find(b"\xff\xc2")
    return data[: at + 5] + b"\xff\xdc\xff\xdc" + data[at + 9 :]


PHOTOGRAPH: Faults = {
    **BYTES,
    "bomb": _edit(_bomb),
    # A whole picture, and yet not what the camera took.
    "one_pixel": _edit(lambda data: _picture("L", (1, 1), "JPEG")),
}
FORMATS: Mapping[str, Faults] = {
    "bytes": BYTES,
    "csv": CSV,
    "json": JSON,
    "our json": OUR_JSON,
    "frames": FRAMES,
    "manifest": MANIFEST,
    "results": RESULTS,
    "splits": SPLITS,
    "photograph": PHOTOGRAPH,
    "words": WORDS,
    "yaml": YAML,
}
