"""Imports between packages and between subpackages have one direction; every module is read.

Packages: ``benchmark -> baselines -> objconnect``, ``simulate -> objconnect`` and
``benchmark -> simulate``. Subpackages (rooms) of ``objconnect``: ``mapping -> network ->
localization -> learning, ingestion -> scene``.
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
    "thermal": {"place", "look"},
    "render": {"place", "look", "camera", "thermal"},
}
# Libraries that only one module or room may import.
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
    "kornia": "baselines.lightglue.networks",
    "srt": "objconnect.scene.storage.subtitles",
    "rasterio": "objconnect.scene.geo.rasters",
    "pyarrow": "benchmark.publishing.shards",
    "huggingface_hub": "objconnect.scene.storage.hub",
}


def modules(package: str) -> dict[str, Path]:
    """Every module of a package by its dotted name."""
    found = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


ALL = {name: path for package in ALLOWED for name, path in modules(package).items()}


@cache
def parse(name: str) -> ast.Module:
    """The syntax tree of a module. Parsing all takes seconds, so collection must not do it."""
    return ast.parse(ALL[name].read_text(encoding="utf-8"), str(ALL[name]))


def list_imported(statement: ast.AST) -> Iterator[str]:
    """Dotted names a statement imports; for ``from a import b`` both ``a`` and ``a.b``."""
    if isinstance(statement, ast.Import):
        yield from (alias.name for alias in statement.names)
    elif isinstance(statement, ast.ImportFrom):
        assert not statement.level, "imports of the project are absolute"
        assert statement.module is not None
        yield statement.module
        yield from (f"{statement.module}.{alias.name}" for alias in statement.names)
    elif (
        isinstance(statement, ast.Call)
        and isinstance(statement.func, ast.Name)
        and statement.func.id == "import_extra"
    ):
        yield ast.literal_eval(statement.args[0])


@cache
def imports_anywhere(name: str) -> set[str]:
    """Imports of a module, also inside functions."""
    return {imported for node in ast.walk(parse(name)) for imported in list_imported(node)}


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


def list_loaded_with(name: str) -> set[str]:
    """Modules of ours that are loaded with one of them, itself and the packages around it too."""
    found: set[str] = set()
    ahead = [name]
    while ahead:
        each = ahead.pop()
        if each in ALL and each not in found:
            found.add(each)
            ahead += imports_when_loaded(parse(each))
            ahead.append(each.rpartition(".")[0])
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
        for name in ALL
        if name.split(".")[0] == package
        for target in imports_anywhere(name)
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
        for name in ALL
        if name.startswith(f"{package}.{room}.")
        for target in imports_anywhere(name) & set(ALL) - {package}
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
        for name in ALL
        if any(target.split(".")[0] == library for target in imports_anywhere(name))
    }
    allowed = ADAPTERS[library]

    assert all(name == allowed or name.startswith(f"{allowed}.") for name in users)


def test_there_is_no_circle() -> None:
    """No file needs itself through others, not even inside functions or for annotations alone."""
    graph = {
        name: {target for target in imports_anywhere(name) if target in ALL and target != name}
        for name in ALL
    }
    try:
        order = list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(f"modules import one another: {' -> '.join(error.args[1])}")
    assert set(order) == set(ALL)


def list_loaded_by(*parts: list[str]) -> list[set[str]]:
    """Top-level modules in memory after importing each of the parts in a process of their own."""
    show = "print(*{m.split('.')[0] for m in sys.modules})"
    lines = [line for names in parts for line in (*(f"import {name}" for name in names), show)]
    answer = subprocess.run(
        [sys.executable, "-c", "\n".join(["import sys", *lines])],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return [set(line.split()) for line in answer.stdout.splitlines()]


@pytest.fixture(scope="module")
def loaded() -> tuple[set[str], set[str]]:
    """Top-level modules in memory after the library is imported, then all but the simulator."""
    library = [name for name in ALL if name.startswith("objconnect")]
    others = [name for name in ALL if not name.startswith(("objconnect", "simulate"))]
    first, second = list_loaded_by(library, others)
    return first, second


def test_blender_is_loaded_by_nobody_who_does_not_render(
    loaded: tuple[set[str], set[str]],
) -> None:
    assert {"baselines", "objconnect", "benchmark"} <= loaded[1]
    assert not {"bpy", "mathutils"} & loaded[1]


def test_the_library_loads_no_other_package(loaded: tuple[set[str], set[str]]) -> None:
    assert not (set(ALLOWED) - {"objconnect"}) & loaded[0]


# Libraries that take seconds to import.
HEAVY = {"torch", "pycolmap", "cv2", "matplotlib"}


def test_the_doctor_loads_nothing_that_may_be_missing() -> None:
    """Its requirements load in processes of their own."""
    (loaded,) = list_loaded_by(["benchmark.doctor"])
    assert not {"typer", "pydantic", "numpy", "h5py", *HEAVY} & loaded


@pytest.mark.parametrize(
    "name", ["objconnect.scene.bundle.scene", "benchmark.cli", "benchmark.regression"]
)
def test_module_loads_no_heavy_library(name: str) -> None:
    (loaded,) = list_loaded_by([name])
    assert not HEAVY & loaded


@pytest.mark.parametrize(
    "name",
    [
        "benchmark.report.board.command",
        "benchmark.evaluation.evaluate",
        "objconnect.ingestion.command",
        "objconnect.learning.training.command",
        "objconnect.localization.pipeline.localize",
    ],
)
def test_matplotlib_is_loaded_where_pictures_are_drawn(name: str) -> None:
    """It takes half a second of every command, also of one that ends with an error."""
    loaded = list_loaded_with(name)
    assert len(loaded) > 20
    drawing = {each for each in loaded if "matplotlib.figure" in imports_when_loaded(parse(each))}
    assert not drawing


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
    called = {clock.rpartition(".")[2] for clock in clocks}
    times = {"st_mtime", "st_mtime_ns", "st_ctime", "st_ctime_ns", "st_atime", "st_atime_ns"}
    asked = {
        (name, ast.unparse(node))
        for name in ALL
        if name != "objconnect.scene.storage.digests"
        for node in ast.walk(parse(name))
        if isinstance(node, ast.Attribute)
        and (node.attr in times or (node.attr in called and ast.unparse(node) in clocks))
    }
    assert not asked
