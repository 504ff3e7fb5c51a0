"""Learned objects: what their losses ask for, and what is read from maps that are right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from objconnect.learning.training.command import train
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.objects import GROUND, UNKNOWN, ImageObjects
from objconnect.learning.training.options import PairOptions
from objconnect.learning.training.pairs import collate
from objconnect.learning.training.rendered import RenderedPairs
from objconnect.network.config import DetectorConfig, ObjConnectNetConfig
from objconnect.network.detector import DetectorMaps, ObjectDetector, extract_detections, label_map
from objconnect.network.localizer import SHIPPED
from objconnect.network.network import ObjConnectNet, read_network
from objconnect.network.object_loss import cell_labels, geometry_loss, identity_loss
from objconnect.network.object_training import ObjectTraining
from objconnect.network.segmentation import NOTHING
from objconnect.scene.bundle.scene import Scene
from objconnect.scene.errors import InputError
from tests.objconnect.network.made import pictures

STRIDE, SIDE = 4, 64


def three_objects() -> ImageObjects:
    """A square of 12 pixels, one of 5, and one at the edge whose centre lies outside."""
    labels = torch.full((SIDE, SIDE), GROUND, dtype=torch.int32)
    labels[8:20, 10:22] = 0
    labels[40:45, 30:35] = 1
    labels[50:64, 60:64] = 2
    labels[:4] = UNKNOWN
    return ImageObjects(
        labels,
        torch.tensor([7, 8, 9]),
        torch.tensor([[16.0, 14.0], [32.5, 42.5], [66.0, 57.0]]),
        torch.tensor([12.0, 5.0, 14.0]),
        torch.tensor([6.0, 1.0, 3.0]),
        torch.tensor([144, 25, 56]),
    )


def right_maps(objects: ImageObjects) -> DetectorMaps:
    """Maps that say what is true."""
    cells = cell_labels(objects.labels, STRIDE)
    height, width = cells.shape
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    middle = torch.stack([columns, rows]) + 0.5
    centre = torch.full((1, height, width), -12.0)
    for x, y in (objects.centres[:2] / STRIDE).long().tolist():
        centre[0, y, x] = 12.0
    of = cells.clamp(min=0)
    vector = torch.nn.functional.one_hot(of, 4).permute(2, 0, 1).float()
    return DetectorMaps(
        (
            centre,
            torch.where(cells >= 0, 12.0, -12.0)[None],
            ((objects.centres / STRIDE)[of].permute(2, 0, 1) - middle)[None],
            objects.sides[of].log()[None],
            (objects.rises / objects.sides)[of].log1p()[None],
            vector[None],
        )
    )


def test_cells_show_the_object_of_a_quarter_of_their_pixels() -> None:
    cells = cell_labels(three_objects().labels, STRIDE)
    assert cells.shape == (16, 16)
    assert (cells[0] == UNKNOWN).all()
    assert cells[3, 4] == 0
    assert cells[10, 8] == 1
    assert cells[14, 15] == 2
    # One row and one column of pixels of the small square reach over into other cells.
    assert cells[11, 7] == GROUND


def test_right_maps_lose_nothing_and_others_do() -> None:
    objects = three_objects()
    right = right_maps(objects)
    loss, figures = geometry_loss(right, [objects], STRIDE)
    assert float(loss) < 0.01
    assert set(figures) == {"centres", "inside", "offsets", "sides", "rises"}
    for position in range(5):
        worse = list(right)
        worse[position] = worse[position] + 2.0 if position > 1 else -worse[position]
        assert float(geometry_loss(DetectorMaps(worse), [objects], STRIDE)[0]) > 0.1


def test_right_maps_are_read_as_the_objects() -> None:
    objects = three_objects()
    found = extract_detections(right_maps(objects), STRIDE, 10, 0.5)
    order = found.side.argsort(descending=True)
    assert torch.allclose(found.xy[order], objects.centres[:2])
    assert torch.allclose(found.side[order], objects.sides[:2])
    assert torch.allclose(found.rise[order], objects.rises[:2], atol=1e-4)
    labels = label_map(right_maps(objects), found, STRIDE, STRIDE)
    cells = cell_labels(objects.labels, STRIDE)
    for number, row in enumerate(order.tolist()):
        assert torch.equal(labels == row, cells == number)
    assert (labels[cells == GROUND] == NOTHING).all()


def test_finer_labels_follow_the_object_more_closely() -> None:
    """The surer a cell is that it is inside, the nearer to the next one the object ends."""
    objects = three_objects()
    maps = right_maps(objects)
    maps.inside[0, 2:5, 5] = 4.4  # between 20 and 24; the next cell says -12
    found = extract_detections(maps, STRIDE, 10, 0.5)
    large = int((found.side == 12).nonzero())
    ends = []
    for cell in (1, 2, 4):
        labels = label_map(maps, found, STRIDE, cell)
        assert labels.shape == (SIDE // cell, SIDE // cell)
        rows, columns = (labels == large).nonzero(as_tuple=True)
        assert int(rows.min()) * cell == 8
        ends.append(int(columns.max() + 1) * cell)
    # A little over a quarter of the way from the middle of its cell, at 22, to that of the next.
    assert ends == [23, 24, 24]


def test_learned_segments_are_the_objects_of_the_blocks() -> None:
    settings = {"width": 0.125, "segmentation": "learned", "detector": {}}
    torch.manual_seed(0)
    network = ObjConnectNet(ObjConnectNetConfig.model_validate(settings)).eval()
    assert network.detector is not None
    with torch.no_grad():  # everything is inside, and some cells are centres
        network.detector.places.bias[:2] = torch.tensor([0.0, 2.0])
    images = pictures(2, 96, 128)
    labels = network.segments(images)
    assert labels.shape == (2, 48, 64)
    assert labels.max() > 0
    for number in range(2):
        alone = network.segments(images[number : number + 1])
        assert torch.equal(alone[0], labels[number])
    with torch.inference_mode():
        by_itself, objects = network.describe(images)
        given, same = network.describe(images, labels)
    assert objects is not None and same is not None
    assert torch.equal(objects.present, same.present)
    for (a, _), (b, _) in zip(by_itself, given, strict=True):
        assert torch.equal(a, b)


def test_learned_segments_need_a_detector() -> None:
    network = ObjConnectNet(ObjConnectNetConfig(width=0.125))
    with pytest.raises(InputError, match="no detector"):
        network.predict_segments(pictures(1, 32, 32))
    with pytest.raises(ValueError, match="needs a detector"):
        ObjConnectNetConfig(segmentation="learned")


def test_no_peak_is_no_object() -> None:
    maps = right_maps(three_objects())
    nothing = DetectorMaps((torch.full_like(maps.centre, -9.0), *maps[1:]))
    found = extract_detections(nothing, STRIDE, 10, 0.5)
    assert len(found) == 0
    assert (label_map(nothing, found, STRIDE, 1) == NOTHING).all()


def vectors(of: list[list[float]], objects: ImageObjects) -> Tensor:
    """(1, 2, 16, 16) vectors, those of two objects and anything elsewhere."""
    maps = torch.full((2, 16, 16), 0.5)
    for vector, (x, y) in zip(of, (objects.centres[:2] / STRIDE).long().tolist(), strict=True):
        maps[:, max(0, y - 1) : y + 2, max(0, x - 1) : x + 2] = torch.tensor(vector)[:, None, None]
    return maps[None]


def test_one_object_in_two_images_has_one_vector() -> None:
    objects = three_objects()
    right = right_maps(objects)
    doubled = [torch.cat([each, each]) for each in right[:5]]
    apart = [[1.0, 0.0], [0.0, 1.0]]

    def loss(first: list[list[float]], second: list[list[float]]) -> tuple[float, float]:
        maps = DetectorMaps([*doubled, torch.cat([vectors(v, objects) for v in (first, second)])])
        lost, share = identity_loss(maps, [objects, objects], STRIDE)
        return float(lost), share

    alike, mixed = loss(apart, apart), loss(apart, apart[::-1])
    assert alike[0] < 0.01 and alike[1] == 1.0
    assert mixed[0] > 5 and mixed[1] == 0.0
    others = objects._replace(ids=objects.ids + 100)
    maps = DetectorMaps([*doubled, torch.cat([vectors(apart, objects)] * 2)])
    assert float(identity_loss(maps, [objects, others], STRIDE)[0]) == 0


def test_levels_of_any_size_are_joined() -> None:
    network, _ = read_network(SHIPPED)
    config = DetectorConfig(size=8, vector=4)
    detector = ObjectDetector(config, network.config.strides, network.config.dims).eval()
    with torch.no_grad():
        maps = detector(network(pictures(2, 70, 100)))
    assert maps.centre.shape == (2, 16, 24)
    assert torch.allclose(maps.vector.norm(dim=1), torch.ones(2, 16, 24), atol=1e-5)


def train_detector(rendered: Scene, steps: int) -> tuple[set[str], set[str], list[float]]:
    """Names of the tensors that some steps changed, names of the figures, and the losses."""
    options = PairOptions(objects=True, heading_deg=180, max_turn_deg=180)
    source = RenderedPairs([rendered], 96, 64, 0.0, options)
    batch = collate([source.draw(np.random.default_rng(seed)) for seed in range(2)])
    network = {"detector": {"size": 16, "vector": 8}}
    training = ObjectTraining(TrainConfig(network=network, pairs=options))
    before = {k: v.clone() for k, v in training.network.state_dict().items()}
    # At 1e-2 all cells of so small a detector may die in the first steps, by rounding.
    optimizer = torch.optim.Adam(training.groups(2e-3)[0]["params"], 2e-3)
    losses, named = [], set()
    for step in range(steps):
        loss, figures = training.loss(batch, step / steps)
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        optimizer.zero_grad()
        losses.append(float(loss.detach()))
        named |= set(figures)
    after = training.network.state_dict()
    return {k for k in after if not torch.equal(after[k], before[k])}, named, losses


def test_training_changes_the_detector_alone(rendered: Scene) -> None:
    changed, figures, _ = train_detector(rendered, 2)
    assert {"centres", "identity", "top-1 accuracy"} <= figures
    assert changed and all(name.startswith("detector.") for name in changed)


@pytest.mark.thorough
def test_training_lowers_the_loss_of_the_detector(rendered: Scene) -> None:
    changed, _, losses = train_detector(rendered, 20)
    assert losses[-1] < 0.75 * losses[0]
    assert changed and all(name.startswith("detector.") for name in changed)


@pytest.mark.parametrize(
    ("objects", "says"),
    [(False, "--set pairs.objects=true"), (True, "--set photograph_share=0")],
)
def test_pairs_without_objects_are_refused_before_a_run_begins(
    rendered: Scene, tmp_path: Path, objects: bool, says: str
) -> None:
    Image.new("RGB", (256, 256)).save(tmp_path / "photograph.png")
    pairs = PairOptions(objects=objects)
    config = TrainConfig(pairs=pairs, photographs=(tmp_path,), workers=0)
    with pytest.raises(InputError, match=says):
        train("objects", ObjectTraining, [rendered.path], tmp_path / "run", config)
    assert not (tmp_path / "run").exists()
