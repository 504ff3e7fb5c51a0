"""The command ``calibrate``: check the simulated camera by rendered views of a chessboard.

OpenCV calibrates the camera from the pictures, and the result is compared with the truth. Detected
corners are shifted by half a pixel, from OpenCV's pixels (the first centre is 0, 0) to COLMAP's
(0.5, 0.5), so that the principal point is in COLMAP's pixels.

Corners are detected twice. Their first positions are biased, because the lens bends edges and small
squares have few pixels. A first calibration therefore warps every view to a frontal view of the
board, in which edges are straight and squares symmetrical. The corners are refined there and mapped
back (Datta, Kim and Kanade, "Accurate camera calibration using iterative refinement of control
points", 2009).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from objconnect.scene.errors import InputError
from objconnect.scene.geometry.camera import MODELS, Camera
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import atomic_write
from objconnect.scene.storage.outputs import OutputFile, check_outputs
from objconnect.scene.storage.provenance import PNG_MARK, PNG_METADATA
from objconnect.scene.storage.scratch import scratch
from simulate.camera.lens import cover_by_pinhole
from simulate.camera.resample import resample_colour
from simulate.render.job import Board, RenderJob, frame_path
from simulate.render.pool import RenderError, render

Array = NDArray[np.float64]

BOARD = Board(columns=7, rows=5, square_m=0.1)

_SAMPLES = 64  # samples per pixel; corners need exact edges
_TRIES = 400  # attempts to draw a pose that shows the whole board
_BORDER_PX = 4.0  # least distance of the board from the border of the picture
# Tilts of the board. Frontal views do not determine the focal length. With 20 views of 320 x 240
# and the measured noise, these tilts give 0.044 % (one sigma), and 10 to 40 degrees 0.059 %.
_TILT_DEG = (20.0, 50.0)
# Half sides of the windows of corner refinement, relative to the spacing of corners. In a picture a
# window must contain a single corner; in the frontal view a wider window averages more noise.
_WINDOW_SHARE, _FRONT_WINDOW_SHARE = 0.35, 0.6
_FRONT_BLUR_PX = 1.0  # standard deviation; gradients of unblurred edges are noisy
_REFINE_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-5)
_PAD_PX = 4  # padding of a picture for the resampling kernel


@dataclass(frozen=True)
class Calibration:
    """A calibration from V views of a chessboard.

    Attributes:
        truth: the simulated camera.
        estimated: the calibrated camera of the same model, COLMAP pixels.
        cam_from_board: estimated board poses (V, 4, 4).
        views: names of the views in which the board was detected.
        corners: detected corners (V, K, 2), COLMAP pixels.
        reprojected: projections (V, K, 2) of the corners by the estimated camera and board poses.
        rms_px: root mean square distance between ``corners`` and ``reprojected``.
        truth_rms_px: root mean square distance between ``corners`` and their true projections,
            which is the error of rendering and detection.
        rotation_deg: rotation error (V,) of each board pose.
        translation_m: translation error (V,) of each board pose.
        distance_m: distance (V,) of the board from the camera.
    """

    truth: Camera
    estimated: Camera
    cam_from_board: Array
    views: tuple[str, ...]
    corners: Array
    reprojected: Array
    rms_px: float
    truth_rms_px: float
    rotation_deg: Array
    translation_m: Array
    distance_m: Array

    def as_dict(self) -> dict[str, Any]:
        """Return the results as a dictionary for JSON."""
        names = MODELS[self.truth.model]
        return {
            "model": self.truth.model,
            "size": [self.truth.width, self.truth.height],
            "views": len(self.views),
            "corners": int(self.corners[..., 0].size),
            "rms_px": self.rms_px,
            "truth_rms_px": self.truth_rms_px,
            "parameters": {
                name: {"truth": a, "found": b, "difference": b - a}
                for name, a, b in zip(names, self.truth.params, self.estimated.params, strict=True)
            },
            "boards": [
                {"view": v, "distance_m": float(d), "rotation_deg": float(r), "translation_m": t}
                for v, d, r, t in zip(
                    self.views,
                    self.distance_m,
                    self.rotation_deg,
                    self.translation_m.tolist(),
                    strict=True,
                )
            ],
        }

    def text(self) -> str:
        """Return the results as a table."""
        lines = [f"{self.truth.model} {self.truth.width} x {self.truth.height}"]
        lines.append(f"{'':4}{'truth':>14}{'found':>14}{'difference':>14}")
        for name, row in self.as_dict()["parameters"].items():
            lines.append(
                f"{name:4}{row['truth']:14.5f}{row['found']:14.5f}{row['difference']:14.5f}"
            )
        relative = np.abs(np.divide(self.estimated.focal, self.truth.focal) - 1).max()
        lines += [
            f"focal length within {100 * relative:.3f} %, "
            f"{len(self.views)} views, {self.corners[..., 0].size} corners, "
            f"RMS {self.rms_px:.3f} px ({self.truth_rms_px:.3f} px against the truth)",
            f"board poses: rotation median {np.median(self.rotation_deg):.4f}, worst "
            f"{self.rotation_deg.max():.4f} deg; position median "
            f"{1e3 * np.median(self.translation_m):.2f}, worst "
            f"{1e3 * self.translation_m.max():.2f} mm at {self.distance_m.mean():.2f} m",
        ]
        return "\n".join(lines)


def calibrate(camera: Camera, out: Path, views: int = 20, seed: int = 0) -> Calibration:
    """Render views of a chessboard, calibrate from them, and write pictures into ``out``.

    The pictures are ``views/NNNNNN.png``, and ``corners.png`` with the corners of all views.

    Raises:
        InputError: the camera cannot be rendered or is too small to detect the board, or ``out``
            cannot be written.
    """
    corners_picture = out / "corners.png"
    view_paths = (out / "views" / f"{k:06d}.png" for k in range(views))
    check_outputs(
        [OutputFile(path, PNG_MARK) for path in (corners_picture, *view_paths)], within=out
    )
    rng = np.random.default_rng(seed)
    poses = np.stack([board_pose(camera, BOARD, rng) for _ in range(views)])
    pictures = _render_views(camera, poses, seed, out)
    for name, picture in pictures.items():
        with atomic_write(out / "views" / name) as partial:
            Image.fromarray(picture).save(partial, "PNG", pnginfo=_provenance())
    detected = {name: find_corners(picture, BOARD) for name, picture in pictures.items()}
    kept = [k for k, corners in enumerate(detected.values()) if corners is not None]
    if len(kept) < 4:
        raise InputError(
            f"the chessboard was detected in {len(kept)} of {views} views of {camera}: "
            "use larger pictures or more views"
        )
    views_kept = [list(pictures)[k] for k in kept]
    corners = np.stack([c for c in detected.values() if c is not None])
    first = _solve(camera, views_kept, corners, poses[kept])
    corners = np.stack(
        [
            refine_corners(pictures[name], first.estimated, pose, BOARD)
            for name, pose in zip(views_kept, first.cam_from_board, strict=True)
        ]
    )
    result = _solve(camera, views_kept, corners, poses[kept])
    _save_picture(result, pictures, corners_picture)
    return result


def _provenance() -> PngInfo:
    info = PngInfo()
    for key, value in PNG_METADATA.items():
        info.add_text(key, value)
    return info


def board_points(board: Board) -> Array:
    """Return the inner corners in the board's frame, row by row, (rows * columns, 3) metres."""
    y, x = np.mgrid[: board.rows, : board.columns]
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1)
    return np.asarray(board.square_m * points)


def board_pose(camera: Camera, board: Board, rng: np.random.Generator) -> Array:
    """Draw a random pose ``cam_from_board`` (4, 4) that shows the whole board at a tilt.

    Raises:
        InputError: no pose shows the whole board.
    """
    side = board.square_m
    x = side * np.linspace(-1.5, board.columns + 0.5, 5)
    y = side * np.linspace(-1.5, board.rows + 0.5, 5)
    outline = np.array([[a, b, 0.0] for a in x for b in y])  # includes half a square of margin
    centre = np.array([x.mean(), y.mean(), 0.0])
    size = np.array([camera.width, camera.height])
    for _ in range(_TRIES):
        axis = rng.uniform(0, 2 * np.pi)
        tilt = np.radians(rng.uniform(*_TILT_DEG)) * np.array([np.cos(axis), np.sin(axis), 0.0])
        roll = np.array([0.0, 0.0, np.radians(rng.uniform(-15, 15))])
        rotation = cv2.Rodrigues(tilt)[0] @ cv2.Rodrigues(roll)[0]
        ray, valid = camera.unproject(torch.from_numpy(rng.uniform(0.1, 0.9, 2) * size)[None])
        fill = rng.uniform(0.5, 0.85)  # share of the picture that the board fills
        distance = max(np.ptp(x) / camera.width, np.ptp(y) / camera.height) * camera.focal[0]
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = ray[0].numpy() * distance / fill - rotation @ centre
        seen = camera.project(torch.from_numpy(outline @ pose[:3, :3].T + pose[:3, 3]))
        inside = seen.valid & camera.contains(seen.xy, border=_BORDER_PX)
        if bool(valid.all()) and bool(inside.all()):
            return pose
    raise InputError(
        f"camera {camera} cannot see the whole chessboard: use a larger field of view or picture"
    )


def find_corners(picture: NDArray[np.uint8], board: Board) -> Array | None:
    """Detect the inner corners (rows * columns, 2) of a chessboard in a picture (H, W, 3).

    Corners are COLMAP pixels in the order of ``board_points``; the result is None without a board.
    """
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    found, corners = cv2.findChessboardCornersSB(
        grey, (board.columns, board.rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not found:
        return None
    grid = corners.reshape(board.rows, board.columns, 2)
    spacing = min(np.linalg.norm(np.diff(grid, axis=k), axis=-1).min() for k in (0, 1))
    window = max(2, int(_WINDOW_SHARE * spacing))
    corners = cv2.cornerSubPix(grey, corners, (window, window), (-1, -1), _REFINE_STOP)
    grid = corners.reshape(board.rows, board.columns, 2).astype(np.float64)
    # Boards roll by at most 15 degrees, so the first corner is the upper left.
    if grid[0, 0].sum() > grid[-1, -1].sum():
        grid = grid[::-1, ::-1]
    return np.asarray(grid.reshape(-1, 2) + 0.5)


def refine_corners(
    picture: NDArray[np.uint8], camera: Camera, cam_from_board: Array, board: Board
) -> Array:
    """Refine the inner corners of a chessboard in a frontal view of it.

    Args:
        picture: the picture (H, W, 3).
        camera: approximate camera of the picture.
        cam_from_board: approximate pose (4, 4) of the board.
        board: the chessboard.

    Returns:
        The corners (rows * columns, 2) in the picture, COLMAP pixels.
    """
    approximate = _project(camera, cam_from_board[None], board_points(board))
    steps = np.diff(approximate.reshape(board.rows, board.columns, 2), axis=1)
    # The frontal view has the resolution of the picture.
    square_px = round(float(np.median(np.linalg.norm(steps, axis=-1))))
    y, x = np.mgrid[: (board.rows + 1) * square_px, : (board.columns + 1) * square_px]
    across, along = (board.square_m * ((axis + 0.5) / square_px - 1) for axis in (x, y))
    plane = np.stack([across, along, np.zeros(x.shape)], -1)
    xy = _project(camera, cam_from_board[None], plane.reshape(-1, 3)).reshape(*x.shape, 2)
    height, width = picture.shape[:2]
    padded = np.pad(picture, [(_PAD_PX, _PAD_PX)] * 2 + [(0, 0)], "edge")
    clipped = np.clip(xy, 0, [width, height]).astype(np.float64) + _PAD_PX
    front = resample_colour(padded, clipped)
    grey = cv2.GaussianBlur(cv2.cvtColor(front, cv2.COLOR_RGB2GRAY), (0, 0), _FRONT_BLUR_PX)
    expected = (board_points(board)[:, :2] / board.square_m + 1) * square_px - 0.5
    window = max(2, int(_FRONT_WINDOW_SHARE * square_px))
    corners = cv2.cornerSubPix(
        grey, expected[:, None].astype(np.float32), (window, window), (-1, -1), _REFINE_STOP
    )
    refined_m = board.square_m * ((corners[:, 0].astype(np.float64) + 0.5) / square_px - 1)
    refined: Array = _project(camera, cam_from_board[None], np.insert(refined_m, 2, 0.0, axis=1))[0]
    return refined


def _render_views(
    camera: Camera, poses: Array, seed: int, out: Path
) -> dict[str, NDArray[np.uint8]]:
    """Render the board at every pose, and return the pictures (H, W, 3) by file name."""
    pinhole, distorted_camera = cover_by_pinhole(camera)
    job = RenderJob(
        seed=seed,
        side_m=1.0,
        condition="summer-noon",
        camera=pinhole,
        distorted_camera=distorted_camera,
        board=BOARD,
        samples=_SAMPLES,
        poses={k: pose.tolist() for k, pose in enumerate(poses)},
    )
    pictures = {}
    with (
        scratch(out) as folder,
        progress_bar("chessboard", len(poses)) as advance,
    ):
        try:
            render(job, folder, on_frame=lambda frame: advance(frame + 1))
        except RenderError as error:
            raise InputError(str(error)) from error
        for k in range(len(poses)):
            with np.load(frame_path(folder, k)) as layers:
                pictures[f"{k:06d}.png"] = layers["rgb"]
    return pictures


def _solve(camera: Camera, views: list[str], corners: Array, poses: Array) -> Calibration:
    """Calibrate the camera's model from corners (V, K, 2); ``poses`` (V, 4, 4) are the truth."""
    size = (camera.width, camera.height)
    points = board_points(BOARD)
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    names = MODELS[camera.model]
    if camera.is_fisheye:
        _, k, d, rotations, translations = cv2.fisheye.calibrate(
            [points[None] for _ in views],
            [c[None] for c in corners],
            size,
            np.eye(3),
            np.zeros(4),
            flags=cv2.fisheye.CALIB_RECOMPUTE_EXTRINSIC | cv2.fisheye.CALIB_FIX_SKEW,
            criteria=stop,
        )
    else:
        flags = cv2.CALIB_RATIONAL_MODEL if "k6" in names else cv2.CALIB_FIX_K3
        for name, flag in (
            ("k1", cv2.CALIB_FIX_K1),
            ("k2", cv2.CALIB_FIX_K2),
            ("p1", cv2.CALIB_ZERO_TANGENT_DIST),
        ):
            flags |= 0 if name in names else flag
        flags |= cv2.CALIB_FIX_ASPECT_RATIO if "f" in names else 0
        _, k, d, rotations, translations = cv2.calibrateCamera(
            [points.astype(np.float32) for _ in views],
            [c[:, None].astype(np.float32) for c in corners],
            size,
            np.eye(3),
            np.zeros(8 if "k6" in names else 5),
            flags=flags,
            criteria=stop,
        )
    last = ("k3", "k4") if camera.is_fisheye else ("p1", "p2", "k3", "k4", "k5", "k6")
    values = dict(zip(("k1", "k2", *last), d.ravel(), strict=False))
    values |= {"f": k[0, 0], "fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
    estimated = Camera(camera.model, *size, tuple(float(values[name]) for name in names))

    recovered = np.tile(np.eye(4), (len(views), 1, 1))
    recovered[:, :3, :3] = [cv2.Rodrigues(r)[0] for r in rotations]
    recovered[:, :3, 3] = np.reshape(translations, (-1, 3))
    error = recovered @ np.linalg.inv(poses)
    shown = _project(estimated, recovered, points)
    return Calibration(
        truth=camera,
        estimated=estimated,
        cam_from_board=recovered,
        views=tuple(views),
        corners=corners,
        reprojected=shown,
        rms_px=_rms(corners - shown),
        truth_rms_px=_rms(corners - _project(camera, poses, points)),
        rotation_deg=np.degrees([np.linalg.norm(cv2.Rodrigues(e[:3, :3])[0]) for e in error]),
        translation_m=np.linalg.norm(recovered[:, :3, 3] - poses[:, :3, 3], axis=-1),
        distance_m=np.linalg.norm(poses[:, :3, 3], axis=-1),
    )


def _project(camera: Camera, poses: Array, points: Array) -> Array:
    """Project points (K, 3) of the board by poses (V, 4, 4) to pixels (V, K, 2)."""
    local = points @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
    return np.asarray(camera.project(torch.from_numpy(local)).xy.numpy())


def _rms(difference: Array) -> float:
    """Return the root mean square length of vectors (..., 2)."""
    return float(np.sqrt(np.square(difference).sum(-1).mean()))


def _save_picture(result: Calibration, pictures: dict[str, NDArray[np.uint8]], path: Path) -> None:
    """Draw the views with detected (circles) and reprojected (crosses) corners."""
    columns = 4
    rows = -(-len(result.views) // columns)
    aspect = result.truth.height / result.truth.width
    figure = Figure(figsize=(4 * columns, 4 * aspect * rows + 0.3), layout="constrained")
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for ax in axes:
        ax.set_axis_off()
    extent = (0, result.truth.width, result.truth.height, 0)  # COLMAP pixels
    for ax, name, seen, shown in zip(
        axes, result.views, result.corners, result.reprojected, strict=False
    ):
        ax.imshow(pictures[name], extent=extent)
        ax.plot(*seen.T, "o", mfc="none", mec="red", ms=5, mew=0.6)
        ax.plot(*shown.T, "+", color="cyan", ms=5, mew=0.6)
    figure.suptitle(f"detected (circles) and reprojected (crosses): RMS {result.rms_px:.3f} px")
    with atomic_write(path) as partial:
        figure.savefig(partial, format="png", dpi=80, metadata=PNG_METADATA)
