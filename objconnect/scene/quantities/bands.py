"""Colours of the bands of a picture, by what its file says each band is."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from objconnect.scene.quantities.reading import Reading, known, unknown

_COLOURS = ("red", "green", "blue")
_ALPHA, _PALETTE = "alpha", "palette"
_GREY = ("gray", "pan", "undefined")
# What a file says of bands whose writer said nothing.
_SILENT = ("gray", "undefined")
_INFRARED = re.compile(r"\bn?ir\b|\bpir\b|nir|infra")
_WORDS = re.compile(r"[^\W\d_]+")
# Words of other languages; a letter alone stands for its colour.
_OTHER_WORDS = {
    **dict.fromkeys(("rouge", "rot", "rojo", "roja", "rosso", "vermelho", "rood"), "red"),
    **dict.fromkeys(("vert", "verte", "grün", "gruen", "verde", "groen"), "green"),
    **dict.fromkeys(("bleu", "bleue", "blau", "azul", "blu", "blauw"), "blue"),
}
_LETTERS = {"r": "red", "g": "green", "b": "blue", "a": "alpha", "n": "nir"}


@dataclass(frozen=True)
class ColourBands:
    """Which bands of a picture hold its colours.

    Attributes:
        colours: numbers of the red, green and blue band, or of one band, from 1.
        alpha: number of the band that tells which pixels have data; None where there is none.
        palette: whether the one band holds numbers of colours in a table.
    """

    colours: tuple[int, ...]
    alpha: int | None = None
    palette: bool = False


def colour_bands(
    interpretations: Sequence[str], descriptions: Sequence[str | None]
) -> Reading[ColourBands]:
    """Return which bands hold the colours of a picture.

    Args:
        interpretations: GDAL's colour interpretation of each band, such as ``red``.
        descriptions: description of each band, such as ``Band 1 (Red)``, which is asked where the
            interpretation says nothing.
    """
    source = "ColorInterp"
    names = []
    described = [*descriptions, *[None] * len(interpretations)]
    for number, interpretation in enumerate(interpretations, 1):
        word = _parse_colour(described[number - 1])
        silent = interpretation in _SILENT
        if word and not silent and word != interpretation:
            return unknown(
                source,
                f"ColorInterp of band {number} is {interpretation}, its description "
                f"{described[number - 1]!r}",
            )
        names.append(word if word and silent else interpretation)
    said = f"it has {len(names)} bands: {', '.join(names)}"
    places = {colour: [n for n, name in enumerate(names, 1) if name == colour] for colour in names}
    alphas = places.get(_ALPHA, [])
    if len(alphas) > 1:
        return unknown(source, said)
    alpha = alphas[0] if alphas else None
    if all(len(places.get(colour, ())) == 1 for colour in _COLOURS):
        return known(ColourBands(tuple(places[colour][0] for colour in _COLOURS), alpha), source)
    others = [n for n, name in enumerate(names, 1) if name != _ALPHA]
    if len(others) == 1 and names[others[0] - 1] in (*_GREY, _PALETTE):
        palette = names[others[0] - 1] == _PALETTE
        return known(ColourBands((others[0],), alpha, palette), source)
    return unknown(source, said)


def _parse_colour(description: str | None) -> str | None:
    """Return the colour that a description names, ``nir``, ``alpha``, or None."""
    text = (description or "").lower()
    if _INFRARED.search(text):
        return "nir"
    if "edge" in text:
        return "rededge"
    if text.strip() in _LETTERS:
        return _LETTERS[text.strip()]
    words = [_OTHER_WORDS.get(word, word) for word in _WORDS.findall(text)]
    found = {word for word in words if word in (*_COLOURS, _ALPHA)}
    return found.pop() if len(found) == 1 else None
