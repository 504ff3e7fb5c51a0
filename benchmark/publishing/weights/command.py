"""The command ``publish-weights``, which writes weights as a model repository of a hub."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark.publishing.description import Release
from benchmark.publishing.weights.benchmarks import open_benchmark, scores, write_scores
from benchmark.publishing.weights.card import write_model_card
from benchmark.publishing.weights.evaluations import read_evaluations
from benchmark.publishing.weights.local_weights import find_local_weights
from objconnect.scene.storage.atomic import atomic_folder
from objconnect.scene.storage.checksums import write_checksums
from objconnect.scene.storage.outputs import check_output_folder, require_empty, require_name


@dataclass(frozen=True)
class WeightsReport:
    """Published weights.

    Attributes:
        out: the folder.
        sha256: digest of the weights.
        results: number of results files that are published with the weights.
        left_out: number of results files of other weights.
        size: bytes of weights, calibration and results.
        written: bytes of all files; None after a dry run.
    """

    out: Path
    sha256: str
    results: int
    left_out: int
    size: int
    written: int | None

    def text(self) -> str:
        """Return a few lines for a person."""
        if self.written is None:
            lines = [f"{self.out} would hold about {self.size} bytes"]
        else:
            lines = [f"{self.out}: {self.written} bytes"]
        lines.append(f"weights {self.sha256[:12]} with {self.results} results files")
        if self.left_out:
            lines.append(f"{self.left_out} results files are of other weights and are left out")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return the report for a program."""
        return {**vars(self), "out": str(self.out)}


def publish_weights(
    weights: str,
    out: Path,
    results: Sequence[Path] = (),
    benchmarks: Sequence[Path] = (),
    release: Release | None = None,
    dry_run: bool = False,
) -> WeightsReport:
    """Write weights as a model repository: the unchanged file, a card, results and checksums.

    Args:
        weights: name of weights that come with the project, or a ``.safetensors`` file with its
            card beside it.
        out: folder, new or empty; its name is the name of the model.
        results: results files, or folders of them; those of other weights are left out.
        benchmarks: published data sets on the hub, ``hf://OWNER/NAME@COMMIT``, whose scores the
            hub is to show.
        release: licence and creator.
        dry_run: whether to write nothing and to report the size.

    Raises:
        InputError: the weights, their card or the results are missing or damaged, no licence is
            stated, a data set has no complete results, or ``out`` is not empty or cannot be
            written.
    """
    release = release or Release()
    name = out.resolve().name
    require_name(name, "model")
    require_empty(out)
    source = find_local_weights(weights, release.license)
    check_output_folder(out, [*results, source.file])
    evaluations, left_out = read_evaluations(results, source.sha256)
    boards = [scores(open_benchmark(address), evaluations) for address in benchmarks]
    copied = {file.name: file for file in source.files}
    copied |= {each.name: each.file for each in evaluations}
    written = None
    if not dry_run:
        with atomic_folder(out) as folder:
            for path, file in copied.items():
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, folder / path)
            for files in boards:
                write_scores(folder, files)
            write_model_card(folder, name, source, evaluations, release)
            write_checksums(folder)
        written = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    return WeightsReport(
        out=out,
        sha256=source.sha256,
        results=len(evaluations),
        left_out=left_out,
        size=sum(file.stat().st_size for file in copied.values()),
        written=written,
    )
