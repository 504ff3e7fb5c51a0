"""Draw images of walls and roofs with numpy.

Each image is (rows, columns, 4) uint8 with row 0 at the bottom. The first three channels are an
sRGB colour. Alpha is the share of the polygon's tint: at 255 the tint multiplies the colour, as for
walls and tiles; at 0 the colour does not change, as for windows.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from simulate.place.world import Facade, Rgb

Image = NDArray[np.uint8]
Float = NDArray[np.float32]

BAY_M, FLOOR_M = 3.0, 2.8  # size of one cell of a facade, which holds one window
BAYS, FLOORS = 12, 6  # number of cells in one facade image
ROOF_TILE_M = 12.8  # side of one roof image
ROOFINGS = ("tile", "slate", "metal", "flat")

_TEXEL_M = 0.05  # side of a pixel of the images


# Linear colours of window frames of houses and blocks of flats.
_FRAMES: dict[Facade, Rgb] = {
    Facade.HOUSE_WHITE_FRAMES: (0.85, 0.85, 0.83),
    Facade.HOUSE_GREEN_SHUTTERS: (0.30, 0.20, 0.13),
    Facade.HOUSE_DARK_FRAMES: (0.20, 0.21, 0.22),
    Facade.HOUSE_BROWN_SHUTTERS: (0.80, 0.78, 0.72),
    Facade.SLAB_WHITE_FRAMES: (0.85, 0.85, 0.83),
    Facade.SLAB_WOODEN_FRAMES: (0.30, 0.20, 0.13),
}
_SHUTTERS: dict[Facade, Rgb] = {
    Facade.HOUSE_GREEN_SHUTTERS: (0.12, 0.22, 0.16),
    Facade.HOUSE_BROWN_SHUTTERS: (0.25, 0.13, 0.09),
}
# Facades of blocks of flats.
_SLABS = (Facade.SLAB_WHITE_FRAMES, Facade.SLAB_WOODEN_FRAMES)


class _Shops(NamedTuple):
    """A town house with shops: linear colours of frames and stone, and the width of windows (m)."""

    frame: Rgb
    stone: Rgb
    window_m: float


_SHOPS: dict[Facade, _Shops] = {
    Facade.SHOPS_PALE_STONE: _Shops((0.82, 0.81, 0.78), (0.42, 0.40, 0.36), 1.1),
    Facade.SHOPS_DARK_STONE: _Shops((0.25, 0.17, 0.11), (0.24, 0.20, 0.18), 1.5),
    Facade.SHOPS_WHITE_STONE: _Shops((0.16, 0.17, 0.18), (0.52, 0.50, 0.46), 1.9),
}


def facade_material(facade: Facade) -> str:
    """Return the name of the material that shows a facade."""
    return f"facade_{facade.value}"


def facade(style: Facade) -> Image:
    """Draw the image of a facade: BAYS x FLOORS cells, with doors in the bottom row."""
    return _draw_facade(style).image()


def panes(style: Facade) -> Image:
    """Draw the share of a room's light that passes through each pixel of a facade, as a grey level.

    Its pixels are aligned with the image of ``facade``. Curtains and blinds dim the light.
    """
    light_share = _draw_facade(style).light_share
    return _encode(np.dstack([light_share] * 3), np.zeros_like(light_share))


def _draw_facade(style: Facade) -> _Canvas:
    rng = np.random.default_rng([77, style.value])
    canvas = _Canvas(BAYS * BAY_M, FLOORS * FLOOR_M)
    canvas.weather(rng)
    if style is Facade.SHED_BOARDS:
        _boards(canvas, rng)
    elif style is Facade.HALL_CLADDING:
        _cladding(canvas, rng)
    elif style in _SHOPS:
        _shop_fronts(canvas, _SHOPS[style], rng)
    else:
        _dwellings(canvas, style, rng)
    return canvas


def _dwellings(canvas: _Canvas, style: Facade, rng: np.random.Generator) -> None:
    """Draw the wall of a house or of a block of flats."""
    slab, frame, shutters = style in _SLABS, _FRAMES[style], _SHUTTERS.get(style)
    canvas.rect(0, 0, BAYS * BAY_M, 0.45, (0.45, 0.44, 0.42), tinted=0.4)  # plinth
    for floor in range(FLOORS):
        z = floor * FLOOR_M
        if slab and floor > 0:
            canvas.rect(0, z - 0.12, BAYS * BAY_M, z + 0.06, (0.7, 0.7, 0.7), tinted=0.6)
        for bay in range(BAYS):
            x = bay * BAY_M
            random_value = rng.random()
            if floor == 0 and bay % (4 if slab else 6) == 1:
                _door(canvas, x, rng)
            elif floor == 0 and not slab and bay % 6 == 4:
                _window(canvas, (x + 0.4, z + 0.15), (2.2, 2.1), frame, rng)  # onto the terrace
            elif slab and (bay % 3 == 1 or random_value < 0.1):
                _balcony(canvas, x, z, frame, rng)
            elif random_value < 0.13:
                continue  # blank wall
            elif random_value < 0.28:
                _window(canvas, (x + 1.1, z + 1.2), (0.8, 1.0), frame, rng)
            else:
                width = 1.8 if random_value > 0.72 else 1.3
                left = x + 0.5 * (BAY_M - width) + rng.normal(0, 0.08)
                _window(canvas, (left, z + 0.95), (width, 1.35), frame, rng)
                if shutters is not None and random_value < 0.6:
                    for side in (left - 0.42, left + width + 0.04):
                        canvas.rect(side, z + 0.92, side + 0.38, z + 2.33, shutters)


def roof(kind: str) -> Image:
    """Draw a periodic image of a roof, ROOF_TILE_M a side; v runs up the slope.

    ``kind`` is one of ROOFINGS.
    """
    rng = np.random.default_rng([78, ROOFINGS.index(kind)])
    n = round(ROOF_TILE_M / _TEXEL_M)
    v, u = np.mgrid[:n, :n].astype(np.float32) * np.float32(_TEXEL_M)
    value = 0.74 + 0.09 * _periodic(rng, n, 2.0) + 0.07 * _periodic(rng, n, 0.5)
    colour = np.ones((n, n, 3), np.float32)
    if kind in ("tile", "slate"):
        course, width = (0.40, 0.32) if kind == "tile" else (0.2667, 0.40)
        row = np.floor(v / course).astype(int)
        column = np.floor(u / width + 0.5 * (row % 2)).astype(int) % round(ROOF_TILE_M / width)
        tile_shade = rng.normal(0, 0.10, (row.max() + 1, column.max() + 1)).astype(np.float32)
        value += tile_shade[row, column]
        value *= np.where((v / course) % 1 < 0.2, 0.72, 1.0)  # the shadow under each course
        moss = np.clip(_periodic(rng, n, 1.3) + 0.5 * _periodic(rng, n, 0.3) - 0.75, 0, 1)
        colour -= 0.8 * moss[..., None] * np.array([0.55, 0.15, 0.6], np.float32)
        # Streaks down the slope are noise that is blurred along v.
        value += 0.06 * cv2.blur(_periodic(rng, n, 0.25), (1, 61))
    elif kind == "metal":
        value += 0.06 * np.cos(2 * np.pi * u / 0.4)
        sheet = np.floor(u / 1.6).astype(int)
        value += rng.normal(0, 0.06, sheet.max() + 1).astype(np.float32)[sheet]
        value *= np.where((v % 6.4) < 0.12, 0.7, 1.0)
        skylight = (sheet % 4 == 2) & (v % 6.4 > 2.0) & (v % 6.4 < 4.6)
        value = np.where(skylight, 1.25, value)
        rust = np.clip(_periodic(rng, n, 0.8) - 0.9, 0, 1)
        colour -= rust[..., None] * np.array([0.1, 0.45, 0.6], np.float32)
    else:
        value += 0.10 * _periodic(rng, n, 4.0) + 0.05 * _periodic(rng, n, 0.12)
        value *= np.where((u % 3.2) < 0.1, 0.78, 1.0) * np.where((v % 6.4) < 0.1, 0.8, 1.0)
        value = np.ascontiguousarray(value, np.float32)
        for _ in range(14):  # repairs, puddle marks
            at = tuple(int(c) for c in rng.integers(30, n - 30, 2))
            axes = tuple(int(c) for c in rng.integers(6, 28, 2))
            level = float(rng.uniform(0.55, 1.05))
            if rng.random() < 0.5:
                cv2.ellipse(value, at, axes, float(rng.uniform(0, 180)), 0, 360, level, -1)
            else:
                corner = (at[0] + axes[0], at[1] + axes[1])
                cv2.rectangle(value, at, corner, level, -1)
        value = cv2.GaussianBlur(value, (0, 0), 0.8)
    rgb = np.clip(colour * value[..., None], 0, 1)
    return _encode(rgb, np.ones((n, n), np.float32))


class _Canvas:
    """The image of a wall while it is drawn. Coordinates are metres from its lower left corner."""

    def __init__(self, width_m: float, height_m: float) -> None:
        rows, columns = round(height_m / _TEXEL_M), round(width_m / _TEXEL_M)
        self.rgb = np.full((rows, columns, 3), 0.88, np.float32)
        self.tinted = np.ones((rows, columns), np.float32)
        self.light_share = np.zeros((rows, columns), np.float32)

    def rect(
        self,
        x0: float,
        z0: float,
        x1: float,
        z1: float,
        rgb: Rgb,
        tinted: float = 0.0,
    ) -> None:
        """Fill a rectangle with a linear colour.

        The polygon's tint multiplies it by the share ``tinted``, 0 to 1.
        """
        c0, r0, c1, r1 = (max(0, round(v / _TEXEL_M)) for v in (x0, z0, x1, z1))
        self.rgb[r0:r1, c0:c1] = rgb
        self.tinted[r0:r1, c0:c1] = tinted
        self.light_share[r0:r1, c0:c1] = 0.0

    def glaze(
        self, x0: float, z0: float, x1: float, z1: float, rgb: Rgb, light_share: float
    ) -> None:
        """Fill a rectangle that lets out a share, 0 to 1, of the light of a room."""
        self.rect(x0, z0, x1, z1, rgb)
        c0, r0, c1, r1 = (max(0, round(v / _TEXEL_M)) for v in (x0, z0, x1, z1))
        self.light_share[r0:r1, c0:c1] = light_share

    def weather(self, rng: np.random.Generator) -> None:
        """Add blotches and streaks that run down."""
        rows, columns = self.tinted.shape
        for scale, strength, stretch in ((0.6, 0.06, 1), (0.15, 0.05, 1), (0.1, 0.12, 90)):
            noise = rng.standard_normal((rows, columns), np.float32)
            sigma = scale / _TEXEL_M
            noise = cv2.GaussianBlur(noise, (0, 0), sigma) * np.float32(2 * sigma)
            if stretch > 1:
                noise = cv2.blur(noise, (1, stretch))
            self.rgb *= 1 + strength * noise[..., None]

    def image(self) -> Image:
        """Return the image drawn so far."""
        return _encode(np.clip(self.rgb, 0, 1), self.tinted)


def _glass(shade: float) -> Rgb:
    return (0.10 * shade, 0.13 * shade, 0.16 * shade)


def _window(
    canvas: _Canvas,
    corner: tuple[float, float],
    size: tuple[float, float],
    frame: Rgb,
    rng: np.random.Generator,
) -> None:
    """Draw a window by its lower left corner and its width and height, metres."""
    (x, z), (width, height) = corner, size
    canvas.rect(x - 0.06, z - 0.12, x + width + 0.06, z, (0.5, 0.5, 0.48), tinted=0.3)  # sill
    canvas.rect(x, z, x + width, z + height, frame)
    pane_count = 2 if width > 1.0 else 1
    pane_width = width / pane_count
    has_blind = rng.random() < 0.3
    for i in range(pane_count):
        shade = float(rng.uniform(0.5, 1.6))
        left = x + i * pane_width + 0.06
        right = left + pane_width - 0.12
        canvas.glaze(left, z + 0.06, right, z + height - 0.06, _glass(shade), 1.0)
        if has_blind:  # blind or curtain
            top = z + height - 0.06
            low = top - rng.uniform(0.2, 0.9) * (height - 0.12)
            canvas.glaze(left, low, right, top, (0.55, 0.53, 0.48), 0.4)


def _door(canvas: _Canvas, x: float, rng: np.random.Generator) -> None:
    colour = [(0.20, 0.05, 0.04), (0.05, 0.10, 0.17), (0.16, 0.09, 0.05), (0.5, 0.5, 0.48)]
    canvas.rect(x + 0.75, 0, x + 2.05, 2.35, (0.7, 0.7, 0.68))
    canvas.rect(x + 0.9, 0, x + 1.9, 2.2, colour[int(rng.integers(4))])
    canvas.glaze(x + 1.15, 1.3, x + 1.65, 2.0, _glass(1.0), 0.6)


def _balcony(
    canvas: _Canvas,
    x: float,
    z: float,
    frame: Rgb,
    rng: np.random.Generator,
) -> None:
    canvas.rect(x + 0.1, z + 0.1, x + BAY_M - 0.1, z + 2.55, (0.16, 0.16, 0.16), tinted=0.3)
    _window(canvas, (x + 0.6, z + 0.3), (1.8, 2.0), frame, rng)
    panel = [(0.5, 0.5, 0.5), (0.30, 0.33, 0.36), (0.45, 0.30, 0.2)][int(rng.integers(3))]
    canvas.rect(x + 0.1, z + 0.1, x + BAY_M - 0.1, z + 1.05, panel)
    canvas.rect(x + 0.1, z + 0.98, x + BAY_M - 0.1, z + 1.05, (0.75, 0.75, 0.75))


def _shop_fronts(canvas: _Canvas, shops: _Shops, rng: np.random.Generator) -> None:
    """Draw a town house: shop windows, doors and signs below, a high window in every bay above."""
    width = BAYS * BAY_M
    frame, stone, window_m = shops
    canvas.rect(0, 0, width, FLOOR_M, stone, tinted=0.35)
    for bay in range(BAYS):
        x = bay * BAY_M
        if bay % 4 == 1:
            _door(canvas, x, rng)
        else:
            colour = tuple(rng.uniform(0.05, 0.45, 3).tolist())
            canvas.rect(x + 0.15, 0.45, x + BAY_M - 0.15, 2.2, frame)
            for left in (x + 0.22, x + 0.5 * BAY_M + 0.03):
                pane_width = 0.5 * BAY_M - 0.25
                glass = _glass(float(rng.uniform(0.4, 1.2)))
                canvas.glaze(left, 0.52, left + pane_width, 2.12, glass, 1.0)
                for _ in range(3):  # goods in the window
                    a, h = rng.uniform(0, pane_width - 0.3), rng.uniform(0.2, 0.9)
                    goods = tuple(rng.uniform(0.05, 0.5, 3).tolist())
                    canvas.glaze(left + a, 0.52, left + a + 0.3, 0.52 + h, goods, 0.3)
            canvas.rect(x + 0.1, 2.25, x + BAY_M - 0.1, 2.65, colour)
            for k in range(int(rng.integers(3, 8))):  # letters of the sign
                at = x + 0.4 + 0.27 * k
                canvas.rect(at, 2.34, at + 0.16, 2.56, (0.75, 0.74, 0.70))
    canvas.rect(0, FLOOR_M - 0.08, width, FLOOR_M + 0.12, (0.62, 0.61, 0.58), tinted=0.5)
    for floor in range(1, FLOORS):
        z = floor * FLOOR_M
        canvas.rect(0, z - 0.05, width, z + 0.05, (0.66, 0.65, 0.62), tinted=0.7)
        for bay in range(BAYS):
            wide = window_m if bay % 3 else 1.1
            left = bay * BAY_M + 0.5 * (BAY_M - wide)
            canvas.rect(left - 0.16, z + 0.5, left + wide + 0.16, z + 2.6, stone, tinted=0.6)
            _window(canvas, (left, z + 0.62), (wide, 1.8), frame, rng)
            if rng.random() < 0.12:  # flowers on the sill
                canvas.rect(left, z + 0.5, left + wide, z + 0.8, (0.10, 0.16, 0.05))


def _boards(canvas: _Canvas, rng: np.random.Generator) -> None:
    """Draw the wall of a shed: boards, and a door or garage door in every second bay."""
    for x in np.arange(0, BAYS * BAY_M, 0.25):
        canvas.rgb[:, round(x / _TEXEL_M)] *= 0.7
    for bay in range(0, BAYS, 2):
        x = bay * BAY_M
        shade = float(rng.uniform(0.25, 0.6))
        canvas.rect(x + 0.3, 0, x + BAY_M - 0.3, 2.1, (shade, shade, shade))
        for z in np.arange(0.35, 2.1, 0.35):
            canvas.rect(x + 0.3, z, x + BAY_M - 0.3, z + 0.05, (0.5 * shade,) * 3)


def _cladding(canvas: _Canvas, rng: np.random.Generator) -> None:
    """Draw the wall of a hall: ribbed sheets, a band of windows, roller doors and a fascia."""
    columns = canvas.rgb.shape[1]
    ribs = 1 + 0.06 * np.sign(np.sin(2 * np.pi * np.arange(columns) * _TEXEL_M / 0.5))
    canvas.rgb *= ribs[None, :, None].astype(np.float32)
    canvas.rect(0, 0, BAYS * BAY_M, 0.6, (0.35, 0.35, 0.34))
    canvas.glaze(0, 3.6, BAYS * BAY_M, 4.4, (0.14, 0.17, 0.20), 0.7)
    for x in np.arange(0, BAYS * BAY_M, 1.0):
        canvas.rect(x, 3.6, x + 0.08, 4.4, (0.6, 0.6, 0.6))
    for bay in range(1, BAYS, 3):
        x = bay * BAY_M
        shade = float(rng.uniform(0.3, 0.6))
        canvas.rect(x, 0, x + 3.4, 3.3, (shade, shade, 0.95 * shade))
        for z in np.arange(0.3, 3.3, 0.3):
            canvas.rect(x, z, x + 3.4, z + 0.05, (0.6 * shade,) * 3)


def _periodic(rng: np.random.Generator, n: int, scale_m: float) -> Float:
    """Return periodic Gaussian noise (n, n): mean 0, standard deviation 1, blobs of ``scale_m``."""
    frequency = np.fft.fftfreq(n, _TEXEL_M)
    keep = np.exp(-2 * (np.pi * 0.5 * scale_m) ** 2 * (frequency[:, None] ** 2 + frequency**2))
    noise = np.fft.ifft2(np.fft.fft2(rng.standard_normal((n, n))) * keep).real
    noise -= noise.mean()
    return np.asarray(noise / noise.std(), np.float32)


def _encode(rgb: Float, tinted: Float) -> Image:
    """Return the image of linear colours (h, w, 3) and shares of the tint (h, w), both 0 to 1."""
    srgb = np.where(
        rgb <= 0.0031308, 12.92 * rgb, 1.055 * np.maximum(rgb, 1e-6) ** (1 / 2.4) - 0.055
    )
    return np.asarray(np.round(255 * np.dstack([srgb, tinted])).clip(0, 255), np.uint8)
