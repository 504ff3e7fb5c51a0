"""Plans of all presets (kinds of places) but ``town``; ``simulate.place.plan`` has the fields."""

from __future__ import annotations

from functools import partial

from simulate.place.alpine import alpine_pasture, chalets
from simulate.place.cemeteries import chapel, graves
from simulate.place.containers import container_yard
from simulate.place.dwellings import flats, housing
from simulate.place.estates import estate
from simulate.place.farms import farm, hayfield, pasture
from simulate.place.greens import field, meadow, park, woods
from simulate.place.harbours import marina, quay
from simulate.place.industry import factory, halls, tank_farm
from simulate.place.orchards import orchard
from simulate.place.plan import Plan, Quarter
from simulate.place.power import power_lines
from simulate.place.relief import valley
from simulate.place.roadside import (
    parked_lorries,
    roadside_trees,
    street_furniture,
    street_lamps,
    traffic,
)
from simulate.place.solar import solar
from simulate.place.streets import StreetKind
from simulate.place.urban import fronts, square
from simulate.place.water import dock, lake

spruces = partial(woods, conifers=(0.9, 1.0))

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
    after_blocks=(street_lamps, traffic, street_furniture, parked_lorries),
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
    after_blocks=(street_lamps, street_furniture),
    streets=StreetKind(verge="path"),
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
    before_blocks=(power_lines,),
    after_blocks=(partial(traffic, parked=0.0),),
    streets=StreetKind(verge="grass"),
)

INDUSTRIAL = Plan(
    block_m=110.0,
    quarters=(
        Quarter(
            first=(factory, halls, tank_farm, dock),
            uses={factory: 0.42, halls: 0.30, tank_farm: 0.13, dock: 0.15},
            open_land=meadow,
            open_share=0.06,
        ),
    ),
    before_blocks=(power_lines,),
    after_blocks=(street_lamps, traffic, street_furniture, parked_lorries),
)

STREET = Plan(
    block_m=62.0,
    min_side_m=180.0,
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
    after_blocks=(
        street_lamps,
        partial(traffic, parked=0.45),
        street_furniture,
        parked_lorries,
        roadside_trees,
    ),
)

ESTATE = Plan(
    block_m=70.0,
    quarters=(
        Quarter(
            first=(estate, estate, estate, estate),
            uses={estate: 0.93, park: 0.07},
            open_land=park,
            open_share=0.04,
        ),
    ),
    after_blocks=(street_lamps, partial(traffic, parked=0.35), street_furniture),
    streets=StreetKind(bend=0.0),
)

ORCHARD = Plan(
    block_m=120.0,
    quarters=(
        Quarter(
            first=(orchard, orchard, farm, orchard),
            uses={orchard: 0.76, farm: 0.08, pasture: 0.08, field: 0.08},
            open_land=meadow,
            open_share=0.08,
        ),
    ),
    after_blocks=(),
    streets=StreetKind(surface="path", verge="grass", widths_m=(5.0, 3.6), bend=0.0),
)

SOLAR = Plan(
    block_m=115.0,
    quarters=(
        Quarter(
            first=(solar, solar, solar, woods),
            uses={solar: 0.86, pasture: 0.07, woods: 0.07},
            open_land=meadow,
            open_share=0.05,
        ),
    ),
    after_blocks=(),
    streets=StreetKind(surface="path", verge="grass", widths_m=(5.0, 4.0), bend=0.0),
)

CONTAINERS = Plan(
    block_m=105.0,
    quarters=(
        Quarter(
            first=(container_yard, container_yard, container_yard, halls),
            uses={container_yard: 0.9, halls: 0.1},
            open_land=halls,
            open_share=0.05,
        ),
    ),
    after_blocks=(street_lamps, partial(traffic, parked=0.0), parked_lorries),
    streets=StreetKind(verge="parking", bend=0.0),
)

CEMETERY = Plan(
    block_m=58.0,
    quarters=(
        Quarter(
            first=(graves, graves, graves, chapel),
            uses={graves: 0.88, woods: 0.12},
            open_land=woods,
            open_share=0.05,
        ),
    ),
    after_blocks=(roadside_trees,),
    streets=StreetKind(surface="path", verge="grass", widths_m=(5.0, 3.4), bend=0.15),
)

ALPINE = Plan(
    block_m=80.0,
    quarters=(
        Quarter(
            first=(chalets, chalets, chapel, alpine_pasture),
            uses={chalets: 0.58, alpine_pasture: 0.26, spruces: 0.16},
            open_land=alpine_pasture,
            open_share=0.1,
        ),
    ),
    after_blocks=(street_lamps, partial(traffic, parked=0.08)),
    streets=StreetKind(verge="grass", widths_m=(5.5, 4.0), bend=1.5),
    relief=valley,
    steep=True,
)

HARBOUR = Plan(
    block_m=115.0,
    quarters=(
        Quarter(
            first=(quay, marina, quay, halls),
            uses={quay: 0.48, marina: 0.42, halls: 0.1},
            open_land=halls,
            open_share=0.04,
        ),
    ),
    after_blocks=(street_lamps, partial(traffic, parked=0.1), street_furniture, parked_lorries),
    streets=StreetKind(bend=0.0),
)
