"""What buildings of each kind wear: roofs, facades and colours drawn for one building."""

from __future__ import annotations

from simulate.place.site import Site
from simulate.place.world import BuildingStyle, Rgb

# Linear albedo.
WALLS: tuple[Rgb, ...] = (
    (0.58, 0.56, 0.51),
    (0.52, 0.46, 0.35),
    (0.28, 0.125, 0.085),
    (0.40, 0.39, 0.38),
    (0.50, 0.38, 0.24),
    (0.34, 0.21, 0.145),
    (0.48, 0.50, 0.50),
)
TILES: tuple[Rgb, ...] = (
    (0.235, 0.105, 0.070),
    (0.19, 0.088, 0.062),
    (0.150, 0.090, 0.070),
    (0.095, 0.090, 0.092),
    (0.066, 0.068, 0.074),
    (0.20, 0.135, 0.10),
)
FLAT_ROOFS: tuple[Rgb, ...] = ((0.28, 0.27, 0.26), (0.16, 0.16, 0.17), (0.34, 0.32, 0.29))
METAL_ROOFS: tuple[Rgb, ...] = (
    (0.34, 0.36, 0.38),
    (0.22, 0.27, 0.31),
    (0.31, 0.20, 0.16),
    (0.20, 0.26, 0.21),
)


def vary(site: Site, rgb: Rgb) -> Rgb:
    """The colour, a little lighter or darker and a little warmer or colder."""
    value = site.rng.uniform(0.82, 1.15)
    warm = site.rng.uniform(0.95, 1.05)
    return (rgb[0] * value * warm, rgb[1] * value, rgb[2] * value / warm)


def house_style(site: Site, front: float, back: float) -> BuildingStyle:
    rng = site.rng
    floors = 1 if site.chance(0.3) else 2
    roof = str(rng.choice(["gable", "hip", "flat"], p=[0.6, 0.28, 0.12]))
    pitch = rng.uniform(0.55, 0.95)
    flat = roof == "flat"
    l_shaped = site.chance(0.45) and min(front, back) > 8.0
    main = (rng.uniform(0.60, 0.72), rng.uniform(0.42, 0.6)) if l_shaped else (1.0, 1.0)
    return BuildingStyle(
        floors=floors,
        roof=roof,
        roof_height_m=0.45 if flat else 0.5 * pitch * back * main[0] + 0.5,
        eaves_m=0.05 if flat else 0.45,
        facade=int(rng.integers(4)),
        roofing="flat" if flat else str(rng.choice(["tile", "slate"], p=[0.65, 0.35])),
        wall_rgb=vary(site, site.choose(WALLS)),
        roof_rgb=vary(site, site.choose(FLAT_ROOFS if flat else TILES)),
        wing=main,
        detail=int(rng.integers(2**31)),
    )


def slab_style(site: Site, floors: int) -> BuildingStyle:
    rng = site.rng
    flat = site.chance(0.65)
    return BuildingStyle(
        floors=floors,
        roof="flat" if flat else "hip",
        roof_height_m=2.3 if flat else 3.2,  # a flat roof carries a stair head
        eaves_m=0.05 if flat else 0.5,
        facade=4 + int(rng.integers(2)),
        roofing="flat" if flat else "tile",
        wall_rgb=vary(site, site.choose(WALLS)),
        roof_rgb=vary(site, site.choose(FLAT_ROOFS if flat else TILES)),
        wing=(1.0, 1.0),
        detail=int(rng.integers(2**31)),
    )


def front_style(site: Site, floors: int) -> BuildingStyle:
    """Of a building wall to wall with its neighbours, shops on its ground floor."""
    gabled = site.chance(0.5)
    return BuildingStyle(
        floors=floors,
        roof="gable" if gabled else "flat",
        roof_height_m=3.4 if gabled else 2.3,
        eaves_m=0.05,
        facade=8 + int(site.rng.integers(3)),
        roofing=str(site.rng.choice(["tile", "slate"])) if gabled else "flat",
        wall_rgb=vary(site, site.choose(WALLS)),
        roof_rgb=vary(site, site.choose(TILES if gabled else FLAT_ROOFS)),
        wing=(1.0, 1.0),
        detail=int(site.rng.integers(2**31)),
    )


def hall_style(site: Site) -> BuildingStyle:
    rng = site.rng
    flat = site.chance(0.45)
    return BuildingStyle(
        floors=2,
        roof="flat" if flat else "gable",
        roof_height_m=1.6 if flat else 2.2,
        eaves_m=0.1,
        facade=6,
        roofing="flat" if flat else "metal",
        wall_rgb=vary(site, site.choose(METAL_ROOFS + WALLS[:2])),
        roof_rgb=vary(site, site.choose(FLAT_ROOFS if flat else METAL_ROOFS)),
        wing=(1.0, 1.0),
        detail=int(rng.integers(2**31)),
    )


def shed_style(site: Site) -> BuildingStyle:
    gabled = site.chance(0.5)
    return BuildingStyle(
        floors=1,
        roof="gable" if gabled else "flat",
        roof_height_m=0.7 if gabled else 0.25,
        eaves_m=0.1 if gabled else 0.03,
        facade=7,
        roofing="tile" if gabled else "flat",
        wall_rgb=vary(site, site.choose(WALLS)),
        roof_rgb=vary(site, site.choose(TILES if gabled else FLAT_ROOFS)),
        wing=(1.0, 1.0),
        detail=int(site.rng.integers(2**31)),
    )
