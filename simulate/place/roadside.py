"""What stands and moves along roads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulate.place.site import PAVEMENT_M, Footing, Site, Thing
from simulate.place.things import LAMP_M, car, small, tree, truck
from simulate.place.world import polyline_length, polyline_points

Array = NDArray[np.float64]


def street_lamps(site: Site) -> None:
    """Lamps along every road, their arms over the kerb."""
    for road in site.roads:
        side = site.choose((1.0, -1.0))
        for s in np.arange(site.rng.uniform(5, 20), polyline_length(road.line), 27.0):
            (p,), (along,) = polyline_points(road.line, s)
            across = side * np.array([-along[1], along[0]])
            yaw = float(np.arctan2(-across[1], -across[0]))
            at = p + (0.5 * road.width_m + 0.2) * across
            if off_junction(site, at, 1.5):
                lamp = Thing("lamp", "lamp", LAMP_M, (0.25, 0.26, 0.27))
                site.place(lamp, at, yaw, Footing(on_road=True))


def avenues(site: Site) -> None:
    """Trees along both sides of every road, behind its pavements, wherever there is room."""
    for road in site.roads:
        for side in (1.0, -1.0):
            for s in np.arange(site.rng.uniform(3, 9), polyline_length(road.line), 9.0):
                (p,), (along,) = polyline_points(road.line, s)
                out = 0.5 * road.width_m + PAVEMENT_M + 2.6
                at = p + side * out * np.array([-along[1], along[0]])
                tree(site, at, site.rng.uniform(1.5, 2.3), conifers=0.0)


def street_furniture(site: Site) -> None:
    """Bins, hydrants, signs and bollards by turns on the pavements."""
    kinds = ("sign", "bin", "hydrant", "bollard")
    placed = 0
    for road in site.roads:
        length = polyline_length(road.line)
        for s in np.arange(site.rng.uniform(5, 20), length, 22.0):
            (p,), (along,) = polyline_points(road.line, s)
            side = site.choose((1.0, -1.0))
            at = p + side * (0.5 * road.width_m + 1.2) * np.array([-along[1], along[0]])
            # Signs face those who drive towards them on their right.
            yaw = float(np.arctan2(side * along[1], side * along[0]))
            if off_junction(site, at, 6.0):
                kind = kinds[placed % len(kinds)]
                placed += small(site, kind, at, yaw, Footing(on_road=True))


def traffic(site: Site, parked: float = 0.28) -> None:
    """Vehicles driving on the right of every road, and on a share `parked` of the places along
    the side streets."""
    rng = site.rng
    for road in site.roads:
        length = polyline_length(road.line)
        for direction in (1.0, -1.0):
            s = rng.uniform(0, 40)
            while s < length:
                (p,), (along,) = polyline_points(road.line, s)
                along = direction * along
                right = np.array([along[1], -along[0]])
                at = p + (0.25 * road.width_m + rng.normal(0, 0.1)) * right
                yaw = float(np.arctan2(along[1], along[0]))
                if off_junction(site, at, 6.0):
                    if site.chance(0.85):
                        car(site, at, yaw, gap_m=0.5)
                    else:
                        truck(site, at, yaw, on_road=True)
                s += rng.uniform(14, 75)
        if road.main:
            continue
        side = site.choose((1.0, -1.0))
        for s in np.arange(6.0, length, 6.4):
            (p,), (along,) = polyline_points(road.line, s)
            at = p + side * (0.5 * road.width_m - 1.1) * np.array([-along[1], along[0]])
            if site.chance(parked) and off_junction(site, at, 9.0):
                car(
                    site,
                    at,
                    float(np.arctan2(along[1], along[0])) + site.choose((0.0, np.pi)),
                    gap_m=0.5,
                )


def deliveries(site: Site) -> None:
    """Lorries standing at the kerb."""
    for road in site.roads:
        for s in np.arange(site.rng.uniform(10, 40), polyline_length(road.line), 30.0):
            (p,), (along,) = polyline_points(road.line, s)
            at = p + (0.5 * road.width_m - 1.5) * np.array([along[1], -along[0]])
            yaw = float(np.arctan2(along[1], along[0]))
            if site.chance(0.3) and off_junction(site, at, 8.0):
                truck(site, at, yaw, shapes=("lorry",), on_road=True)


def off_junction(site: Site, at: Array, clear_m: float) -> bool:
    """Whether only one road comes within `clear_m` of `at` (2,)."""
    return len(site.roads_within(at[None], clear_m)) <= 1
