from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from objconnect.learning.checkpoint import write_weights
from objconnect.learning.pixloc_net import PixlocNet, PixlocNetConfig
from objconnect.network.config import ObjConnectNetConfig
from objconnect.network.network import ObjConnectNet, read_network, start_from
from objconnect.network.segmentation import segment
from objconnect.scene.config import load_config
from objconnect.scene.errors import InputError
from tests.objconnect.network.made import pictures

SWITCHES = ("attention", "object_graph", "scene_graph")
OFF: dict[str, Any] = dict.fromkeys(SWITCHES, False)
SMALL: dict[str, Any] = {"width": 0.05, "pyramid": 16, "dims": (12, 8, 6), "segment_side": 16}


def network(**values: Any) -> ObjConnectNet:
    torch.manual_seed(0)
    return ObjConnectNet(load_config(ObjConnectNetConfig, None, SMALL | values)).eval()


@pytest.mark.parametrize("size", [(64, 96), (75, 53), (16, 16)])
def test_levels_have_the_form_of_pixloc(size: tuple[int, int]) -> None:
    made = network()
    theirs = PixlocNet(PixlocNetConfig(width=0.05, strides=(16, 4, 2), dims=(12, 8, 6))).eval()
    image = pictures(2, *size)
    with torch.no_grad():
        for ours, others in zip(made(image), theirs(image), strict=True):
            assert [each.shape for each in ours] == [each.shape for each in others]
            assert ours[1].min() > 0 and ours[1].max() < 1


@pytest.mark.parametrize("on", list(product([False, True], repeat=3)))
def test_every_switch(on: tuple[bool, ...]) -> None:
    switches = dict(zip(SWITCHES, on, strict=True))
    made = network(**switches).train()
    image = pictures(2, 64, 64)
    levels, objects = made.describe(image)
    assert objects is not None
    loss = sum((f.square().mean() + c.mean() for f, c in levels), objects.confidence.mean())
    loss.backward()
    damping = {name for name, _ in made.named_parameters() if name.startswith("damping")}
    for name, parameter in made.named_parameters():
        if name not in damping:
            assert parameter.grad is not None and parameter.grad.isfinite().all(), name
            assert parameter.grad.any() or "bias" in name, name
    blocks = sum(name.startswith("objects_of") for name, _ in made.named_parameters())
    assert (blocks > 0) == any(on)


def test_without_objects_nothing_is_segmented(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("objconnect.network.network.segment", lambda *_: pytest.fail("segmented"))
    made = network(segmentation="none", **OFF)
    image = pictures(1, 32, 32)
    assert len(made(image)) == 3
    with pytest.raises(InputError, match="has no objects"):
        made.objects(image)


def test_finer_levels_know_no_objects() -> None:
    made = network()
    image = pictures(1, 64, 64)
    one = torch.zeros(1, 8, 8, dtype=torch.int64)
    with torch.no_grad():
        ours, others = made(image), made(image, one)
    changed = [not torch.equal(a[0], b[0]) for a, b in zip(ours, others, strict=True)]
    assert changed == [True, True, False]


def test_the_order_of_labels_does_not_matter() -> None:
    made = network()
    image = pictures(2, 64, 80)
    labels = segment(image, made.config)
    order = torch.randperm(made.config.segments)
    with torch.no_grad():
        levels, objects = made.describe(image, labels)
        others, permuted = made.describe(image, order[labels])
    for a, b in zip(levels, others, strict=True):
        torch.testing.assert_close(a, b)
    assert objects is not None and permuted is not None
    for before, after in zip(objects, permuted, strict=True):
        torch.testing.assert_close(after[:, order], before)


def test_objects_lie_where_they_are() -> None:
    made = network()
    image = pictures(1, 64, 64)
    labels = torch.full((1, 64, 64), -1)
    labels[0, 8:16, 40:56] = 3
    objects = made.objects(image, labels)
    assert objects.present.nonzero().tolist() == [[0, 3]]
    assert objects.centres[0, 3].tolist() == [48, 12]
    assert 0 < objects.confidence[0, 3] < 1


def test_vectors_are_the_features_at_the_centre_not_their_mean() -> None:
    """Of the set V: a ring's centre is none of its own cells."""
    made = network()
    made_here: list[Tensor] = []
    made.objects_of[-1].register_forward_hook(lambda *call: made_here.append(call[2]))
    labels = torch.full((1, 64, 64), -1)
    labels[0, 20:40, 8:28], labels[0, 24:36, 12:24] = 0, 1  # in cells of 4, the hole is 3 x 3
    labels[0, 48:52, 40:56] = 2  # 4 cells: the centre lies between two
    with torch.no_grad():
        objects = made.objects(pictures(1, 64, 64), labels)
    (features,) = made_here
    ring, hole, row = objects.vectors[0, :3]
    torch.testing.assert_close(ring, features[0, :, 7, 4])
    torch.testing.assert_close(hole, ring)
    torch.testing.assert_close(row, features[0, :, 12, 11:13].mean(1))
    means = torch.stack([features[0, :, 5:10, 2:7].mean((1, 2)), features[0, :, 12, 10:14].mean(1)])
    assert (means - objects.vectors[0, [0, 2]]).abs().max() > 0.05 * features.std()


def test_trust_judges_features_and_does_not_bend_them() -> None:
    made = network().train()
    objects = made.objects(pictures(2, 64, 64))
    objects.confidence.sum().backward()
    taught = {name for name, p in made.named_parameters() if p.grad is not None and p.grad.any()}
    assert taught == {"trust.weight", "trust.bias"}


def test_what_objects_look_like_can_teach_features() -> None:
    made = network().train()
    made.objects(pictures(2, 64, 64)).vectors.square().sum().backward()
    taught = {name.split(".")[0] for name, p in made.named_parameters() if p.grad is not None}
    assert taught == {"encoder", "decoder", "objects_of"}


@pytest.mark.parametrize("kind", ["slic", "felzenszwalb", "grid"])
def test_constant_pictures_and_single_segments_are_finite(kind: str) -> None:
    made = network(segmentation=kind, segments=1).train()
    for image in (torch.full((1, 3, 48, 48), 0.5), torch.zeros(1, 3, 48, 48)):
        levels, objects = made.describe(image)
        assert objects is not None and objects.present.all()
        loss = sum((f.square().mean() + c.mean() for f, c in levels), torch.zeros(()))
        loss.backward()
        assert all(p.grad.isfinite().all() for p in made.parameters() if p.grad is not None)


def test_given_masks() -> None:
    made = network(segmentation="given")
    image = pictures(1, 32, 32)
    with pytest.raises(InputError, match="give label maps"):
        made(image)
    assert len(made(image, torch.zeros(1, 5, 9, dtype=torch.int64))) == 3


@pytest.mark.parametrize(
    "wrong",
    [
        *({"strides": (16, 3)}, {"strides": (4, 16, 1)}, {"dims": (8,)}, {"segmentation": "none"}),
        *({"dims": (8, 8, 10**6)}, {"steps": (64, 64, 64, 10**6)}, {"pyramid": 10**6}),
    ],
)
def test_a_bad_configuration_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        load_config(ObjConnectNetConfig, None, wrong)


def test_written_weights_come_back_and_others_are_refused(tmp_path: Path) -> None:
    made = network(scene_graph=False)
    path = tmp_path / "weights.safetensors"
    write_weights(path, made, made.config.model_dump(mode="json"))
    again, digest = read_network(path)
    assert again.config == made.config and len(digest) == 64
    image = pictures(1, 48, 64)
    with torch.no_grad():
        for a, b in zip(made(image), again(image), strict=True):
            assert torch.equal(a[0], b[0]) and torch.equal(a[1], b[1])
    theirs = PixlocNet(PixlocNetConfig(width=0.05))
    write_weights(path, theirs, theirs.config.model_dump(mode="json"))
    with pytest.raises(InputError, match="no weights of objconnect"):
        read_network(path)


def test_going_on_from_weights(tmp_path: Path) -> None:
    path = tmp_path / "weights.safetensors"
    theirs = PixlocNet(PixlocNetConfig(width=0.1, strides=(16, 4, 2)))
    write_weights(path, theirs, theirs.config.model_dump(mode="json"))
    ours = start_from(path, {"segments": 50})
    assert ours.config == ObjConnectNetConfig(width=0.1, segments=50)
    for a, b in zip(ours.encoder.parameters(), theirs.encoder.parameters(), strict=True):
        assert torch.equal(a, b)

    # Without objects it is PixLoc's network to the last layer.
    plain = start_from(path, {"segmentation": "none", **OFF}).eval()
    image = pictures(1, 48, 64)
    with torch.no_grad():
        for a, b in zip(plain(image), theirs.eval()(image), strict=True):
            torch.testing.assert_close(a, b)

    plain = network(segmentation="none", **OFF)
    write_weights(path, plain, plain.config.model_dump(mode="json"))
    more = start_from(path, {"segmentation": "slic", "attention": True})
    assert more.config.attention and not more.config.scene_graph
    kept = more.state_dict()
    assert all(torch.equal(tensor, kept[name]) for name, tensor in plain.state_dict().items())

    deeper = PixlocNet(PixlocNetConfig(width=0.05, extra_convolutions=1))
    write_weights(path, deeper, deeper.config.model_dump(mode="json"))
    with pytest.raises(InputError, match="VGG19"):
        start_from(path, {})


@pytest.mark.parametrize("decoder", ["unet", "fpn"])
@torch.inference_mode()
def test_coarse_levels_alone_are_those_of_all(decoder: str) -> None:
    config = ObjConnectNetConfig.model_validate({"width": 0.125, "decoder": decoder})
    network = ObjConnectNet(config).eval()
    image = torch.rand(1, 3, 64, 96)
    everything = network(image)
    for count in (1, 2):
        some = network(image, levels=count)
        assert len(some) == count
        for (features, trust), (as_of_all, trust_of_all) in zip(some, everything, strict=False):
            torch.testing.assert_close(features, as_of_all, atol=0, rtol=0)
            torch.testing.assert_close(trust, trust_of_all, atol=0, rtol=0)


def test_weights_may_record_what_is_no_option_any_more() -> None:
    assert ObjConnectNetConfig(**{"finest_object_stride": 4}) == ObjConnectNetConfig()
    with pytest.raises(ValueError, match="finest_object_stride is 8 in these weights; only 4"):
        ObjConnectNetConfig(**{"finest_object_stride": 8})
