"""Localize photographs, or the frames of a video, in a map and write the poses."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import Field

from objconnect.localization.pipeline.answers import (
    Geography,
    ImageEstimate,
    encode_files,
    output_files,
)
from objconnect.localization.pipeline.cameras import add_focal_error, focal_sigma
from objconnect.localization.pipeline.disagreement import warn_of_disagreement
from objconnect.localization.pipeline.failures import localize_safely, localize_with_retry
from objconnect.localization.pipeline.frames import VideoFrames
from objconnect.localization.pipeline.journal import Journal, journal_path
from objconnect.localization.pipeline.localization_map import LocalizationMap, geography_of
from objconnect.localization.pipeline.options import LocalizeOptions
from objconnect.localization.pipeline.photograph_folder import PhotographFolder, photographs_in
from objconnect.localization.pipeline.query_image import QueryImage
from objconnect.localization.pipeline.tracking import SequenceConfig, Tracker
from objconnect.localization.provenance import Environment, Method
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import (
    Estimate,
    Localizer,
    PoseSource,
    Query,
    Status,
    prepare_lazily,
)
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.answers import NamedRecord, PoseNumbers
from objconnect.scene.storage.atomic import atomic_write, write_text
from objconnect.scene.storage.digests import digest_of, digests_in
from objconnect.scene.storage.names import quote_name
from objconnect.scene.storage.outputs import OutputFile, check_outputs, check_outside
from objconnect.scene.storage.scratch import cache_or_scratch

Source = PhotographFolder | VideoFrames

# Text that identifies JSON files of this command, which may be replaced.
_RECORD: Final = "sequence by objconnect localize"
_DEFAULTS: Final = LocalizeOptions()


def localize(
    localization_map: LocalizationMap,
    photographs: Path,
    localizer: Localizer,
    out: Path,
    options: LocalizeOptions = _DEFAULTS,
) -> list[ImageEstimate]:
    """Localize every photograph of a folder and write the poses as a text file and a CSV file.

    The text file has a line ``name qw qx qy qz tx ty tz`` (world to camera, metres) for each
    localized photograph. The CSV file beside it has a row for each photograph: status, camera
    centre in the map's frame, latitude, longitude, altitude, sigma and the reason of a failure,
    then time, attitude, camera and covariance (``ImageEstimate``). A photograph that cannot be read
    has a row with status ``failed`` and the reason. A hidden journal stores finished photographs,
    so that an interrupted run resumes where it stopped.

    With ``options.sequence``, the motion of the camera gives the prior of the next photograph
    (``Tracker``), the table has the time of each photograph in seconds, and a JSON file beside the
    poses records the method and its options.

    Args:
        localization_map: map to localize in.
        photographs: folder of the photographs.
        localizer: method to run.
        out: text file of the poses. The text and CSV files replace only files of this command.
        options: camera and priors of the photographs, and further files to write.

    Returns:
        One entry for each photograph.

    Raises:
        InputError: no photograph can be read; the priors cannot be read or name none of the
            photographs; photographs of a sequence have no times; an output cannot be written, lies
            in the folder of the photographs or would replace a file of another program; or a
            further file needs a position of the map on earth, and the map has none.
    """
    job = _Job(localization_map, localizer, out, options, options.sequence)
    table = [] if options.priors is None else [options.priors]
    job.check([*photographs_in(photographs).values(), *table], photographs)
    geography = geography_of(localization_map, options)
    source = PhotographFolder.open(photographs, localization_map, options, geography.undulation_m)
    return job.run(source, geography)


def localize_video(
    localization_map: LocalizationMap,
    video: Path,
    localizer: Localizer,
    out: Path,
    options: LocalizeOptions = _DEFAULTS,
) -> list[ImageEstimate]:
    """Localize frames of a video as a sequence, and write the files of ``localize``.

    Args:
        localization_map: map to localize in.
        video: MP4 or another file that FFmpeg reads.
        localizer: method to run.
        out: text file of the poses.
        options: camera and telemetry of the video, and further files to write. ``priors`` is not
            used.

    Returns:
        One entry for each frame.

    Raises:
        InputError: video or subtitles cannot be read, the camera is unknown, or an output cannot be
            written.
    """
    job = _Job(localization_map, localizer, out, options, options.sequence or SequenceConfig())
    job.check([video] if options.srt is None else [video, options.srt])
    geography = geography_of(localization_map, options)
    source = VideoFrames.open(video, localization_map, options, geography.undulation_m)
    return job.run(source, geography)


def journal_key(sparse_map: SparseMap, images: Path, localizer: Localizer) -> str:
    """Return a digest of a map, its photographs, a method and the versions of packages."""
    method = Method.of(localizer).model_dump_json()
    photographs = digests_in(images, sparse_map.names, "missing")
    return digest_of(method, sparse_map.sha256, photographs, Environment.current())


@dataclass(frozen=True)
class _Job:
    """A call of ``localize`` or ``localize_video``.

    Attributes:
        localization_map: map to localize in.
        localizer: method to run.
        out: text file of the poses.
        options: options of the call.
        sequence: options of the sequence; None if photographs are localized independently.
    """

    localization_map: LocalizationMap
    localizer: Localizer
    out: Path
    options: LocalizeOptions
    sequence: SequenceConfig | None

    @property
    def record(self) -> Path:
        """Return the JSON file that records the method and options of a sequence."""
        return self.out.with_suffix(".json")

    def check(self, inputs: Iterable[Path], folder: Path | None = None) -> None:
        """Check that all outputs can be written.

        Args:
            inputs: files that are read.
            folder: folder in which no output may lie; None for none.

        Raises:
            InputError: an output cannot be written, would replace an input or a file of another
                program, or lies in the folder.
        """
        files = output_files(self.out, self.options.also)
        if self.sequence is not None:
            files.append(OutputFile(self.record, _RECORD.encode()))
        check_outputs(files, inputs)
        if folder is not None:
            check_outside(files, folder)

    def run(self, source: Source, geography: Geography) -> list[ImageEstimate]:
        """Localize the images whose answers are not in the journal, and write all answers."""
        localization_map, localizer = self.localization_map, self.localizer
        estimates: list[ImageEstimate] = []
        with (
            Journal(journal_path(self.out), self._key(), Answer) as journal,
            # A scratch cache lies beside the output, because that disk is expected to have room.
            cache_or_scratch(self.options.cache, self.out.parent) as cache_folder,
        ):
            prepare = partial(
                prepare_lazily,
                localizer,
                localization_map.sparse_map,
                localization_map.images,
                cache_folder,
            )
            image_localizer = _ImageLocalizer(self, journal, cache(prepare))
            images = source.images(image_localizer.localize)
            with progress_bar(f"localize with {localizer.name}", source.count) as advance:
                for image in images:
                    estimates.append(self._to_answer(image, image_localizer(image)))
                    advance(min(len(estimates), source.count))
            self._write(source, estimates, geography)
        source.warn()
        warn_of_disagreement(estimates, geography)
        return estimates

    def _key(self) -> str:
        """Return a digest of all inputs of the answers except the images to localize."""
        key = journal_key(
            self.localization_map.sparse_map, self.localization_map.images, self.localizer
        )
        return digest_of(key, "" if self.sequence is None else self.sequence.model_dump_json())

    def _to_answer(self, image: QueryImage, estimate: Estimate) -> ImageEstimate:
        """Combine an estimate with the metadata of its image."""
        camera = None if image.query is None else image.query.camera
        source = None if image.calibration is None else image.calibration.source
        if camera is not None and source is not None:
            sigma = focal_sigma(camera, source, self.localization_map.cameras)
            points = self.localization_map.sparse_map.xyz
            estimate = add_focal_error(estimate, camera, sigma, points)
        return ImageEstimate(
            image.name,
            estimate,
            self.localization_map.locate_on_earth(estimate),
            image.time,
            camera,
            source,
            image.seconds,
            image.gps,
            image.doubts,
        )

    def _write(
        self,
        source: Source,
        estimates: Sequence[ImageEstimate],
        geography: Geography,
    ) -> None:
        """Write the answers and, for a sequence, the record of method and options."""
        files = output_files(self.out, self.options.also)
        for file, content in encode_files(estimates, files, geography):
            with atomic_write(file) as partial_file:
                partial_file.write_bytes(content)
        if self.sequence is None:
            return
        values = {
            "generator": _RECORD,
            **source.record,
            "images": len(estimates),
            "found": sum(item.is_localized for item in estimates),
            "method": Method.of(self.localizer).model_dump(mode="json"),
            "sequence": self.sequence.model_dump(mode="json"),
        }
        write_text(self.record, json.dumps(values, indent=1) + "\n")


class _ImageLocalizer:
    """Localizes images in their order, or takes their estimates from the journal.

    Args:
        job: the call of ``localize``.
        journal: answers of an interrupted run and of this run.
        prepare: prepares the method at the first call, which follows the reading of the first
            image, so that unreadable input is rejected before the preparation.
    """

    def __init__(self, job: _Job, journal: Journal[Answer], prepare: Callable[[], None]) -> None:
        self._job, self._journal, self._prepare = job, journal, prepare
        self._tracker = None if job.sequence is None else Tracker(job.localizer, job.sequence)
        self._inputs = ""  # ``Answer.inputs`` of the current image

    def localize(self, query: Query) -> Estimate:
        """Localize a single query.

        If it fails and its attitude is not from the user's table of priors but from the gimbal, it
        is localized once more without the attitude.
        """
        self._prepare()
        has_gimbal_attitude = self._job.options.priors is None
        localize_once = localize_with_retry if has_gimbal_attitude else localize_safely
        return localize_once(self._job.localizer, query)

    def __call__(self, image: QueryImage) -> Estimate:
        """Return the estimate of the next image."""
        self._prepare()
        # In a sequence an estimate depends on all earlier images.
        earlier = "" if self._tracker is None else self._inputs
        self._inputs = digest_of(earlier, image.seconds, *_digest_inputs(image))
        estimate = self._estimate(image)
        if self._tracker is not None and image.seconds is not None:
            self._tracker.update(estimate, image.seconds)
        return estimate

    def _estimate(self, image: QueryImage) -> Estimate:
        """Return the estimate in the journal, or localize the image and add the estimate to it."""
        if image.query is None:
            return Estimate(Status.FAILED, reason=image.reason)
        answer = self._journal.done.get(quote_name(image.name))
        if answer is None or answer.inputs != self._inputs:
            if self._tracker is None or image.seconds is None:
                estimate = self.localize(image.query)
            else:
                estimate = self._tracker.localize(image.query, image.seconds)
            answer = Answer.of(image.name, self._inputs, estimate)
            self._journal.add(answer)
        return answer.estimate()


class Answer(NamedRecord):
    """The journal's entry of a photograph or frame: its estimate and a digest of its inputs.

    Other fields are those of ``Estimate``.

    Attributes:
        name: file name, escaped by ``quote_name`` because JSON cannot hold every file name.
        inputs: digest of the image, its camera and its prior; in a sequence also of all earlier
            images.
        cam_from_world: estimated pose as qw qx qy qz tx ty tz; None without a pose.
        covariance: 36 numbers of the covariance by rows; None if unknown or not finite.
    """

    inputs: str
    status: Status
    reason: str
    cam_from_world: PoseNumbers | None
    covariance: tuple[float, ...] | None = Field(min_length=36, max_length=36)
    inliers: int
    by: PoseSource | None = None
    probability: float | None = None

    @staticmethod
    def of(name: str, inputs: str, estimate: Estimate) -> Answer:
        """Return the entry of an estimate."""
        pose, covariance = estimate.cam_from_world, estimate.covariance
        is_finite = covariance is not None and np.isfinite(covariance).all()
        return Answer(
            name=quote_name(name),
            inputs=inputs,
            status=estimate.status,
            reason=for_terminal(estimate.reason),
            cam_from_world=None
            if pose is None
            else (*pose.quaternion().tolist(), *pose.translation.tolist()),
            covariance=tuple(covariance.ravel().tolist())
            if covariance is not None and is_finite
            else None,
            inliers=estimate.inliers,
            by=estimate.by,
            probability=estimate.probability,
        )

    def estimate(self) -> Estimate:
        """Return the estimate of this entry."""
        numbers, covariance = self.cam_from_world, self.covariance
        return Estimate(
            self.status,
            None if numbers is None else Pose.from_quaternion(numbers[:4], numbers[4:]),
            None if covariance is None else np.reshape(covariance, (6, 6)),
            inliers=self.inliers,
            reason=self.reason,
            by=self.by,
            probability=self.probability,
        )


def _digest_inputs(image: QueryImage) -> Iterator[object]:
    """Yield the inputs of an image that affect its estimate, for a digest."""
    yield image.name
    if image.query is None:
        return
    yield image.query.image
    yield image.query.camera
    if image.query.prior is not None:
        for value in vars(image.query.prior).values():
            yield None if value is None else np.asarray(value).tolist()
