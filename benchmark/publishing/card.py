"""``README.md``: the data card of a published folder, with the front matter that a hub reads."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, Final

import yaml

from benchmark.publishing.description import CardFacts
from benchmark.publishing.index import PublishedIndex, PublishedScene
from benchmark.publishing.licenses import hub_license, license_url
from benchmark.publishing.previews import preview_name
from benchmark.publishing.rows import SPLITS
from objconnect.scene.storage.atomic import write_text

CARD: Final = "README.md"

# The hub's size classes: (upper bound of the number of rows, name of the class).
_SIZES: Final = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"))
_LARGEST: Final = "100K<n<1M"
# Commands that use a published folder, with query poses and without them (*sealed*).
_USE: Final = """objconnect evaluate FOLDER --method sift --out RESULTS
objconnect leaderboard RESULTS"""
_SEALED_USE: Final = "objconnect submit FOLDER --method sift --out SUBMISSION"
# Number of digits of a digest that the card shows.
_DIGEST_DIGITS: Final = 12


def write_card(folder: Path, facts: CardFacts) -> None:
    """Write the data card of a folder.

    Args:
        folder: the published folder.
        facts: the facts that the card states.

    Raises:
        InputError: the file cannot be written.
    """
    published, description = facts.published, facts.description
    release, columns = facts.release, facts.columns
    template = (files("benchmark.publishing") / "card.md").read_text(encoding="utf-8")
    body = Template(template).substitute(
        name=facts.name,
        use=_SEALED_USE if published.sealed else _USE,
        summary=description.summary,
        pictures="\n".join(f"![{s.name}]({preview_name(s.name)})" for s in published.scenes),
        scenes="\n".join(map(_scene_row, published.scenes)),
        columns="\n".join(f"| `{key}` | {column.meaning} |" for key, column in columns.items()),
        making=description.making,
        annotation=description.annotation,
        cost=description.cost,
        license=published.license,
        license_url=license_url(published.license),
        by="" if release.creator is None else f", {release.creator}",
        limitations=_bullets(description.limitations),
        uses=_bullets(description.uses),
        personal=description.personal,
    )
    matter = yaml.safe_dump(
        _front_matter(facts.name, published), sort_keys=False, allow_unicode=True
    )
    write_text(folder / CARD, f"---\n{matter}---\n\n{body}")


def _front_matter(name: str, published: PublishedIndex) -> dict[str, Any]:
    """Return the metadata that the hub reads: the licence, and the files of each split."""
    count = sum(sum(scene.photographs.values()) for scene in published.scenes)
    configs = [_config("default", "*", default=True)]
    if len(published.scenes) > 1:
        configs += [_config(scene.name, scene.name) for scene in published.scenes]
    return {
        "pretty_name": name,
        "license": hub_license(published.license),
        "annotations_creators": ["machine-generated"],
        "size_categories": [next((word for most, word in _SIZES if count < most), _LARGEST)],
        "tags": ["uav", "visual-localization", "camera-pose", "colmap", "croissant"],
        "configs": configs,
    }


def _config(name: str, scene: str, default: bool = False) -> dict[str, Any]:
    data = [{"split": split, "path": f"data/{scene}/{split}-*.parquet"} for split in SPLITS]
    return {"config_name": name, "data_files": data, **({"default": True} if default else {})}


def _scene_row(scene: PublishedScene) -> str:
    conditions = ", ".join(sorted({c for s in scene.sessions.values() for c in s.conditions}))
    counts = scene.photographs
    return (
        f"| {scene.name} | {counts['map']} | {counts['query']} | {conditions} "
        f"| `{scene.sha256[:_DIGEST_DIGITS]}` |"
    )


def _bullets(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)
