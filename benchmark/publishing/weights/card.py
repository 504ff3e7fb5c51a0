"""``README.md``: the model card of published weights, with the front matter that a hub reads."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Final

import yaml

from benchmark.publishing.card import CARD
from benchmark.publishing.description import Release
from benchmark.publishing.licenses import hub_license, license_url
from benchmark.publishing.weights.benchmarks import FOLDER
from benchmark.publishing.weights.evaluations import Evaluation, results_table
from benchmark.publishing.weights.local_weights import LocalWeights
from objconnect.scene.storage.atomic import write_text

_TAGS: Final = ("uav", "visual-localization", "camera-pose", "colmap")
_LIMITS: Final = (
    "Recall on data unlike the training data is unknown until it is measured.",
    "Photographs must be calibrated, and the map must cover the ground that they show.",
)


def write_model_card(
    folder: Path,
    name: str,
    source: LocalWeights,
    evaluations: Sequence[Evaluation],
    release: Release,
) -> None:
    """Write the model card of a folder that holds all other files.

    Args:
        folder: the published folder.
        name: name of the model.
        source: the weights.
        evaluations: results of the weights.
        release: what the publisher states.

    Raises:
        InputError: the file cannot be written.
    """
    methods = dict.fromkeys(each.results.method.name for each in evaluations) or [source.method]
    template = (files("benchmark.publishing.weights") / "card.md").read_text(encoding="utf-8")
    body = Template(template).substitute(
        name=name,
        method=source.method,
        methods=" or ".join(f"`{method}`" for method in methods),
        file=source.file.name,
        sha256=source.sha256,
        files="\n".join(_rows(folder, source)),
        facts=_bullets(source.facts),
        figures=results_table(evaluations),
        license=source.license,
        license_url=license_url(source.license),
        by="" if release.creator is None else f", {release.creator}",
        limits=_bullets((*source.limits, *_LIMITS)),
    )
    matter = {
        "library_name": "objconnect",
        "license": hub_license(source.license),
        "tags": list(_TAGS),
    }
    text = yaml.safe_dump(matter, sort_keys=False, allow_unicode=True)
    write_text(folder / CARD, f"---\n{text}---\n\n{body}")


def _rows(folder: Path, source: LocalWeights) -> Iterable[str]:
    for file in source.calibration:
        yield f"| `{file.name}` | calibration, which is read with the weights |"
    if (folder / "results").is_dir():
        yield "| `results/START/DATASET/` | results of `objconnect evaluate` |"
    if (folder / FOLDER).is_dir():
        yield f"| `{FOLDER}/` | scores on published data sets, which the hub reads |"


def _bullets(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)
