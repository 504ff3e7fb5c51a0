"""What was found of a site: ``site/report.json`` of a scene."""

from __future__ import annotations

from typing import Final

from pydantic import BaseModel, ConfigDict

REPORT: Final = "site/report.json"
PLACE: Final = "site/place.npz"


class SiteReport(BaseModel):
    """What a twin was made of, and what has to be known of it.

    Attributes:
        texel_m: side of a pixel of the texture, metres.
        spacing_m: distance between the nodes of the surface, metres.
        margin_m: width of the strip around the place that is known, too, metres.
        closed: share of the place that had no height and got that of its neighbours.
        holes: share of the place that had no colours and got those around.
        classes: share of the place by class.
        sun: azimuth and elevation of the sun in the orthophoto, degrees; None where not known.
        shade: share of the place that lay in the shade then.
        gain: mean factor by which the shade was brightened.
        notes: one line for each thing that a user has to know.
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
        """Return the figures in a line, and each note in its own."""
        shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in self.classes.items())
        figures = (
            f"site: texture {100 * self.texel_m:.0f} cm, surface {100 * self.spacing_m:.0f} cm, "
            f"{shares}"
        )
        if self.sun is not None:
            figures += (
                f"; shadows of a sun {self.sun[1]:.0f}° high softened on {100 * self.shade:.0f} %"
            )
        return "\n".join((figures, *self.notes))
