"""Random legal GeoTIFFs with a known truth: what is read is the truth, unknown or an error.

Heights and colours are stored in any unit, scale, type, order, palette and mask that GeoTIFF and
GDAL know. The truth is kept beside, from numbers of the test's own.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.random import Generator
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.transform import from_origin

from objconnect.scene.errors import InputError
from objconnect.scene.geo.rasters import Kind, Raster

FILES = 350
SHAPE = (24, 32)
_UNITS = {
    None: 1.0, "metre": 1.0, "m": 1.0, "foot": 0.3048, "ft": 0.3048, "US survey foot": 1200 / 3937,
    "yard": 0.9144, "cm": 0.01, "fathom": 1.8288, "link": 0.201168, "cubit": 0.4572,
}  # fmt: skip
_SYSTEMS = {
    "EPSG:32632": True, "EPSG:2056": True, "EPSG:3857": True, "EPSG:25832": True, "EPSG:2180": True,
    "EPSG:4326": False, "EPSG:2263": False, "EPSG:25832+5783": False, "EPSG:7415": False,
    "EPSG:6339+6360": False, "EPSG:25832+5831": False, "EPSG:32632+5773": False,
}  # fmt: skip
_NAMES = "ColorInterp|unit|scale|type|bands|palette|heights|height|system|colours|no data"


@dataclass
class Made:
    """A file and the truth: (channels, H, W), NaN where there is no data."""

    kind: Kind
    stored: NDArray[Any]
    truth: NDArray[np.float64]
    profile: dict[str, Any] = field(default_factory=dict)
    names: list[str] | None = None
    describe: bool = False
    unit: str | None = None
    scale: tuple[float, float] = (1.0, 0.0)
    table: dict[int, tuple[int, ...]] | None = None
    mask: NDArray[np.uint8] | None = None
    tolerance: float = 1e-3

    def write(self, path: Path) -> None:
        """Write the file with rasterio."""
        bands, height, width = self.stored.shape
        left, top = (1e6, 6e6) if "3857" in str(self.profile["crs"]) else (5e5, 5.2e6)
        if self.profile["crs"] == "EPSG:4326":
            left, top = 8.0, 47.0
        size = {"count": bands, "height": height, "width": width, "dtype": self.stored.dtype}
        place = {"transform": from_origin(left, top, 0.5, 0.5), "driver": "GTiff"}
        with rasterio.open(path, "w", **size | place | self.profile) as file:
            if self.names and not self.describe:
                file.colorinterp = [ColorInterp[name] for name in self.names]
            if self.names and self.describe:
                file.descriptions = self.names
            if self.unit:
                file.units = [self.unit] * bands
            if self.scale != (1.0, 0.0):
                file.scales, file.offsets = [self.scale[0]] * bands, [self.scale[1]] * bands
            if self.table:
                file.write_colormap(1, self.table)
            file.write(self.stored)
            if self.mask is not None:
                file.write_mask(self.mask)


def surface_model(rng: Generator) -> Made:
    ground = rng.uniform(20, 3000) + 15 * rng.random((1, *SHAPE))
    unit = [*_UNITS][rng.integers(len(_UNITS))]
    dtype = str(rng.choice(["float32", "float64", "int32", "int16"]))
    scale = (float(rng.choice([1.0, 0.1, 0.5])), float(rng.choice([0.0, 100.0])))
    step = scale[0] * _UNITS[unit]
    stored = (ground / _UNITS[unit] - scale[1]) / scale[0]
    if np.dtype(dtype).kind == "i":
        stored = np.rint(stored)
        if abs(stored).max() > np.iinfo(dtype).max:
            dtype = "int32"
    stored = stored.astype(dtype)
    truth = (stored.astype(float) * scale[0] + scale[1]) * _UNITS[unit]
    made = Made("surface model", stored, truth, unit=unit, scale=scale)
    made.tolerance = 1e-3 * max(1.0, step) + 1e-6 * float(abs(truth).max())
    holes = rng.random()
    if holes < 0.6:
        where = (slice(None), slice(0, 5), slice(None))
        number = float(rng.choice([-9999, -32767, -999, 0]))
        made.stored[where], truth[where] = number, np.nan
        if scale != (1.0, 0.0) or _UNITS[unit] < 0.1 or holes < 0.3:
            made.profile["nodata"] = number
    elif holes < 0.7:
        made.mask = np.where(np.arange(SHAPE[0])[:, None] < 3, 0, 255).astype(np.uint8)
        made.mask = np.broadcast_to(made.mask, SHAPE).copy()
        truth[:, :3] = np.nan
    return made


def orthophoto(rng: Generator) -> Made:
    rgb = rng.integers(1, 255, (3, *SHAPE)).astype(np.uint8)
    truth = rgb.astype(float)
    names = ["red", "green", "blue"]
    extra = [[], ["undefined"], ["nir"], ["alpha"], ["nir", "alpha"]][rng.integers(5)]
    order = list(rng.permutation([*names, *extra]))
    alpha = np.full(SHAPE, 255, np.uint8)
    alpha[: 4 * rng.integers(2)] = 0
    noise = rng.integers(0, 255, SHAPE).astype(np.uint8)
    bands = {**dict(zip(names, rgb, strict=True)), "alpha": alpha}
    made = Made("orthophoto", np.stack([bands.get(n, noise) for n in order]), truth, names=order)
    if "alpha" in order:
        truth[:, alpha == 0] = np.nan
    elif rng.random() < 0.5:
        made.profile["nodata"] = 0
        for k, name in enumerate(order):
            if name == "red":
                made.stored[k, 9:12] = 0
            if name in names:
                made.stored[k, 2:5] = 0
        truth[0, 9:12], truth[:, 2:5] = 0, np.nan
    elif rng.random() < 0.3:
        made.mask = np.broadcast_to(noise // 128 * 255, SHAPE).astype(np.uint8)
        truth[:, made.mask == 0] = np.nan
    silent = rng.random()
    if silent < 0.15:
        made.names = None
    elif silent < 0.4 and "alpha" not in order:
        made.describe = True
    if silent < 0.4:
        made.profile["photometric"] = "minisblack"
    return made


def one_band(rng: Generator) -> Made:
    if rng.random() < 0.3:
        grey = rng.integers(0, 255, (1, *SHAPE)).astype(np.uint8)
        white = bool(rng.integers(2))
        made = Made("orthophoto", grey, (255.0 - grey) if white else grey.astype(float))
        made.profile["photometric"] = "miniswhite" if white else "minisblack"
        return made
    bits = int(rng.choice([1, 2, 4, 8, 16]))
    count = min(2**bits, 700)
    colours = rng.integers(0, 256, (count, 3))
    numbers = rng.integers(0, count, (1, *SHAPE)).astype(np.uint16 if bits == 16 else np.uint8)
    truth = np.moveaxis(colours[numbers[0]], -1, 0).astype(float)
    made = Made("orthophoto", numbers, truth)
    made.table = {k: (*map(int, colours[k]), 255) for k in range(count)}
    if bits < 8:
        made.profile["nbits"] = bits
    if rng.random() < 0.4:
        made.profile["nodata"] = 1
        truth[:, numbers[0] == 1] = np.nan
    return made


def other_colours(rng: Generator) -> Made:
    """Colours that are not read: only an error is right."""
    space = str(rng.choice(["cmyk", "cielab", "uint16", "two alphas"]))
    values = rng.integers(1, 255, (4 if space == "cmyk" else 3, *SHAPE)).astype(np.uint8)
    made = Made("orthophoto", values, np.full((3, *SHAPE), np.inf))
    if space == "uint16":
        made.stored = values.astype(np.uint16)
    elif space == "two alphas":
        made.names = ["red", "red", "blue"]
    else:
        made.profile["photometric"] = space
    return made


MAKERS = (surface_model, surface_model, orthophoto, orthophoto, one_band, other_colours)


@pytest.mark.parametrize(
    "part", [0, *(pytest.param(part, marks=pytest.mark.thorough) for part in (1, 2))]
)
def test_the_truth_or_unknown_or_an_error(tmp_path: Path, part: int) -> None:
    outcomes: Counter[str] = Counter()
    for seed in range(part * FILES // 3, (part + 1) * FILES // 3):
        rng = np.random.default_rng([55, seed])
        made = MAKERS[rng.integers(len(MAKERS))](rng)
        systems = [*_SYSTEMS] if rng.random() < 0.3 else [s for s, good in _SYSTEMS.items() if good]
        made.profile["crs"] = str(rng.choice(systems))
        path = tmp_path / f"{seed}.tif"
        made.write(path)
        outcomes[outcome(path, made, seed)] += 1
    # Most files are read; some are refused, and each refusal names what is unknown.
    assert outcomes["truth"] > 40 and outcomes["error"] > 10, outcomes


def outcome(path: Path, made: Made, seed: int) -> str:
    """How a file was read; any other value than the truth fails."""
    try:
        raster = Raster.open(path, made.kind)
        read = raster.patch(raster.grid.box).values
    except InputError as error:
        said = str(error).replace(str(path), "")
        assert "\n" not in said and any(name in said for name in _NAMES.split("|")), (seed, said)
        return "error"
    truth = np.broadcast_to(made.truth, (max(len(read), len(made.truth)), *SHAPE))
    known = np.isfinite(read)
    assert not known[:, np.isnan(truth[0])].any(), (seed, "no data was read as a value")
    off = np.abs(read - truth)[known]
    assert (off <= made.tolerance).all(), (seed, made.unit, made.scale, float(off.max()))
    assert known.mean() > 0.5 * np.isfinite(truth).mean(), (seed, "most of it is unknown")
    return "truth"
