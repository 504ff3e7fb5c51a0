"""The command ``supplement``: add points on small objects that a map misses."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from objconnect.mapping.diagnosis.command import Diagnosis, diagnose
from objconnect.mapping.supplement.classifier import read_classifier
from objconnect.mapping.supplement.config import SupplementConfig
from objconnect.mapping.supplement.map import add_to_map
from objconnect.mapping.supplement.small_objects import supplement_points
from objconnect.network.masks import read_masks
from objconnect.network.network import read_network
from objconnect.scene.bundle.scene import Scene


@dataclass(frozen=True)
class SupplementReport:
    """The added points of a map.

    Attributes:
        points: number of added points.
        observations: number of their observations.
        diagnosis: statistics of the map before and after.
    """

    points: int
    observations: int
    diagnosis: Diagnosis

    def as_dict(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""
        return asdict(self)

    def text(self) -> str:
        """Return the report as text."""
        added = f"{self.points} points with {self.observations} observations added"
        return f"{added}\n\n{self.diagnosis.text()}"


def supplement(
    path: Path, weights: Path | None = None, masks: Path | None = None
) -> SupplementReport:
    """Add points on small objects that have no point in a scene's map.

    Points of an earlier call are replaced. ``map.remove_from_map`` removes them.

    Args:
        path: finished scene with a map.
        weights: weights of an object-connect network; the object centres that it detects are
            candidates in addition to blobs (differences of Gaussians). None uses blobs alone.
        masks: masks of objects in the map's photographs, as ``read_masks`` takes them; None for
            none.

    Returns:
        The added points, with the map's statistics before and after.
        ``pictures/diagnosis.png`` shows both.

    Raises:
        InputError: the scene is not finished, has no map or a damaged file, or none of its
            photographs looks down. The map is unchanged then.
    """
    scene = Scene.open(path)
    scene.check_readable()
    sparse_map = scene.sparse_map()
    before = sparse_map.drop_points(scene.is_added_point(sparse_map))
    network = None if weights is None else read_network(weights)[0]
    labels = None if masks is None else dict(read_masks(masks, before.names))
    config = SupplementConfig()
    classifier = read_classifier()
    points, detections = supplement_points(
        before, scene.images_root, config, classifier, network, labels
    )
    add_to_map(path, points, detections, sparse_map.sha256)
    observations = sum(len(point.rows) for point in points)
    return SupplementReport(len(points), observations, diagnose(path, masks))
