"""SIFT features extracted by COLMAP."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from objconnect.scene.colmap.native import MIN_FREE_BYTES, Progress
from objconnect.scene.colmap.options import SiftOptions
from objconnect.scene.errors import InputError
from objconnect.scene.maps.features import Features
from objconnect.scene.storage.files import require_disk_space
from objconnect.scene.storage.scratch import scratch

IMAGES_PER_CALL = 16
"""Images per call of the extractor: enough to use all cores, few enough to report progress."""

KEYPOINT_BYTES = 160
"""Size of a keypoint with its descriptor in a database (bytes)."""

# Largest plausible number of keypoints of a photograph.
_MAX_KEYPOINTS = 1 << 16


class SiftExtractor:
    """A SIFT extractor for one image at a time."""

    def __init__(self, options: SiftOptions) -> None:
        self._options = _native(options)

    def __call__(self, rgb: NDArray[np.uint8]) -> Features:
        """Return the features of an image (H, W, 3) uint8."""
        # An extractor keeps the scale space of its last image (0.3 GB for 1024 x 1024 pixels), so
        # each call makes a new one.
        native = pycolmap.FeatureExtractor.create(self._options, pycolmap.Device.cpu)
        grey = pycolmap.Bitmap.from_array(np.ascontiguousarray(rgb)).clone_as_grey()
        keypoints, descriptors = native.extract(grey)
        x, y, scale, _ = pycolmap.keypoints_to_matrix(keypoints).T
        return Features(np.stack([x, y], -1), scale.copy(), np.array(descriptors.data))


def extract_sift(
    root: Path,
    names: Sequence[str],
    options: SiftOptions,
    on_progress: Progress | None = None,
    threads: int = -1,
    parent: Path | None = None,
) -> dict[str, Features]:
    """Extract the SIFT features of many images.

    Args:
        root: folder that the names are relative to.
        names: names of the images.
        options: options of the detector.
        on_progress: called with the number of images done.
        threads: number of threads; -1 for the number of cores.
        parent: folder for temporary files, as for ``scratch``.

    Raises:
        InputError: an image is missing or cannot be read.
        WriteError: the disk has no space for temporary files.
    """
    native = _native(options)
    native.num_threads = threads
    with scratch(parent) as folder:
        database = folder / "database.db"
        for start in range(0, len(names), IMAGES_PER_CALL):
            chunk = list(names[start : start + IMAGES_PER_CALL])
            max_keypoints = min(options.max_features, _MAX_KEYPOINTS)
            require_disk_space(
                database, MIN_FREE_BYTES + 2 * len(chunk) * max_keypoints * KEYPOINT_BYTES
            )
            pycolmap.extract_features(
                database,
                root,
                chunk,
                extraction_options=native,
                device=pycolmap.Device.cpu,
            )
            if on_progress is not None:
                on_progress(start + len(chunk))
        features = read_features(database, root)
    for name in names:
        if name not in features:
            raise InputError(f"image {root / name} cannot be read or is damaged")
    return features


def read_features(database: Path, root: Path) -> dict[str, Features]:
    """Return the features of a database by image name.

    Args:
        database: file to read.
        root: folder of the images, for the error message.

    Raises:
        InputError: an image of the database has no keypoints.
    """
    features = {}
    with pycolmap.Database.open(database) as db:
        for image in db.read_all_images():
            if not db.exists_keypoints(image.image_id):
                raise InputError(f"image {root / image.name} cannot be read or is damaged")
            # A row is x, y and a 2x2 affine shape, whose determinant is the square of the scale.
            rows = db.read_keypoints(image.image_id)
            scale = np.sqrt(np.abs(np.linalg.det(rows[:, 2:].reshape(-1, 2, 2))))
            descriptors = np.array(db.read_descriptors(image.image_id).data)
            features[image.name] = Features(rows[:, :2].copy(), scale, descriptors)
    return features


def _native(options: SiftOptions) -> pycolmap.FeatureExtractionOptions:
    """Convert options to pycolmap's, without GPU."""
    native = pycolmap.FeatureExtractionOptions()
    native.use_gpu = False
    native.sift.max_num_features = options.max_features
    native.sift.peak_threshold = options.peak_threshold
    native.sift.upright = options.upright
    return native
