"""Detections of objects whose place is known: what a perfect network would find, made worse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from objconnect.mapping.supplement.association import Detections
from objconnect.scene.bundle.manifest import SceneObject
from objconnect.scene.bundle.scene import Scene

DIMENSIONS = 32


def detections(
    scene: Scene,
    wanted: Callable[[SceneObject], bool] = lambda item: item.size_class == "small",
    noise_px: float = 0.0,
    blur: float = 0.0,
    outliers: int = 0,
    seed: int = 0,
) -> dict[str, Detections]:
    """Centres of objects where a photograph of the map shows them unhidden.

    Args:
        scene: rendered, with its map.
        wanted: objects to find.
        noise_px: standard deviation of the pixels.
        blur: length of what is added to descriptors of length one.
        outliers: detections of nothing per photograph.
        seed: of all that.
    """
    rng = np.random.default_rng(seed)
    items = [item for item in scene.objects.objects if wanted(item)]
    # What looks alike has the same descriptor, but for a little.
    kinds = sorted({item.class_name for item in items})
    looks = dict(zip(kinds, rng.normal(size=(len(kinds), DIMENSIONS)), strict=True))
    found = {}
    for image, layers in scene.layers_of_map(scene.sparse_map(), "instance"):
        centres = torch.tensor([item.centre for item in items], dtype=torch.float64)
        seen = image.camera.project(image.pose.transform(centres))
        inside = (seen.valid & image.camera.contains(seen.xy, 1)).numpy()
        xy, descriptors = [], []
        for item, pixel in zip(
            [items[k] for k in np.flatnonzero(inside)], seen.xy.numpy()[inside], strict=True
        ):
            column, row = pixel.astype(int)
            if layers["instance"][row, column] == item.id:
                xy.append(pixel)
                descriptors.append(looks[item.class_name])
        size = (image.camera.width, image.camera.height)
        xy += list(rng.uniform(1, np.subtract(size, 1), (outliers, 2)))
        descriptors += [looks[kinds[k]] for k in rng.integers(0, len(kinds), outliers)]
        noisy = np.array(xy).reshape(-1, 2) + rng.normal(scale=noise_px, size=(len(xy), 2))
        vectors = np.array(descriptors).reshape(-1, DIMENSIONS)
        vectors = vectors / np.linalg.norm(vectors, axis=1, keepdims=True).clip(1e-9)
        around = rng.normal(size=vectors.shape)
        vectors = vectors + blur * around / np.linalg.norm(around, axis=1, keepdims=True)
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
        found[image.name] = Detections(
            noisy, vectors.astype(np.float32), rng.uniform(0.5, 1, len(noisy))
        )
    return found
