"""Evaluation of a method in a container, for the command ``evaluate --container``."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from benchmark.containers.data import write_data
from benchmark.containers.runtime import (
    Limits,
    image_digest,
    require_image_name,
    run_container,
)
from benchmark.datasets.dataset import Dataset
from benchmark.datasets.identity import require_unchanged
from benchmark.evaluation.evaluate import available_start, require_folder
from benchmark.evaluation.external_poses import require_method_name, score_poses
from benchmark.evaluation.starts import PRIOR, Start
from benchmark.report.album import ALBUM, ALBUM_MARK, keep_album
from benchmark.results.results import DatasetId, Results
from benchmark.results.results_files import check_results_output
from benchmark.submissions.submission import require_few_lines
from objconnect.localization.provenance import Method
from objconnect.methods import method_names
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import read_poses
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.storage.outputs import OutputFile, check_outputs
from objconnect.scene.storage.scratch import scratch

POSES: Final = "poses.txt"
"""The file that a container writes into its folder ``/output``."""

# Largest number of bytes per pixel of a photograph that is written as PNG.
_PIXEL_BYTES: Final = 3


def evaluate_container(
    image: str,
    name: str,
    settings: Mapping[str, Any],
    datasets: Sequence[Dataset],
    out: Path,
    start: Start = PRIOR,
) -> list[Path]:
    """Run a method in a container on data sets, score its poses, and write the results.

    Args:
        image: name of an image on this machine.
        name: name of the method, which names the results files.
        settings: limits of the container, values of ``Limits``.
        datasets: data sets to run on, one container for each.
        out: folder of the results.
        start: information on each query that the method gets besides its image.

    Returns:
        The results files.

    Raises:
        InputError: for the reasons of ``Container`` and ``Container.evaluate``.
    """
    container = Container(image, name, load_config(Limits, None, settings))
    for dataset in datasets:
        container.check_outputs(dataset, out)
    return [container.evaluate(dataset, out, start) for dataset in datasets]


class Container:
    """A method in a container image.

    Attributes:
        method: its description in results files: the digest of the image and the limits.
    """

    def __init__(self, image: str, name: str, limits: Limits) -> None:
        """Look an image up.

        Args:
            image: name of an image on this machine.
            name: name of the method, which names the results files.
            limits: limits of the container.

        Raises:
            InputError: the name cannot be used, Docker does not answer, or there is no such image.
        """
        require_image_name(image)
        require_method_name(name)
        if name in method_names():
            raise InputError(
                f"--method names the method in the container, and {name} is one of the project: "
                "choose another name"
            )
        self._digest, self._limits = image_digest(image), limits
        recorded = {"image": self._digest, **limits.model_dump(mode="json")}
        self.method = Method(name=name, config=recorded, weights_sha256=None)

    def check_outputs(self, dataset: Dataset, out: Path) -> Path:
        """Return the path of the results on a data set.

        Raises:
            InputError: a file would be replaced that ``evaluate`` did not write.
        """
        require_folder(out)
        target = out / dataset.name / f"{self.method.name}.json"
        check_results_output(target, self.method, out)
        check_outputs([OutputFile(target.with_name(ALBUM), ALBUM_MARK)], within=out)
        return target

    def evaluate(self, dataset: Dataset, out: Path, start: Start = PRIOR) -> Path:
        """Run the container on a data set, score its poses, and write the results.

        Args:
            dataset: data set to run on.
            out: folder of the results.
            start: information on each query that the method gets besides its image.

        Returns:
            The results file.

        Raises:
            InputError: the data set is damaged or changed during the run, the container failed, its
                poses are missing or wrong, or ``out`` cannot be written.
        """
        target = self.check_outputs(dataset, out)
        start = available_start(start, dataset)
        sparse_map = dataset.load_map()
        needed = sum(q.camera.width * q.camera.height for q in dataset.queries) * _PIXEL_BYTES
        with scratch(out, needed) as folder:
            data, output = folder / "data", folder / "output"
            data.mkdir()
            output.mkdir()
            write_data(dataset, start, data)
            run_container(self._digest, data, output, self._limits)
            poses = _read_poses(output / POSES, dataset)
        require_unchanged(dataset, sparse_map.names)
        queries = score_poses(dataset, poses, sparse_map, start, f"no line in {POSES}")
        results = Results.of(self.method, DatasetId.of(dataset), start.name, queries)
        keep_album(target.with_name(ALBUM), dataset, sparse_map)
        results.write(target)
        return target


def _read_poses(path: Path, dataset: Dataset) -> dict[str, Pose]:
    """Read the poses that a container wrote; the file may hold anything."""
    if not os.path.lexists(path):
        raise InputError(f"the container wrote no {POSES}: it must write /output/{POSES}")
    if path.is_symlink() or not path.is_file():
        raise InputError(f"/output/{POSES} of the container is a link or a folder, not a file")
    try:
        require_few_lines(path, dataset.name, len(dataset.queries))
        poses = read_poses(path)
    except InputError as error:
        text = str(error).replace(str(path), f"/output/{POSES}")
        raise InputError(f"poses of the container: {text}") from None
    known = {query.name for query in dataset.queries}
    if unknown := [name for name in poses if name not in known]:
        raise InputError(
            f"/output/{POSES} of the container has a pose of {unknown[0]}, which is not a query of "
            f"{dataset.name}: names are those in /data/queries.txt"
        )
    return poses
