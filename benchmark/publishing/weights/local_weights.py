"""The weights to publish, with the card and the calibration files beside them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Final

from objconnect.learning.training.card import CARD
from objconnect.learning.weights_file import SUFFIX
from objconnect.scene.errors import InputError
from objconnect.scene.storage.digests import sha256_of
from objconnect.scene.storage.files import read_text, require_readable

SHIPPED: Final = {
    "objconnect": "objconnect.network",
    "objconnect-objects": "objconnect.network",
    "pixloc": "baselines.pixloc",
    "d2net": "baselines.d2net",
}
"""Package of each file of weights that comes with the project, by its name."""

_SHIPPED_LICENSE: Final = "Apache-2.0"
_TITLE: Final = re.compile(r"# Weights of (\S+)")
_BULLET: Final = "- "
_LIMITS: Final = "limits: "


@dataclass(frozen=True)
class LocalWeights:
    """A file of weights to publish.

    Attributes:
        file: the file.
        sha256: its digest.
        method: method that it belongs to.
        facts: statements of its card on data, training and licences.
        limits: statements of its card on its limits.
        calibration: calibration files beside it.
        license: SPDX identifier of its licence.
    """

    file: Path
    sha256: str
    method: str
    facts: tuple[str, ...]
    limits: tuple[str, ...]
    calibration: tuple[Path, ...]
    license: str

    @property
    def files(self) -> tuple[Path, ...]:
        """The files to copy."""
        return (self.file, *self.calibration)


def find_local_weights(weights: str, license_id: str | None) -> LocalWeights:
    """Find weights that come with the project by name, and other weights by file.

    Args:
        weights: a key of ``SHIPPED``, or a ``.safetensors`` file.
        license_id: SPDX identifier; None for the licence of the project's own weights.

    Raises:
        InputError: there is no such file, it is not safetensors, its card is missing or belongs to
            other weights, or the licence is not stated.
    """
    if weights in SHIPPED:
        file = Path(str(files(SHIPPED[weights]) / f"{weights}{SUFFIX}"))
        license_id = license_id or _SHIPPED_LICENSE
    else:
        file = Path(weights)
    if file.suffix != SUFFIX:
        raise InputError(
            f"{weights!r} is neither a {SUFFIX} file nor one of {', '.join(SHIPPED)}: give one"
        )
    require_readable(file, "file of weights")
    if license_id is None:
        raise InputError(f"{file}: state the licence of your weights with --license")
    sha256 = sha256_of(file)
    method, bullets = _read_card(file, sha256)
    return LocalWeights(
        file=file,
        sha256=sha256,
        method=method,
        facts=tuple(fact for fact in bullets if not fact.startswith(_LIMITS)),
        limits=tuple(f.removeprefix(_LIMITS) for f in bullets if f.startswith(_LIMITS)),
        calibration=tuple(sorted(file.parent.glob(f"{_escape(file.stem)}.*.yaml"))),
        license=license_id,
    )


def _read_card(file: Path, sha256: str) -> tuple[str, Sequence[str]]:
    """Return the method and the facts of the card beside a file of weights."""
    own_card = file.with_suffix(".md")
    path = own_card if own_card.is_file() else file.with_name(CARD)
    if not path.is_file():
        raise InputError(
            f"{file} has no card: describe data, training and limits in {own_card}, as {CARD} of "
            "'objconnect train' does"
        )
    lines = read_text(path, "card").splitlines()
    title = _TITLE.match(lines[0]) if lines else None
    if title is None:
        raise InputError(f"{path}: the first line is not '# Weights of METHOD': write it so")
    if sha256 not in "\n".join(lines):
        raise InputError(f"{path} does not describe {file}: it lacks its sha256, {sha256}")
    bullets: list[str] = []
    for line in lines[1:]:
        if line.startswith(_BULLET):
            bullets.append(line.removeprefix(_BULLET).strip())
        elif line.strip() and bullets:
            bullets[-1] += f" {line.strip()}"
    return title[1], bullets


def _escape(name: str) -> str:
    """Escape the glob characters of a file name."""
    return re.sub(r"([*?[])", r"[\1]", name)
