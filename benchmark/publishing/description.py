"""The description of a published data set, for its card and its metadata."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Final

from benchmark.publishing.columns import Column
from benchmark.publishing.index import Provenance, PublishedIndex, PublishedScene
from benchmark.publishing.licenses import require_license
from objconnect.scene.errors import InputError

# How scenes were made, and the origin of their poses, by ``Provenance.reference``.
_MAKING: Final = {
    "exact": "ObjConnect planned the sites and flights, and Blender rendered them. COLMAP built "
    "the maps.",
    "sfm": "ObjConnect registered the photographs by structure from motion. COLMAP built the maps.",
    "stated": "Photographs, cameras, poses and map are those of a flight's files, which do not "
    "record how they were made.",
}
_POSES: Final = {
    "exact": "Poses and cameras are those that the renderer was given, so they are exact.",
    "sfm": "Poses and cameras come from structure from motion over all photographs; they are "
    "accurate to centimetres at best.",
    "stated": "Poses and cameras are those that the files of the flight state.",
}
_DATE: Final = re.compile(r"\d{4}-\d\d-\d\d")
_VERSION: Final = re.compile(r"\d+\.\d+\.\d+")
# Part of the summary of a data set without query poses.
_SEALED: Final = (
    ". The query poses are sealed: these files lack them, and the organiser scores answers"
)
_URL: Final = re.compile(r"https?://[^\s\"<>]+")


@dataclass(frozen=True)
class Release:
    """The publisher's statements on a data set.

    Attributes:
        license: SPDX identifier that the hub accepts; None for the licence of renders.
        creator: person or organization; None if not stated.
        url: page of the data set; None if not stated.
        date: day of publication as YYYY-MM-DD; None if not stated.
        version: version of the data set as MAJOR.MINOR.PATCH.

    Raises:
        InputError: a value has another form.
    """

    license: str | None = None
    creator: str | None = None
    url: str | None = None
    date: str | None = None
    version: str = "1.0.0"

    def __post_init__(self) -> None:
        if self.license is not None:
            require_license(self.license)
        if self.creator is not None and not (self.creator.strip() and self.creator.isprintable()):
            raise InputError(f"creator {self.creator!r} is not a name: give printable characters")
        if self.url is not None and not _URL.fullmatch(self.url):
            raise InputError(
                f"url {self.url!r} is not an address, such as https://example.org/data"
            )
        if self.date is not None and not _is_day(self.date):
            raise InputError(f"date {self.date!r} is not a day, such as 2026-05-17")
        if not _VERSION.fullmatch(self.version):
            raise InputError(f"release {self.version!r} is not a version of the form 1.0.0")

    @property
    def unstated(self) -> tuple[str, ...]:
        """The facts that Croissant asks for and that were not stated."""
        facts = {"creator": self.creator, "url": self.url, "date": self.date}
        return tuple(name for name, value in facts.items() if value is None)


def _is_day(text: str) -> bool:
    try:
        return bool(_DATE.fullmatch(text)) and bool(date.fromisoformat(text))
    except ValueError:
        return False


def is_invented(scene: Provenance) -> bool:
    """Return whether a site is known to be invented; photographs and twins show a real one."""
    simulated = scene.reference == "exact" and scene.preset is not None
    return simulated and scene.config.get("site") is None


@dataclass(frozen=True)
class Description:
    """The description of a data set.

    Attributes:
        summary: contents of the data set.
        making: how the data set was made.
        cost: cost of making the data set, and its size.
        annotation: where poses, cameras and priors come from.
        limitations: what the data set cannot show.
        biases: how the data set differs from the real world.
        uses: intended uses.
        personal: personal information in the data set.
    """

    summary: str
    making: str
    cost: str
    annotation: str
    limitations: tuple[str, ...]
    biases: tuple[str, ...]
    uses: tuple[str, ...]
    personal: str


@dataclass(frozen=True)
class CardFacts:
    """The facts that the data card and the Croissant metadata of a published folder state.

    Attributes:
        name: name of the data set.
        release: the publisher's statements.
        published: the contents of ``published.json``.
        description: what the data set shows, and how it was made.
        columns: columns of the shards by name.
    """

    name: str
    release: Release
    published: PublishedIndex
    description: Description
    columns: Mapping[str, Column]


def describe(published: PublishedIndex, total_bytes: int) -> Description:
    """Describe a data set from its list of scenes.

    Args:
        published: the scenes.
        total_bytes: bytes of all files of the scenes.
    """
    scenes = published.scenes
    invented = all(is_invented(scene) for scene in scenes)
    references = sorted({scene.reference for scene in scenes})
    exact = references == ["exact"]
    count = sum(sum(scene.photographs.values()) for scene in scenes)
    queries = sum(scene.photographs["query"] for scene in scenes)
    sessions = [session for scene in scenes for session in scene.sessions.values()]
    conditions = sorted({name for session in sessions for name in session.conditions})
    return Description(
        summary=(
            f"{count} {'rendered ' if exact else ''}photographs of {_number(len(scenes), 'site')} "
            f"from a camera in motion, each with {'' if published.sealed else 'its 6-DoF pose, '}"
            f"calibrated camera and priors, and a sparse COLMAP map of each site. {queries} of "
            f"them are queries whose poses are to be found in the map"
            f"{_SEALED if published.sealed else ''}. Conditions: {', '.join(conditions)}."
        ),
        making=_making(published, references),
        cost=(
            f"The files take {total_bytes / 1e6:.1f} MB. {_render_settings(scenes)}"
            "The time of making them was not recorded."
        ),
        annotation=" ".join(_POSES[reference] for reference in references)
        + " Priors are positions of GNSS and attitudes of a gimbal with their standard deviations"
        + (", both simulated." if exact else "."),
        limitations=_limitations(scenes, exact, invented),
        biases=(
            "Sites, seasons, weather and flights were chosen by the makers; they are not a random "
            "sample of the world.",
        ),
        uses=(
            "Measuring and comparing methods that localize a camera in a map.",
            "Studying how season, light, weather and view change recall.",
            "Not meant as evidence that a method is safe to navigate an aircraft by.",
        ),
        personal=(
            "None: the sites are invented and show no people, faces or number plates."
            if invented
            else "The photographs may show real sites, people, vehicles and private ground. The "
            "publisher is responsible for having checked them."
        ),
    )


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _making(published: PublishedIndex, references: Sequence[str]) -> str:
    versions = {f"{k} {v}" for scene in published.scenes for k, v in scene.versions.items()}
    programs = f" Programs: {', '.join(sorted(versions))}." if versions else ""
    how = " ".join(_MAKING[reference] for reference in references)
    options = "" if published.sealed else " `published.json` holds all options."
    return f"{how}{programs}{options}"


def _render_settings(scenes: tuple[PublishedScene, ...]) -> str:
    """Return size and samples of the renders as a sentence; empty if they are unknown."""
    settings = {(scene.config.get("size"), scene.config.get("spp")) for scene in scenes}
    known = sorted((int(a), int(b)) for a, b in settings if a is not None and b is not None)
    if not known:
        return ""
    words = " and ".join(f"{size} pixels with {spp} samples a pixel" for size, spp in known)
    return f"The photographs were rendered at {words}. "


def _limitations(
    scenes: tuple[PublishedScene, ...], exact: bool, invented: bool
) -> tuple[str, ...]:
    limitations = []
    for scene in scenes:
        if scene.unjudged:
            limitations.append(
                f"The reference poses of {scene.name} are too inexact to score at "
                f"{', '.join(scene.unjudged)}."
            )
    if exact:
        limitations.append(
            "A renderer is not the world: textures, vegetation and light are simpler, so recall on "
            "real photographs must be measured on real photographs."
        )
        limitations.append(
            "A method that was trained on renders of the same program has an advantage."
        )
    if not exact:
        limitations.append("Errors smaller than those of the reference poses cannot be measured.")
    if exact and not invented:
        limitations.append(
            "Sites modelled on real ones are as accurate as the files they came from."
        )
    if any(session.readout_s for scene in scenes for session in scene.sessions.values()):
        limitations.append(
            "Poses of photographs with a rolling shutter are those of the middle row."
        )
    return tuple(limitations)
