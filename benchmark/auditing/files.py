"""Check of the photographs as files: missing, damaged, of a wrong size, or duplicate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from benchmark.auditing.findings import Finding, right, unknown, wrong
from benchmark.auditing.statements import StatedData
from objconnect.scene.errors import InputError
from objconnect.scene.geo.sea_level import convert_to_ellipsoid
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.exif import Exif, read_exif
from objconnect.scene.storage.images import read_rgb

READABLE = "photographs are there and readable"
SIZES = "photographs have the size of their cameras"
UNIQUE = "every photograph is there once"

# A line names at most this many pairs of duplicates.
_MAX_NAMED = 3


@dataclass(frozen=True)
class Photographs:
    """Sizes, metadata and digests of the N photographs of a data set.

    Attributes:
        sizes: width and height of each; None if it cannot be read.
        exif: metadata of each; None if it cannot be read.
        digests: digest of the bytes of each; None if it cannot be read.
        faults: error messages of those that cannot be read, by name.
    """

    sizes: tuple[tuple[int, int] | None, ...]
    exif: tuple[Exif | None, ...]
    digests: tuple[str | None, ...]
    faults: dict[str, str]

    @property
    def duplicates(self) -> set[int]:
        """The rows of photographs with the same bytes as an earlier one."""
        first: dict[str, int] = {}
        rows = [(digest, row) for row, digest in enumerate(self.digests) if digest is not None]
        return {row for digest, row in rows if first.setdefault(digest, row) != row}


def read_photographs(stated: StatedData) -> Photographs:
    """Read the size, metadata and digest of every photograph.

    Each is decoded whole, because the header of a truncated file is intact.
    """
    sizes: list[tuple[int, int] | None] = []
    exif: list[Exif | None] = []
    digests: list[str | None] = []
    faults: dict[str, str] = {}
    files = stated.files
    if files is None:
        nothing = (None,) * len(stated)
        return Photographs(nothing, nothing, nothing, {})
    with progress_bar("photographs", len(files)) as advance:
        for done, (name, file) in enumerate(zip(stated.names, files, strict=True), 1):
            try:
                height, width = read_rgb(file).shape[:2]
                tags, digest = convert_to_ellipsoid(read_exif(file)), sha256_of(file)
            except (InputError, OSError) as error:
                faults[name] = str(error)
                sizes, exif, digests = [*sizes, None], [*exif, None], [*digests, None]
            else:
                sizes, exif = [*sizes, (width, height)], [*exif, tags]
                digests.append(digest)
            advance(done)
    return Photographs(tuple(sizes), tuple(exif), tuple(digests), faults)


def check_files(stated: StatedData, photographs: Photographs) -> Iterator[Finding]:
    """Yield the findings on the photographs as files."""
    if stated.files is None:
        why = "no photograph of the data set was found: give their folder with --images"
        yield unknown(READABLE, why)
        return
    if photographs.faults:
        first = next(iter(photographs.faults.values()))
        detail = f"{len(photographs.faults)} of {len(stated)} cannot be read: {first}"
        count = float(len(photographs.faults))
        yield wrong(READABLE, "photographs-missing", detail, photographs=count)
    else:
        yield right(READABLE, f"{len(stated)} photographs")
    yield _check_sizes(stated, photographs)
    yield _check_duplicates(stated, photographs)


def _check_sizes(stated: StatedData, photographs: Photographs) -> Finding:
    known = [
        (name, size, (camera.width, camera.height))
        for name, size, camera in zip(stated.names, photographs.sizes, stated.cameras, strict=True)
        if size is not None and camera is not None
    ]
    if not known:
        return unknown(SIZES, "no readable photograph has a stated camera")
    wrong_sizes = [
        (name, size, camera_size) for name, size, camera_size in known if size != camera_size
    ]
    if not wrong_sizes:
        return right(SIZES, f"{len(known)} photographs")
    name, size, camera_size = wrong_sizes[0]
    detail = (
        f"{len(wrong_sizes)} of {len(known)}, such as {name}, which is {size[0]} x {size[1]} "
        f"pixels; its camera is {camera_size[0]} x {camera_size[1]}"
    )
    return wrong(SIZES, "sizes", detail, photographs=float(len(wrong_sizes)))


def _check_duplicates(stated: StatedData, photographs: Photographs) -> Finding:
    owners: dict[str, str] = {}
    twice = []
    for name, digest in zip(stated.names, photographs.digests, strict=True):
        if digest is not None and owners.setdefault(digest, name) != name:
            twice.append(f"{owners[digest]} and {name}")
    if not twice:
        return right(UNIQUE, f"{len(owners)} different files")
    more = f" and {len(twice) - _MAX_NAMED} more" if len(twice) > _MAX_NAMED else ""
    detail = f"the same file has two names: {', '.join(twice[:_MAX_NAMED])}{more}"
    return wrong(UNIQUE, "duplicates", detail, photographs=float(len(twice)))


def fit_cameras(stated: StatedData, photographs: Photographs) -> list[Camera | None]:
    """Return the cameras scaled to the size of their photographs.

    ``check_files`` reports wrong sizes; all later checks use the scaled cameras. A camera that is
    not stated is guessed from the focal length in EXIF.
    """
    rows = zip(stated.cameras, photographs.sizes, photographs.exif, strict=True)
    return [_fit_camera(camera, size, tags) for camera, size, tags in rows]


def _fit_camera(
    camera: Camera | None, size: tuple[int, int] | None, exif: Exif | None
) -> Camera | None:
    """Return the camera of one photograph; None if it is unknown or has another aspect ratio."""
    if size is None:
        return camera
    if camera is None:
        if exif is None or exif.relative_focal is None:
            return None
        focal = exif.relative_focal * max(size)
        return Camera("SIMPLE_PINHOLE", *size, (focal, size[0] / 2, size[1] / 2))
    if size == (camera.width, camera.height):
        return camera
    try:
        return camera.resize(*size)
    except InputError:  # another aspect ratio
        return None
