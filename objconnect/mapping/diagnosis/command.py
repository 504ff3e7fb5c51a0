"""The command ``diagnose``: measure coverage, accuracy and uniformity of a map's points.

The object-connect paper claims that structure from motion misses small objects, covers the ground
unevenly and has points that drift off the surfaces. These statistics test the claim on a map.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from objconnect.mapping.diagnosis.mask_coverage import check_size, mask_coverage, points_by_label
from objconnect.mapping.diagnosis.picture import Panel, draw
from objconnect.mapping.diagnosis.surface_distances import SurfaceDistances, Truth, read_truth
from objconnect.mapping.diagnosis.uniformity import Uniformity, uniformity, visible_cells
from objconnect.network.masks import read_masks
from objconnect.network.segmentation import NOTHING, Labels
from objconnect.scene.bundle.object_points import ObjectCoverage, coverage
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.images import read_rgb

_PICTURE = Path("pictures", "diagnosis.png")


@dataclass(frozen=True)
class PointStatistics:
    """Statistics of the points of a map.

    Attributes:
        points: number of points.
        objects: coverage of the objects in the map's photographs, by size class.
        small_objects: coverage of the small objects, by class.
        masks: coverage of the user's masks, by the size class of the objects.
        surface_distances: distances from the true surface of all points, of points on the ground,
            and of points on objects by size class; empty without truth.
        uniformity: how evenly the points cover the ground; None if no two photographs see the
            same ground.
    """

    points: int
    objects: Mapping[str, ObjectCoverage]
    small_objects: Mapping[str, ObjectCoverage]
    masks: Mapping[str, ObjectCoverage]
    surface_distances: Mapping[str, SurfaceDistances]
    uniformity: Uniformity | None

    def text(self) -> str:
        """Return the statistics as text."""
        lines = [f"{self.points} points"]
        lines += [f"{name} objects: {c.text()}" for name, c in self.objects.items()]
        lines += [f"  small, {name}: {c.text()}" for name, c in self.small_objects.items()]
        lines += [f"masks of {name} objects: {c.text()}" for name, c in self.masks.items()]
        lines += [
            f"off the true surface, {name}: {d.text()}"
            for name, d in self.surface_distances.items()
        ]
        if self.uniformity is not None:
            lines.append(f"ground: {self.uniformity.text()}")
        return "\n".join(lines)


@dataclass(frozen=True)
class Diagnosis:
    """Statistics of a map, with and without the points that ``supplement`` added.

    Attributes:
        reprojection_error_px: mean reprojection error over all observations, pixels.
        track_length: mean number of photographs that observe a point.
        map: statistics of all points.
        before: statistics without added points; None if there are none.
        added: distances of added points from the surface of their object, infinite for points on no
            object; None without added points or truth.
        picture: file of the picture of the points over a photograph.
    """

    reprojection_error_px: float
    track_length: float
    map: PointStatistics
    before: PointStatistics | None
    added: SurfaceDistances | None
    picture: Path

    def as_dict(self) -> dict[str, Any]:
        """Return the statistics as a dictionary for JSON."""
        return asdict(self)

    def text(self) -> str:
        """Return the statistics as text."""
        lines = [
            f"{self.reprojection_error_px:.2f} px mean reprojection error, tracks of "
            f"{self.track_length:.1f} images",
            self.map.text(),
        ]
        if self.before is not None:
            lines += ["", "before points were added:", self.before.text()]
        if self.added is not None:
            lines += ["", f"added points, off their objects' true surface: {self.added.text()}"]
        return "\n".join([*lines, str(self.picture)])


def diagnose(path: Path, masks: Path | None = None, cell_m: float = 5.0) -> Diagnosis:
    """Measure which objects of a scene have points in its map, and draw the points.

    Rendered scenes have true objects and surfaces. Other scenes need masks of objects; without
    masks, only the uniformity of the points is measured.

    Args:
        path: finished scene with a map.
        masks: masks of map photographs, as ``read_masks`` takes them. They replace the true
            objects.
        cell_m: side of the cells over which uniformity is measured, metres.

    Returns:
        The statistics. ``pictures/diagnosis.png`` is written into the scene.

    Raises:
        InputError: the scene is not finished, has no map, or has a damaged file.
    """
    scene = Scene.open(path)
    sparse_map = scene.sparse_map()
    added = scene.is_added_point(sparse_map)
    user_masks = {} if masks is None else dict(read_masks(masks, sparse_map.names))
    for name, labels in user_masks.items():
        check_size(labels, sparse_map.images[name])
    truth = read_truth(scene, sparse_map)
    cells = visible_cells(scene, sparse_map, cell_m)

    def measure_points(kept: NDArray[np.bool_]) -> PointStatistics:
        return PointStatistics(
            points=int(kept.sum()),
            **_object_coverage(scene, truth, kept),
            masks=mask_coverage(sparse_map, user_masks, kept),
            surface_distances={} if truth is None else _surface_distances(scene, truth, kept),
            uniformity=uniformity(sparse_map.xyz[kept], cells, cell_m),
        )

    added_distances = None
    if added.any() and truth is not None:
        distances = np.where(truth.owners > 0, truth.distance_m, np.inf)[added]
        added_distances = SurfaceDistances.of(distances)
    states = {"map": np.ones(len(added), bool)}
    if added.any():
        states = {"before": ~added, "after": states["map"]}
    picture = path / _PICTURE
    _draw(scene, sparse_map, truth, user_masks, states, picture)
    measured = [measure_points(kept) for kept in states.values()]
    return Diagnosis(
        reprojection_error_px=sparse_map.reprojection_error(),
        track_length=float(sparse_map.track_length.mean()),
        map=measured[-1],
        before=measured[0] if len(measured) > 1 else None,
        added=added_distances,
        picture=picture,
    )


def _object_coverage(
    scene: Scene, truth: Truth | None, kept: NDArray[np.bool_]
) -> dict[str, dict[str, ObjectCoverage]]:
    """Return the fields ``objects`` and ``small_objects`` of ``PointStatistics``."""
    if truth is None:
        return {"objects": {}, "small_objects": {}}
    in_view = [item for item in scene.objects.objects if item.id in truth.ids_in_view]
    small = [item for item in in_view if item.size_class == "small"]
    owners = truth.owners[kept]
    return {
        "objects": coverage(owners, in_view, lambda item: item.size_class),
        "small_objects": coverage(owners, small, lambda item: item.class_name),
    }


def _surface_distances(
    scene: Scene, truth: Truth, kept: NDArray[np.bool_]
) -> dict[str, SurfaceDistances]:
    owners, distances = truth.owners[kept], truth.distance_m[kept]
    groups = {"all": np.ones(len(owners), bool), "ground": owners == 0}
    for size in ("small", "medium", "large"):
        ids = [item.id for item in scene.objects.objects if item.size_class == size]
        groups[f"{size} objects"] = np.isin(owners, ids)
    return {
        name: SurfaceDistances.of(distances[group]) for name, group in groups.items() if group.any()
    }


def _draw(
    scene: Scene,
    sparse_map: SparseMap,
    truth: Truth | None,
    user_masks: Mapping[str, Labels],
    states: Mapping[str, NDArray[np.bool_]],
    path: Path,
) -> None:
    """Draw the points over the photograph with the most masks, small objects or points."""
    if user_masks:
        name = max(user_masks, key=lambda name: len(np.unique(user_masks[name])))
        labels = user_masks[name]
    elif truth is not None:
        name = max(truth.small_counts, key=lambda name: truth.small_counts[name])
        labels = _true_labels(scene, sparse_map, name)
    else:
        name = max(
            sparse_map.names, key=lambda n: int((sparse_map.images[n].point_rows >= 0).sum())
        )
        camera = sparse_map.images[name].camera
        labels = np.full((camera.height, camera.width), NOTHING)
    image = sparse_map.images[name]
    shown = np.unique(labels[labels != NOTHING]).tolist()
    panels = []
    for title, kept in states.items():
        if user_masks or truth is None:
            labels_with_points = set(points_by_label(labels, image, kept))
        else:
            labels_with_points = set(truth.owners[kept].tolist())
        panels.append(Panel(title, kept, {label: label in labels_with_points for label in shown}))
    photograph = read_rgb(scene.images_root / name, image.camera)
    draw(photograph, image, labels, None if truth is None else truth.distance_m, panels, path)


def _true_labels(scene: Scene, sparse_map: SparseMap, name: str) -> Labels:
    """Return the label map of the small objects of a photograph, labelled by their ids."""
    small = [item.id for item in scene.objects.objects if item.size_class == "small"]
    layers_of_images = scene.layers_of_map(sparse_map, "instance")
    instance = next(layers["instance"] for image, layers in layers_of_images if image.name == name)
    return np.where(np.isin(instance, small), instance.astype(np.int64), NOTHING)
