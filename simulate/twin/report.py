"""The report of a real site that was built for rendering, ``site/report.json`` of a scene."""

from __future__ import annotations

from typing import Final

from pydantic import BaseModel, ConfigDict

REPORT_FILE: Final = "site/report.json"
PLACE_FILE: Final = "site/place.npz"


class SiteReport(BaseModel):
    """The resolution, completeness, classes and shadows of a site, and notes for the user.

    Attributes:
        texel_m: side of a pixel of the texture, metres.
        spacing_m: distance between the nodes of the surface, metres.
        margin_m: width of the strip around the place in which the sources have data, metres.
        closed: share of the place without heights, which were interpolated.
        holes: share of the place without colours, which were interpolated.
        classes: share of the place, with its margin, by class.
        sun: azimuth and elevation of the sun in the orthophoto, degrees; None if unknown, or too
            low to locate shadows.
        shade: share of the place, with its margin, in the shade; 0 if ``sun`` is None.
        gain: mean factor by which shadows were brightened.
        notes: remarks for the user, a line each.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    texel_m: float
    spacing_m: float
    margin_m: float
    closed: float
    holes: float
    classes: dict[str, float]
    sun: tuple[float, float] | None = None
    shade: float = 0.0
    gain: float = 1.0
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """Return a summary in one line, and each note in a line of its own."""
        shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in self.classes.items())
        summary = (
            f"site: texture {100 * self.texel_m:.0f} cm, surface {100 * self.spacing_m:.0f} cm, "
            f"{shares}"
        )
        if self.sun is not None:
            summary += (
                f"; sun {self.sun[1]:.0f}° high, shadows softened on {100 * self.shade:.0f} %"
            )
        return "\n".join((summary, *self.notes))
