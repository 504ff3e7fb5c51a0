"""The command ``localize`` for a video or a sequence of photographs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import Field

from objconnect.localization.pipeline.answers import Geography, Located, contents, outputs
from objconnect.localization.pipeline.disagreement import warn_of_disagreement
from objconnect.localization.pipeline.footage import Footage, cameras_of_frames
from objconnect.localization.pipeline.journal import Journal, journal_path
from objconnect.localization.pipeline.localize import (
    Answer,
    geography_of,
    journal_key,
    on_earth,
    photographs_in,
)
from objconnect.localization.pipeline.photographs import (
    PhotographReader,
    Place,
    priors_of,
    warn_of_doubts,
    warn_of_rolling_shutter,
)
from objconnect.localization.pipeline.shots import (
    Shot,
    TelemetryReader,
    frames_of,
    photographs_of,
    warn_of_far_telemetry,
)
from objconnect.localization.pipeline.tracking import SequenceConfig, Tracker
from objconnect.localization.provenance import Method
from objconnect.scene.config import Config, load_config
from objconnect.scene.errors import InputError
from objconnect.scene.geo.crs import Projection
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.localizer import Estimate, Localizer, Query, Status, prepare_first
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import atomic_write, write_text
from objconnect.scene.storage.names import quote_name
from objconnect.scene.storage.outputs import OutputFile, check_outputs, check_outside
from objconnect.scene.storage.scratch import cache_or_scratch

RATE_HZ: Final = 2.0
"""Frames a second of a video that are localized where nothing else is asked for."""
_RECORD: Final = "sequence by objconnect localize"
_DEFAULTS: Final = SequenceConfig()


class _Settings(Config):
    sequence: SequenceConfig = Field(
        _DEFAULTS, description="When an image of a sequence is believed."
    )


def sequence_config(settings: dict[str, Any]) -> SequenceConfig:
    """Take the settings of a sequence, ``sequence.KEY``, out of others.

    Args:
        settings: values by key; those of the sequence are removed.

    Raises:
        InputError: a key of the sequence is unknown or its value is bad.
    """
    own = [key for key in settings if key.partition(".")[0] == "sequence"]
    return load_config(_Settings, None, {key: settings.pop(key) for key in own}).sequence


@dataclass(frozen=True)
class SequenceOutput:
    """What a sequence writes.

    Attributes:
        poses: text file of the poses; a table and a record lie beside it.
        also: further files, by their ending as those of ``localize.localize``.
        undulation_m: height of the geoid above the ellipsoid; None takes it from the grid of PROJ
            where that is installed.
        cache: folder for what the method keeps per map; None for a scratch folder.
        projection: coordinate reference system in which coordinates are written, too.
    """

    poses: Path
    also: Sequence[Path] = ()
    undulation_m: float | None = None
    cache: Path | None = None
    projection: Projection | None = None

    @property
    def record(self) -> Path:
        """Return the JSON file of how the poses were made."""
        return self.poses.with_suffix(".json")

    def claim(self, place: Place, inputs: Iterable[Path]) -> tuple[list[OutputFile], Geography]:
        """Check that everything can be written, and return the files and what places are said in.

        Raises:
            InputError: an output cannot be written, or would replace an input or a file of another
                program, or the map of further files has no position on earth.
        """
        files = outputs(self.poses, self.also)
        check_outputs([*files, OutputFile(self.record, _RECORD.encode())], inputs)
        return files, geography_of(place, self.also, self.undulation_m, self.projection)


@dataclass(frozen=True)
class SequenceInputs:
    """What is told of a sequence beside its images.

    Attributes:
        camera: of all images; None takes the map's camera of their size, or what else tells it.
        gps_sigma_m: standard deviation of measured positions per axis, metres.
        gimbal_sigma_deg: standard deviation of measured attitudes per axis, degrees.
        rate_hz: frames of a video to localize a second; None for ``RATE_HZ``. Photographs a second,
            in the order of their names; None takes times from EXIF.
        srt: subtitles of a video with telemetry; None takes those beside it, if there are any.
        priors: CSV file of positions, and perhaps attitudes, of photographs; None takes EXIF's and
            XMP's.
        config: when an image is believed.
    """

    camera: Camera | None = None
    gps_sigma_m: float = 10.0
    gimbal_sigma_deg: float = 5.0
    rate_hz: float | None = None
    srt: Path | None = None
    priors: Path | None = None
    config: SequenceConfig = _DEFAULTS


def localize_video(
    place: Place, video: Path, localizer: Localizer, output: SequenceOutput, told: SequenceInputs
) -> list[Located]:
    """Localize frames of a video, each from where the ones before it lead (``Tracker``).

    The files are those of ``localize.localize``, with the seconds of each frame, and a
    record of the method and its options as JSON. An interrupted run goes on where it stopped.

    Args:
        place: map to localize in.
        video: MP4 or another file that FFmpeg reads.
        localizer: method to run.
        output: what to write.
        told: what is known beside the images.

    Returns:
        One entry for each frame.

    Raises:
        InputError: video or subtitles cannot be read, the frames have no camera, or an output
            cannot be written.
    """
    files, geography = output.claim(place, [video] if told.srt is None else [video, told.srt])
    footage = Footage.open(video, told.srt, told.rate_hz or RATE_HZ, place)
    sigmas = told.gps_sigma_m, told.gimbal_sigma_deg
    telemetry = TelemetryReader(place, *sigmas, geography.undulation_m)
    warn_of_far_telemetry(footage, telemetry)
    shots = frames_of(footage, cameras_of_frames(footage, told.camera, place), telemetry)
    srt = None if footage.srt is None else footage.srt.name
    source = {"video": video.name, "srt": srt, "rate_hz": footage.rate_hz}
    job = _Job(output, files, geography, told.config, source)
    return _localize(place, shots, footage.count, localizer, job)


def localize_sequence(
    place: Place,
    photographs: Path,
    localizer: Localizer,
    output: SequenceOutput,
    told: SequenceInputs,
) -> list[Located]:
    """Localize the photographs of a folder as a sequence, as ``localize_video`` does a video.

    Args:
        place: map to localize in.
        photographs: folder of the photographs.
        localizer: method to run.
        output: what to write.
        told: what is known beside the images.

    Returns:
        One entry for each photograph.

    Raises:
        InputError: as for ``localize.localize``, or the photographs tell no times.
    """
    paths = {path.name: path for path in photographs_in(photographs)}
    priors = [] if told.priors is None else [told.priors]
    files, geography = output.claim(place, [*paths.values(), *priors])
    check_outside([*files, OutputFile(output.record)], photographs)
    sigmas = told.gps_sigma_m, told.gimbal_sigma_deg
    known = priors_of(told.priors, paths, place, *sigmas)
    reader = PhotographReader(place, told.camera, known, *sigmas, geography.undulation_m)
    shots = photographs_of(paths, reader, told.rate_hz)
    source = {"photographs": photographs.name, "rate_hz": told.rate_hz}
    job = _Job(output, files, geography, told.config, source)
    shots = _from_the_first(shots, len(paths), photographs)
    located = _localize(place, shots, len(paths), localizer, job)
    warn_of_rolling_shutter(reader.said.values())
    warn_of_doubts(reader)
    return located


@dataclass(frozen=True)
class _Job:
    """How a sequence is localized, and where its answers go."""

    output: SequenceOutput
    files: list[OutputFile]
    geography: Geography
    config: SequenceConfig
    source: dict[str, Any]


def _localize(
    place: Place, shots: Iterator[Shot], count: int, localizer: Localizer, job: _Job
) -> list[Located]:
    """Localize the images of a sequence and write the answers."""
    output, config = job.output, job.config
    key = f"{journal_key(place, localizer)} {config.model_dump_json()}"
    located: list[Located] = []
    with (
        Journal(journal_path(output.poses), _digest(key), Answer) as journal,
        # The disk of the output has room for what the method keeps per map.
        cache_or_scratch(output.cache, output.poses.parent) as kept,
    ):
        tracker = Tracker(localizer, config)
        asked, prepared = "", False
        with progress_bar(f"localize with {localizer.name}", count) as advance:
            for shot in shots:
                if not prepared:  # what cannot be read is refused before the map is prepared
                    prepare_first(localizer, place.sparse_map, place.images, kept)
                    prepared = True
                asked = _digest(asked, shot.seconds, *_words(shot))
                estimate = _answer(shot, tracker, journal, asked)
                where = on_earth(estimate, place)
                camera = None if shot.query is None else shot.query.camera
                seen = (shot.time, camera, shot.source, shot.seconds, shot.gps, shot.doubts)
                located.append(Located(shot.name, estimate, where, *seen))
                advance(min(len(located), count))
        for file, content in contents(located, job.files, job.geography):
            with atomic_write(file) as partial:
                partial.write_bytes(content)
        write_text(output.record, _record(located, localizer, job))
    warn_of_disagreement(located, job.geography)
    return located


def _answer(shot: Shot, tracker: Tracker, journal: Journal[Answer], asked: str) -> Estimate:
    """Localize an image, or return the answer that the journal has for it, and track it."""
    before = journal.done.get(quote_name(shot.name))
    if shot.query is None or shot.seconds is None:
        estimate = Estimate(Status.FAILED, reason=shot.reason)
    elif before is not None and before.asked == asked:
        estimate = before.estimate()
    else:
        answer = Answer.of(shot.name, asked, tracker.localize(shot.query, shot.seconds))
        journal.add(answer)
        estimate = answer.estimate()
    if shot.seconds is not None:
        tracker.take(estimate, shot.seconds)
    return estimate


def _words(shot: Shot) -> Iterator[object]:
    """Yield what decides the answer to an image beside the images before it."""
    query: Query | None = shot.query
    yield shot.name
    if query is None:
        return
    yield hashlib.sha256(query.image.tobytes()).hexdigest()
    yield query.camera
    if query.prior is not None:
        for value in vars(query.prior).values():
            yield None if value is None else np.asarray(value).tolist()


def _digest(*words: object) -> str:
    return hashlib.sha256("\n".join(map(str, words)).encode("utf-8", "surrogatepass")).hexdigest()


def _record(located: Sequence[Located], localizer: Localizer, job: _Job) -> str:
    """Return how the poses were made, as JSON."""
    values = {
        "generator": _RECORD,
        **job.source,
        "images": len(located),
        "found": sum(item.found for item in located),
        "method": Method.of(localizer).model_dump(mode="json"),
        "sequence": job.config.model_dump(mode="json"),
    }
    return json.dumps(values, indent=1) + "\n"


def _from_the_first(shots: Iterable[Shot], count: int, folder: Path) -> Iterator[Shot]:
    """Yield images from the beginning once one of them can be read.

    Raises:
        InputError: none of them can be read.
    """
    unread: list[Shot] = []
    shots = iter(shots)
    for shot in shots:
        unread.append(shot)
        if shot.query is not None:
            break
    else:
        several = f"none of the {count} photographs in {folder} can be localized: "
        raise InputError((several if count > 1 else "") + unread[0].reason)
    yield from unread
    yield from shots
