"""The import arrows of the project, held by reading every module.

Packages: ``benchmark -> baselines -> objconnect``, ``simulate -> objconnect`` and
``benchmark -> simulate``. Rooms of ``objconnect``: ``mapping -> network -> localization ->
learning, ingestion -> scene``.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.robustness.misuse.world import make_scene

ROOT = Path(__file__).parents[1]
ALLOWED = {
    "objconnect": set(),
    "simulate": {"objconnect"},
    "baselines": {"objconnect"},
    "benchmark": {"baselines", "simulate", "objconnect"},
}
# The rooms of the library, and which of them each may use; modules beside them may use all.
LIBRARY: dict[str, set[str]] = {
    "scene": set(),
    "ingestion": {"scene"},
    "learning": {"scene"},
    "localization": {"learning", "ingestion", "scene"},
    "network": {"localization", "learning", "scene"},
    "mapping": {"network", "localization", "learning", "ingestion", "scene"},
}
# The rooms of the simulator; what stands on its top floor may use them all.
ROOMS = {
    "place": set(),
    "look": {"place"},
    "flight": {"place"},
    "camera": set(),
    "twin": {"place", "look"},
    "render": {"place", "look", "camera"},
}
# Libraries that one module or room alone may speak to.
ADAPTERS = {
    "bpy": "simulate.render.blender",
    "bmesh": "simulate.render.blender",
    "mathutils": "simulate.render.blender",
    "pycolmap": "objconnect.scene.colmap",
    "ray": "objconnect.scene.runtime.cluster",
    "pymavlink": "objconnect.localization.pipeline.mavlink",
    "pyproj": "objconnect.scene.geo.crs",
    "rerun": "objconnect.scene.exports.rerun",
    "rosbags": "objconnect.localization.pipeline.ros",
    "av": "objconnect.scene.storage.video",
    "srt": "objconnect.scene.storage.subtitles",
    "rasterio": "objconnect.scene.geo.rasters",
}


def modules(package: str) -> dict[str, ast.Module]:
    """Every module of a package by its dotted name."""
    found = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = ast.parse(path.read_text(encoding="utf-8"), str(path))
    return found


ALL = {name: tree for package in ALLOWED for name, tree in modules(package).items()}


def list_imported(statement: ast.AST) -> Iterator[str]:
    """Dotted names a statement imports; for ``from a import b`` both ``a`` and ``a.b``."""
    if isinstance(statement, ast.Import):
        yield from (alias.name for alias in statement.names)
    elif isinstance(statement, ast.ImportFrom):
        assert not statement.level, "imports of the project are absolute"
        assert statement.module is not None
        yield statement.module
        yield from (f"{statement.module}.{alias.name}" for alias in statement.names)
    elif isinstance(statement, ast.Call) and ast.unparse(statement.func) == "import_extra":
        yield ast.literal_eval(statement.args[0])


@cache
def imports_anywhere(tree: ast.Module) -> set[str]:
    return {name for statement in ast.walk(tree) for name in list_imported(statement)}


def imports_when_loaded(tree: ast.AST) -> set[str]:
    """Imports outside functions and outside ``if TYPE_CHECKING``."""
    found: set[str] = set()
    for statement in ast.iter_child_nodes(tree):
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(statement, ast.If) and "TYPE_CHECKING" in ast.unparse(statement.test):
            continue
        found |= set(list_imported(statement)) | imports_when_loaded(statement)
    return found


def test_every_package_is_read() -> None:
    assert set(ALLOWED) == {name.split(".")[0] for name in ALL}
    assert {
        "objconnect.scene.geometry.pose",
        "objconnect.localization.matching.sift",
        "benchmark.cli",
    } <= set(ALL)


@pytest.mark.parametrize("package", ALLOWED)
def test_arrows_run_one_way(package: str) -> None:
    forbidden = set(ALLOWED) - ALLOWED[package] - {package}
    wrong = {
        (name, target)
        for name, tree in ALL.items()
        if name.split(".")[0] == package
        for target in imports_anywhere(tree)
        if target.split(".")[0] in forbidden
    }
    assert not wrong


@pytest.mark.parametrize(
    ("package", "room", "others"),
    [
        *(("simulate", room, others) for room, others in ROOMS.items()),
        *(("objconnect", room, others) for room, others in LIBRARY.items()),
    ],
)
def test_rooms_run_one_way(package: str, room: str, others: set[str]) -> None:
    allowed = {f"{package}.{other}" for other in others | {room}}
    wrong = {
        (name, target)
        for name, tree in ALL.items()
        if name.startswith(f"{package}.{room}.")
        for target in imports_anywhere(tree) & set(ALL) - {package}
        if target.startswith(f"{package}.") and ".".join(target.split(".")[:2]) not in allowed
    }
    assert not wrong


def test_every_room_of_the_library_has_its_arrows() -> None:
    rooms = {path.parent.name for path in (ROOT / "objconnect").glob("*/__init__.py")}
    assert rooms == set(LIBRARY)


@pytest.mark.parametrize("library", ADAPTERS)
def test_one_module_speaks_to(library: str) -> None:
    users = {
        name
        for name, tree in ALL.items()
        if any(target.split(".")[0] == library for target in imports_anywhere(tree))
    }
    allowed = ADAPTERS[library]

    assert all(name == allowed or name.startswith(f"{allowed}.") for name in users)


def test_there_is_no_circle() -> None:
    """No file needs itself through others, not even inside functions or for annotations alone."""
    graph = {
        name: {target for target in imports_anywhere(tree) if target in ALL and target != name}
        for name, tree in ALL.items()
    }
    try:
        order = list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(f"modules import one another: {' -> '.join(error.args[1])}")
    assert set(order) == set(ALL)


def list_loaded_by(names: list[str]) -> set[str]:
    """Top-level modules in memory after importing ``names`` in a process of their own."""
    lines = [f"import {name}" for name in names]
    code = "\n".join([*lines, "import sys", "print(*{m.split('.')[0] for m in sys.modules})"])
    answer = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return set(answer.stdout.split())


def test_blender_is_loaded_by_nobody_who_does_not_render() -> None:
    names = [name for name in ALL if not name.startswith("simulate")]
    loaded = list_loaded_by(names)
    assert {"baselines", "objconnect", "benchmark"} <= loaded
    assert not {"bpy", "mathutils"} & loaded


def test_the_library_loads_no_other_package() -> None:
    loaded = list_loaded_by([name for name in ALL if name.startswith("objconnect")])
    assert not (set(ALLOWED) - {"objconnect"}) & loaded


# Libraries that take seconds to import.
HEAVY = {"torch", "pycolmap", "cv2", "matplotlib"}


@pytest.mark.parametrize("name", ["objconnect.scene.bundle.scene", "benchmark.cli"])
def test_module_loads_no_heavy_library(name: str) -> None:
    assert not HEAVY & list_loaded_by([name])


def test_scene_is_opened_without_heavy_libraries(tmp_path: Path) -> None:
    make_scene(tmp_path / "hamlet")
    code = (
        "import sys\n"
        "from pathlib import Path\n"
        "from objconnect.scene.bundle.scene import Scene\n"
        "scene = Scene.open(Path(sys.argv[1]))\n"
        "assert scene.manifest.origin.altitude == scene.manifest.origin[2]\n"
        "assert scene.splits.map and scene.objects.objects and scene.covisibility.names\n"
        "for session in scene.sessions:\n"
        "    frames = scene.frames(session)\n"
        "    assert frames.cam_from_world.shape == (len(frames.names), 4, 4)\n"
        "    assert frames.cameras[0].calibration.shape == (3, 3)\n"
        "    assert frames.has_gps.shape == (len(frames),)\n"
        f"print(*sorted({HEAVY!r} & set(sys.modules)))\n"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "hamlet")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    assert not answer.stdout.split()


def test_nobody_asks_what_time_it_is() -> None:
    """What is done and what is left follows from files that are there, never from a clock, which
    may be set back: durations alone are measured, by a counter that only rises.

    ``storage.digests`` alone may look at the times of files, as a part of their identity: a
    file with other times is another file, whichever is later. It asks for the time in order to
    doubt a file that has just changed; a wrong clock makes it read files again, or trust one that
    changes twice within a tick of its file system.
    """
    clocks = {
        "time.time",
        "time.time_ns",
        "datetime.now",
        "datetime.utcnow",
        "datetime.today",
        "date.today",
    }
    times = {"st_mtime", "st_mtime_ns", "st_ctime", "st_ctime_ns", "st_atime", "st_atime_ns"}
    asked = {
        (name, ast.unparse(node))
        for name, tree in ALL.items()
        if name != "objconnect.scene.storage.digests"
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and (ast.unparse(node) in clocks or node.attr in times)
    }
    assert not asked
