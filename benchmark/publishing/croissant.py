"""``croissant.json``: the metadata of a published folder in Croissant 1.1.

It includes the Responsible-AI fields (RAI 1.0) and a record set whose fields are the columns of the
shards. Specifications: https://docs.mlcommons.org/croissant/docs/croissant-spec-1.1.html and
https://docs.mlcommons.org/croissant/docs/croissant-rai-spec.html.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from benchmark.publishing.columns import Column
from benchmark.publishing.description import CardFacts, Description, Release
from benchmark.publishing.licenses import license_url
from objconnect.scene.storage.atomic import write_text

CROISSANT: Final = "croissant.json"

_SPECIFICATIONS: Final = (
    "http://mlcommons.org/croissant/1.1",
    "http://mlcommons.org/croissant/RAI/1.0",
)
_RECORDS: Final = "photographs"
_SHARDS: Final = "shards"
_TYPES: Final = {
    "text": "sc:Text",
    "float": "cr:Float64",
    "integer": "cr:Int32",
    "picture": "sc:ImageObject",
}
_MEDIA: Final = {
    ".parquet": "application/x-parquet",
    ".json": "application/json",
}
_FILE_SET: Final = {
    "@type": "cr:FileSet",
    "@id": _SHARDS,
    "name": _SHARDS,
    "description": "The rows of all scenes and splits.",
    "encodingFormat": _MEDIA[".parquet"],
    "includes": "data/*/*.parquet",
}


def write_croissant(folder: Path, facts: CardFacts) -> None:
    """Write the metadata of a folder.

    Args:
        folder: the published folder.
        facts: the facts that the metadata state.

    Raises:
        InputError: the file cannot be written.
    """
    release = facts.release
    distribution = [_file(folder, path, sha256) for path, sha256 in facts.published.files.items()]
    metadata = {
        "@context": json.loads(
            (files("benchmark.publishing") / "context.json").read_text(encoding="utf-8")
        ),
        "@type": "sc:Dataset",
        "conformsTo": list(_SPECIFICATIONS),
        "name": facts.name,
        "description": facts.description.summary,
        "license": license_url(facts.published.license),
        "version": release.version,
        "citeAs": _citation(facts.name, release),
        "keywords": ["UAV", "visual localization", "camera pose", "COLMAP"],
        "inLanguage": "en",
        **_origin(release),
        **_responsible_ai(facts.description, facts.published.sealed),
        "distribution": [*distribution, _FILE_SET],
        "recordSet": [_record_set(facts.columns)],
    }
    write_text(folder / CROISSANT, json.dumps(metadata, indent=1, ensure_ascii=False) + "\n")


def _origin(release: Release) -> dict[str, Any]:
    """Return page, creator and date, as far as the publisher stated them."""
    fields: dict[str, Any] = {}
    if release.url is not None:
        fields["url"] = release.url
    if release.creator is not None:
        fields["creator"] = {"@type": "sc:Organization", "name": release.creator}
    if release.date is not None:
        fields["datePublished"] = release.date
    return fields


def _citation(name: str, release: Release) -> str:
    parts = [release.creator, name, f"version {release.version}", release.date, release.url]
    return ", ".join(part for part in parts if part is not None)


def _responsible_ai(description: Description, sealed: bool) -> dict[str, Any]:
    """Return the fields of the Responsible-AI vocabulary."""
    return {
        "rai:dataCollection": description.making,
        "rai:dataAnnotationProtocol": description.annotation,
        "rai:dataPreprocessingProtocol": (
            "Files of map photographs are published unchanged, those of queries without metadata."
            if sealed
            else "None: files of photographs are published unchanged."
        ),
        "rai:dataLimitations": list(description.limitations),
        "rai:dataBiases": list(description.biases),
        "rai:dataUseCases": list(description.uses),
        "rai:personalSensitiveInformation": description.personal,
        "rai:dataSocialImpact": (
            "Localization without GNSS serves inspection and rescue, and also surveillance."
        ),
        "rai:dataReleaseMaintenancePlan": (
            "A change is a new version with new digests; earlier commits stay readable."
        ),
    }


def _file(folder: Path, path: str, sha256: str) -> dict[str, Any]:
    media = _MEDIA.get(Path(path).suffix, "application/octet-stream")
    return {
        "@type": "cr:FileObject",
        "@id": path,
        "name": path,
        "contentUrl": path,
        "contentSize": f"{(folder / path).stat().st_size} B",
        "encodingFormat": media,
        "sha256": sha256,
    }


def _record_set(columns: Mapping[str, Column]) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": _RECORDS,
        "name": _RECORDS,
        "description": "One record for each photograph.",
        "key": [{"@id": f"{_RECORDS}/scene"}, {"@id": f"{_RECORDS}/name"}],
        "field": [_field(name, column) for name, column in columns.items()],
    }


def _field(name: str, column: Column) -> dict[str, Any]:
    source: dict[str, Any] = {"fileSet": {"@id": _SHARDS}, "extract": {"column": name}}
    if column.kind == "picture":
        source["transform"] = {"jsonPath": "bytes"}
    shape = {}
    if column.shape:
        shape = {"isArray": True, "arrayShape": ",".join(map(str, column.shape))}
    return {
        "@type": "cr:Field",
        "@id": f"{_RECORDS}/{name}",
        "name": name,
        "description": column.meaning,
        "dataType": _TYPES[column.kind],
        "source": source,
        **shape,
    }
