"""Detection of the bands that hold the colours of a raster, from its metadata."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from objconnect.scene.quantities.reading import Reading, known, unknown

_COLOURS = ("red", "green", "blue")
_ALPHA, _PALETTE = "alpha", "palette"
_GREY = ("gray", "pan", "undefined")
# Colour interpretation of bands whose writer stated none.
_UNSTATED = ("gray", "undefined")
_INFRARED = re.compile(r"\bn?ir\b|\bpir\b|nir|infra")
_WORDS = re.compile(r"[^\W\d_]+")
# Colour words of other languages, and single letters.
_OTHER_WORDS = {
    **dict.fromkeys(("rouge", "rot", "rojo", "roja", "rosso", "vermelho", "rood"), "red"),
    **dict.fromkeys(("vert", "verte", "grün", "gruen", "verde", "groen"), "green"),
    **dict.fromkeys(("bleu", "bleue", "blau", "azul", "blu", "blauw"), "blue"),
}
_LETTERS = {"r": "red", "g": "green", "b": "blue", "a": "alpha", "n": "nir"}


@dataclass(frozen=True)
class ColourBands:
    """The bands of a raster that hold its colours.

    Attributes:
        colours: numbers of the red, green and blue band, or of one band, from 1.
        alpha: number of the alpha band; None if there is none.
        palette: whether the single band holds indices of a colour table.
    """

    colours: tuple[int, ...]
    alpha: int | None = None
    palette: bool = False


def colour_bands(
    interpretations: Sequence[str], descriptions: Sequence[str | None]
) -> Reading[ColourBands]:
    """Return the bands that hold the colours of a raster.

    Args:
        interpretations: GDAL's colour interpretation of each band, such as ``red``.
        descriptions: description of each band, such as ``Band 1 (Red)``; it is used if the
            interpretation states nothing.
    """
    source = "ColorInterp"
    names = []
    padded_descriptions = [*descriptions, *[None] * len(interpretations)]
    for number, interpretation in enumerate(interpretations, 1):
        word = _parse_colour(padded_descriptions[number - 1])
        unstated = interpretation in _UNSTATED
        if word and not unstated and word != interpretation:
            return unknown(
                source,
                f"ColorInterp of band {number} is {interpretation}, its description "
                f"{padded_descriptions[number - 1]!r}",
            )
        names.append(word if word and unstated else interpretation)
    listing = f"it has {len(names)} bands: {', '.join(names)}"
    numbers = {colour: [n for n, name in enumerate(names, 1) if name == colour] for colour in names}
    alphas = numbers.get(_ALPHA, [])
    if len(alphas) > 1:
        return unknown(source, listing)
    alpha = alphas[0] if alphas else None
    if all(len(numbers.get(colour, ())) == 1 for colour in _COLOURS):
        return known(ColourBands(tuple(numbers[colour][0] for colour in _COLOURS), alpha), source)
    others = [n for n, name in enumerate(names, 1) if name != _ALPHA]
    if len(others) == 1 and names[others[0] - 1] in (*_GREY, _PALETTE):
        palette = names[others[0] - 1] == _PALETTE
        return known(ColourBands((others[0],), alpha, palette), source)
    return unknown(source, listing)


def _parse_colour(description: str | None) -> str | None:
    """Return the colour that a description names, ``nir``, ``rededge``, ``alpha``, or None."""
    text = (description or "").lower()
    if _INFRARED.search(text):
        return "nir"
    if "edge" in text:
        return "rededge"
    if text.strip() in _LETTERS:
        return _LETTERS[text.strip()]
    words = [_OTHER_WORDS.get(word, word) for word in _WORDS.findall(text)]
    colours = {word for word in words if word in (*_COLOURS, _ALPHA)}
    return colours.pop() if len(colours) == 1 else None
