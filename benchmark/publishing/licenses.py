"""The licences that published data and weights may have: SPDX identifiers that the hub accepts.

The names of the hub are those of its documentation (hf.co/docs/hub/repositories-licenses).
"""

from __future__ import annotations

from typing import Final

from objconnect.scene.errors import InputError

RENDERS_LICENSE: Final = "CC-BY-4.0"
"""SPDX identifier of the licence of renders."""

# Identifiers whose name on the hub is the same in lower case.
_SAME: Final = (
    "AFL-3.0", "Apache-2.0", "Artistic-2.0", "BSD-2-Clause", "BSD-3-Clause", "BSD-3-Clause-Clear",
    "BSL-1.0", "CC-BY-2.0", "CC-BY-2.5", "CC-BY-3.0", "CC-BY-4.0", "CC-BY-NC-2.0", "CC-BY-NC-3.0",
    "CC-BY-NC-4.0", "CC-BY-NC-ND-3.0", "CC-BY-NC-ND-4.0", "CC-BY-NC-SA-2.0", "CC-BY-NC-SA-3.0",
    "CC-BY-NC-SA-4.0", "CC-BY-ND-4.0", "CC-BY-SA-3.0", "CC-BY-SA-4.0", "CC0-1.0",
    "CDLA-Permissive-1.0", "CDLA-Permissive-2.0", "CDLA-Sharing-1.0", "ECL-2.0", "EPL-1.0",
    "EPL-2.0", "etalab-2.0", "EUPL-1.1", "ISC", "LPPL-1.3c", "MIT", "MPL-2.0", "MS-PL", "NCSA",
    "OFL-1.1", "OSL-3.0", "PostgreSQL", "Unlicense", "WTFPL", "Zlib",
)  # fmt: skip
# Name on the hub of each SPDX identifier.
_HUB_NAMES: Final = {name: name.lower() for name in _SAME} | {
    "AGPL-3.0-only": "agpl-3.0",
    "AGPL-3.0-or-later": "agpl-3.0",
    "C-UDA-1.0": "c-uda",
    "GPL-2.0-only": "gpl-2.0",
    "GPL-2.0-or-later": "gpl-2.0",
    "GPL-3.0-only": "gpl-3.0",
    "GPL-3.0-or-later": "gpl-3.0",
    "LGPL-2.1-only": "lgpl-2.1",
    "LGPL-2.1-or-later": "lgpl-2.1",
    "LGPL-3.0-only": "lgpl-3.0",
    "LGPL-3.0-or-later": "lgpl-3.0",
    "ODbL-1.0": "odbl",
    "ODC-By-1.0": "odc-by",
    "PDDL-1.0": "pddl",
}
_URLS: Final = {RENDERS_LICENSE: "https://creativecommons.org/licenses/by/4.0/"}


def require_license(license_id: str) -> None:
    """Refuse a licence that the hub does not accept.

    Raises:
        InputError: it is not one of the SPDX identifiers.
    """
    if license_id not in _HUB_NAMES:
        known = ", ".join(sorted(_HUB_NAMES, key=str.lower))
        raise InputError(
            f"license {license_id!r} is no SPDX identifier that the hub accepts: give one of "
            f"{known}"
        )


def hub_license(license_id: str) -> str:
    """Return the hub's name of a licence that ``require_license`` accepts."""
    return _HUB_NAMES[license_id]


def license_url(license_id: str) -> str:
    """Return the page of a licence."""
    return _URLS.get(license_id, f"https://spdx.org/licenses/{license_id}.html")
