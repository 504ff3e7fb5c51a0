"""Place objects along roads: lamps, trees, street furniture and vehicles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulate.place.builder import PAVEMENT_M, Footing, ObjectSpec, PlaceBuilder
from simulate.place.objects import LAMP_M, car, small_object, tree, truck
from simulate.place.world import polyline_length, polyline_points

Array = NDArray[np.float64]


def street_lamps(builder: PlaceBuilder) -> None:
    """Place lamps along every road, with their arms over the kerb."""
    for road in builder.roads:
        side = builder.choose((1.0, -1.0))
        for s in np.arange(builder.rng.uniform(5, 20), polyline_length(road.line), 27.0):
            (p,), (along,) = polyline_points(road.line, s)
            across = side * np.array([-along[1], along[0]])
            yaw = float(np.arctan2(-across[1], -across[0]))
            position = p + (0.5 * road.width_m + 0.2) * across
            if is_off_junction(builder, position, 1.5):
                lamp = ObjectSpec("lamp", "lamp", LAMP_M, (0.25, 0.26, 0.27))
                builder.place(lamp, position, yaw, Footing(on_road=True))


def roadside_trees(builder: PlaceBuilder) -> None:
    """Place trees along both sides of every road, behind its pavements, where there is room."""
    for road in builder.roads:
        for side in (1.0, -1.0):
            for s in np.arange(builder.rng.uniform(3, 9), polyline_length(road.line), 9.0):
                (p,), (along,) = polyline_points(road.line, s)
                out = 0.5 * road.width_m + PAVEMENT_M + 2.6
                position = p + side * out * np.array([-along[1], along[0]])
                tree(builder, position, builder.rng.uniform(1.5, 2.3), conifers=0.0)


def street_furniture(builder: PlaceBuilder) -> None:
    """Place bins, hydrants, signs and bollards in turn on the pavements."""
    kinds = ("sign", "bin", "hydrant", "bollard")
    placed = 0
    for road in builder.roads:
        length = polyline_length(road.line)
        for s in np.arange(builder.rng.uniform(5, 20), length, 22.0):
            (p,), (along,) = polyline_points(road.line, s)
            side = builder.choose((1.0, -1.0))
            position = p + side * (0.5 * road.width_m + 1.2) * np.array([-along[1], along[0]])
            # Signs face the drivers that come towards them on the right-hand lane.
            yaw = float(np.arctan2(side * along[1], side * along[0]))
            if is_off_junction(builder, position, 6.0):
                kind = kinds[placed % len(kinds)]
                placed += small_object(builder, kind, position, yaw, Footing(on_road=True))


def traffic(builder: PlaceBuilder, parked: float = 0.28) -> None:
    """Place vehicles on the right-hand lanes of all roads, and parked ones along side streets.

    Args:
        builder: The place.
        parked: The share of the parking places along side streets that are occupied.
    """
    rng = builder.rng
    for road in builder.roads:
        length = polyline_length(road.line)
        for direction in (1.0, -1.0):
            s = rng.uniform(0, 40)
            while s < length:
                (p,), (along,) = polyline_points(road.line, s)
                along = direction * along
                right = np.array([along[1], -along[0]])
                position = p + (0.25 * road.width_m + rng.normal(0, 0.1)) * right
                yaw = float(np.arctan2(along[1], along[0]))
                if is_off_junction(builder, position, 6.0):
                    if builder.chance(0.85):
                        car(builder, position, yaw, gap_m=0.5, driven=True)
                    else:
                        truck(builder, position, yaw, on_road=True, driven=True)
                s += rng.uniform(14, 75)
        if road.main:
            continue
        side = builder.choose((1.0, -1.0))
        for s in np.arange(6.0, length, 6.4):
            (p,), (along,) = polyline_points(road.line, s)
            position = p + side * (0.5 * road.width_m - 1.1) * np.array([-along[1], along[0]])
            if builder.chance(parked) and is_off_junction(builder, position, 9.0):
                car(
                    builder,
                    position,
                    float(np.arctan2(along[1], along[0])) + builder.choose((0.0, np.pi)),
                    gap_m=0.5,
                )


def parked_lorries(builder: PlaceBuilder) -> None:
    """Place lorries that stand at the kerb."""
    for road in builder.roads:
        for s in np.arange(builder.rng.uniform(10, 40), polyline_length(road.line), 30.0):
            (p,), (along,) = polyline_points(road.line, s)
            position = p + (0.5 * road.width_m - 1.5) * np.array([along[1], -along[0]])
            yaw = float(np.arctan2(along[1], along[0]))
            if builder.chance(0.3) and is_off_junction(builder, position, 8.0):
                truck(builder, position, yaw, shapes=("lorry",), on_road=True)


def is_off_junction(builder: PlaceBuilder, position: Array, clear_m: float) -> bool:
    """Return whether at most one road comes within ``clear_m`` metres of a point (2,)."""
    return len(builder.roads_within(position[None], clear_m)) <= 1
