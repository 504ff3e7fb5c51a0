"""Options of ``localize``: camera, priors, sequence and further outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from objconnect.localization.pipeline.tracking import SequenceConfig
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.camera import Camera


@dataclass(frozen=True)
class LocalizeOptions:
    """Options of ``localize`` and ``localize_video``, the same as on the command line.

    Attributes:
        camera: camera of all images. None determines the camera of each photograph
            (``calibration_of``) or frame (``cameras_of_frames``).
        priors: CSV file of positions and, optionally, attitudes of photographs (``read_priors``).
            None takes positions from EXIF and gimbal attitudes from XMP, if a photograph has them.
        gps_sigma_m: standard deviation per axis of positions for which none is stated, metres. The
            XMP of photographs with RTK states one.
        gimbal_sigma_deg: standard deviation per axis of attitudes for which none is stated,
            degrees.
        srt: file of subtitles with the telemetry of a video. None takes the file of the same name
            beside the video, if it exists.
        rate_hz: for a video, number of frames to localize per second; None takes 2. For a sequence
            of photographs, number of photographs per second in the order of their names; None takes
            times from EXIF.
        sequence: options of a sequence. None localizes photographs independently; a video is always
            a sequence.
        also: further files to write. The ending of each selects its format: GeoJSON (.geojson), KML
            (.kml), MAVLink (.tlog) or ROS 2 (.mcap).
        undulation_m: height of the geoid above the ellipsoid at the map, metres. None takes it from
            the grid of PROJ; without the grid, heights above sea level are left out.
        projection: coordinate reference system of further coordinates in the output; None for none.
        cache: folder for the data that the method prepares per map. None uses a scratch folder
            beside the poses.
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
