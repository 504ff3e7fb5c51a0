"""What a folder of photographs holds: files, cameras, places, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from scene.errors import InputError
from scene.geometry.camera import Camera
from scene.maps.photographs import Photograph
from scene.runtime.escaping import for_terminal
from scene.runtime.progress import progress_bar
from scene.storage.files import sha256_of
from scene.storage.images import Exif, image_size, read_exif
from scene.storage.listing import list_files

SESSION = "flight"
_ENDINGS = (".jpg", ".jpeg")
# Focal length in widths of the picture where nobody knows it; COLMAP's own guess.
_GUESS = 1.2


@dataclass(frozen=True)
class Shot:
    """One photograph of the folder.

    Attributes:
        file: relative to the folder.
        name: of the image in the scene, without white space, which divides words in text files.
        sha256: of the file.
        exif: what the camera wrote.
        size: width and height as stored, pixels.
    """

    file: str
    name: str
    sha256: str
    exif: Exif
    size: tuple[int, int]

    @property
    def lens(self) -> str:
        """What photographs of one lens have in common."""
        focal = f"{self.exif.focal_35mm:.2f} mm" if self.exif.focal_35mm else "focal length unknown"
        maker = f"{self.exif.make} {self.exif.model}".strip() or "unknown camera"
        return f"{maker}, {self.size[0]} x {self.size[1]}, {focal}"


@dataclass(frozen=True)
class Roll:
    """A folder's photographs in the order they were taken, and the files left out, with reasons."""

    shots: tuple[Shot, ...]
    left_out: dict[str, str]

    def without(self, reasons: dict[str, str]) -> Roll:
        """The roll without some files."""
        shots = tuple(shot for shot in self.shots if shot.file not in reasons)
        return replace(self, shots=shots, left_out=self.left_out | reasons)


def read_roll(folder: Path) -> Roll:
    """Look at every JPEG of a folder and of the folders in it.

    Of files with the same bytes the first by name stays. Files that are no images, or cannot be
    read, are left out, and so are those whose names are not UTF-8.

    Raises:
        InputError: no such folder, or no photograph in it, or two names that become one.
    """
    if not folder.is_dir():
        raise InputError(f"folder of photographs {folder} does not exist")
    found = list_files(folder, _ENDINGS, depth=None)
    files = sorted(path.relative_to(folder).as_posix() for path in found)
    if not files:
        raise InputError(f"{folder} holds no photograph ({', '.join(_ENDINGS)})")
    shots: dict[str, Shot] = {}
    left_out = {}
    with progress_bar("read photographs", len(files)) as advance:
        for done, file in enumerate(files, 1):
            try:
                file.encode()
                digest = sha256_of(folder / file)
                if digest in shots:
                    left_out[file] = f"the same file as {shots[digest].file}"
                else:
                    shots[digest] = _look_at(folder, file, digest)
            except UnicodeEncodeError:
                # Neither COLMAP nor JSON can hold it.
                left_out[for_terminal(file)] = "its name is not UTF-8: rename it"
            except InputError as error:
                left_out[file] = str(error)
            except OSError as error:
                left_out[file] = f"cannot be read: {error.strerror}"
            advance(done)
    ordered = _in_order(shots.values())
    named: dict[str, str] = {}
    for shot in ordered:
        if shot.name in named:
            raise InputError(
                f"{folder}: {named[shot.name]!r} and {shot.file!r} would have one name in the "
                "scene: rename one of them"
            )
        named[shot.name] = shot.file
    return Roll(tuple(ordered), left_out)


def _look_at(folder: Path, file: str, digest: str) -> Shot:
    exif, size = read_exif(folder / file), image_size(folder / file)
    name = f"{SESSION}/images/{'_'.join(file.split())}"
    return Shot(file, name, digest, exif, size)


def _in_order(shots: Iterable[Shot]) -> list[Shot]:
    """By time where every photograph tells one, else by name."""
    by_name = sorted(shots, key=lambda shot: shot.file)
    times = {shot.file: shot.exif.time for shot in by_name if shot.exif.time is not None}
    if len(times) < len(by_name):
        return by_name
    return sorted(by_name, key=lambda shot: times[shot.file])


def photographs_of(
    shots: Sequence[Shot], longest: int, calibration: Camera | None
) -> list[Photograph]:
    """Photographs as structure from motion takes them, with a camera for each lens.

    Args:
        shots: photographs.
        longest: side that those in the scene have at most, pixels.
        calibration: of all of them; None takes focal lengths from EXIF, or guesses.

    Raises:
        InputError: ``calibration`` is for another shape of picture.
    """
    photographs = []
    for shot in shots:
        scale = min(1.0, longest / max(shot.size))
        width, height = (round(scale * side) for side in shot.size)
        focal = shot.exif.focal_35mm
        if calibration is None:
            pixels = (focal / 36 if focal else _GUESS) * max(width, height)
            # One coefficient: more of them bend flat ground into a dome.
            camera = Camera("SIMPLE_RADIAL", width, height, (pixels, width / 2, height / 2, 0.0))
        else:
            camera = _fitted(calibration, width, height, shot)
        photographs.append(
            Photograph(
                shot.name,
                camera,
                shot.lens if calibration is None else str(camera),
                calibrated=calibration is not None,
                focal_known=calibration is not None or focal is not None,
            )
        )
    return photographs


def _fitted(calibration: Camera, width: int, height: int, shot: Shot) -> Camera:
    # Sides are whole pixels, so that a smaller picture's shape may be off by one of them.
    if abs(calibration.width * height - calibration.height * width) > max(
        calibration.width, calibration.height
    ):
        raise InputError(
            f"the camera is {calibration.width} x {calibration.height} pixels but {shot.file} is "
            f"{shot.size[0]} x {shot.size[1]}: give a calibration of its shape"
        )
    return calibration.resized(width, height)
