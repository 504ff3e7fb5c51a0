"""Ours held to what the authors' code gave for the same weights and pictures; see ``official``."""

from __future__ import annotations

from argparse import Namespace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.d2net.detection import detect
from baselines.d2net.loss import ImagePoints, triplet_loss
from baselines.d2net.network import (
    D2Net,
    D2NetNetConfig,
    DenseD2Net,
    read_network,
    soft_scores,
)
from tests.baselines.d2net import official


@pytest.fixture(scope="module")
def recorded() -> dict[str, NDArray[Any]]:
    with np.load(official.RECORDED) as file:
        return dict(file)


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> D2Net:
    """Read from a checkpoint as the authors' training writes it."""
    path = tmp_path_factory.mktemp("weights") / "d2.pth"
    torch.save(
        {
            "args": Namespace(lr=1e-3, plot=False),
            "epoch_idx": 1,
            "model": official.tensors(),
            "train_loss_history": [np.mean([0.5, 0.25])],
        },
        path,
    )
    return read_network(path)[0]


def image(picture: NDArray[np.uint8]) -> Tensor:
    return torch.from_numpy(picture.copy()).permute(2, 0, 1).float() / 255


def close(ours: Tensor, theirs: NDArray[np.float32]) -> None:
    """To 1e-4 of the standard deviation, which is the second of what ``sampled`` keeps."""
    difference = np.abs(official.sample(ours) - theirs)
    assert difference.max() < 1e-4 * theirs[1]


def test_dense_features_are_the_authors(network: D2Net, recorded: dict[str, NDArray[Any]]) -> None:
    picture = image(official.pictures()[0])[None]
    close(DenseD2Net(network, "float32")(picture), recorded["dense"])
    close(network(picture), recorded["trained"])


def test_soft_scores_are_the_authors(network: D2Net, recorded: dict[str, NDArray[Any]]) -> None:
    scores = soft_scores(network(image(official.pictures()[0])[None]))[0].numpy()
    assert np.abs(scores / recorded["soft"] - 1).max() < 1e-4


@pytest.mark.parametrize(("name", "height", "width", "scales"), official.DETECTED)
def test_keypoints_are_the_authors(
    network: D2Net,
    recorded: dict[str, NDArray[Any]],
    name: str,
    height: int,
    width: int,
    scales: tuple[float, ...],
) -> None:
    picture = image(official.pictures()[0][:height, :width])
    ours = detect(DenseD2Net(network, "float32"), picture, scales)
    theirs = recorded[f"{name}_yx"]
    assert len(ours.xy) == len(theirs)

    # Theirs takes the cell (0, 0) of a level to the pixel 1.5 and each level for a magnification;
    # ours says what the network and the resampling do (see the documentation). Undo and redo.
    placed = np.empty((len(theirs), 2))
    for scale in scales:
        for axis, size in enumerate((width, height)):
            level = int(size * scale)
            of_level = theirs[:, 2] == 1 / scale
            cell = (theirs[of_level, 1 - axis] * level / size - 1.5) / 4
            placed[of_level, axis] = (4 * cell + 3.5) * (size - 1) / (level - 1) + 0.5
    order, their_order = (
        np.lexsort((np.round(xy[:, 0], 2), np.round(xy[:, 1], 2), scale))
        for xy, scale in ((ours.xy.numpy(), ours.scale.numpy()), (placed, theirs[:, 2]))
    )
    # To 1e-4 of a cell, which is four pixels wide or more.
    assert np.abs(ours.xy.numpy()[order] - placed[their_order]).max() < 4e-4
    assert np.array_equal(ours.scale.numpy()[order], theirs[their_order, 2])
    scores = recorded[f"{name}_scores"][their_order]
    assert np.abs(ours.scores.numpy()[order] / scores - 1).max() < 1e-4
    descriptors = recorded[f"{name}_descriptors"][their_order]
    assert np.abs(ours.descriptors.numpy()[order, :: official.CHANNELS] - descriptors).max() < 1e-4


def test_the_loss_and_its_gradient_are_the_authors(recorded: dict[str, NDArray[Any]]) -> None:
    network = D2Net(D2NetNetConfig())
    network.load_state_dict(official.tensors())
    last = network.dense_feature_extraction.get_parameter("model.21.weight")
    network.requires_grad_(False)
    last.requires_grad_()
    features = network(torch.stack([image(picture) for picture in official.pictures()]))
    scores = soft_scores(features)
    moved = official.SHIFT // 8
    rows, columns = torch.meshgrid(torch.arange(12), torch.arange(moved, 16), indexing="ij")
    cells = torch.stack([columns, rows], -1).reshape(-1, 2) + 0.5
    away = torch.tensor([float(moved), 0])
    found = triplet_loss(
        ImagePoints(features[0], scores[0], cells),
        ImagePoints(features[1], scores[1], cells - away),
    )
    found.loss.backward()
    assert found.loss.item() == pytest.approx(float(recorded["loss"]), rel=1e-5)
    assert last.grad is not None
    close(last.grad, recorded["gradient"])
