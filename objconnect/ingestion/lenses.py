"""Lenses of a scene that took new photographs too."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from objconnect.ingestion.photographs import FlightImage
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.photographs import Photograph
from objconnect.scene.storage.images import read_exif

# Focal lengths of one lens, as EXIF rounds them, differ by less than this share.
_SAME_FOCAL: Final = 0.005


@dataclass(frozen=True)
class _Lens:
    """What EXIF says of a lens: maker and model, and focal length (mm) on 35 mm film.

    Where its fields contradict each other, ``focals`` are what they say (longest sides).
    """

    body: tuple[str, str]
    focal: float | None
    focals: tuple[float, ...]

    def is_like(self, other: _Lens) -> bool:
        if self.focal is None or other.focal is None:
            return self == other
        return self.body == other.body and abs(self.focal / other.focal - 1) < _SAME_FOCAL


def with_known_lenses(
    scene: Scene, images: Sequence[FlightImage], taken: Sequence[Photograph]
) -> list[Photograph]:
    """Return photographs of which those of a lens of the map have its camera, calibrated.

    A photograph is of a lens of the map if maker, model, focal length and the picture's shape are
    equal. The camera of most of the map's photographs is taken where there are several.

    Args:
        scene: a scene with a map.
        images: the photographs as found.
        taken: the same photographs as structure from motion takes them.
    """
    seen: Counter[tuple[_Lens, Camera]] = Counter()
    for name, mapped in scene.sparse_map().images.items():
        exif = read_exif(scene.images_root / name)
        if exif.make or exif.model:
            seen[_Lens((exif.make, exif.model), exif.focal_35mm, exif.focals), mapped.camera] += 1
    known = [lens for lens, _ in seen.most_common()]
    found = []
    for image, photograph in zip(images, taken, strict=True):
        said = image.exif
        lens = _Lens((said.make, said.model), said.focal_35mm, said.focals)
        size = photograph.camera.width, photograph.camera.height
        camera = next((c for like, c in known if lens.is_like(like) and _has_shape(c, size)), None)
        if camera is not None:
            shared = camera.resize(*size)
            photograph = Photograph(image.name, shared, image.lens, True, True)
        found.append(photograph)
    return found


def _has_shape(camera: Camera, size: tuple[int, int]) -> bool:
    """Return whether a camera is that of pictures of a size, whose sides are whole pixels."""
    return abs(camera.width * size[1] - camera.height * size[0]) <= max(camera.width, camera.height)
