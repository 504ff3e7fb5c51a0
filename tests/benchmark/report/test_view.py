"""The page of a scene in a real headless Chromium, opened as a file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.report.view import SceneView, view
from objconnect.mapping.dense.workspace import Workspace
from objconnect.scene.bundle.frames import write_frames
from objconnect.scene.bundle.manifest import Objects, SceneObject, write_json
from objconnect.scene.bundle.object_points import objects_of_points
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.bundle.supplement import SUPPLEMENT, AddedPoint, Supplement
from objconnect.scene.errors import InputError
from objconnect.scene.maps.colmap_files import read_point_ids
from tests.benchmark.made_data import CAMERA, write_scene
from tests.benchmark.report.test_leaderboard import run
from tests.browser import Browser

MAGENTA = "[255, 60, 230]"
# The first object fills the left half of every photograph, the second the right half.
INSTANCE = np.where(np.arange(CAMERA.width) < CAMERA.width / 2, 1, 2).astype(np.uint16)


def add_objects(path: Path) -> int:
    """Two benches; the points of the second count as added. How many these are."""
    scene = Scene.open(path)
    frames = scene.frames("summer-nadir")
    instance = np.tile(INSTANCE, (CAMERA.height, 1))
    layers = [{"instance": instance} for _ in frames.names]
    write_frames(path / "sessions/summer-nadir/frames.h5", frames, ("instance",), iter(layers))
    benches = tuple(
        SceneObject(
            id=k, class_name="bench", centre=(10.0 * k, 0, 0), size=(2, 1, 1), yaw_deg=30,
            size_class="small",
        )
        for k in (1, 2)
    )  # fmt: skip
    write_json(path / "objects.json", Objects(classes={}, objects=benches))
    sparse_map = scene.sparse_map()
    images = [(image, instance) for image in sparse_map.images.values()]
    owners = objects_of_points(len(sparse_map.xyz), images)
    ids = read_point_ids(scene.map_path)[owners == 2].tolist()
    points = tuple(AddedPoint(id=k, object=0, confidence=0.9) for k in ids)
    write_json(scene.map_path / SUPPLEMENT, Supplement(points=points, map_sha256=""))
    return len(points)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser() as started:
        yield started


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("view") / "hamlet")


@pytest.fixture(scope="module")
def written(path: Path) -> SceneView:
    run(path, path.parent / "out", "zzz")
    add_objects(path)
    return view(path, [path.parent / "out"])


@pytest.fixture
def page(written: SceneView, browser: Browser) -> Browser:
    browser.open(written.page)
    return browser


def pixels_of(browser: Browser, colour: str) -> int:
    """How many pixels of the canvas have a colour."""
    browser.settle()
    found: int = browser.run(
        f"""(() => {{
        const wanted = {colour}, p = context.getImageData(0, 0, canvas.width, canvas.height).data;
        let count = 0;
        for (let k = 0; k < p.length; k += 4)
          if (p[k] === wanted[0] && p[k + 1] === wanted[1] && p[k + 2] === wanted[2]) count++;
        return count;
    }})()"""
    )
    return found


def is_clean(browser: Browser) -> bool:
    asked = [url for url in browser.requests if not url.startswith("data:")]
    return not browser.errors and len(asked) == 1 and asked[0].startswith("file:///")


def test_it_opens_as_a_file_and_asks_for_nothing(page: Browser, written: SceneView) -> None:
    page.settle()
    assert is_clean(page)
    assert page.texts("h1") == ["hamlet"]
    counts = [text.split("\n")[-1] for text in page.texts("#layers label")]
    assert counts == [str(written.points["sparse"]), str(written.points["added"]), "2", "3", "6"]
    assert sum(written.points.values()) == 60


def test_before_and_after_differ_by_the_added_points(page: Browser) -> None:
    assert page.texts("#figures") == ["2 of 2 small objects in the photographs have a point"]
    assert pixels_of(page, MAGENTA) > 20
    page.click("#states input[value=before]")
    assert page.texts("#figures") == ["1 of 2 small objects in the photographs have a point"]
    assert pixels_of(page, MAGENTA) == 0
    page.click("#states input[value=after]")
    assert pixels_of(page, MAGENTA) > 20
    page.click("#layers input[name=added]")
    assert pixels_of(page, MAGENTA) == 0
    assert is_clean(page)


def test_queries_stand_where_the_method_found_them(page: Browser) -> None:
    green, amber = "[55, 224, 91]", "[255, 179, 64]"
    page.click("#layers input[name=objects]")
    assert pixels_of(page, green) == pixels_of(page, amber) == 0
    # Three queries 0.1 m off and one 1 m off are found, and two without a pose are not.
    assert page.texts("#methods label")[-1].split("\n")[-1] == "4"
    assert not page.run("document.getElementById('error-key').offsetParent")
    page.click("#methods input[value=zzz]")
    assert page.texts("#error-key li")[-2] == "no pose"
    # Three queries 0.1 m off, one 1 m off, two without a pose.
    assert page.texts("#figures")[0].endswith("zzz: 4 of 6 queries have a pose, median 0.10 m off")
    assert pixels_of(page, green) > 20
    assert pixels_of(page, amber) > 20
    assert is_clean(page)


def test_colours_are_explained(page: Browser) -> None:
    assert page.texts("#object-key li") == [
        "object with a point of the map",
        "object without one",
    ]


def test_on_a_phone_the_panel_opens_on_demand(written: SceneView, browser: Browser) -> None:
    browser.open(written.page, width=390, height=844)
    assert browser.texts("h1") == ["hamlet"]
    assert not browser.run("document.getElementById('layers').offsetParent")
    browser.click("summary")
    low, height = browser.run(
        "[document.querySelector('aside').getBoundingClientRect().bottom, innerHeight]"
    )
    assert low < height
    assert browser.run("document.getElementById('layers').offsetParent !== null")
    assert is_clean(browser)


def click_at(browser: Browser, x: float, y: float) -> None:
    for kind in ("mousePressed", "mouseReleased"):
        browser.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    browser.settle()


def test_a_camera_shows_its_photograph(page: Browser) -> None:
    page.settle()
    name, x, y = page.run("(c => [c.name, ...project(view(), c.centre)])(data.cameras[2])")[:3]
    click_at(page, x, y)
    assert page.texts("#camera-name") == [name]
    page.wait("document.getElementById('photograph').naturalWidth === 96")
    before = page.run("JSON.stringify(eye)")
    page.click("#through")
    # From where it stood, the camera's own axis runs through the middle of the screen.
    x, y = page.run("(c => project(view(), c.centre.map((v, k) => v + 9 * c.ahead[k])))(chosen)")[
        :2
    ]
    assert page.run("JSON.stringify(eye)") != before
    assert abs(x - 640) < 1
    assert abs(y - 450) < 1
    page.click("#close")
    assert not page.run("document.getElementById('camera').offsetParent")
    assert is_clean(page)


def test_it_turns_and_zooms_by_hand_and_by_keys(page: Browser) -> None:
    page.run("canvas.focus()")
    yaw, distance = page.run("[eye.yaw, eye.distance]")
    page.send("Input.dispatchKeyEvent", type="keyDown", key="ArrowRight")
    page.press("+")
    assert page.run("eye.yaw") > yaw
    assert page.run("eye.distance") < distance
    page.send("Input.dispatchMouseEvent", type="mouseWheel", x=900, y=400, deltaX=0, deltaY=500)
    page.wait(f"eye.distance > {0.8 * distance}")
    assert is_clean(page)


def test_of_many_points_a_stated_number_is_drawn(
    path: Path,
    written: SceneView,
    browser: Browser,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setitem(view.__globals__["MOST_POINTS"], "sparse", 20)
    found = view(path, out=tmp_path / "few.html")
    assert found.picture == tmp_path / "few.png"
    browser.open(found.page)
    total = found.points["sparse"]
    assert total > 20
    said = browser.texts("#bounds")
    assert said == [f"20 of {total} points of the map are drawn, chosen at random."]
    assert browser.run("clouds[0].xyz.length") == 60


def test_points_keep_their_place(path: Path, written: SceneView, page: Browser) -> None:
    scene = Scene.open(path)
    sparse_map = scene.sparse_map()
    xyz = sparse_map.xyz[~scene.is_added_point(sparse_map)]
    drawn = np.array(page.run("[...clouds[0].xyz]")).reshape(-1, 3)
    assert np.abs(drawn - xyz).max() < 1e-3


def test_the_picture_shows_something(written: SceneView) -> None:
    with Image.open(written.picture) as image:
        assert image.width > 1.8 * image.height  # before and after
        assert len(np.unique(np.asarray(image.convert("L")))) > 20


def test_mistakes_are_named(path: Path, written: SceneView, tmp_path: Path) -> None:
    results = path.parent / "out" / "hamlet" / "zzz.json"
    other = tmp_path / "other.json"
    other.write_text(results.read_text().replace("winter-grid/images/000002", "elsewhere/x"))
    with pytest.raises(InputError, match="no photograph elsewhere/x"):
        view(path, [other])
    with pytest.raises(InputError, match="must end in .html"):
        view(path, out=tmp_path / "page.png")
    answer = CliRunner().invoke(
        app, ["view", str(path), "--out", str(tmp_path / "v.html"), "--json"]
    )
    assert json.loads(answer.stdout)["points"] == written.points


def test_a_fused_cloud_is_read_or_refused(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path)
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nend_header\n"
    body = np.array([1, 2, 3, 0, 0, 1], "<f4").tobytes() + bytes([9, 8, 7])
    workspace.cloud.write_bytes(head + body)
    xyz, rgb = workspace.read_cloud()
    assert xyz.tolist() == [[1, 2, 3]]
    assert rgb.tolist() == [[9, 8, 7]]
    workspace.cloud.write_bytes(head + body[:-1])
    with pytest.raises(InputError, match=r"fused.ply is damaged"):
        workspace.read_cloud()
