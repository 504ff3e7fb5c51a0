"""Write the world of a real site to a file, and read it in rendering processes."""

from __future__ import annotations

from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.storage.atomic import atomic_write
from simulate.place.world import Ground, Heightfield, Imagery, World

_NEUTRAL_TONE: Final = 128  # ``Ground.tone`` distinguishes regions, and sites have none


def make_ground(labels: NDArray[np.uint8], texel_m: float) -> Ground:
    """Return the ground cover of a site from its labels (n, n) uint8."""
    tone = np.broadcast_to(np.uint8(_NEUTRAL_TONE), labels.shape)
    return Ground(texel_m, labels, tone, ())


def save_site(path: Path, world: World) -> None:
    """Write the world of a site atomically.

    Raises:
        WriteError: The file cannot be written.
    """
    assert world.imagery is not None and world.bare_ground is not None
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as partial, partial.open("wb") as file:
        np.savez_compressed(
            file,
            area_m=world.side_m,
            margin_m=world.margin_m,
            level_m=world.level_m,
            spacing_m=world.terrain.spacing_m,
            surface=world.terrain.nodes.astype(np.float32),
            bare=world.bare_ground.nodes.astype(np.float32),
            texel_m=world.ground.texel_m,
            labels=world.ground.labels,
            albedo=world.imagery.albedo,
            snow=world.imagery.snow,
            season=world.imagery.season,
        )


def load_site(path: Path, seed: int) -> World:
    """Read the world of a site. The seed determines the variation of snow and puddles.

    Raises:
        InputError: The file is missing or damaged.
    """
    try:
        with np.load(path) as file:
            spacing_m = float(file["spacing_m"])
            return World(
                seed=seed,
                side_m=float(file["area_m"]),
                terrain=Heightfield(file["surface"].astype(float), spacing_m),
                roads=(),
                ground=make_ground(file["labels"], float(file["texel_m"])),
                objects=(),
                imagery=Imagery(file["albedo"], file["snow"], str(file["season"])),
                bare_ground=Heightfield(file["bare"].astype(float), spacing_m),
                margin_m=float(file["margin_m"]),
                level_m=float(file["level_m"]),
            )
    except (OSError, KeyError, ValueError, EOFError, BadZipFile) as error:
        raise InputError(
            f"site file {path} is missing or damaged ({error}): remove the scene and simulate it "
            "again"
        ) from None
