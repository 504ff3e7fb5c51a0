"""Messages between the main process and the rendering processes."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from objconnect.scene.geometry.geodesy import Geodetic
from simulate.camera.pinhole import PinholeCamera
from simulate.look.conditions import DEFAULT_ORIGIN
from simulate.place.change import Change
from simulate.render.window import Window

Denoising = Literal["fast", "high"]
"""Quality of Open Image Denoise."""


class Board(BaseModel):
    """A chessboard on the plane z = 0, in metres.

    The origin is its first inner corner. x runs along its ``columns`` inner corners and y along its
    ``rows``. Its face is seen from below (-z).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    columns: int = Field(ge=3)
    rows: int = Field(ge=3)
    square_m: float = Field(gt=0)


class RenderJob(BaseModel):
    """The frames of one flight under one condition.

    - ``poses`` maps frame numbers to ``cam_from_world`` (4, 4), OpenCV axes, metres.
    - ``samples`` is the number of paths per pixel, and ``denoising`` the quality of the denoiser.
    - ``origin`` is the geodetic origin, which determines the position of the sun.
    - ``change`` and ``first_new_id`` are arguments of ``simulate.place.change.change_world``.
    - ``site_path`` is the file of a site (a real place), which is read instead of building one.
    - ``distorted_camera`` is the camera of the photographs as ``str(Camera)``; the pinhole
      ``camera`` covers its view. None means that the photographs have the pinhole camera.
    - ``travel`` is the displacement of the camera in world metres while a frame is read out from
      top to bottom, by frame. The pose is that of the middle row.
    - ``windows`` are squares of tiles of a large place, each with the frames to render in it;
      together they have all frames. A chunk has one window.
    - ``thermal`` adds the layer "thermal", the radiance (H, W) float32 between 8 and 14
      micrometres, W/(m2 sr), without noise.
    """

    model_config = ConfigDict(extra="forbid")

    preset: str = "town"
    seed: int = Field(ge=0)
    side_m: float = Field(gt=0)
    condition: str
    origin: Geodetic = DEFAULT_ORIGIN
    change: Change = Change()
    first_new_id: int = Field(default=0, ge=0)
    site_path: Path | None = None
    camera: PinholeCamera
    distorted_camera: str | None = None
    board: Board | None = None
    samples: int = Field(default=4, ge=1)
    denoising: Denoising = "fast"
    poses: dict[int, list[list[float]]]
    travel: dict[int, tuple[float, float, float]] = {}
    thermal: bool = False
    windows: tuple[Window, ...] = ()

    @field_validator("poses")
    @classmethod
    def _check_poses(cls, poses: dict[int, list[list[float]]]) -> dict[int, list[list[float]]]:
        for frame, rows in poses.items():
            if [len(row) for row in rows] != [4, 4, 4, 4]:
                raise ValueError(f"the pose of frame {frame} is not a 4 x 4 matrix")
        return poses

    def by_window(self) -> list[RenderJob]:
        """Return one job per window; this job alone if the place is not tiled."""
        if not self.windows:
            return [self]
        jobs = []
        for window in self.windows:
            poses = {k: self.poses[k] for k in window.frames if k in self.poses}
            if poses:
                jobs.append(self.model_copy(update={"poses": poses, "windows": (window,)}))
        return jobs

    @model_validator(mode="after")
    def _check_rolling_shutter(self) -> RenderJob:
        if self.travel and self.distorted_camera is not None:
            raise ValueError("rolling shutter is not supported with lens distortion")
        return self


class RenderChunk(BaseModel):
    """The task of one Blender process: a job with its share of the poses.

    The process ends early when its memory has grown by ``max_growth_bytes`` since its first frame,
    and another process continues. It also ends when the process ``parent`` ends.
    """

    model_config = ConfigDict(extra="forbid")

    job: RenderJob
    rays: Path | None  # npy (H, W, 2): x/z and y/z of the pixels; None for those of the pinhole
    out_dir: Path
    threads: int = Field(ge=0)  # 0 stands for one per processor
    max_growth_bytes: int = Field(ge=0)
    parent: int


class FrameDone(BaseModel):
    """The line that a Blender process prints for each finished frame."""

    frame: int
    seconds: float


def frame_path(out_dir: Path, frame: int) -> Path:
    """Return the path of a finished frame, NNNNNN.npz."""
    return out_dir / f"{frame:06d}.npz"
