"""Parsing and checking of the arguments of commands before their work begins."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import yaml

from objconnect.scene.errors import InputError

if TYPE_CHECKING:
    import typer

    from benchmark.datasets.dataset import Dataset
    from objconnect.scene.geo.crs import Projection
    from objconnect.scene.geometry.camera import Camera
    from objconnect.scene.localizer import Localizer

# A plain value followed by a second KEY=VALUE.
_SECOND_SETTING: Final = re.compile(r"[\w./+-]+[\s,;]+[A-Za-z_][\w.]*=")


def list_given_options(context: typer.Context) -> list[str]:
    """Return the options that the command line gives, as ``--size``, in the order of the help."""
    sources = {
        parameter.opts[0]: context.get_parameter_source(parameter.name or "")
        for parameter in context.command.params
    }
    return [
        name
        for name, source in sources.items()
        if name.startswith("--") and source is not None and source.name == "COMMANDLINE"
    ]


def parse_settings(overrides: Sequence[str] | None) -> dict[str, Any]:
    """Read the values of ``--set`` as a dictionary.

    Values are read as YAML, so that 0.7 is a number.

    Raises:
        InputError: a word that is not ``KEY=VALUE`` or holds several, a key that is given twice, or
            a value that is not YAML or is empty.
    """
    settings: dict[str, Any] = {}
    for word in overrides or ():
        key, equals, value = word.partition("=")
        if not key or not equals:
            raise InputError(f"--set takes KEY=VALUE, got {word!r}")
        if key in settings:
            raise InputError(f"--set {key} is given twice: give each key one value")
        if _SECOND_SETTING.match(value) and not Path(value).exists():
            raise InputError(
                f"--set {key}: {value!r} holds another KEY=VALUE: --set is given once per value"
            )
        try:
            settings[key] = yaml.safe_load(value)
        except (yaml.YAMLError, ValueError, RecursionError):
            raise InputError(f"--set {key}: {value!r} is not a YAML value: quote it") from None
        # null switches an option off; an empty value is an error.
        if settings[key] is None and not value.strip():
            raise InputError(
                f"--set {key}: {value!r} is not valid: leave --set {key} out for the default"
            )
    return settings


def create_with_risk(method: str, settings: Mapping[str, Any], risk: float | None) -> Localizer:
    """Create a localizer with the accepted risk of ``--risk``; None keeps the method's own.

    Raises:
        InputError: the method has no such option, ``--set`` gives it too, or the method cannot be
            created with its settings.
    """
    from objconnect.methods import create

    localizer = create(method, settings)
    if risk is None:
        return localizer
    if not hasattr(getattr(localizer.config, "search", None), "risk"):
        raise InputError(f"{method} predicts no probability of its poses: leave out --risk")
    search = settings.get("search")
    if "search.risk" in settings or (isinstance(search, Mapping) and "risk" in search):
        raise InputError("--risk and --set search.risk are the same: give one of them")
    return create(method, {**settings, "search.risk": risk})


def check_jobs(jobs: int, cluster: str | None) -> None:
    """Refuse ``--jobs`` together with ``--cluster``, which uses all cores of its nodes.

    Raises:
        InputError: both are given.
    """
    if cluster is not None and jobs != 1:
        raise InputError(
            f"--jobs {jobs} is for this machine alone, and --cluster uses all cores of its nodes: "
            "leave one out"
        )


def check_methods(names: Sequence[str]) -> None:
    """Refuse a method that is given twice, because its results would overwrite each other.

    Raises:
        InputError: a method is given twice.
    """
    for name, count in Counter(names).items():
        if count > 1:
            raise InputError(f"--method {name} is given {count} times: give it once")


def parse_camera(words: str | None) -> Camera | None:
    """Read the value of ``--camera``, "MODEL W H PARAMS".

    Raises:
        InputError: the words do not describe a camera.
    """
    from objconnect.scene.geometry.camera import Camera

    try:
        return None if words is None else Camera.parse(words.split())
    except InputError as error:
        raise InputError(f"--camera: {error}") from None


def parse_crs(code: str | None) -> Projection | None:
    """Read the value of ``--crs``, the code of a coordinate reference system.

    Raises:
        InputError: there is no such system, it has no eastings and northings, or pyproj is not
            installed.
    """
    from objconnect.scene.geo.crs import Projection

    try:
        return None if code is None else Projection(code)
    except InputError as error:
        raise InputError(f"--crs: {error}") from None


def open_distinct_datasets(paths: Iterable[Path]) -> list[Dataset]:
    """Open the data sets at these paths.

    Raises:
        InputError: a path is no data set or is given twice, or two data sets share a name and
            would overwrite each other's results.
    """
    from benchmark.datasets.open import open_datasets
    from objconnect.scene.storage.files import require_distinct

    paths = list(paths)
    require_distinct(paths)
    datasets = [dataset for path in paths for dataset in open_datasets(path)]
    names = set()
    for dataset in datasets:
        if dataset.name in names:
            raise InputError(
                f"two data sets are called {dataset.name!r}: evaluate them in separate runs"
            )
        names.add(dataset.name)
    return datasets


def check_folders(inputs: Iterable[Path], *folders: Path | None) -> None:
    """Refuse output folders that lie inside an input of the command.

    Files written there would change the input: the next run would read another data set.

    Raises:
        InputError: a folder lies inside an input, or cannot be written.
    """
    from objconnect.scene.storage.outputs import check_output_folder

    for folder in folders:
        if folder is not None:
            check_output_folder(folder, inputs)
