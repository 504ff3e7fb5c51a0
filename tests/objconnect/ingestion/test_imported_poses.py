"""Scenes whose poses other programs have found."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from benchmark.auditing.command import audit
from benchmark.datasets.open import open_datasets
from objconnect.ingestion.command import ingest
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.exports.export import export
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import ecef_from_geodetic, enu_axes

pytestmark = pytest.mark.usefixtures("extracted_once")

SESSION = "summer-noon-nadir-map"


def photographs_of(rendered: Scene) -> Path:
    return rendered.images_root / SESSION / "images"


def geocentric(scene: Scene, session: str) -> dict[str, np.ndarray]:
    """Camera centres and axes in geocentric metres by file name: (3, 4)."""
    origin, frames = scene.manifest.origin, scene.frames(session)
    found = {}
    for name, pose in zip(frames.names, frames.cam_from_world, strict=True):
        world_from_cam = np.linalg.inv(pose)[:3]
        moved = enu_axes(origin).T @ world_from_cam
        moved[:, 3] += ecef_from_geodetic(origin)
        found[Path(name).name] = moved
    return found


# In the default part OpenSfM's poses are those of photographs without GPS.
@pytest.mark.parametrize(
    ("file_format", "file"),
    [
        ("metashape", "cameras.xml"),
        pytest.param("opensfm", "reconstruction.json", marks=pytest.mark.thorough),
    ],
)
def test_given_poses_stay_as_they_are(
    rendered: Scene, tmp_path: Path, file_format: str, file: str
) -> None:
    """A map of poses that another program has written stands where those stood on earth."""
    export(rendered.path, file_format, tmp_path / "given", [SESSION])
    out = tmp_path / "scene"
    report = ingest(photographs_of(rendered), out, poses=tmp_path / "given" / file)
    assert (report.registered, report.queries, report.level) == (12, 3, "given")
    assert report.reprojection_error_px < 1
    assert report.map_points > 200
    assert report.gps is not None
    assert 0.3 < report.gps.horizontal_rms < 5
    assert "poses as imported" in report.text()
    made, truth = geocentric(Scene.open(out), "flight"), geocentric(rendered, SESSION)
    assert set(made) == set(truth)
    for name, pose in truth.items():
        np.testing.assert_allclose(made[name], pose, atol=1e-5)
    cameras, expected = Scene.open(out).frames("flight").cameras, rendered.frames(SESSION).cameras
    np.testing.assert_allclose(cameras[0].focal, expected[0].focal)
    np.testing.assert_allclose(cameras[0].principal, expected[0].principal)
    (dataset,) = open_datasets(out)
    assert len(dataset.queries) == 3
    assert ingest(photographs_of(rendered), out, poses=tmp_path / "given" / file) == report
    with pytest.raises(InputError, match="other photographs or options"):
        ingest(photographs_of(rendered), out)


def test_poses_without_a_place_are_placed_by_gps(rendered: Scene, tmp_path: Path) -> None:
    """nerfstudio's world is anywhere, of any scale; the similarity to GPS keeps its shape."""
    export(rendered.path, "nerfstudio", tmp_path / "given", [SESSION])
    path = tmp_path / "given" / "transforms.json"
    document = json.loads(path.read_text())
    spun = np.diag([0.02, 0.02, 0.02, 1.0]) @ np.array(
        [[0.0, 0.0, 1.0, 40.0], [1.0, 0.0, 0.0, -9.0], [0.0, 1.0, 0.0, 7.0], [0.0, 0.0, 0.0, 1.0]]
    )
    for frame in document["frames"][1:]:  # the first has no pose
        matrix = spun @ np.array(frame["transform_matrix"])
        matrix[:3, :3] /= 0.02
        frame["transform_matrix"] = matrix.tolist()
    document["frames"] = document["frames"][1:]
    path.write_text(json.dumps(document))
    out = tmp_path / "scene"
    report = ingest(photographs_of(rendered), out, poses=path)
    assert (report.registered, report.level) == (11, "gps")
    assert report.left_out == {"000000.jpg": "no pose in transforms.json"}
    made, truth = geocentric(Scene.open(out), "flight"), geocentric(rendered, SESSION)
    ours = np.array([made[name][:, 3] for name in sorted(made)])
    theirs = np.array([truth[name][:, 3] for name in sorted(made)])
    # GPS of 1.5 m places it; within itself it is exact but for the scale.
    assert np.linalg.norm(ours.mean(0) - theirs.mean(0)) < 2
    spread = np.linalg.norm(ours - ours.mean(0), axis=1)
    ratio = spread / np.linalg.norm(theirs - theirs.mean(0), axis=1)
    assert np.ptp(ratio) < 1e-6
    assert ratio.mean() == pytest.approx(1, abs=0.1)


def test_photographs_need_no_gps(rendered: Scene, tmp_path: Path) -> None:
    """Where the poses are placed on earth, photographs without EXIF do."""
    export(rendered.path, "opensfm", tmp_path / "given", [SESSION])
    (tmp_path / "photos").mkdir()
    for path in sorted(photographs_of(rendered).iterdir()):
        with Image.open(path) as image:
            image.save(tmp_path / "photos" / path.name, quality=95, exif=b"")
    poses = tmp_path / "given" / "reconstruction.json"
    report = ingest(tmp_path / "photos", tmp_path / "scene", poses=poses)
    assert (report.registered, report.fixes, report.gps) == (12, 0, None)
    assert not Scene.open(tmp_path / "scene").frames("flight").has_gps.any()
    assert "GPS residuals of 0 photographs: none" in report.text()
    with pytest.raises(InputError, match="0 of 12 photographs have a GPS position"):
        ingest(tmp_path / "photos", tmp_path / "other")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,e,n,u\na.jpg,1,2,3\n", "positions without attitudes: give it as --gps"),
        ("1.5 0 0 0 0 0 0 1\n", "names none of the photographs: its first name is '1.5'"),
        ("000000 0 0 0 0 0 0 1\n", "has no camera of 000000.jpg: give --camera"),
    ],
)
def test_poses_that_do_not_do(rendered: Scene, tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / ("poses.csv" if text.startswith("name") else "poses.txt")
    file.write_text(text)
    with pytest.raises(InputError, match=message):
        ingest(photographs_of(rendered), tmp_path / "scene", poses=file)
    assert not (tmp_path / "scene").exists()


def test_a_frame_is_of_a_file_of_poses(rendered: Scene, tmp_path: Path) -> None:
    export(rendered.path, "opensfm", tmp_path / "given", [SESSION])
    with pytest.raises(InputError, match="--poses-frame needs a file of poses"):
        ingest(photographs_of(rendered), tmp_path / "scene", poses_frame="projected")
    poses = tmp_path / "given" / "reconstruction.json"
    with pytest.raises(InputError, match="topocentric according to its field frame, but proj"):
        ingest(photographs_of(rendered), tmp_path / "scene", poses=poses, poses_frame="projected")
    with pytest.raises(InputError, match="projected according to --poses-frame"):
        audit(poses, frame="projected")
    with pytest.raises(InputError, match="is not a reconstruction.json of ODM or OpenSfM"):
        audit(rendered.path, frame="topocentric")


def test_a_camera_of_another_shape_is_refused(rendered: Scene, tmp_path: Path) -> None:
    export(rendered.path, "opensfm", tmp_path / "given", [SESSION])
    camera = Camera("PINHOLE", 400, 300, (300.0, 300.0, 200.0, 150.0))
    poses = tmp_path / "given" / "reconstruction.json"
    with pytest.raises(InputError, match="the camera is 400 x 300 pixels but 000000.jpg"):
        ingest(photographs_of(rendered), tmp_path / "scene", poses=poses, camera=camera)


def test_poses_with_a_rational_lens(rendered: Scene, tmp_path: Path) -> None:
    """Numerator and denominator cancel: only with all coefficients is it the pictures' lens."""
    export(rendered.path, "colmap", tmp_path / "given", [SESSION])
    model = pycolmap.Reconstruction(tmp_path / "given")
    ((fx, fy), (cx, cy)) = rendered.frames(SESSION).cameras[0].focal, (160.0, 160.0)
    params = (fx, fy, cx, cy, 0.3, 0.05, 0.0, 0.0, 0.02, 0.3, 0.05, 0.02)
    for camera in model.cameras.values():
        assert tuple(camera.params[-2:]) == (cx, cy)
        camera.model, camera.params = pycolmap.CameraModelId.FULL_OPENCV, list(params)
    model.write(tmp_path / "given")
    report = ingest(photographs_of(rendered), tmp_path / "scene", poses=tmp_path / "given")
    assert report.registered == 12
    assert report.reprojection_error_px < 1
    assert report.map_points > 200
    scene = Scene.open(tmp_path / "scene")
    (camera,) = set(scene.frames("flight").cameras)
    assert (camera.model, camera.params) == ("FULL_OPENCV", params)
    assert scene.sparse_map().reprojection_error() < 1
