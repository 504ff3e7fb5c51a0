"""Recognise the lenses of a scene in new photographs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from objconnect.ingestion.photographs import FlightImage
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.photographs import Photograph
from objconnect.scene.storage.exif import read_exif

# Focal lengths of one lens, as EXIF rounds them, differ by less than this share.
_SAME_FOCAL: Final = 0.005


@dataclass(frozen=True)
class _Lens:
    """A lens by its EXIF: maker and model, and 35 mm equivalent focal length (mm).

    If the fields of EXIF contradict each other, ``focals`` are their focal lengths, divided by the
    longer image side.
    """

    body: tuple[str, str]
    focal: float | None
    focals: tuple[float, ...]

    def is_like(self, other: _Lens) -> bool:
        if self.focal is None or other.focal is None:
            return self == other
        return self.body == other.body and abs(self.focal / other.focal - 1) < _SAME_FOCAL


def apply_known_lenses(
    scene: Scene, images: Sequence[FlightImage], photographs: Sequence[Photograph]
) -> list[Photograph]:
    """Give photographs taken with a lens of the map the calibrated camera of that lens.

    A lens is the same if maker, model, focal length and aspect ratio are equal. Where it has
    several cameras in the map, the most frequent one is used.

    Args:
        scene: a scene with a map.
        images: the photographs with their EXIF.
        photographs: the same photographs with cameras, as structure from motion reads them.

    Returns:
        The photographs with the known cameras.
    """
    counts: Counter[tuple[_Lens, Camera]] = Counter()
    for name, mapped in scene.sparse_map().images.items():
        exif = read_exif(scene.images_root / name)
        if exif.make or exif.model:
            counts[_Lens((exif.make, exif.model), exif.focal_35mm, exif.focals), mapped.camera] += 1
    known = [lens_and_camera for lens_and_camera, _ in counts.most_common()]
    calibrated = []
    for image, photograph in zip(images, photographs, strict=True):
        exif = image.exif
        lens = _Lens((exif.make, exif.model), exif.focal_35mm, exif.focals)
        size = photograph.camera.width, photograph.camera.height
        camera = next(
            (c for other, c in known if lens.is_like(other) and _has_shape(c, size)), None
        )
        if camera is not None:
            photograph = Photograph(
                image.name, camera.resize(*size), image.lens, calibrated=True, focal_known=True
            )
        calibrated.append(photograph)
    return calibrated


def _has_shape(camera: Camera, size: tuple[int, int]) -> bool:
    """Return whether a camera has the aspect ratio of a size, up to rounding to whole pixels."""
    return abs(camera.width * size[1] - camera.height * size[0]) <= max(camera.width, camera.height)
