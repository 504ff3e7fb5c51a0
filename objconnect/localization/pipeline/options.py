"""Options of ``localize``: what is known of the images beside themselves, and what is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from objconnect.localization.pipeline.tracking import SequenceConfig
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.camera import Camera


@dataclass(frozen=True)
class LocalizeOptions:
    """Options of ``localize`` and ``localize_video``, as the command line has them.

    Attributes:
        camera: camera of all images. None takes that of each photograph (``calibration_of``), or of
            each frame (``cameras_of_frames``).
        priors: CSV file of positions of photographs, and perhaps attitudes (``read_priors``). None
            takes positions from EXIF and attitudes of the gimbal from XMP, where a photograph has
            them.
        gps_sigma_m: standard deviation per axis of measured positions, metres, and of those of a
            table that states none. A fixed position of RTK has that of its XMP.
        gimbal_sigma_deg: standard deviation per axis of measured attitudes, degrees.
        srt: subtitles of a video with telemetry. None takes those beside it, if there are any.
        rate_hz: frames of a video to localize a second; None takes 2. Photographs of a sequence a
            second, in the order of their names; None takes times from EXIF.
        sequence: when an image is believed where those before it lead. None localizes each
            photograph by itself. A video always is a sequence.
        also: further files to write, by their ending: GeoJSON, KML, MAVLink's .tlog, ROS 2's .mcap.
        undulation_m: height of the geoid above the ellipsoid at the place, metres. None takes it
            from the grid of PROJ where that is installed, and else leaves heights above sea level
            out.
        projection: coordinate reference system in which coordinates are written, too.
        cache: folder for what the method keeps per map. None takes a scratch folder beside the
            poses.
    """

    camera: Camera | None = None
    priors: Path | None = None
    gps_sigma_m: float = 10.0
    gimbal_sigma_deg: float = 5.0
    srt: Path | None = None
    rate_hz: float | None = None
    sequence: SequenceConfig | None = None
    also: Sequence[Path] = ()
    undulation_m: float | None = None
    projection: Projection | None = None
    cache: Path | None = None
