"""The command ``track``, which prepares the sites (*places*) of a track and checks digests."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.datasets.cmu import is_cmu
from benchmark.datasets.flight import open_flight
from benchmark.datasets.identity import sealed_sha256
from benchmark.datasets.simulated import open_scene
from benchmark.tracks.description import (
    DESCRIPTION,
    TRACKS_FOLDER,
    Track,
    TrackPlace,
    load_track,
    write_track,
)
from benchmark.tracks.difficulty import measure, measure_flight, write_queries
from benchmark.tracks.renders import difference, read_render, render_of, render_path, write_render
from benchmark.tracks.sealing import read_key, sealed_seed
from objconnect.mapping.build import build_map
from objconnect.scene.bundle.scene import Scene, is_scene
from objconnect.scene.errors import InputError
from objconnect.scene.exports.export import export
from objconnect.scene.storage.outputs import check_output_folder, check_outputs
from simulate.command import find_finished, simulate
from simulate.config import SimulateConfig

# The preset of drives, which are also exported in the layout of Extended CMU Seasons.
_STREET: Final = "street"
_CMU_FORMAT: Final = "cmu"
FLIGHTS_VARIABLE: Final = "OBJCONNECT_REAL"
"""Environment variable that names the folder of the flights of a track."""

# Characters of a digest that are shown.
_DIGEST_LENGTH: Final = 12


@dataclass(frozen=True)
class PlaceReport:
    """A rendered and mapped place, or a flight, compared with the recorded one.

    Attributes:
        dataset: name of the data set.
        scene: folder of the scene or flight.
        export: folder in the layout of Extended CMU Seasons; None for places without streets.
        queries: number of queries.
        sha256: digest of the data set.
        recorded_digests: digests of the renders that the track records; empty if it records none.
        difference: how this render differs from the recorded one by more than rounding; empty if it
            does not.
        public_sha256: digest of what is published of a place with withheld query poses (*sealed*);
            None for other places.
    """

    dataset: str
    scene: Path
    export: Path | None
    queries: int
    sha256: str
    recorded_digests: tuple[str, ...]
    difference: str = ""
    public_sha256: str | None = None

    @property
    def digests(self) -> tuple[str, ...]:
        """Digests of the data set, and of its public half if it is sealed."""
        return tuple(filter(None, (self.sha256, self.public_sha256)))

    @property
    def same(self) -> bool | None:
        """Whether the data set equals the recorded one up to rounding; None if none is recorded."""
        return not self.difference if self.recorded_digests else None

    def text(self) -> str:
        """Return one line for a person."""
        if not self.recorded_digests:
            verdict = "not recorded yet"
        elif self.sha256 in self.recorded_digests:
            verdict = "as recorded"
        elif not self.difference:
            verdict = (
                f"like the recorded {self.recorded_digests[0][:_DIGEST_LENGTH]} but for rounding"
            )
        else:
            verdict = (
                f"NOT the recorded {self.recorded_digests[0][:_DIGEST_LENGTH]} ({self.difference})"
            )
        digest = self.sha256[:_DIGEST_LENGTH]
        line = f"{self.dataset}: {self.queries} queries, data set {digest}, {verdict}"
        if self.public_sha256 is None:
            return line
        return f"{line}; sealed, public half {self.public_sha256[:_DIGEST_LENGTH]}"


@dataclass(frozen=True)
class TrackReport:
    """The places of a track, compared with the recorded ones.

    Attributes:
        track: name of the track.
        tracks_folder: folder of all tracks.
        places: the requested places.
        written: files in the folder of the tracks that were written.
    """

    track: str
    tracks_folder: Path
    places: tuple[PlaceReport, ...]
    written: tuple[Path, ...] = ()

    @property
    def differing(self) -> tuple[str, ...]:
        """The data sets that are not the recorded ones."""
        return tuple(place.dataset for place in self.places if place.same is False)

    def text(self) -> str:
        """Return one line per place, and a note if any differ from the recorded ones."""
        lines = [place.text() for place in self.places]
        lines += [f"wrote {path}" for path in self.written]
        results = f"the results of {', '.join(self.differing)} in {self.tracks_folder / self.track}"
        if self.differing and self.written:
            lines.append(
                f"Note: {results} belong to earlier data sets: evaluate again and replace them."
            )
        elif self.differing:
            lines.append(
                f"Note: {results} cannot be compared with results on these scenes: evaluate all "
                "methods that you compare on the same render."
            )
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return the report for a program."""
        places = [
            {
                "dataset": place.dataset,
                "scene": str(place.scene),
                "export": None if place.export is None else str(place.export),
                "queries": place.queries,
                "sha256": place.sha256,
                "recorded": list(place.recorded_digests),
                "same": place.same,
                "unlike": place.difference,
                "public_sha256": place.public_sha256,
            }
            for place in self.places
        ]
        return {
            "track": self.track,
            "places": places,
            "differing": list(self.differing),
            "written": [str(path) for path in self.written],
        }


# More than six parameters: it is the function of a command.
def track(
    name: str,
    out: Path | None = None,
    places: Sequence[str] = (),
    jobs: int = 1,
    cluster: str | None = None,
    tracks_folder: Path = TRACKS_FOLDER,
    update: bool = False,
    flights: Path | None = None,
    key: Path | None = None,
) -> TrackReport:
    """Prepare the places of a track, and compare their data sets with the recorded ones.

    Places are rendered and mapped; those with streets are also exported in the layout of Extended
    CMU Seasons. Finished places are not rendered again, and an interrupted run goes on where it
    stopped. Flights are only read.

    Args:
        name: name of the track.
        out: folder of the scenes, ``out/<dataset>``; None for a track of flights.
        places: data sets of the places to render; none means all.
        jobs: number of rendering processes on this machine.
        cluster: cluster that renders and extracts features instead, see
            ``objconnect.scene.runtime.cluster.worker_pool``.
        tracks_folder: folder of all tracks.
        update: whether to record these data sets, and the difficulty of each query, in that
            folder.
        flights: folder of the flights, ``flights/<dataset>``; None for a track of renders.
        key: file of the key of sealed places; None for a track of other places.

    Raises:
        InputError: there is no such track or place, the description is wrong, a folder is missing
            or holds other files, the key is missing, wrong or not needed, rendering or mapping
            failed, or the folder of the tracks cannot be written.
    """
    description = load_track(name, tracks_folder)
    selected = description.select(tuple(places))
    _check_key(description, selected, key)
    secret = None if key is None else read_key(key)
    if update:
        files = [tracks_folder / name / DESCRIPTION]
        for place in selected:
            files += [
                _queries_file(tracks_folder, name, place),
                _render_record(tracks_folder, name, place),
            ]
        check_outputs(files)
    if description.config is None:
        reports = _read_flights(description, selected, flights)
    else:
        workers = jobs, cluster
        reports = _render_places(description, selected, out, tracks_folder, workers, secret)
    written = _record(name, tracks_folder, reports) if update else ()
    return TrackReport(name, tracks_folder, reports, written)


def _check_key(track: Track, places: Sequence[TrackPlace], key: Path | None) -> None:
    """Refuse sealed places without a key, and a key without sealed places."""
    sealed = [place.dataset for place in places if place.is_sealed]
    if sealed and key is None:
        raise InputError(
            f"{sealed[0]} of {track.name} is sealed, as it has no seed: its organiser renders it "
            "with --sealed KEYFILE"
        )
    if key is not None and not sealed:
        raise InputError(
            f"no place of {track.name} is sealed: leave out --sealed, or remove the seeds from its "
            f"{DESCRIPTION}"
        )


def _read_flights(
    track: Track, places: Sequence[TrackPlace], folder: Path | None
) -> tuple[PlaceReport, ...]:
    """Read the flights of a track, and compare them with the recorded ones."""
    if folder is None:
        raise InputError(
            f"the flights of {track.name} do not come with objconnect: give their folder by "
            f"--flights or the variable {FLIGHTS_VARIABLE}"
        )
    for place in places:
        if not (folder / place.dataset).is_dir():
            raise InputError(
                f"{folder} does not hold the flight {place.dataset} of {track.name}: give another "
                "folder by --flights"
            )
    reports = []
    for place in places:
        dataset = open_flight(folder / place.dataset)[0]
        is_other = place.renders and dataset.sha256 not in place.renders
        reports.append(
            PlaceReport(
                dataset=place.dataset,
                scene=folder / place.dataset,
                export=None,
                queries=len(dataset.queries),
                sha256=dataset.sha256,
                recorded_digests=place.renders,
                difference="other files" if is_other else "",
            )
        )
    return tuple(reports)


def _render_places(
    track: Track,
    places: Sequence[TrackPlace],
    out: Path | None,
    tracks_folder: Path,
    workers: tuple[int, str | None],
    key: bytes | None,
) -> tuple[PlaceReport, ...]:
    """Render and map the places of a track; ``workers`` are processes and the cluster's address."""
    if out is None:
        raise InputError(f"the places of {track.name} are rendered: give their folder by --out")
    configured = [(place, _configuration(track, place, key)) for place in places]
    check_output_folder(out, [tracks_folder])
    for place, config in configured:
        find_finished(out / place.dataset, config)  # refuses a wrong folder before hours of work
    return tuple(
        _prepare_place(
            place, config, out, _render_record(tracks_folder, track.name, place), *workers
        )
        for place, config in configured
    )


def _record(name: str, tracks_folder: Path, reports: Sequence[PlaceReport]) -> tuple[Path, ...]:
    """Write the digests of places and the difficulty of their queries into the folder of tracks.

    The record of each render is written too. If a render differs from the recorded one by rounding
    only, its digest is added to the recorded ones and nothing else changes.
    """
    written: list[Path] = []
    renders = {}
    for place in reports:
        if place.same:
            renders[place.dataset] = tuple(dict.fromkeys([*place.recorded_digests, *place.digests]))
            continue
        renders[place.dataset] = place.digests
        queries = _queries_file(tracks_folder, name, place)
        written.append(queries)
        if not is_scene(place.scene):
            write_queries(queries, measure_flight(open_flight(place.scene)[0]))
            continue
        scene = Scene.open(place.scene)
        write_queries(queries, measure(scene))
        record = _render_record(tracks_folder, name, place)
        write_render(record, render_of(scene))
        written.append(record)
    # Read again, because another run may have recorded other places meanwhile.
    write_track(load_track(name, tracks_folder).with_renders(renders), tracks_folder)
    return (*written, tracks_folder / name / DESCRIPTION)


def _queries_file(tracks_folder: Path, name: str, place: TrackPlace | PlaceReport) -> Path:
    return tracks_folder / name / "queries" / f"{place.dataset}.csv"


def _render_record(tracks_folder: Path, name: str, place: TrackPlace | PlaceReport) -> Path:
    return render_path(tracks_folder / name, place.dataset)


def _configuration(track: Track, place: TrackPlace, key: bytes | None) -> SimulateConfig:
    seed = sealed_seed(key, track, place) if key is not None and place.is_sealed else place.seed
    options = {"preset": place.preset, "seed": seed}
    return SimulateConfig.load(Path(track.config or ""), options)


def _prepare_place(
    place: TrackPlace,
    config: SimulateConfig,
    out: Path,
    record: Path,
    jobs: int,
    cluster: str | None,
) -> PlaceReport:
    """Render, map and export a place, unless that is done already, and compare it.

    Args:
        place: the place.
        config: configuration of its render.
        out: folder of the scenes.
        record: file of the recorded render.
        jobs: number of rendering processes.
        cluster: cluster to use instead; None for this machine.
    """
    path = out / place.dataset
    scene = simulate(config, path, jobs, cluster)
    if not _is_mapped(scene):
        build_map(path, cluster=cluster)
    cmu_folder = (
        path.with_name(f"{place.dataset}-{_CMU_FORMAT}") if place.preset == _STREET else None
    )
    if cmu_folder is not None and not is_cmu(cmu_folder):
        export(path, _CMU_FORMAT, cmu_folder)
    dataset = open_scene(path)
    return PlaceReport(
        dataset=place.dataset,
        scene=path,
        export=cmu_folder,
        queries=len(dataset.queries),
        sha256=dataset.sha256,
        recorded_digests=place.renders,
        difference=_describe_difference(place, dataset.sha256, record, scene),
        public_sha256=sealed_sha256(dataset) if place.is_sealed else None,
    )


def _describe_difference(place: TrackPlace, sha256: str, record: Path, scene: Scene) -> str:
    """Return how a render differs from the recorded one by more than rounding; empty if not."""
    if not place.renders or sha256 in place.renders:
        return ""
    if not os.path.lexists(record):
        return f"there is no {record.name} to compare with"
    return difference(read_render(record), render_of(scene))


def _is_mapped(scene: Scene) -> bool:
    """Return whether the map is complete: the manifest lists its files once all are written."""
    return any(name.startswith("map/") for name in scene.manifest.sha256)
