"""Plans of all presets except ``town``, which has its own module."""

from __future__ import annotations

from functools import partial

from simulate.place.dwellings import flats, housing
from simulate.place.farms import farm, hayfield, pasture
from simulate.place.greens import field, meadow, park, woods
from simulate.place.plan import Plan, Quarter
from simulate.place.power import power_lines
from simulate.place.roadside import avenues, deliveries, street_furniture, street_lamps, traffic
from simulate.place.trade import tank_farm, trade, works
from simulate.place.urban import fronts, square
from simulate.place.water import dock, lake

SUBURB = Plan(
    block_m=85.0,
    quarters=(
        Quarter(
            first=(housing, housing, flats, park),
            uses={housing: 0.82, flats: 0.06, park: 0.07, lake: 0.05},
            open_land=meadow,
            open_share=0.06,
        ),
    ),
    after=(street_lamps, traffic, street_furniture, deliveries),
)

PARK = Plan(
    block_m=130.0,
    quarters=(
        Quarter(
            first=(lake, park, woods, meadow),
            uses={park: 0.45, woods: 0.35, lake: 0.20},
            open_land=meadow,
            open_share=0.3,
        ),
    ),
    after=(street_lamps, street_furniture),
    verge="path",
)

FARMLAND = Plan(
    block_m=150.0,
    quarters=(
        Quarter(
            first=(farm, hayfield, pasture, field),
            uses={farm: 0.18, hayfield: 0.32, pasture: 0.27, woods: 0.15, lake: 0.08},
            open_land=field,
            open_share=0.4,
        ),
    ),
    before=(power_lines,),
    after=(partial(traffic, parked=0.0),),
    verge="grass",
)

INDUSTRIAL = Plan(
    block_m=110.0,
    quarters=(
        Quarter(
            first=(works, trade, tank_farm, dock),
            uses={works: 0.42, trade: 0.30, tank_farm: 0.13, dock: 0.15},
            open_land=meadow,
            open_share=0.06,
        ),
    ),
    before=(power_lines,),
    after=(street_lamps, traffic, street_furniture, deliveries),
)

STREET = Plan(
    block_m=62.0,
    least_m=180.0,
    quarters=(
        Quarter(
            name="urban",
            first=(fronts, fronts, square),
            uses={fronts: 1.0},
            open_land=square,
            open_share=0.1,
        ),
        Quarter(
            name="suburban",
            first=(housing,),
            uses={housing: 1.0},
            open_land=meadow,
            open_share=0.0,
        ),
        Quarter(
            name="park",
            first=(park, lake, woods),
            uses={park: 0.5, woods: 0.35, lake: 0.15},
            open_land=meadow,
            open_share=0.0,
        ),
    ),
    after=(
        street_lamps,
        partial(traffic, parked=0.45),
        street_furniture,
        deliveries,
        avenues,
    ),
)
