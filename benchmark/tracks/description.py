"""The description of a benchmark track: its places, starting information and methods.

A track is the folder ``benchmark/tracks/<track>/``. This module reads its ``track.yaml``. Beside
it, ``renders/`` holds poses and brightness of the rendered photographs, ``queries/`` the queries
with their difficulty, and ``results/`` the stored results.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final

import yaml
from pydantic import Field, field_validator, model_validator

from objconnect.scene.bundle.held_out import HeldOut
from objconnect.scene.config import MAX_NUMBER, load_config
from objconnect.scene.errors import InputError
from objconnect.scene.flights.reference_error import ReferencePoseError
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.listing import list_files
from objconnect.scene.storage.records import Record
from simulate.camera.lens import PRESETS as LENSES
from simulate.look.conditions import LIGHTS, WEATHER
from simulate.look.seasons import SEASONS
from simulate.place.presets import PRESETS

TRACKS_FOLDER: Final = Path(__file__).parent
"""The folder of the tracks that come with the project."""

DESCRIPTION: Final = "track.yaml"

# Kinds of starts that are made from reference poses, see ``benchmark.evaluation.starts``.
_FROM_POSES: Final = ("error", "gravity", "gps")

_Name = Annotated[str, Field(pattern=r"^[a-z0-9]+(-[a-z0-9]+)*$", max_length=100)]
_Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Words = Annotated[str, Field(min_length=1, max_length=300)]


class TrackPlace(Record):
    """A place of a track, which is one scene or flight and one data set.

    Attributes:
        dataset: name of its folder and of the data set.
        preset: kind of a rendered place; None for a flight.
        seed: random seed of a rendered place; None for a flight, and for a place with withheld
            query poses (sealed), whose seed is derived from a key (``benchmark.tracks.sealing``).
        renders: digests of the data set. A rendered one has one for each kind of machine; the
            renders differ by rounding only (``benchmark.tracks.renders``). Empty before it is
            recorded.
        reference_error: error of its reference poses; None where they are exact. It is used for
            stored results too, even if their data set states none.
    """

    dataset: _Name
    preset: _Name | None = None
    seed: int | None = Field(None, ge=0, le=MAX_NUMBER)
    renders: tuple[_Digest, ...] = ()
    reference_error: ReferencePoseError | None = None

    @property
    def is_sealed(self) -> bool:
        """Whether only the organiser can render the place."""
        return self.preset is not None and self.seed is None


class Track(Record):
    """A list of places, and the methods run on them.

    Attributes:
        name: name of its folder.
        title: one line that states what it tests.
        config: configuration of ``simulate``, a name or a file; places set preset and seed. None
            if they are flights, which are not rendered.
        places: the places.
        starts: information on each query that methods get besides its image, as names of
            ``benchmark.evaluation.starts``.
        methods: names of the results files.
        controls: names of methods, by the name of their control, a method that differs in a single
            part. Both are compared only if the options that both have are equal.
        held_out: what no training may use; None where the track declares nothing.
    """

    name: _Name
    title: _Words
    config: _Words | None = None
    places: tuple[TrackPlace, ...] = Field(min_length=1)
    starts: tuple[_Words, ...] = Field(min_length=1)
    methods: tuple[_Words, ...] = Field(min_length=1)
    controls: dict[_Words, _Words] | None = None
    held_out: HeldOut | None = None

    @field_validator("places")
    @classmethod
    def _check_names(cls, places: tuple[TrackPlace, ...]) -> tuple[TrackPlace, ...]:
        names = [place.dataset for place in places]
        if len(set(names)) < len(names):
            raise ValueError(f"two places have the same name: {', '.join(names)}")
        return places

    @field_validator("held_out")
    @classmethod
    def _check_held_out(cls, held_out: HeldOut | None) -> HeldOut | None:
        """Refuse names that the simulator lacks, because they would hold out nothing."""
        if held_out is None:
            return None
        words = {word for name in held_out.conditions for word in name.split("-")}
        for what, names, known in (
            ("season, light or weather", words, (*SEASONS, *LIGHTS, *WEATHER)),
            ("preset", held_out.presets, PRESETS),
            ("lens", held_out.lenses, LENSES),
        ):
            for name in sorted(names):
                if name not in known:
                    raise ValueError(f"no {what} {name!r}; there are {', '.join(known)}")
        return held_out

    @model_validator(mode="after")
    def _check_controls(self) -> Track:
        controls = self.controls or {}
        for name in (*controls, *controls.values()):
            if name not in self.methods:
                raise ValueError(f"controls: {name} is none of the methods")
        return self

    @model_validator(mode="after")
    def _check_places(self) -> Track:
        is_sealed = all(place.is_sealed for place in self.places)
        for place in self.places:
            rendered = place.preset is not None, place.seed is not None or is_sealed
            if rendered != (self.config is not None,) * 2:
                raise ValueError(
                    f"{place.dataset}: a rendered place has a preset and a seed, and its track a "
                    "config; in a sealed track no place has a seed; a flight has none of them"
                )
        return self

    @model_validator(mode="after")
    def _check_starts(self) -> Track:
        """Refuse starts that are made from reference poses, if the places are sealed."""
        for start in self.starts:
            if start.partition("=")[0] in _FROM_POSES and self.places[0].is_sealed:
                raise ValueError(
                    f"start {start} is made from reference poses, which the public half of a "
                    "sealed place lacks: take none, prior or retrieval"
                )
        return self

    def select(self, names: tuple[str, ...] = ()) -> tuple[TrackPlace, ...]:
        """Return the places with these names in the track's order; all places for no names.

        Raises:
            InputError: the track has no place of a given name.
        """
        known = [place.dataset for place in self.places]
        for name in names:
            if name not in known:
                raise InputError(
                    f"the track {self.name} has no place {name!r}; it has {', '.join(known)}"
                )
        return tuple(place for place in self.places if not names or place.dataset in names)

    def with_renders(self, renders: Mapping[str, tuple[str, ...]]) -> Track:
        """Return the track with new digests of renders, given by data set; others keep theirs."""
        places = tuple(
            place.model_copy(update={"renders": renders.get(place.dataset, place.renders)})
            for place in self.places
        )
        return self.model_copy(update={"places": places})


def load_track(name: str, tracks_folder: Path = TRACKS_FOLDER) -> Track:
    """Read a track.

    Args:
        name: name of the track.
        tracks_folder: folder of all tracks.

    Raises:
        InputError: there is no such folder or track, or the description is wrong.
    """
    files = list_files(tracks_folder, (".yaml",), depth=2)
    known = [path.parent.name for path in files if path.name == DESCRIPTION]
    if name not in known:
        existing = f"; there are {', '.join(known)}" if known else ""
        raise InputError(f"{tracks_folder} has no track named {name!r}{existing}")
    path = tracks_folder / name / DESCRIPTION
    track = load_config(Track, path, {})
    if track.name != name:
        raise InputError(
            f"{path}: the track is called {track.name!r}, its folder {name!r}: rename one of them"
        )
    return track


def read_held_out(tracks_folder: Path = TRACKS_FOLDER) -> dict[str, HeldOut]:
    """Return the held-out data of each track of a folder, by the name of the track.

    Raises:
        InputError: a description is wrong.
    """
    names = sorted(path.parent.name for path in tracks_folder.glob(f"*/{DESCRIPTION}"))
    tracks = (load_track(name, tracks_folder) for name in names)
    return {track.name: track.held_out for track in tracks if track.held_out is not None}


def write_track(track: Track, tracks_folder: Path) -> None:
    """Write the description of a track; comments of the file are lost.

    Raises:
        InputError: the folder cannot be written.
    """
    text = yaml.safe_dump(
        track.model_dump(mode="json", exclude_none=True),
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=None,
        width=1000,
    )
    write_text(tracks_folder / track.name / DESCRIPTION, text)
