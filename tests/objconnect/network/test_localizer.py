"""The localizer as it is shipped: nobody says a weight or an option."""

from __future__ import annotations

import gc
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from objconnect.localization.featuremetric.attempt import Attempt
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.refiner import Refiner
from objconnect.localization.provenance import Method
from objconnect.methods import create
from objconnect.network.localizer import SHIPPED
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Localizer, PoseSource, Prior, Query, Status
from tests.baselines.pixloc.made_map import CAMERA, looking_down, photograph, write_map

TRUTH = looking_down(9.3, -0.4, (1.5, -1.0, 4.0))


@pytest.fixture(scope="module")
def localizer(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> FeaturemetricLocalizer:
    images = tmp_path_factory.mktemp("map") / "images"
    made = create("objconnect", {})
    assert isinstance(made, FeaturemetricLocalizer)
    made.prepare(write_map(images), images, cache)
    return made


def find_from(localizer: Localizer, start: Pose) -> tuple[float, float]:
    """Metres and degrees from the truth."""
    prior = Prior(start.centre().numpy(), None, start.rotation.numpy(), None)
    estimate = localizer.localize(Query("query.png", photograph(TRUTH), CAMERA, prior))
    assert estimate.status is Status.OK, estimate.reason
    assert estimate.cam_from_world is not None
    metres, degrees = estimate.cam_from_world.error_to(TRUTH)
    return float(metres), float(degrees)


def test_a_near_start(localizer: Localizer) -> None:
    metres, degrees = find_from(localizer, looking_down(8.9, -0.1, (0.5, 0.0, 3.0)))
    assert metres < 0.1 and degrees < 0.25


def test_a_start_beyond_the_reach_of_one_alignment(localizer: Localizer) -> None:
    """A third of the altitude aside and ten degrees off: found from many starts alone."""
    metres, degrees = find_from(localizer, looking_down(15.0, 3.6, (7.0, -6.0, 10.0)))
    assert metres < 0.2 and degrees < 0.5


def test_a_query_leaves_no_tensor_behind(localizer: FeaturemetricLocalizer) -> None:
    """Bounded caches hold what they will hold once a query has been asked."""

    def held() -> int:
        gc.unfreeze()  # what is frozen is not listed
        gc.collect()
        total = sum(each.nbytes for each in gc.get_objects() if type(each) is torch.Tensor)
        gc.freeze()
        return total

    start = looking_down(8.9, -0.1, (0.5, 0.0, 3.0))
    find_from(localizer, start)
    before = held()
    for _ in range(2):
        find_from(localizer, start)
    assert held() <= before  # what other tests left may go meanwhile


def something_else() -> Query:
    """Patches of the ground in another order: as much to see, and nothing where it should be."""
    patches = photograph(TRUTH).reshape(6, 32, 8, 32, 3).swapaxes(1, 2).reshape(48, 32, 32, 3)
    mixed = np.random.default_rng(0).permutation(patches).reshape(6, 8, 32, 32, 3)
    image = mixed.swapaxes(1, 2).reshape(192, 256, 3)
    start = looking_down(8.9, -0.1, (0.5, 0.0, 3.0))
    prior = Prior(start.centre().numpy(), None, start.rotation.numpy(), None)
    return Query("query.png", image, CAMERA, prior)


def test_a_picture_of_something_else_is_no_fix(localizer: Localizer) -> None:
    estimate = localizer.localize(something_else())
    assert (estimate.status, estimate.by) == (Status.FALLBACK, PoseSource.PRIOR)
    assert "right with a probability of 0.0" in estimate.reason


@pytest.mark.parametrize(("again", "tried"), [(1, [8]), (3, [8, 24])])
def test_where_no_pose_is_believed_more_are_tried(
    localizer: FeaturemetricLocalizer, monkeypatch: pytest.MonkeyPatch, again: int, tried: list[int]
) -> None:
    search, numbers = localizer.config.search, []
    refine = Refiner.__call__

    def record_width(self: Refiner, *arguments: Any) -> Attempt:
        numbers.append(self.search_width.refined)
        return refine(self, *arguments)

    monkeypatch.setattr(Refiner, "__call__", record_width)
    options = {"search": search.model_copy(update={"again": again})}
    monkeypatch.setattr(localizer, "config", localizer.config.model_copy(update=options))
    localizer.localize(something_else())
    assert numbers == tried
    localizer.localize(replace(something_else(), image=photograph(TRUTH)))
    assert numbers == [*tried, 8]


def test_without_an_attitude(localizer: Localizer) -> None:
    """Every heading is looked at from the prior: the camera was turned by 140 degrees."""
    truth = looking_down(9.3, -0.4, (1.5, -1.0, 140.0))
    prior = Prior(np.array([9.0, 0.4, 20.5]))
    estimate = localizer.localize(Query("query.png", photograph(truth), CAMERA, prior))
    assert estimate.status is Status.OK, estimate.reason
    assert estimate.cam_from_world is not None
    metres, degrees = estimate.cam_from_world.error_to(truth)
    assert metres < 0.1 and degrees < 0.25


def test_options_without_effect_are_refused_or_recorded_as_off(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Weights without learned objects, and a search without many starts."""
    shipped = create("objconnect", {})
    assert Method.of(shipped).objects == f"learned, objconnect.safetensors {shipped.weights_sha256}"
    weights = str(SHIPPED.with_name("objconnect-objects.safetensors"))
    message = f"option objects needs learned objects, which the weights {weights} do not have"
    for explicit in ({"objects": {}}, {"objects.candidates": 4}):
        with pytest.raises(InputError, match=re.escape(message)):
            create("objconnect", {"weights": weights, **explicit})
    assert not caplog.records
    method = Method.of(create("objconnect", {"weights": weights}))
    assert (method.config["objects"], method.objects) == (None, "none")
    assert [weights in record.getMessage() for record in caplog.records] == [True]
    # A worker of a cluster gets all recorded options.
    assert Method.of(create("objconnect", method.config)) == method
    alone = Method.of(create("objconnect", {"multistart": False}))
    config = alone.config
    assert (config["objects"], config["matches"], config["place"]["candidates"]) == (None, None, 0)
    assert alone.objects == "none"
    for name in ("objects", "matches", "place"):
        with pytest.raises(InputError, match=f"option {name} has no effect without multistart"):
            create("objconnect", {"multistart": False, name: {}})
    with pytest.raises(InputError, match="option max_magnification has no effect"):
        create("pixloc", {"max_magnification": 1.5})
    with pytest.raises(InputError, match=r"option search.again has no effect without multistart"):
        create("pixloc", {"search.again": 3})
    assert create("pixloc", {"search.again": 3, "multistart": True}).config.search.again == 3
    without = create("pixloc", {})
    assert Method.of(create("pixloc", Method.of(without).config)) == Method.of(without)
