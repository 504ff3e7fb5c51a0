"""Files of other programs that are not poses, or not of a known format, are named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from objconnect.scene.errors import InputError
from objconnect.scene.imports.formats import read_foreign

LENS = {"projection_type": "brown", "width": 5472, "height": 3648, "focal_x": 0.66, "k1": 0}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cameras.json", json.dumps({"v2 dji": LENS, "v2 b": LENS}), "lenses without poses"),
        ("shots.geojson", '{"type": "FeatureCollection", "features": []}', "GeoJSON, such as"),
        ("s.json", '{"type": "FeatureCollection", "features": []}', "GeoJSON, such as"),
        ("images.json", '[{"filename": "a.jpg", "latitude": 1}]', "JSON with 'filename', 'lat"),
        ("sfm.json", '{"version": 1, "views": [], "poses": []}', "JSON with 'version', 'views'"),
        ("gt.json", '{"0": {"cam_R_w2c": []}}', "JSON with '0'"),
        ("bundle.out", "# Bundle file v0.3\n1 2\n", "a bundle of Bundler"),
        ("b.txt", "# Bundle file v0.3\n1 2\n", "a bundle of Bundler"),
        ("m.txt", "NVM_V3\n\n2\n", "a model of VisualSFM"),
        ("p.txt", "imageName X Y Z Omega Phi Kappa\na.jpg 1 2 3 4 5 6\n", "Pix4D's external"),
        ("r.csv", "#name,x,y,alt,heading,pitch,roll\na.jpg,1,2,3,4,5,6\n", "RealityCapture"),
        ("c.xml", '<?xml version="1.0"?>\n<BlocksExchange version="2"/>', "of ContextCapture"),
    ],
)
def test_it_is_named(tmp_path: Path, name: str, text: str, message: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match=f"is not supported as a file of poses: it is .*{message}"):
        read_foreign(path)


def test_cameras_of_gaussian_splatting(tmp_path: Path) -> None:
    """The columns of ``rotation`` are the axes of the camera in the world."""
    path = tmp_path / "cameras.json"
    right, down, ahead = np.array([0.6, 0.8, 0]), np.array([0, 0, -1.0]), np.array([-0.8, 0.6, 0])
    entry = {
        "id": 0,
        "img_name": "a",
        "width": 640,
        "height": 480,
        "position": [1.0, 2.0, 50.0],
        "rotation": np.stack([right, down, ahead], -1).tolist(),
        "fy": 500.0,
        "fx": 500.0,
    }
    path.write_text(json.dumps([entry]))
    poses = read_foreign(path)
    assert (poses.names, poses.cameras, poses.origin) == (("a",), (None,), None)
    np.testing.assert_allclose(poses.positions, [[1, 2, 50]])
    np.testing.assert_allclose(poses.cam_from_world[0, 2, :3], ahead, atol=1e-12)
    path.write_text(json.dumps([entry | {"rotation": np.diag([1.0, -1.0, 1.0]).tolist()}]))
    with pytest.raises(InputError, match="the rotation of 'a' is scaled, sheared or mirrored"):
        read_foreign(path)
