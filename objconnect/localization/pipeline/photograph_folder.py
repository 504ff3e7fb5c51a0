"""A folder of photographs as queries, independently or as a sequence in the order of time."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from objconnect.localization.pipeline.localization_map import LocalizationMap
from objconnect.localization.pipeline.options import LocalizeOptions
from objconnect.localization.pipeline.photographs import (
    PhotographReader,
    add_estimates,
    warn_of_doubts,
    warn_of_rolling_shutter,
)
from objconnect.localization.pipeline.query_image import QueryImage
from objconnect.scene.errors import InputError
from objconnect.scene.flights.priors import AssumedSigmas, MapFrame
from objconnect.scene.flights.textfiles import read_priors, require_same_case
from objconnect.scene.localizer import Estimate, Prior, Query
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.storage.files import require_folder
from objconnect.scene.storage.listing import OTHER_PICTURES, PHOTOGRAPHS, list_files

log = logging.getLogger(__name__)

# Largest number of sub-folders that a message names.
_MAX_NAMES: Final = 3


def photographs_in(folder: Path) -> dict[str, Path]:
    """Return the photographs of a folder by name, in the order of their names.

    Raises:
        InputError: the folder does not exist or holds no photograph.
    """
    require_folder(folder, "folder of photographs")
    paths = list_files(folder, PHOTOGRAPHS)
    if not paths:
        unread = _unread_pictures(folder)
        hint = f"; not read: {unread}" if unread else ""
        raise InputError(f"{folder} holds no photograph ({', '.join(PHOTOGRAPHS)}){hint}")
    return {path.name: path for path in paths}


def _unread_pictures(folder: Path) -> str:
    """Return a phrase that counts the pictures that ``photographs_in`` leaves out; empty if none.

    These are photographs in sub-folders, and pictures of other kinds in the folder itself.
    """
    phrases = []
    try:
        paths = [path for path in list_files(folder, PHOTOGRAPHS, None) if path.parent != folder]
    except InputError as error:  # a sub-folder that is not ours to read must not end the run
        paths, phrases = [], [str(error)]
    if paths:
        names = list(dict.fromkeys(path.parent.relative_to(folder).as_posix() for path in paths))
        more = [f"{len(names) - _MAX_NAMES} more"] if len(names) > _MAX_NAMES else []
        where = ", ".join(names[:_MAX_NAMES] + more)
        phrases.append(f"{_count(len(paths), 'photograph')} in sub-folders ({where})")
    if others := list_files(folder, OTHER_PICTURES):
        suffixes = sorted({path.suffix.lower() for path in others})
        phrases.append(f"{_count(len(others), 'picture')} of other kinds ({', '.join(suffixes)})")
    return " and ".join(phrases)


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


@dataclass(frozen=True)
class PhotographFolder:
    """The photographs of a folder.

    Attributes:
        folder: the folder.
        paths: the photographs by name.
        reader: reads photographs.
        rate_hz: number of photographs per second of a sequence in the order of names; None for the
            times in EXIF.
        seconds: time of each photograph of a sequence from its start; times from EXIF lack
            photographs that cannot be read. None if photographs are localized independently.
    """

    folder: Path
    paths: Mapping[str, Path]
    reader: PhotographReader
    rate_hz: float | None
    seconds: Mapping[str, float] | None

    @staticmethod
    def open(
        folder: Path,
        localization_map: LocalizationMap,
        options: LocalizeOptions,
        undulation_m: float | None,
    ) -> PhotographFolder:
        """List the photographs; read the table of priors and the times of a sequence.

        Pictures that are not read are warned of.

        Args:
            folder: the folder.
            localization_map: map to localize in.
            options: options of the photographs: camera, priors, standard deviations and sequence.
            undulation_m: height of the geoid above the ellipsoid, metres; None if unknown.

        Raises:
            InputError: there is no photograph; the priors cannot be read or name none of the
                photographs; or a photograph of a sequence has no time, or the same time as another
                one.
        """
        paths = photographs_in(folder)
        if unread := _unread_pictures(folder):
            log.warning("%s: not read: %s", for_terminal(folder), for_terminal(unread))
        reader = PhotographReader(
            localization_map, options, _priors(paths, localization_map, options), undulation_m
        )
        seconds = None if options.sequence is None else _seconds(paths, reader, options.rate_hz)
        return PhotographFolder(folder, paths, reader, options.rate_hz, seconds)

    @property
    def count(self) -> int:
        """Return the number of photographs."""
        return len(self.paths)

    @property
    def record(self) -> Mapping[str, Any]:
        """Return the description of the folder for the JSON file that ``localize`` writes."""
        return {"photographs": self.folder.name, "rate_hz": self.rate_hz}

    def images(self, localize: Callable[[Query], Estimate]) -> Iterator[QueryImage]:
        """Yield the photographs in their order.

        Args:
            localize: localizes one query. It is called to estimate unknown intrinsics before the
                first photograph is yielded, unless the photographs are a sequence.

        Raises:
            InputError: none of the photographs can be localized.
        """
        self._require_localizable()
        reader = self.reader
        if self.seconds is None:
            reader = add_estimates(reader, self.paths, localize)
        return (self._image(reader, name) for name in self._order())

    def warn(self) -> None:
        """Warn of rolling shutter and of uncertain metadata of the photographs that were read."""
        warn_of_rolling_shutter(self.reader.metadata.values())
        warn_of_doubts(self.reader)

    def _require_localizable(self) -> None:
        """Check that at least one photograph can be read and has a camera.

        Raises:
            InputError: there is no such photograph.
        """
        reason = ""
        for name in self._order():
            image = self._image(self.reader, name)
            if image.query is not None:
                return
            reason = reason or image.reason
        prefix = f"none of the {self.count} photographs in {self.folder} can be localized: "
        raise InputError((prefix if self.count > 1 else "") + reason)

    def _order(self) -> list[str]:
        """Return the names in the order of their times; photographs without a time come last."""
        seconds = self.seconds or {}
        return sorted(self.paths, key=lambda name: seconds.get(name, math.inf))

    def _image(self, reader: PhotographReader, name: str) -> QueryImage:
        """Read a photograph; if it cannot be localized, the result has the reason and no query."""
        path, sequence = self.paths[name], self.seconds
        seconds = None if sequence is None else sequence.get(name)
        try:
            image = replace(reader(name, path), seconds=seconds)
        except (InputError, OSError) as error:
            reason = str(error)
            if isinstance(error, OSError):
                reason = f"cannot read {path}: {error.strerror}"
            exif = None if sequence is None else reader.metadata.get(path)
            time = None if exif is None else exif.time
            return QueryImage(name, time=time, seconds=seconds, reason=reason)
        if sequence is None or image.calibration is None or not image.calibration.others:
            return image
        doubts = "; ".join(reader.exif(path).lens_doubts)
        why = f" ({doubts})" if doubts else ""
        reason = f"the focal length of {path} is unknown{why}: give --camera"
        return replace(image, query=None, reason=reason)


def _priors(
    paths: Mapping[str, Path], localization_map: LocalizationMap, options: LocalizeOptions
) -> dict[str, Prior] | None:
    """Read the table of priors, by name; None without a table.

    Raises:
        InputError: the table cannot be read, has no row for any of the photographs, or gives
            geodetic positions although the map is not georeferenced.
    """
    path = options.priors
    if path is None:
        return None
    stated = read_priors(path)
    require_same_case(path, stated.rows, paths)
    missing = [name for name in paths if name not in stated.rows]
    if len(missing) == len(paths):
        raise InputError(
            f"{path} has no row for any of the photographs, such as {missing[0]!r}: its names must "
            "be those of the files"
        )
    if missing:
        log.warning("%s lacks %d of %d photographs", path, len(missing), len(paths))
    frame = MapFrame.of(localization_map.sparse_map, localization_map.origin)
    assumed = AssumedSigmas(
        np.full(3, options.gps_sigma_m),
        options.gimbal_sigma_deg,
        f"--gps-sigma {options.gps_sigma_m:g} (metres) is used",
        f"--gimbal-sigma {options.gimbal_sigma_deg:g} (degrees) is used",
    )
    return stated.priors(frame, paths, assumed)


def _seconds(
    paths: Mapping[str, Path], reader: PhotographReader, rate_hz: float | None
) -> dict[str, float]:
    """Return the time of each photograph from the first one, in seconds, by a rate or by EXIF.

    Raises:
        InputError: ``rate_hz`` is None, and a photograph has no time or the same time as another.
    """
    times: dict[str, datetime | None] = {}
    for name, path in paths.items():
        with suppress(InputError, OSError):
            times[name] = reader.exif(path).time
    if rate_hz is not None:
        return {name: index / rate_hz for index, name in enumerate(paths)}
    known = {name: time.replace(tzinfo=None) for name, time in times.items() if time is not None}
    hint = "give --rate (photographs per second) to take them in the order of their names"
    for name in times:
        if name not in known:
            raise InputError(f"photograph {name} has no time in EXIF: {hint}")
    ordered = sorted(known, key=lambda name: known[name])
    for before, name in pairwise(ordered):
        if known[before] == known[name]:
            raise InputError(f"photographs {before} and {name} have the same time: {hint}")
    return {name: (known[name] - known[ordered[0]]).total_seconds() for name in ordered}
