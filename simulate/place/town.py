"""The plan of a town: housing, flats, halls and parks, with fields between them."""

from __future__ import annotations

from simulate.place.dwellings import flats, housing
from simulate.place.greens import field, park
from simulate.place.industry import halls
from simulate.place.plan import Plan, Quarter
from simulate.place.roadside import parked_lorries, street_furniture, street_lamps, traffic

TOWN = Plan(
    block_m=80.0,
    quarters=(
        Quarter(
            first=(housing, flats, halls, park),
            uses={housing: 0.60, flats: 0.14, halls: 0.13, park: 0.13},
            open_land=field,
            open_share=0.12,
        ),
    ),
    after_blocks=(street_lamps, traffic, street_furniture, parked_lorries),
)
