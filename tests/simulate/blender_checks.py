"""Compare renders with Blender's own ray casts and photographs of discs, in other processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import torch

from objconnect.scene.geometry.camera import Camera
from simulate.camera.lens import cover_by_pinhole
from simulate.render.job import RenderJob
from tests.blender import require_blender

_SAMPLES = 256
_RADIUS_PX, _REACH_PX = 4.0, 8


def check_rays(job: RenderJob, frames: list[dict[str, np.ndarray]], folder: Path) -> None:
    """Check frames of a job against ray casts through 1,000 random pixel centres of each."""
    path, out = folder / "job.json", folder / "rays.npz"
    path.write_text(job.model_dump_json())
    _run_script("cast_rays", path, out)
    rays = np.load(out)
    for k, arrays in enumerate(frames):
        at = rays["rows"][k], rays["columns"][k]
        error = np.abs(arrays["depth"][at] - rays["depth"][k])
        assert len(error) == 1000
        others = int((arrays["instance"][at] != rays["instance"][k]).sum())
        median, most = 1e3 * np.percentile(error, [50, 99])
        print(f"frame {k}: median {median:.4f} mm, 99 % {most:.4f} mm, {others} other objects")
        assert median < 0.1
        assert most < 1
        assert others == 0


def dot_errors(camera: Camera, folder: Path) -> np.ndarray:
    """Return the centres of light of small discs in a photograph minus those of their projected
    outlines, (N, 2) pixels. The discs are parallel to the image, all over it, 5 to 60 m away."""
    rng = np.random.default_rng(0)
    x, y = (np.arange(11.0, side - 10, 18) for side in (camera.width, camera.height))
    pixels = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    rays, _ = camera.unproject(torch.from_numpy(pixels + rng.uniform(-1, 1, pixels.shape)))
    local = rays.numpy() * rng.uniform(5, 60, (len(pixels), 1))
    matrix, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = matrix * np.linalg.det(matrix)
    pose[:3, 3] = [3, -5, 2]
    points = (local - pose[:3, 3]) @ pose[:3, :3]
    pinhole, distorted_camera = cover_by_pinhole(camera)
    job = RenderJob(
        seed=0, side_m=1, condition="summer-noon", camera=pinhole,
        distorted_camera=distorted_camera, samples=_SAMPLES,
        poses={0: pose.tolist()},
    )  # fmt: skip
    paths = [folder / name for name in ("job.json", "dots.npz", "photograph.npy")]
    paths[0].write_text(job.model_dump_json())
    radii = _RADIUS_PX * local[:, 2] / camera.focal[0]
    np.savez(paths[1], points=points, radii=radii)
    _run_script("photograph_dots", *paths)
    light = np.load(paths[2]).mean(-1)
    light -= np.median(light)
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    outlines = local[:, None] + radii[:, None, None] * circle
    errors = []
    for outline in camera.project(torch.from_numpy(outlines)).xy.numpy():
        area = cv2.moments(outline.astype(np.float32))  # of the polygon
        u, v = area["m10"] / area["m00"], area["m01"] / area["m00"]
        left, top = round(u) - _REACH_PX, round(v) - _REACH_PX
        part = light[top : top + 2 * _REACH_PX, left : left + 2 * _REACH_PX]
        rows, columns = np.mgrid[: part.shape[0], : part.shape[1]] + 0.5
        seen = np.array([(part * columns).sum(), (part * rows).sum()]) / part.sum()
        errors.append(seen + np.array([left - u, top - v]))
    return np.array(errors)


def _run_script(script: str, *paths: Path) -> None:
    require_blender()
    words = [sys.executable, "-m", f"tests.simulate.{script}", *map(str, paths)]
    subprocess.run(words, check=True, cwd=Path(__file__).parents[2], stdout=subprocess.DEVNULL)
