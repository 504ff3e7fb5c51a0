"""The command ``publish``, which writes scenes as a folder for a data hub."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmark.publishing.card import write_card
from benchmark.publishing.columns import Column, columns_with
from benchmark.publishing.croissant import write_croissant
from benchmark.publishing.description import CardFacts, Release, describe
from benchmark.publishing.index import (
    INDEX,
    PublishedIndex,
    PublishedScene,
    PublishedSession,
    scene_folder,
)
from benchmark.publishing.layers import LAYER_FILES, PublishedLayer
from benchmark.publishing.previews import draw_preview, preview_name
from benchmark.publishing.report import PublishReport, Sizes
from benchmark.publishing.rows import SPLITS
from benchmark.publishing.shards import require_parquet, write_shards
from benchmark.publishing.sources import Source, choose_license, find_scenes, open_sources
from objconnect.scene.bundle.manifest import write_json
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.storage.atomic import atomic_folder, replace_folder
from objconnect.scene.storage.checksums import write_checksums
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.outputs import check_output_folder, require_empty, require_name
from objconnect.scene.storage.scratch import scratch


def publish(
    paths: Sequence[Path],
    out: Path,
    layers: Sequence[str] = (),
    release: Release | None = None,
    dry_run: bool = False,
    sealed: bool = False,
) -> PublishReport:
    """Write scenes as a folder for a data hub.

    The folder holds Parquet files of the photographs with poses, cameras, priors and difficulty,
    the maps, a data card, metadata in Croissant 1.1, preview pictures and checksums. It appears
    when it is complete.

    Args:
        paths: scenes, flights, or folders of them, such as those that ``track`` renders.
        out: folder, new or empty; its name is the name of the data set.
        layers: layers to publish with the photographs, keys of ``LAYER_FILES``.
        release: the publisher's statements on the data set.
        dry_run: whether to write nothing and to report the size.
        sealed: whether to leave out the poses of the queries and all data that reveal them. Only
            scenes that were rendered from a secret key can be sealed.

    Raises:
        InputError: a path is neither a scene nor a flight, one lacks a map, a query or a layer, a
            prior cannot be stored, two scenes have the same name, a licence must be stated, a scene
            cannot be sealed, or ``out`` is not empty, cannot be written or lies in a scene or a
            published data set.
    """
    release = release or Release()
    require_parquet()
    name = out.resolve().name
    require_name(name, "data set")
    folders = find_scenes(paths)
    require_empty(out)
    for folder in folders:
        if out.resolve().is_relative_to(folder.resolve()):
            raise InputError(f"{out} lies in the scene {folder}: choose a folder outside it")
    for parent in out.resolve().parents:
        if (parent / INDEX).is_file():
            raise InputError(f"{out} lies in the data set {parent}: choose a folder outside it")
    check_output_folder(out, folders)
    if unknown := [layer for layer in layers if layer not in LAYER_FILES]:
        raise InputError(f"there is no layer {unknown[0]!r}; there are {', '.join(LAYER_FILES)}")
    if layers and sealed:
        raise InputError(
            "layers can reveal the poses, so a sealed data set has none: leave out --layer"
        )
    ordered_layers = tuple(layer for layer in LAYER_FILES if layer in layers)
    sources = open_sources(folders, ordered_layers, sealed)
    license_id = choose_license(sources, release)
    sizes = Sizes.sum(source.sizes() for source in sources)
    written = None
    if not dry_run:
        with scratch(out.resolve().parent, sizes.total) as temporary:
            draft = temporary / name
            try:
                with atomic_folder(draft) as folder:
                    _write(folder, name, sources, ordered_layers, release, license_id)
            except WriteError as error:
                raise WriteError(str(error).replace(str(draft), str(out))) from None
            written = sum(file.stat().st_size for file in draft.rglob("*") if file.is_file())
            replace_folder(out.resolve(), draft, ())
    counts = {split: sum(len(s.rows.frame_rows(split)) for s in sources) for split in SPLITS}
    return PublishReport(
        out=out,
        scenes=tuple(source.rows.scene.name for source in sources),
        photographs=counts,
        left_out=sum(source.left_out for source in sources),
        sizes=sizes,
        written=written,
        unstated=release.unstated,
    )


def _write(
    folder: Path,
    name: str,
    sources: Sequence[Source],
    layers: Sequence[PublishedLayer],
    release: Release,
    license_id: str,
) -> None:
    """Write all files into an empty folder, the checksums last."""
    columns = columns_with(layers)
    scenes = tuple(_write_scene(folder, source, columns) for source in sources)
    sealed = sources[0].rows.sealed
    published = PublishedIndex(
        license=license_id, layers=tuple(layers), scenes=scenes, sealed=sealed
    )
    total_bytes = sum((folder / path).stat().st_size for path in published.files)
    description = describe(published, total_bytes)
    facts = CardFacts(name, release, published, description, columns)
    write_json(folder / INDEX, published)
    write_card(folder, facts)
    write_croissant(folder, facts)
    write_checksums(folder, published.files)


def _write_scene(folder: Path, source: Source, columns: Mapping[str, Column]) -> PublishedScene:
    """Write shards, map and preview of a scene."""
    scene, dataset = source.rows.scene, source.dataset
    rows = source.rows.with_difficulty(source.difficulty())
    shards = {
        split: write_shards(folder / "data" / scene.name, split, columns, rows.rows(split))
        for split in SPLITS
    }
    copied = []
    for name, original in source.files:
        copied.append(folder / scene_folder(scene.name) / name)
        copied[-1].parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(original, copied[-1])
    preview = folder / preview_name(scene.name)
    preview.parent.mkdir(exist_ok=True)
    draw_preview(preview, scene.images_root, rows.frames)
    files = [*copied, *(shard for split in SPLITS for shard in shards[split])]
    return PublishedScene(
        name=scene.name,
        track=dataset.track,
        sha256=source.sha256,
        map_conditions=dataset.map_conditions,
        unjudged=dataset.unjudged,
        **vars(source.provenance),
        sessions={
            name: PublishedSession(
                conditions=rows.session_conditions(name),
                flight=session.flight,
                readout_s=session.readout_s,
            )
            for name, session in scene.sessions.items()
        },
        photographs={split: len(rows.frame_rows(split)) for split in SPLITS},
        left_out=source.left_out,
        shards={
            split: tuple(shard.relative_to(folder).as_posix() for shard in shards[split])
            for split in SPLITS
        },
        files={file.relative_to(folder).as_posix(): sha256_of(file) for file in files},
    )
