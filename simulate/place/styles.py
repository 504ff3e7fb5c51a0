"""Draw random styles of buildings: roofs, facades and colours."""

from __future__ import annotations

from simulate.place.builder import PlaceBuilder
from simulate.place.world import BuildingStyle, Facade, Rgb, Roof, Roofing

# Linear albedo of walls and roofs.
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

# Walls and roofs of chalets.
_TIMBER: tuple[Rgb, ...] = ((0.19, 0.10, 0.055), (0.12, 0.065, 0.04), (0.26, 0.16, 0.09))
_SHINGLES: tuple[Rgb, ...] = ((0.17, 0.15, 0.135), (0.12, 0.085, 0.07), (0.22, 0.21, 0.20))

_HOUSE_ROOFS: tuple[Roof, ...] = ("gable", "hip", "flat")
# Roofing of pitched roofs.
_PITCHED: tuple[Roofing, ...] = ("tile", "slate")
_HOUSES = (
    Facade.HOUSE_WHITE_FRAMES,
    Facade.HOUSE_GREEN_SHUTTERS,
    Facade.HOUSE_DARK_FRAMES,
    Facade.HOUSE_BROWN_SHUTTERS,
)
_SLABS = (Facade.SLAB_WHITE_FRAMES, Facade.SLAB_WOODEN_FRAMES)
_SHOPS = (Facade.SHOPS_PALE_STONE, Facade.SHOPS_DARK_STONE, Facade.SHOPS_WHITE_STONE)


def vary(builder: PlaceBuilder, rgb: Rgb) -> Rgb:
    """Return a colour made a little lighter or darker, and a little warmer or colder."""
    value = builder.rng.uniform(0.82, 1.15)
    warm = builder.rng.uniform(0.95, 1.05)
    return (rgb[0] * value * warm, rgb[1] * value, rgb[2] * value / warm)


def house_style(builder: PlaceBuilder, width: float, depth: float) -> BuildingStyle:
    """Draw the style of a house whose box is ``width`` x ``depth`` metres."""
    rng = builder.rng
    floors = 1 if builder.chance(0.3) else 2
    roof = _HOUSE_ROOFS[int(rng.choice(len(_HOUSE_ROOFS), p=[0.6, 0.28, 0.12]))]
    pitch = rng.uniform(0.55, 0.95)
    flat = roof == "flat"
    l_shaped = builder.chance(0.45) and min(width, depth) > 8.0
    main_depth, wing_width = (
        (rng.uniform(0.60, 0.72), rng.uniform(0.42, 0.6)) if l_shaped else (1.0, 1.0)
    )
    return BuildingStyle(
        floors=floors,
        roof=roof,
        roof_height_m=0.45 if flat else 0.5 * pitch * depth * main_depth + 0.5,
        overhang_m=0.05 if flat else 0.45,
        facade=_HOUSES[int(rng.integers(len(_HOUSES)))],
        roofing="flat" if flat else _PITCHED[int(rng.choice(len(_PITCHED), p=[0.65, 0.35]))],
        wall_rgb=vary(builder, builder.choose(WALLS)),
        roof_rgb=vary(builder, builder.choose(FLAT_ROOFS if flat else TILES)),
        main_depth_share=main_depth,
        wing_width_share=wing_width,
        detail=int(rng.integers(2**31)),
    )


def slab_style(builder: PlaceBuilder, floors: int) -> BuildingStyle:
    """Draw the style of a block of flats."""
    rng = builder.rng
    flat = builder.chance(0.65)
    return BuildingStyle(
        floors=floors,
        roof="flat" if flat else "hip",
        roof_height_m=2.3 if flat else 3.2,  # a flat roof carries a stair head
        overhang_m=0.05 if flat else 0.5,
        facade=_SLABS[int(rng.integers(len(_SLABS)))],
        roofing="flat" if flat else "tile",
        wall_rgb=vary(builder, builder.choose(WALLS)),
        roof_rgb=vary(builder, builder.choose(FLAT_ROOFS if flat else TILES)),
        main_depth_share=1.0,
        wing_width_share=1.0,
        detail=int(rng.integers(2**31)),
    )


def front_style(builder: PlaceBuilder, floors: int) -> BuildingStyle:
    """Draw the style of a building with shops below, which adjoins its neighbours."""
    gabled = builder.chance(0.5)
    return BuildingStyle(
        floors=floors,
        roof="gable" if gabled else "flat",
        roof_height_m=3.4 if gabled else 2.3,
        overhang_m=0.05,
        facade=_SHOPS[int(builder.rng.integers(len(_SHOPS)))],
        roofing=_PITCHED[int(builder.rng.choice(len(_PITCHED)))] if gabled else "flat",
        wall_rgb=vary(builder, builder.choose(WALLS)),
        roof_rgb=vary(builder, builder.choose(TILES if gabled else FLAT_ROOFS)),
        main_depth_share=1.0,
        wing_width_share=1.0,
        detail=int(builder.rng.integers(2**31)),
    )


def hall_style(builder: PlaceBuilder) -> BuildingStyle:
    """Draw the style of an industrial hall."""
    rng = builder.rng
    flat = builder.chance(0.45)
    return BuildingStyle(
        floors=2,
        roof="flat" if flat else "gable",
        roof_height_m=1.6 if flat else 2.2,
        overhang_m=0.1,
        facade=Facade.HALL_CLADDING,
        roofing="flat" if flat else "metal",
        wall_rgb=vary(builder, builder.choose(METAL_ROOFS + WALLS[:2])),
        roof_rgb=vary(builder, builder.choose(FLAT_ROOFS if flat else METAL_ROOFS)),
        main_depth_share=1.0,
        wing_width_share=1.0,
        detail=int(rng.integers(2**31)),
    )


def chalet_style(builder: PlaceBuilder, depth: float) -> BuildingStyle:
    """Draw the style of a chalet or hay barn: timber, and a low roof with a wide overhang."""
    rng = builder.rng
    return BuildingStyle(
        floors=2 if builder.chance(0.55) else 3,
        roof="gable",
        roof_height_m=0.5 * rng.uniform(0.32, 0.50) * depth + 0.5,
        overhang_m=0.11 * depth,
        facade=Facade.HOUSE_BROWN_SHUTTERS,
        roofing="metal" if builder.chance(0.2) else "slate",
        wall_rgb=vary(builder, builder.choose(_TIMBER)),
        roof_rgb=vary(builder, builder.choose(_SHINGLES)),
        main_depth_share=1.0,
        wing_width_share=1.0,
        detail=int(rng.integers(2**31)),
    )


def chapel_style(builder: PlaceBuilder, *, tower: bool) -> BuildingStyle:
    """Draw the style of a chapel, or of its tower. All chapels of a place have the same stone."""
    stone, slate = builder.once(_chapel_colours)
    return BuildingStyle(
        floors=2,
        roof="hip" if tower else "gable",
        roof_height_m=5.0 if tower else builder.rng.uniform(4.0, 5.5),
        overhang_m=0.05 if tower else 0.3,
        facade=Facade.HOUSE_DARK_FRAMES,
        roofing="slate",
        wall_rgb=stone,
        roof_rgb=slate,
        main_depth_share=1.0,
        wing_width_share=1.0,
        detail=int(builder.rng.integers(2**31)),
    )


def _chapel_colours(builder: PlaceBuilder) -> tuple[Rgb, Rgb]:
    return vary(builder, builder.choose(WALLS)), vary(builder, builder.choose(TILES))


def shed_style(builder: PlaceBuilder) -> BuildingStyle:
    """Draw the style of a shed or garage."""
    gabled = builder.chance(0.5)
    return BuildingStyle(
        floors=1,
        roof="gable" if gabled else "flat",
        roof_height_m=0.7 if gabled else 0.25,
        overhang_m=0.1 if gabled else 0.03,
        facade=Facade.SHED_BOARDS,
        roofing="tile" if gabled else "flat",
        wall_rgb=vary(builder, builder.choose(WALLS)),
        roof_rgb=vary(builder, builder.choose(TILES if gabled else FLAT_ROOFS)),
        main_depth_share=1.0,
        wing_width_share=1.0,
        detail=int(builder.rng.integers(2**31)),
    )
