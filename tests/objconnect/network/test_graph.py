"""The graphs against loops over points and objects."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from objconnect.network.graph import ObjectGraph, PointConvolution, SceneGraph
from objconnect.network.objects import Occupancy, affinity, centres, occupancy

N, C, HEIGHT, WIDTH = 4, 5, 3, 6


@pytest.fixture
def objects() -> Occupancy:
    labels = torch.randint(-1, N - 1, (2, HEIGHT, WIDTH), generator=torch.manual_seed(1))
    return occupancy(labels, N)


@pytest.fixture
def rows() -> Tensor:
    return torch.randn(2, HEIGHT * WIDTH, C, generator=torch.manual_seed(2))


def members(objects: Occupancy, b: int, n: int) -> list[int]:
    return [k for k, label in enumerate(objects.index[b].tolist()) if label == n]


def convolve(layer: PointConvolution, points: Tensor, own: list[int]) -> list[Tensor]:
    """G over one object: every point joined to every point of it."""
    made = []
    for k in own:
        around = sum((points[j] for j in own), torch.zeros(C)) / len(own)
        value = layer.own.weight @ points[k] + layer.own.bias + layer.others.weight @ around
        made.append(value.clamp(min=0))
    return made


def unit(v: Tensor) -> Tensor:
    return v / (v.square().mean() + 1e-6).sqrt()


def test_object_graph_is_equations_4_and_5(objects: Occupancy, rows: Tensor) -> None:
    torch.manual_seed(0)
    block = ObjectGraph(C)
    weights, found = block.weights(rows, objects), block(rows, objects)
    expected = rows.clone()
    for b in range(2):
        for n in range(N):
            own = members(objects, b, n)
            if not own:
                assert not weights[b, n].any()
                continue
            pooled = torch.stack(convolve(block.convolution, rows[b], own)).mean(0)
            mean = torch.stack([rows[b, k] for k in own]).mean(0)
            f_c = unit(pooled) * unit(mean)
            torch.testing.assert_close(weights[b, n], f_c)
            for k, value in zip(own, convolve(block.convolution, rows[b] * f_c, own), strict=True):
                expected[b, k] += block.out.weight @ value
    torch.testing.assert_close(found, expected)


def test_objects_hear_of_no_other_object(objects: Occupancy, rows: Tensor) -> None:
    block = ObjectGraph(C)
    before = block(rows, objects)
    here = objects.index[0] == 0
    changed = rows.clone()
    changed[0, ~here] += 10
    torch.testing.assert_close(block(changed, objects)[0, here], before[0, here])


def test_scene_graph_against_loops(objects: Occupancy, rows: Tensor) -> None:
    torch.manual_seed(0)
    block = SceneGraph(C)
    vectors, place = affinity(objects, rows), centres(objects)
    edges, found = block.edges(vectors, objects), block(rows, objects)
    for b in range(2):
        there = [n for n in range(N) if members(objects, b, n)]
        side = (sum(len(members(objects, b, n)) for n in there) / len(there)) ** 0.5
        for i in range(N):
            if i not in there:
                assert not edges[b, i].any() and not edges[b, :, i].any()
                continue
            score = torch.stack(
                [
                    block.alpha * nn.functional.cosine_similarity(vectors[b, i], vectors[b, j], 0)
                    - block.beta * (place[b, i] - place[b, j]).norm() / side
                    for j in there
                ]
            )
            torch.testing.assert_close(edges[b, i, there], score.softmax(0))
            merged = sum(
                (w * vectors[b, j] for w, j in zip(score.softmax(0), there, strict=True)),
                torch.zeros(C),
            )
            both = torch.cat([merged, vectors[b, i] - merged])
            hidden = (block.join.weight @ both + block.join.bias).clamp(min=0)
            for k in members(objects, b, i):
                torch.testing.assert_close(found[b, k], rows[b, k] + block.out.weight @ hidden)


def test_near_and_alike_objects_are_merged_most() -> None:
    labels = torch.tensor([[[0, 0, 1, 1, 2, 2, 3, 3]]])
    rows = torch.tensor([[1.0, 0], [1, 0], [1, 0], [1, 0], [0, 1], [0, 1], [1, 0], [1, 0]])[None]
    objects = occupancy(labels, 4)
    first = SceneGraph(2).edges(affinity(objects, rows), objects)[0, 0]
    assert first[0] > first[1] > first[3] > first[2]


@pytest.mark.parametrize("block", [ObjectGraph, SceneGraph])
def test_no_object_at_all_changes_nothing(block: type[nn.Module], rows: Tensor) -> None:
    nothing = occupancy(torch.full((2, HEIGHT, WIDTH), -1), N)
    torch.testing.assert_close(block(C)(rows, nothing), rows)
