"""Read the photographs of a flight from a folder, with their cameras and positions."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from objconnect.scene.errors import InputError
from objconnect.scene.geo.sea_level import convert_to_ellipsoid
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.photographs import Photograph
from objconnect.scene.quantities.doubts import summarize_doubts
from objconnect.scene.quantities.focal import FILM_LENGTH
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.exif import Exif, read_exif, resize_file
from objconnect.scene.storage.files import require_folder
from objconnect.scene.storage.images import image_size, read_rgb
from objconnect.scene.storage.listing import list_files

log = logging.getLogger(__name__)

SESSION = "flight"
"""Name of the session (flight) of ingested photographs."""

_ENDINGS = (".jpg", ".jpeg")
# Initial relative focal length f / max(w, h) of images without one in EXIF; COLMAP's default.
_GUESSED_FOCAL: Final = 1.2


@dataclass(frozen=True)
class FlightImage:
    """One photograph of the folder.

    Attributes:
        file: Path of the file, relative to the folder.
        name: Name of the image in the scene. It has no white space, which separates columns in the
            text files of other programs.
        size: Width and height as stored, pixels.
    """

    file: str
    name: str
    sha256: str
    exif: Exif
    size: tuple[int, int]

    @property
    def lens(self) -> str:
        """Return a description of the lens, equal for all photographs taken with it."""
        focal = f"{self.exif.focal_35mm:.2f} mm" if self.exif.focal_35mm else "focal length unknown"
        if self.exif.focals:
            lengths = " or ".join(f"{FILM_LENGTH * each:.2f}" for each in self.exif.focals)
            focal = f"focal length {lengths} mm"
        maker = f"{self.exif.make} {self.exif.model}".strip() or "unknown camera"
        return f"{maker}, {self.size[0]} x {self.size[1]}, {focal}"


@dataclass(frozen=True)
class Flight:
    """The photographs of a flight.

    Attributes:
        images: Photographs in the order they were taken, or by file name if one has no time.
        left_out: Files of the folder that are left out, with the reasons.
    """

    images: tuple[FlightImage, ...]
    left_out: dict[str, str]

    def leave_out(self, reasons: dict[str, str]) -> Flight:
        """Return the flight without the files that ``reasons`` names."""
        images = tuple(image for image in self.images if image.file not in reasons)
        return replace(self, images=images, left_out=self.left_out | reasons)


def read_sigmas(images: Iterable[FlightImage]) -> dict[str, tuple[float, float, float]]:
    """Return the standard deviations of positions that receivers wrote into EXIF, by name.

    They are east, north and up in metres. Photographs without them are omitted.
    """
    return {i.name: i.exif.xmp.rtk_sigma for i in images if i.exif.xmp.rtk_sigma is not None}


def read_flight(folder: Path, session: str = SESSION) -> Flight:
    """Read the metadata of every JPEG of a folder and of the folders in it.

    Of files with the same bytes, the first by name is kept. Files that are not images, cannot be
    read or have names that are not UTF-8 are left out.

    Args:
        folder: The folder.
        session: Session of the photographs in the scene.

    Raises:
        InputError: The folder does not exist or holds no photograph, or two files would have the
            same name in the scene.
    """
    require_folder(folder, "folder of photographs")
    paths = list_files(folder, _ENDINGS, depth=None)
    files = sorted(path.relative_to(folder).as_posix() for path in paths)
    if not files:
        raise InputError(f"{folder} holds no photograph ({', '.join(_ENDINGS)})")
    images: dict[str, FlightImage] = {}
    left_out = {}
    with progress_bar("read photographs", len(files)) as advance:
        for done, file in enumerate(files, 1):
            try:
                file.encode()
                digest = sha256_of(folder / file)
                if digest in images:
                    left_out[file] = f"the same file as {images[digest].file}"
                else:
                    images[digest] = _read_image(folder, file, digest, session)
            except UnicodeEncodeError:
                # Neither COLMAP nor JSON can store such a name.
                left_out[for_terminal(file)] = "its name is not UTF-8: rename it"
            except InputError as error:
                left_out[file] = str(error)
            except OSError as error:
                left_out[file] = f"cannot be read: {error.strerror}"
            advance(done)
    ordered = _sort(images.values())
    file_of: dict[str, str] = {}
    for image in ordered:
        if image.name in file_of:
            raise InputError(
                f"{folder}: {file_of[image.name]!r} and {image.file!r} would have the same name in "
                "the scene: rename one of them"
            )
        file_of[image.name] = image.file
    return Flight(tuple(ordered), left_out)


def warn_of_doubts(flight: Flight, *, with_lenses: bool) -> None:
    """Warn of metadata that cannot be trusted, one line for each kind.

    Args:
        flight: The photographs, with the positions that are used.
        with_lenses: Whether cameras are taken from EXIF, so that doubts about lenses matter.
    """
    doubts = {
        image.file: image.exif.doubts
        if with_lenses
        else (*image.exif.place_doubts, *image.exif.capture_doubts)
        for image in flight.images
    }
    for line in summarize_doubts(doubts):
        log.warning("%s", line)


def _read_image(folder: Path, file: str, digest: str, session: str = SESSION) -> FlightImage:
    exif, size = convert_to_ellipsoid(read_exif(folder / file)), image_size(folder / file)
    name = f"{session}/images/{'_'.join(file.split())}"
    return FlightImage(file, name, digest, exif, size)


def _sort(images: Iterable[FlightImage]) -> list[FlightImage]:
    """Sort by time if every photograph has one, else by file name."""
    by_name = sorted(images, key=lambda image: image.file)
    times = {image.file: image.exif.time for image in by_name if image.exif.time is not None}
    if len(times) < len(by_name):
        return by_name
    return sorted(by_name, key=lambda image: times[image.file])


def copy_photographs(
    flight: Flight, folder: Path, root: Path, size: int, rotated: Collection[str]
) -> Flight:
    """Copy photographs into a scene at a reduced size, some of them rotated by 180 degrees.

    Args:
        flight: The photographs.
        folder: Their folder.
        root: Folder of the sessions. Photographs that exist there are not copied again.
        size: Longest side, pixels.
        rotated: Names of the photographs to rotate.

    Returns:
        The flight without damaged photographs.
    """
    damaged = {}
    with progress_bar("copy photographs", len(flight.images)) as advance:
        for done, image in enumerate(flight.images, 1):
            target = root / image.name
            if not target.is_file():
                try:
                    read_rgb(folder / image.file)
                except InputError as error:
                    damaged[image.file] = str(error)
                else:
                    resize_file(folder / image.file, target, size, rotate_180=image.name in rotated)
            advance(done)
    return flight.leave_out(damaged)


def make_photographs(
    images: Sequence[FlightImage],
    longest: int,
    calibration: Camera | None,
) -> list[Photograph]:
    """Return photographs with the initial cameras for structure from motion.

    Args:
        images: The photographs of a flight.
        longest: Longest side of the photographs in the scene, pixels.
        calibration: Camera of all photographs; None takes focal lengths from EXIF, or guesses.

    Raises:
        InputError: ``calibration`` is for images of another aspect ratio.
    """
    photographs = []
    for image in images:
        focal = image.exif.relative_focal
        if calibration is None:
            width, height = reduce_size(image, longest)
            guess = image.exif.focals[0] if image.exif.focals else _GUESSED_FOCAL
            pixels = (focal or guess) * max(width, height)
            # One distortion coefficient, because more of them bend flat ground into a dome.
            camera = Camera("SIMPLE_RADIAL", width, height, (pixels, width / 2, height / 2, 0.0))
        else:
            camera = scale_camera(calibration, longest, image)
        photographs.append(
            Photograph(
                image.name,
                camera,
                image.lens if calibration is None else str(camera),
                calibrated=calibration is not None,
                focal_known=calibration is not None or focal is not None,
                focal_doubt="; ".join(image.exif.lens_doubts),
            )
        )
    return photographs


def reduce_size(image: FlightImage, longest: int) -> tuple[int, int]:
    """Return width and height of a photograph in the scene, limited to a longest side."""
    scale = min(1.0, longest / max(image.size))
    width, height = (round(scale * side) for side in image.size)
    return width, height


def scale_camera(calibration: Camera, longest: int, image: FlightImage) -> Camera:
    """Scale a calibration to the size of a photograph in the scene.

    Raises:
        InputError: the calibration is for images of another aspect ratio.
    """
    width, height = reduce_size(image, longest)
    # Sides are rounded to whole pixels.
    if abs(calibration.width * height - calibration.height * width) > max(
        calibration.width, calibration.height
    ):
        raise InputError(
            f"the camera is {calibration.width} x {calibration.height} pixels but {image.file} is "
            f"{image.size[0]} x {image.size[1]}: give a calibration of the same aspect ratio"
        )
    return calibration.resize(width, height)
