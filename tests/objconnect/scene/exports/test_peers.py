"""Exports are read by programs of other projects: nerfstudio's and kapture's own readers.

Metashape and OpenSfM cannot be installed as packages; nerfstudio reads Metashape's cameras,
and kapture OpenSfM's reconstructions.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from objconnect.scene.bundle.scene import Scene
from objconnect.scene.exports.export import export
from objconnect.scene.geometry.camera import Camera
from tests.objconnect.scene.exports.test_exports import with_cameras
from tests.peers import run

pytestmark = pytest.mark.thorough

SESSION = "summer-noon-nadir-map"
LENS = Camera("OPENCV", 320, 320, (300.0, 300.0, 150.0, 165.0, -0.1, 0.02, 1e-3, -2e-3))
# From OpenGL's camera axes (x right, y up, z back) to OpenCV's.
OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])

_NERFSTUDIO = """
import json
from pathlib import Path
from nerfstudio.data.dataparsers.nerfstudio_dataparser import NerfstudioDataParserConfig
config = NerfstudioDataParserConfig(
    data=Path(sys.argv[2]), orientation_method="none", center_method="none",
    auto_scale_poses=False, eval_mode="all", load_3D_points=False, downscale_factor=1,
)
read = config.setup().get_dataparser_outputs("train")
cameras = read.cameras
print(json.dumps({
    "names": [path.name for path in read.image_filenames],
    "world_from_cam": cameras.camera_to_worlds.tolist(),
    "applied": read.dataparser_transform.tolist(),
    "lens": [each[0].item() for each in (cameras.fx, cameras.fy, cameras.cx, cameras.cy)],
    "distortion": cameras.distortion_params[0].tolist(),
}))
"""

_METASHAPE = """
import json
from pathlib import Path
from nerfstudio.process_data.metashape_utils import metashape_to_json
names = {Path(name).stem: Path(name) for name in sys.argv[4:]}
metashape_to_json(names, Path(sys.argv[2]), Path(sys.argv[3]))
print(json.dumps(json.loads((Path(sys.argv[3]) / "transforms.json").read_text())))
"""

_OPENSFM = """
import json, os
import kapture
from kapture.converter.opensfm.import_opensfm import import_opensfm
from kapture.io.records import TransferAction
import_opensfm(sys.argv[2], sys.argv[3], True, TransferAction.skip)
from kapture.io.csv import kapture_from_dir
read = kapture_from_dir(sys.argv[3])
shots = {}
for time, sensor, name in kapture.flatten(read.records_camera):
    pose = read.trajectories[time, sensor]
    shots[name] = [pose.r_raw, pose.t_raw, read.sensors[sensor].camera_params]
print(json.dumps(shots))
"""


def test_nerfstudio_reads_transforms(rendered: Scene, rendered_copy: Path, tmp_path: Path) -> None:
    with_cameras(rendered_copy, SESSION, [LENS])
    export(rendered_copy, "nerfstudio", tmp_path / "out", [SESSION])
    read = run(_NERFSTUDIO, tmp_path / "out")
    frames = rendered.frames(SESSION)
    assert len(read["names"]) == len(frames)
    applied = np.vstack([read["applied"], [0, 0, 0, 1]])
    np.testing.assert_allclose(applied, np.eye(4), atol=1e-7)
    order = np.argsort(read["names"])
    for name, k in zip(sorted(frames.names), order, strict=True):
        pose = np.vstack([read["world_from_cam"][k], [0, 0, 0, 1]])
        truth = frames.cam_from_world[frames.names.index(name)]
        # nerfstudio keeps single precision.
        np.testing.assert_allclose(np.linalg.inv(pose @ OPENCV), truth, atol=1e-4)
    (fx, fy), (cx, cy) = LENS.focal, LENS.principal
    np.testing.assert_allclose(read["lens"], [fx, fy, cx, cy], rtol=1e-6)
    k1, k2, p1, p2 = LENS.distortion
    np.testing.assert_allclose(read["distortion"], [k1, k2, 0, 0, p1, p2], rtol=1e-6)


def test_nerfstudio_reads_metashape_s_cameras(
    rendered: Scene, rendered_copy: Path, tmp_path: Path
) -> None:
    with_cameras(rendered_copy, SESSION, [LENS])
    export(rendered_copy, "metashape", tmp_path / "out", [SESSION])
    frames = rendered.frames(SESSION)
    names = [Path(name).name for name in frames.names]
    read = run(_METASHAPE, tmp_path / "out" / "cameras.xml", tmp_path, *names)
    assert sorted(Path(frame["file_path"]).name for frame in read["frames"]) == sorted(names)
    applied = np.vstack([read["applied_transform"], [0, 0, 0, 1]])
    found = {
        Path(frame["file_path"]).name: np.linalg.inv(applied) @ frame["transform_matrix"] @ OPENCV
        for frame in read["frames"]
    }
    # nerfstudio leaves the cameras where the file's transform places them: on the Earth.
    first, earth = frames.cam_from_world[0], found[names[0]]
    assert 6.3e6 < np.linalg.norm(earth[:3, 3]) < 6.4e6
    for name, truth in zip(names, frames.cam_from_world, strict=True):
        between = np.linalg.inv(found[name]) @ earth
        np.testing.assert_allclose(between, truth @ np.linalg.inv(first), atol=1e-6)
    (fx, fy), (cx, cy) = LENS.focal, LENS.principal
    for frame in read["frames"]:
        numbers = [frame[key] for key in ("fl_x", "fl_y", "cx", "cy")]
        assert numbers == pytest.approx([fx, fy, cx, cy])


def test_kapture_reads_opensfm_s_reconstruction(rendered: Scene, tmp_path: Path) -> None:
    export(rendered.path, "opensfm", tmp_path / "out", [SESSION])
    read = run(_OPENSFM, tmp_path / "out", tmp_path / "kapture")
    frames = rendered.frames(SESSION)
    assert len(read) == len(frames)
    for path, truth, camera in zip(
        frames.names, frames.cam_from_world, frames.cameras, strict=True
    ):
        quaternion, translation, numbers = read[Path(path).name]
        w, x, y, z = quaternion
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        np.testing.assert_allclose(rotation, truth[:3, :3], atol=1e-9)
        np.testing.assert_allclose(translation, truth[:3, 3], atol=1e-9)
        width, height, focal, cx, cy, *lens = numbers
        assert [width, height] == [camera.width, camera.height]
        assert [focal, cx, cy] == pytest.approx([camera.focal[0], *camera.principal])
        assert lens == [0.0, 0.0]
