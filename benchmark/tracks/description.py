"""The description of a track: its sites, starts and methods.

A track is the folder ``benchmark/tracks/<track>/``. This module reads its ``track.yaml``. Beside
it, ``renders/`` holds records of the renders, ``queries/`` the queries with their difficulty, and
``results/`` the stored results.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final

import yaml
from pydantic import Field, field_validator

from objconnect.scene.config import LARGEST, load_config
from objconnect.scene.errors import InputError
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.listing import list_files
from objconnect.scene.storage.records import Record

BOARD: Final = Path(__file__).parent
"""The folder of the tracks that come with the project."""

DESCRIPTION: Final = "track.yaml"

_Name = Annotated[str, Field(pattern=r"^[a-z0-9]+(-[a-z0-9]+)*$", max_length=100)]
_Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Words = Annotated[str, Field(min_length=1, max_length=300)]


class TrackPlace(Record):
    """A site of a track, which is one scene and one data set.

    Attributes:
        dataset: name of the scene's folder and of the data set.
        preset: kind of site.
        seed: random seed of the site.
        renders: digests of the rendered and mapped data set, one for each kind of machine; the
            renders differ by rounding only (``benchmark.tracks.renders``). Empty before the first
            render.
    """

    dataset: _Name
    preset: _Name
    seed: int = Field(ge=0, le=LARGEST)
    renders: tuple[_Digest, ...] = ()


class Track(Record):
    """A list of sites that are rendered with one configuration, and the methods run on them.

    Attributes:
        name: name of its folder.
        title: one line that says what it tests.
        config: configuration of ``simulate``: a name or a file; sites set preset and seed.
        places: the sites.
        starts: starts of ``benchmark.evaluation.starts`` that methods are run with.
        methods: names of the results files.
    """

    name: _Name
    title: _Words
    config: _Words
    places: tuple[TrackPlace, ...] = Field(min_length=1)
    starts: tuple[_Words, ...] = Field(min_length=1)
    methods: tuple[_Words, ...] = Field(min_length=1)

    @field_validator("places")
    @classmethod
    def _are_distinct(cls, places: tuple[TrackPlace, ...]) -> tuple[TrackPlace, ...]:
        names = [place.dataset for place in places]
        if len(set(names)) < len(names):
            raise ValueError(f"two sites have the same name: {', '.join(names)}")
        return places

    def select(self, names: tuple[str, ...] = ()) -> tuple[TrackPlace, ...]:
        """Return the sites with these names in the track's order; all sites for no names.

        Raises:
            InputError: the track has no site with a name.
        """
        known = [place.dataset for place in self.places]
        for name in names:
            if name not in known:
                raise InputError(
                    f"the track {self.name} has no place {name!r}; it has {', '.join(known)}"
                )
        return tuple(place for place in self.places if not names or place.dataset in names)

    def with_renders(self, renders: Mapping[str, tuple[str, ...]]) -> Track:
        """Return the track with new digests of the renders of some sites, by data set."""
        places = tuple(
            place.model_copy(update={"renders": renders.get(place.dataset, place.renders)})
            for place in self.places
        )
        return self.model_copy(update={"places": places})


def load_track(name: str, board: Path = BOARD) -> Track:
    """Read a track.

    Args:
        name: name of the track.
        board: folder of all tracks.

    Raises:
        InputError: there is no such folder or track, or the description is wrong.
    """
    files = list_files(board, (".yaml",), depth=2)
    known = [path.parent.name for path in files if path.name == DESCRIPTION]
    if name not in known:
        existing = f"; there are {', '.join(known)}" if known else ""
        raise InputError(f"{board} has no track named {name!r}{existing}")
    path = board / name / DESCRIPTION
    track = load_config(Track, path, {})
    if track.name != name:
        raise InputError(f"{path}: the track is called {track.name!r}, its folder {name!r}")
    return track


def write_track(track: Track, board: Path) -> None:
    """Write the description of a track; comments of the file are lost.

    Raises:
        InputError: the folder cannot be written.
    """
    text = yaml.safe_dump(
        track.model_dump(mode="json"),
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=None,
        width=1000,
    )
    write_text(board / track.name / DESCRIPTION, text)
