"""White and black rims of pictures whose files declare no such no data."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from objconnect.scene.quantities.collars import describe_collar

PICTURE = np.random.default_rng(8).uniform(1, 254, (3, 60, 80)).astype(np.float32)


def find_collar(picture: NDArray[np.float32], rows: int = 16) -> str | None:
    return describe_collar(picture[:, k : k + rows] for k in range(0, picture.shape[1], rows))


@pytest.mark.parametrize(("value", "name"), [(255, "white"), (0, "black")])
@pytest.mark.parametrize("side", ["top", "bottom", "left", "right"])
def test_a_rim_is_told(value: int, name: str, side: str) -> None:
    picture = PICTURE.copy()
    parts = {"top": np.s_[:, :20], "bottom": np.s_[:, 40:], "left": np.s_[:, :, :27]}
    picture[parts.get(side, np.s_[:, :, 53:])] = value
    said = find_collar(picture)
    assert said is not None
    assert said.startswith(("33 %", "34 %"))
    assert name in said and said.endswith(f": gdal_edit -a_nodata {value} FILE")


def test_what_is_no_rim() -> None:
    roof, shadow, declared, water = (PICTURE.copy() for _ in range(4))
    roof[:, 20:40, 20:60] = 255
    shadow[:, :2, :8] = 0
    declared[:, :20] = np.nan
    water[:2, :20] = 0  # blue is left
    assert [find_collar(picture) for picture in (PICTURE, roof, shadow, declared, water)] == [
        None
    ] * 5
