"""The true objects of training pairs."""

from __future__ import annotations

import numpy as np

from objconnect.learning.training.objects import GROUND, UNKNOWN, ImageObjects, PairObjects
from objconnect.learning.training.options import PairOptions
from objconnect.learning.training.pairs import Pair, collate
from objconnect.learning.training.rendered import RenderedPairs
from objconnect.scene.bundle.scene import Scene

WITH_OBJECTS = PairOptions(objects=True, heading_deg=180, max_turn_deg=180, zoom=(0.65, 1.5))


def draw(scene: Scene, count: int) -> list[Pair]:
    source = RenderedPairs([scene], 128, 96, 0.0, WITH_OBJECTS)
    return [source.draw(np.random.default_rng(seed)) for seed in range(count)]


def both(pairs: list[Pair]) -> list[PairObjects]:
    return [objects for pair in pairs if pair.objects for objects in pair.objects]


def test_small_objects_lie_around_their_centres(rendered: Scene) -> None:
    apart = []
    for objects in both(draw(rendered, 12)):
        assert objects.labels.max() < len(objects.ids) == len(objects.centres)
        for row in np.flatnonzero((objects.sides < 12) & (objects.pixels > 20)):
            rows, columns = np.nonzero(objects.labels == row)
            assert len(rows) == objects.pixels[row]
            middle = np.array([columns.mean(), rows.mean()]) + 0.5
            if middle.min() > 12 and middle.max() < 116:
                apart.append(np.linalg.norm(middle - objects.centres[row]) / objects.sides[row])
    assert len(apart) >= 10
    assert np.median(apart) < 0.4


def test_an_object_has_one_id_in_both_images(rendered: Scene) -> None:
    shared = 0
    by_id = {item.id: item for item in rendered.objects.objects}
    for pair in draw(rendered, 12):
        assert pair.objects is not None
        a, b = pair.objects
        shared += len(set(a.ids.tolist()) & set(b.ids.tolist()))
        for number in (*a.ids.tolist(), *b.ids.tolist()):
            assert by_id[number].class_name not in ("wire", "fence", "hedge")
    assert shared >= 12


def test_what_lies_beyond_the_photograph_is_unknown(rendered: Scene) -> None:
    labels = [objects.labels for objects in both(draw(rendered, 12))]
    assert any((each == UNKNOWN).any() for each in labels)
    assert any((each == GROUND).any() for each in labels)


def test_scenes_do_not_share_ids(rendered: Scene) -> None:
    source = RenderedPairs([rendered, rendered], 128, 96, 0.0, WITH_OBJECTS)
    objects = both([source.draw(np.random.default_rng(seed)) for seed in range(12)])
    ids = np.concatenate([each.ids for each in objects])
    known = {item.id for item in rendered.objects.objects}
    assert set(ids.tolist()) - known
    assert {number % (1 << 17) for number in ids.tolist()} <= known


def test_batches_hold_the_objects_of_images_a_then_b(rendered: Scene) -> None:
    pairs = draw(rendered, 2)
    batch = collate(pairs)
    wanted = [pair.objects[side] for side in (0, 1) for pair in pairs if pair.objects]
    assert len(batch.objects) == 4
    for one, other in zip(batch.objects, wanted, strict=True):
        assert isinstance(one, ImageObjects)
        np.testing.assert_array_equal(one.ids.numpy(), other.ids)
    assert collate([pair._replace(objects=None) for pair in pairs]).objects == ()
