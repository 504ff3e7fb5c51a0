"""AerialExtreMatch-Localization in its published layout, made of a place on earth.

No file of the data set itself is in these tests.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from PIL import Image

from benchmark.datasets.open import open_datasets
from benchmark.results.results_files import load
from objconnect.ingestion.virtual.command import photograph_orthophoto
from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.mapping.build import build_map
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import enu_from_geodetic, geodetic_from_enu
from objconnect.scene.geometry.pose import Pose
from tests.benchmark.test_cli import invoke
from tests.objconnect.scene.geo.made_site import ORIGIN, cast, colour, down_from, rasters

# This grid is turned by 0.7 degrees against north there.
CRS = "EPSG:32632"
CAMERA = Camera("PINHOLE", 320, 320, (300.0, 300.0, 160.0, 160.0))
POSES = {"DJI_0001": down_from(-3.0, 2.0, 22.0, 8.0), "DJI_0002": down_from(4.0, 3.0, 24.0)}
UNDULATION = 47.5

Array = NDArray[np.float64]


def grid_line(name: str, cam_from_world: Array, digits: int = 16) -> str:
    """The line of a pose in the grid, by the grid coordinates of points along the camera's axes."""
    projection = Projection(CRS)
    rotation, translation = cam_from_world[:3, :3], cam_from_world[:3, 3]
    centre = -rotation.T @ translation
    points = [centre, *(centre + 20 * axis for axis in rotation)]
    grid = np.array([projection.from_geodetic(geodetic_from_enu(p, ORIGIN)) for p in points])
    grid[:, 2] -= UNDULATION
    left, _, right = np.linalg.svd(grid[1:] - grid[0])
    turned = np.eye(4)
    turned[:3, :3], turned[:3, 3] = left @ right, -left @ right @ grid[0]
    pose = Pose.from_matrix(turned)
    numbers = [*pose.quaternion().tolist(), *pose.translation.tolist()]
    return " ".join([name, *(f"{x:.{digits}f}" for x in numbers)]) + "\n"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The download, with a map of the lower quality."""
    path = tmp_path_factory.mktemp("data") / "AerialExtreMatch-Localization"
    quality = path / "LQref"
    quality.mkdir(parents=True)
    ortho, dsm = rasters(quality, CRS)
    ortho.rename(quality / "DOM.tif")
    dsm.rename(quality / "DSM.tif")
    with rasterio.open(quality / "DSM.tif", "r+") as file:
        file.write(file.read(1) - np.float32(UNDULATION), 1)
    photograph_orthophoto(
        quality / "DOM.tif",
        quality / "DSM.tif",
        quality / "map",
        undulation=UNDULATION,
        options=ViewOptions(altitude=26, overlap=0.5, size=256),
    )
    build_map(quality / "map")
    (path / "rgb").mkdir()
    for name, pose in POSES.items():
        _, points = cast(CAMERA, pose)
        seen = np.rint(colour(points[..., 0], points[..., 1])).astype(np.uint8)
        Image.fromarray(seen).save(path / "rgb" / f"{name}.JPG", quality=95)
    write_lists(path)
    return path


def write_lists(path: Path) -> None:
    off = {name: down_from(1.0, 1.0, 23.0) for name in POSES}
    for file, poses in (("gt_pose.txt", POSES), ("pose.txt", off)):
        (path / file).write_text("".join(grid_line(f"{n}.JPG", p) for n, p in poses.items()))
    (path / "intrinsic.txt").write_text("".join(f"{name}.JPG {CAMERA}\n" for name in POSES))


@pytest.fixture
def data(made: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    shutil.copytree(made, tmp_path / made.name, copy_function=shutil.copy)
    return tmp_path / made.name


def test_poses_are_those_of_the_place(made: Path) -> None:
    (dataset,) = open_datasets(made)
    assert (dataset.name, dataset.track) == ("aerialextrematch-LQref", "flight")
    assert [query.name for query in dataset.queries] == ["DJI_0001.JPG", "DJI_0002.JPG"]
    origin = Scene.open(made / "LQref" / "map").manifest.origin
    for query in dataset.queries:
        expected = Pose.from_matrix(POSES[Path(query.name).stem])
        place = geodetic_from_enu(query.reference.centre().numpy(), origin)
        off = enu_from_geodetic(place, ORIGIN) - expected.centre().numpy()
        assert np.abs(off).max() < 2e-3
        _, degrees = query.reference.error_to(expected)
        assert float(degrees) < 2e-3
        prior = query.prior
        assert prior is not None and prior.cam_from_world_rotation is not None
        assert prior.position_sigma is None and prior.attitude_sigma_deg is None
        away = np.linalg.norm(prior.position - query.reference.centre().numpy())
        assert 1 < away < 8


def test_photographs_agree_with_the_map(made: Path, tmp_path: Path) -> None:
    """SIFT finds the reference poses, so no axis, order or height is mistaken."""
    out = tmp_path / "out"
    result = invoke("evaluate", made, "--method", "sift", "--start", "none", "--out", out)
    assert result.exit_code == 0, result.stderr
    (dataset,) = open_datasets(made)
    scored = load(out / dataset.name / "sift.json").queries
    assert [query.t_err_m is not None and query.t_err_m < 0.1 for query in scored] == [True] * 2


def test_rounded_quaternions_are_refused(data: Path) -> None:
    """At 5 000 km from the origin of the grid, seven digits leave half a metre open."""
    lines = "".join(grid_line(f"{name}.JPG", pose, 6) for name, pose in POSES.items())
    (data / "gt_pose.txt").write_text(lines)
    with pytest.raises(InputError, match=r"gt_pose.txt:1: DJI_0001.JPG: the quaternion has too"):
        open_datasets(data)


def test_positions_elsewhere_are_refused(data: Path) -> None:
    """As when poses are in another system than the surface model."""
    (data / "gt_pose.txt").write_text("DJI_0001.JPG 0 1 0 0 1 2 3\n")
    with pytest.raises(InputError, match=r"gt_pose.txt: DJI_0001.JPG: at this position a metre"):
        open_datasets(data)


def test_poses_cut_at_the_end_of_a_line_are_refused(data: Path) -> None:
    first, _ = (data / "gt_pose.txt").read_text().splitlines(keepends=True)
    (data / "gt_pose.txt").write_text(first)
    message = r"gt_pose.txt has no pose of DJI_0002, but intrinsic.txt and rgb have it: download"
    with pytest.raises(InputError, match=message):
        open_datasets(data)
    (data / "intrinsic.txt").write_text(f"DJI_0001.JPG {CAMERA}\n")
    (dataset,) = open_datasets(data)
    assert [query.name for query in dataset.queries] == ["DJI_0001.JPG"]


def test_without_a_map_the_command_is_named(data: Path, tmp_path: Path) -> None:
    shutil.rmtree(data / "LQref" / "map")
    result = invoke("evaluate", data, "--method", "sift", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 1
    assert f"objconnect map --ortho {data}/LQref/DOM.tif" in result.stderr


def test_faults_are_named(data: Path) -> None:
    (data / "pose.txt").unlink()
    assert {query.prior for query in open_datasets(data)[0].queries} == {None}
    (data / "LQref" / "DSM.tif").rename(data / "elsewhere.tif")
    with pytest.raises(InputError, match=r"LQref/DSM.tif"):
        open_datasets(data)
    (data / "elsewhere.tif").rename(data / "LQref" / "DSM.tif")
    (data / "rgb" / "DJI_0002.JPG").unlink()
    with pytest.raises(InputError, match=r"rgb has no DJI_0002, but .*gt_pose.txt has its pose"):
        open_datasets(data)
    (data / "intrinsic.txt").write_text(f"DJI_0001.JPG {CAMERA}\n")
    with pytest.raises(InputError, match=r"intrinsic.txt has no DJI_0002"):
        open_datasets(data)
    (data / "gt_pose.txt").write_text("")
    with pytest.raises(InputError, match=r"gt_pose.txt holds no pose"):
        open_datasets(data)
