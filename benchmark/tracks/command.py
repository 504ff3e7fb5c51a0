"""The command ``track``, which renders and maps the sites of a track and checks their digests."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.datasets.cmu import is_cmu
from benchmark.datasets.simulated import open_scene
from benchmark.tracks.description import (
    BOARD,
    DESCRIPTION,
    Track,
    TrackPlace,
    load_track,
    write_track,
)
from benchmark.tracks.difficulty import measure, write_queries
from benchmark.tracks.renders import difference, read_render, render_of, write_render
from objconnect.mapping.build import build_map
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.exports.export import export
from objconnect.scene.storage.outputs import check_output_folder, check_outputs
from objconnect.scene.storage.packed import SUFFIX
from simulate.command import find_finished, simulate
from simulate.config import SimulateConfig

# The preset of drives, which are also exported in the layout of Extended CMU Seasons.
_STREET: Final = "street"
_TREE: Final = "cmu"
# Characters of a digest that are shown.
_SHOWN: Final = 12


@dataclass(frozen=True)
class PlaceReport:
    """A rendered and mapped site, compared with the recorded one.

    Attributes:
        dataset: name of the data set.
        scene: folder of the scene.
        export: folder in the layout of Extended CMU Seasons; None for sites without streets.
        queries: number of queries.
        sha256: digest of the data set.
        recorded: digests of the renders that the track records; empty if it records none.
        unlike: how this render differs from the recorded one by more than rounding; empty if it
            does not.
    """

    dataset: str
    scene: Path
    export: Path | None
    queries: int
    sha256: str
    recorded: tuple[str, ...]
    unlike: str = ""

    @property
    def same(self) -> bool | None:
        """Whether the data set equals the recorded one up to rounding; None if none is recorded."""
        return not self.unlike if self.recorded else None

    def text(self) -> str:
        """Return one line for a person."""
        if not self.recorded:
            verdict = "not recorded yet"
        elif self.sha256 in self.recorded:
            verdict = "as recorded"
        elif not self.unlike:
            verdict = f"like the recorded {self.recorded[0][:_SHOWN]} but for rounding"
        else:
            verdict = f"NOT the recorded {self.recorded[0][:_SHOWN]} ({self.unlike})"
        return f"{self.dataset}: {self.queries} queries, data set {self.sha256[:_SHOWN]}, {verdict}"


@dataclass(frozen=True)
class TrackReport:
    """The sites of a track, compared with the recorded ones.

    Attributes:
        track: name of the track.
        board: folder of all tracks.
        places: the requested sites.
        written: files of the board that were written.
    """

    track: str
    board: Path
    places: tuple[PlaceReport, ...]
    written: tuple[Path, ...] = ()

    @property
    def differing(self) -> tuple[str, ...]:
        """The data sets that are not the recorded ones."""
        return tuple(place.dataset for place in self.places if place.same is False)

    def text(self) -> str:
        """Return one line per site, and a note if some differ from the recorded ones."""
        lines = [place.text() for place in self.places]
        lines += [f"wrote {path}" for path in self.written]
        results = f"the results of {', '.join(self.differing)} in {self.board / self.track}"
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
                "recorded": list(place.recorded),
                "same": place.same,
                "unlike": place.unlike,
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
    out: Path,
    places: Sequence[str] = (),
    jobs: int = 1,
    cluster: str | None = None,
    board: Path = BOARD,
    update: bool = False,
) -> TrackReport:
    """Render and map the sites of a track, and compare their data sets with the recorded ones.

    Finished sites are not rendered again, and an interrupted run goes on where it stopped. Sites
    with streets are also exported in the layout of Extended CMU Seasons.

    Args:
        name: name of the track.
        out: folder of the scenes, ``out/<dataset>``.
        places: data sets of the sites to render; none means all.
        jobs: number of rendering processes on this machine.
        cluster: cluster that renders and extracts features instead, see
            ``objconnect.scene.runtime.cluster.worker_pool``.
        board: folder of all tracks.
        update: whether to record these renders, and the difficulty of each query, in the board.

    Raises:
        InputError: there is no such track or site, the description is wrong, a folder holds other
            files, rendering or mapping failed, or the board cannot be written.
    """
    chosen = load_track(name, board)
    sites = [(place, _configuration(chosen, place)) for place in chosen.select(tuple(places))]
    check_output_folder(out, [board])
    if update:
        files = [_queries, _render]
        check_outputs(
            [board / name / DESCRIPTION, *(of(board, name, p) for p, _ in sites for of in files)]
        )
    for place, config in sites:
        find_finished(out / place.dataset, config)  # refuses a wrong folder before hours of work
    reports = tuple(
        _prepare_site(place, config, out, _render(board, name, place), jobs, cluster)
        for place, config in sites
    )
    written = _record(name, board, reports) if update else ()
    return TrackReport(name, board, reports, written)


def _record(name: str, board: Path, reports: Sequence[PlaceReport]) -> tuple[Path, ...]:
    """Write the renders of sites and the difficulty of their queries into the board.

    The digest of a render that differs from the recorded one by rounding joins the recorded ones.
    """
    written: list[Path] = []
    renders = {}
    for place in reports:
        if place.same:
            renders[place.dataset] = tuple(dict.fromkeys([*place.recorded, place.sha256]))
            continue
        scene = Scene.open(place.scene)
        renders[place.dataset] = (place.sha256,)
        queries, render = _queries(board, name, place), _render(board, name, place)
        write_queries(queries, measure(scene))
        write_render(render, render_of(scene))
        written += [queries, render]
    # Read again, because another run may have recorded other sites meanwhile.
    write_track(load_track(name, board).with_renders(renders), board)
    return (*written, board / name / DESCRIPTION)


def _queries(board: Path, name: str, place: TrackPlace | PlaceReport) -> Path:
    return board / name / "queries" / f"{place.dataset}.csv"


def _render(board: Path, name: str, place: TrackPlace | PlaceReport) -> Path:
    return board / name / "renders" / f"{place.dataset}.json{SUFFIX}"


def _configuration(track: Track, place: TrackPlace) -> SimulateConfig:
    return SimulateConfig.load(Path(track.config), {"preset": place.preset, "seed": place.seed})


def _prepare_site(
    place: TrackPlace,
    config: SimulateConfig,
    out: Path,
    record: Path,
    jobs: int,
    cluster: str | None,
) -> PlaceReport:
    """Render, map and export a site, unless that is done already, and compare it."""
    path = out / place.dataset
    scene = simulate(config, path, jobs, cluster)
    if not _is_mapped(scene):
        build_map(path, cluster=cluster)
    tree = path.with_name(f"{place.dataset}-{_TREE}") if place.preset == _STREET else None
    if tree is not None and not is_cmu(tree):
        export(path, _TREE, tree)
    dataset = open_scene(path)
    return PlaceReport(
        dataset=place.dataset,
        scene=path,
        export=tree,
        queries=len(dataset.queries),
        sha256=dataset.sha256,
        recorded=place.renders,
        unlike=_unlike(place, dataset.sha256, record, scene),
    )


def _unlike(place: TrackPlace, sha256: str, record: Path, scene: Scene) -> str:
    """Return how a render differs from the recorded one by more than rounding; empty if not."""
    if not place.renders or sha256 in place.renders:
        return ""
    if not os.path.lexists(record):
        return f"there is no {record.name} to compare with"
    return difference(read_render(record), render_of(scene))


def _is_mapped(scene: Scene) -> bool:
    """Return whether the map is complete: the manifest lists its files once all are written."""
    return any(name.startswith("map/") for name in scene.manifest.sha256)
