from __future__ import annotations

import pytest
import torch
from torch.nn.functional import grid_sample

from objconnect.localization.align.sampling import CellTable, sample, stencil


def reference_values(maps: torch.Tensor, cells: torch.Tensor) -> torch.Tensor:
    size = torch.tensor([maps.shape[-1], maps.shape[-2]], dtype=maps.dtype)
    place = 2 * (cells + 0.5) / size - 1
    found = grid_sample(maps, place[:, None], padding_mode="border", align_corners=False)
    return found[:, :, 0].transpose(1, 2)


def test_stencil_is_bilinear_with_central_differences() -> None:
    torch.manual_seed(0)
    maps = torch.rand(2, 5, 7, 9, dtype=torch.float64)
    cells = 1 + torch.rand(2, 40, 2, dtype=torch.float64) * torch.tensor([6.0, 4.0])
    cells[0, 0], cells[0, 1] = torch.tensor([1.0, 1.0]), torch.tensor([7.0, 5.0])  # both borders
    table = CellTable.of(maps)
    index, weights = stencil(cells, table, table.first(torch.arange(2)))
    value, along_x, along_y = table.value_and_slopes(index, weights).unbind(-2)
    x, y = torch.eye(2, dtype=torch.float64)

    def at(c: torch.Tensor) -> torch.Tensor:
        return reference_values(maps, c)

    torch.testing.assert_close(value, at(cells))
    torch.testing.assert_close(table.value(index, weights), value)
    torch.testing.assert_close(along_x, (at(cells + x) - at(cells - x)) / 2)
    torch.testing.assert_close(along_y, (at(cells + y) - at(cells - y)) / 2)


def test_samples_at_pixels_up_to_the_outermost_centres() -> None:
    maps = torch.rand(2, 3, 6, 8)
    xy = torch.tensor([[4.0, 4.0], [60.0, 44.0], [31.7, 20.2]]).expand(2, -1, -1)
    values, seen = sample(maps, xy, 8.0)
    assert seen.all()
    torch.testing.assert_close(values, reference_values(maps, xy / 8 - 0.5))
    assert torch.equal(values[:, 0], maps[:, :, 0, 0])  # pixel (4, 4) is the first cell's centre
    _, seen = sample(maps, torch.tensor([[3.9, 9.0], [float("nan"), 9.0]]).expand(2, -1, -1), 8.0)
    assert not seen.any()
    _, seen = sample(maps, xy, (8.0, 8.0), border=1)
    assert seen.tolist() == [[False, False, True]] * 2


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_half_precision_maps_are_mixed_in_single(layout: torch.memory_format) -> None:
    maps = torch.rand(1, 16, 20, 30).bfloat16().contiguous(memory_format=layout)
    xy = torch.rand(1, 50, 2) * torch.tensor([26.0, 16.0]) + 2
    values, _ = sample(maps, xy, 1)
    assert values.dtype == torch.float32
    torch.testing.assert_close(values, reference_values(maps.float(), xy - 0.5))
