"""Photographs as queries with camera and prior, read from files and their metadata."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from objconnect.ingestion.attitude import gimbal_pose
from objconnect.localization.pipeline.cameras import (
    Calibration,
    CameraSource,
    calibration_of,
    estimate_camera,
)
from objconnect.localization.pipeline.localization_map import LocalizationMap
from objconnect.localization.pipeline.options import LocalizeOptions
from objconnect.localization.pipeline.query_image import QueryImage
from objconnect.scene.errors import InputError
from objconnect.scene.geo.sea_level import convert_to_ellipsoid
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.localizer import Estimate, Prior, Query
from objconnect.scene.quantities.doubts import summarize_doubts
from objconnect.scene.quantities.reading import Reading, unknown
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.exif import Exif, read_exif
from objconnect.scene.storage.images import image_size, read_rgb

log = logging.getLogger(__name__)

# DJI's name of a rolling shutter in XMP.
_ROLLING_SHUTTER: Final = "electronic"
# Speed (m/s) from which a rolling shutter biases poses noticeably.
_FAST_MPS: Final = 5.0
# Maximum number of photographs of one lens from which its camera is estimated.
_MAX_PHOTOGRAPHS: Final = 5

Lens = tuple[str, str, float | None, tuple[float, ...], tuple[int, int]]
"""Key of the photographs of one lens: maker, model, 35 mm equivalent focal length (mm), relative
focal lengths f / max(w, h) of fields that contradict each other, and size in pixels."""


@dataclass(frozen=True)
class PhotographReader:
    """Reads photographs as queries with camera and prior.

    Attributes:
        localization_map: map to localize in.
        options: the camera of all photographs, and standard deviations.
        priors: priors by name; None takes them from EXIF and XMP.
        undulation_m: height of the geoid above the ellipsoid at the map, metres, which converts
            altitudes above sea level; None if unknown.
        estimated_cameras: estimated cameras by lens.
        metadata: metadata of the photographs that were read.
    """

    localization_map: LocalizationMap
    options: LocalizeOptions
    priors: Mapping[str, Prior] | None = None
    undulation_m: float | None = None
    estimated_cameras: Mapping[Lens, Camera] = field(default_factory=dict)
    metadata: dict[Path, Exif] = field(default_factory=dict)

    def __call__(self, name: str, path: Path) -> QueryImage:
        """Read a photograph.

        Raises:
            InputError: the photograph cannot be read, or its size is not that of the given camera.
        """
        pixels, exif = read_rgb(path, self.options.camera), self.exif(path)
        calibration = self.calibration(exif, (pixels.shape[1], pixels.shape[0]))
        measured = self._read_prior(exif)
        prior = measured if self.priors is None else self.priors.get(name)
        is_estimated = calibration.source is CameraSource.ESTIMATED and not exif.lens_doubts
        lens = ("EXIF has no focal length",) if is_estimated else ()
        return QueryImage(
            name,
            Query(name, pixels, calibration.camera, prior),
            calibration,
            exif.time,
            gps=measured,
            doubts=(*self.doubts(exif), *lens),
        )

    def exif(self, path: Path) -> Exif:
        """Return the metadata of a photograph, which is read once.

        Raises:
            InputError: the photograph cannot be read.
        """
        if path not in self.metadata:
            self.metadata[path] = convert_to_ellipsoid(read_exif(path), self.undulation_m)
        return self.metadata[path]

    def calibration(self, exif: Exif, size: tuple[int, int]) -> Calibration:
        """Return the camera of a photograph, or its candidates."""
        if self.options.camera is not None:
            return Calibration(self.options.camera, CameraSource.GIVEN)
        if (estimate := self.estimated_cameras.get(lens_of(exif, size))) is not None:
            return Calibration(estimate, CameraSource.ESTIMATED)
        return calibration_of(size, exif, self.localization_map.cameras)

    def doubts(self, exif: Exif) -> tuple[str, ...]:
        """Return which metadata are missing, uncertain, or not used because they cannot be true.

        Metadata that the user's camera or table of priors replaces are left out. A missing focal
        length is left out too, because ``add_estimates`` warns of it.
        """
        place = self._read_place(exif).doubts if self.priors is None else ()
        lens = exif.lens_doubts if self.options.camera is None else ()
        capture = exif.capture_doubts
        if exif.time is None and not any("DateTimeOriginal" in doubt for doubt in capture):
            capture = (*capture, "DateTimeOriginal is missing")
        return (*place, *lens, *capture)

    def _read_place(self, exif: Exif) -> Reading[Geodetic]:
        """Return the position in EXIF, if the map has one on earth and it can be true there."""
        origin, source = self.localization_map.origin, "position"
        if origin is None:
            return unknown(source)
        if exif.position is None:
            return unknown(source, *(exif.place_doubts or ["GPSLatitude is missing"]))
        checked = self.localization_map.check_place(exif.position, origin)
        return replace(checked, doubts=(*exif.place_doubts, *checked.doubts))

    def _read_prior(self, exif: Exif) -> Prior | None:
        """Return the prior of the position in EXIF, and the sigma and attitude in XMP.

        It is None if the photograph has no position that can be true, or the map no position on
        earth.
        """
        origin, place = self.localization_map.origin, self._read_place(exif).value
        if place is None or origin is None:
            return None
        sigma = np.array(exif.xmp.rtk_sigma or (self.options.gps_sigma_m,) * 3)
        prior = Prior(*self.localization_map.to_map_frame(place, origin, sigma))
        if exif.gimbal is None:
            return prior
        return replace(
            prior,
            cam_from_world_rotation=gimbal_pose(*exif.gimbal).rotation.numpy(),
            attitude_sigma_deg=self.options.gimbal_sigma_deg,
        )


def lens_of(exif: Exif, size: tuple[int, int]) -> Lens:
    """Return the metadata that all photographs of one lens share."""
    return exif.make, exif.model, exif.focal_35mm, exif.focals, size


def add_estimates(
    reader: PhotographReader, paths: Mapping[str, Path], localize: Callable[[Query], Estimate]
) -> PhotographReader:
    """Return the reader with estimates of the unknown cameras.

    A few photographs of each lens are localized with every candidate camera.

    Args:
        reader: reads photographs.
        paths: photographs by name.
        localize: localizes a query.
    """
    candidates: dict[Lens, tuple[Camera, ...]] = {}
    unknown: dict[Lens, dict[str, Path]] = {}
    for name, path in paths.items():
        try:
            exif, size = reader.exif(path), image_size(path)
        except (InputError, OSError):
            continue  # the table of results has the reason
        lens, calibration = lens_of(exif, size), reader.calibration(exif, size)
        if calibration.others:
            candidates[lens] = (calibration.camera, *calibration.others)
            unknown.setdefault(lens, {})[name] = path
    estimated = {}
    for lens, cameras in candidates.items():
        log.warning(
            "%s the focal length of %d photographs of %d x %d pixels: it is estimated; "
            "give --camera for exact poses",
            "fields of EXIF contradict each other on" if lens[-2] else "EXIF does not have",
            len(unknown[lens]),
            *lens[-1],
        )
        sample = _sample(unknown[lens])
        with progress_bar("estimate the focal length", len(sample)) as advance:
            estimated[lens] = estimate_camera(
                cameras, _read_queries(reader, sample, advance), localize
            )
    return replace(reader, estimated_cameras=estimated)


def _sample(paths: Mapping[str, Path]) -> dict[str, Path]:
    """Return a few photographs spread over a flight."""
    names, count = list(paths), min(len(paths), _MAX_PHOTOGRAPHS)
    return {name: paths[name] for name in (names[k * len(names) // count] for k in range(count))}


def _read_queries(
    reader: PhotographReader, paths: Mapping[str, Path], advance: Callable[[int], None]
) -> Iterator[Query]:
    """Yield the photographs that can be read; ``advance`` receives the number of finished ones."""
    for done, (name, path) in enumerate(paths.items()):
        advance(done)
        with suppress(InputError, OSError):
            if (query := reader(name, path).query) is not None:
                yield query


def warn_of_doubts(reader: PhotographReader) -> None:
    """Warn of uncertain metadata of photographs, a line for each kind."""
    doubts = {path.name: reader.doubts(exif) for path, exif in reader.metadata.items()}
    for line in summarize_doubts(doubts):
        log.warning("%s", line)


def warn_of_rolling_shutter(photographs: Collection[Exif]) -> None:
    """Warn of photographs that were taken at speed with a rolling shutter."""
    speeds = [
        exif.xmp.speed
        for exif in photographs
        if (exif.xmp.shutter or "").lower() == _ROLLING_SHUTTER
        and (exif.xmp.speed or 0.0) >= _FAST_MPS
    ]
    if speeds:
        log.warning(
            "%d photographs were taken with a rolling (electronic) shutter at up to %.0f m/s, "
            "which biases poses: fly slower or use a mechanical shutter",
            len(speeds),
            max(filter(None, speeds)),
        )
