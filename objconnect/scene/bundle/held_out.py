"""Data that a benchmark track reserves for tests: neither training nor tuning may use them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field

from objconnect.scene.bundle.manifest import Manifest
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from objconnect.scene.storage.records import Record

_Name = Annotated[str, Field(pattern=r"^[a-z0-9]+(-[a-z0-9]+)*$", max_length=100)]


class HeldOut(Record):
    """The conditions, sites and cameras of a track that only tests may use.

    Attributes:
        conditions: season, light and weather of flights, or some of these: ``winter-fog`` holds out
            fog in winter in any light, ``fog`` all fog.
        presets: kinds of rendered sites.
        lenses: names of the simulator's camera presets.
        seeds: seeds of rendered sites of any kind.
    """

    conditions: tuple[_Name, ...] = ()
    presets: tuple[_Name, ...] = ()
    lenses: tuple[_Name, ...] = ()
    seeds: tuple[Annotated[int, Field(ge=0)], ...] = ()

    def has_condition(self, name: str) -> bool:
        """Return whether a condition has all words of a held-out one."""
        words = set(name.split("-"))
        return any(words.issuperset(held.split("-")) for held in self.conditions)

    def find(self, manifest: Manifest) -> str | None:
        """Return the first held-out property of a rendered scene, in words; None without one.

        A scene of real photographs has none.
        """
        if manifest.preset is None:
            return None
        if manifest.preset in self.presets:
            return f"the preset {manifest.preset}"
        if manifest.seed in self.seeds:
            return f"the seed {manifest.seed}"
        for session in manifest.sessions.values():
            if self.has_condition(session.condition):
                return f"the condition {session.condition}"
        return next((f"the lens {n}" for n in _lenses(manifest.config) if n in self.lenses), None)


def refuse_held_out(scenes: Iterable[Scene], tracks: Mapping[str, HeldOut]) -> None:
    """Refuse scenes with conditions, presets, lenses or seeds that a track holds out.

    Args:
        scenes: scenes to train on or to select settings with.
        tracks: what each track holds out, by its name.

    Raises:
        InputError: a scene has a held-out property.
    """
    for scene in scenes:
        for track, held_out in tracks.items():
            if (what := held_out.find(scene.manifest)) is not None:
                raise InputError(
                    f"scene {scene.path} has {what}, which the track {track} holds out for tests: "
                    "train on other scenes"
                )


def _lenses(config: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names of camera presets in the configuration of a rendered scene."""
    sessions = config.get("sessions") or ()
    for camera in (config.get("camera"), *(session.get("camera") for session in sessions)):
        if camera and camera.get("preset"):
            yield camera["preset"]
