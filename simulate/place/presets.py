"""The presets: kinds of procedural places by name, and ``site`` for a real place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from objconnect.scene.registry import Lazy, Registry

if TYPE_CHECKING:
    from simulate.place.plan import Plan
    from simulate.place.world import World


def _is_plan(entry: object) -> bool:
    from simulate.place.plan import Plan  # late, because listing presets must be quick

    return isinstance(entry, Plan)


PRESETS: Final[Registry[Plan]] = Registry(
    "preset",
    "objconnect.presets",
    {
        "town": Lazy("simulate.place.town:TOWN"),
        "suburb": Lazy("simulate.place.plans:SUBURB"),
        "park": Lazy("simulate.place.plans:PARK"),
        "farmland": Lazy("simulate.place.plans:FARMLAND"),
        "industrial": Lazy("simulate.place.plans:INDUSTRIAL"),
        "street": Lazy("simulate.place.plans:STREET"),
        "estate": Lazy("simulate.place.plans:ESTATE"),
        "orchard": Lazy("simulate.place.plans:ORCHARD"),
        "solar": Lazy("simulate.place.plans:SOLAR"),
        "containers": Lazy("simulate.place.plans:CONTAINERS"),
        "cemetery": Lazy("simulate.place.plans:CEMETERY"),
        "alpine": Lazy("simulate.place.plans:ALPINE"),
        "harbour": Lazy("simulate.place.plans:HARBOUR"),
    },
    accepts=_is_plan,
)

SITE: Final = "site"
"""The preset of a real place, which is read from a file instead of built by a plan."""


def preset(name: str, site_path: Path | None = None) -> Callable[[int, float], World]:
    """Return the function that builds a World from a seed and a side in metres.

    ``simulate.place.plan.Plan.build`` describes the function. A package adds a preset by an entry
    point of the group ``objconnect.presets`` that names a ``simulate.place.plan.Plan``.

    Args:
        name: Name of a preset.
        site_path: File of a site, for the preset ``SITE``.

    Raises:
        InputError: the preset does not exist, or a package's preset cannot be loaded.
    """
    if name == SITE and site_path is not None:
        from simulate.place.site_files import load_site

        return lambda seed, _side_m: load_site(site_path, seed)
    return PRESETS.load(name).build
