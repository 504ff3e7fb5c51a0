"""Each point of a map is assigned to the object that photographs show at its keypoints."""

from __future__ import annotations

import numpy as np

from objconnect.scene.bundle.manifest import SceneObject
from objconnect.scene.bundle.object_points import coverage, objects_of_points
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.maps.sparse_map import MapImage


def test_a_point_lies_on_what_most_photographs_see_there() -> None:
    """Three points: two of three photographs see object 7 at the first; the second is on the last
    pixel of the picture; the third is never observed."""
    camera = Camera("SIMPLE_PINHOLE", 4, 2, (4.0, 2.0, 1.0))
    instance = np.array([[7, 0, 0, 0], [0, 0, 0, 9]], np.uint16)
    image = MapImage(
        "a", camera, np.eye(4), np.array([[0.9, 0.9], [4.0, 2.0], [2.5, 0.5]]), np.array([0, 1, -1])
    )
    aside = MapImage("b", camera, np.eye(4), np.array([[1.1, 0.9]]), np.array([0]))
    seen = [(image, instance), (aside, instance), (image, instance)]
    assert objects_of_points(3, seen).tolist() == [7, 9, 0]
    assert objects_of_points(2, []).tolist() == [0, 0]


def test_objects_without_a_point_count_too() -> None:
    def make(number: int, name: str) -> SceneObject:
        return SceneObject(
            id=number, class_name=name, centre=(0, 0, 0), size=(1, 1, 1), yaw_deg=0,
            size_class="small",
        )  # fmt: skip

    objects = [make(3, "bench"), make(4, "bench"), make(5, "bin")]
    found = coverage(np.array([0, 3, 3, 9]), objects, lambda item: item.class_name)
    assert [(name, c.seen, c.with_points, c.points) for name, c in found.items()] == [
        ("bench", 2, 1, 2),
        ("bin", 1, 0, 0),
    ]
    assert found["bench"].text() == "1 of 2 seen have a point (50%), 1.00 points each"
