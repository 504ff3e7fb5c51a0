"""The networks of kornia: ALIKED and DISK extract keypoints, and LightGlue matches them.

ALIKED: Zhao et al., IEEE TIM 2023. DISK: Tyszkiewicz et al., NeurIPS 2020. LightGlue: Lindenberger
et al., ICCV 2023. The weights come from files, or kornia downloads them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from torch import Tensor, nn

from baselines.lightglue.known_files import require_network
from objconnect.learning.checkpoint import load_into, read_weights
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.extras import import_extra
from objconnect.scene.storage.digests import sha256

# Key of the tensors in a checkpoint of DISK's authors.
_GROUP: Final = "extractor"
# Buffers that kornia computes and the authors' files lack.
_DERIVED: Final = frozenset({"dkd.hw_grid", "confidence_thresholds"})
# In the first release of LightGlue's weights, the number of a layer follows the name of its block.
_OLD_LAYER: Final = re.compile(r"^(self_attn|cross_attn)\.(\d+)\.")
# Tensors of that release that LightGlue does not use.
_UNUSED: Final = re.compile(r"^log_assignment\.\d+\.r$")
# Number of channels of the descriptors of ALIKED and DISK.
_DESCRIPTOR: Final = 128


def import_kornia(method: str) -> ModuleType:
    """Import the module ``kornia.feature``.

    Raises:
        InputError: kornia is not installed.
    """
    return import_extra("kornia.feature", "kornia", f"--method {method}")


def create_aliked(kornia: ModuleType, model: str, limit: int, path: Path | None) -> nn.Module:
    """Return ALIKED.

    Args:
        kornia: the module ``kornia.feature``.
        model: variant, such as ``aliked-n16``.
        limit: maximum number of keypoints of an image.
        path: file of its weights; None lets kornia download them.

    Raises:
        InputError: the file holds no weights, or weights of another network, or the download
            fails.
    """
    if path is None:
        return _download(
            lambda: kornia.ALIKED.from_pretrained(model, max_num_keypoints=limit), model
        )
    return _load(kornia.ALIKED(model, max_num_keypoints=limit), path, f"ALIKED {model}")


def create_disk(kornia: ModuleType, model: str, path: Path | None) -> nn.Module:
    """Return DISK.

    Args:
        kornia: the module ``kornia.feature``.
        model: variant, such as ``depth``.
        path: file of its weights; None lets kornia download them.

    Raises:
        InputError: the file holds no weights, or weights of another network, or the download
            fails.
    """
    if path is None:
        return _download(lambda: kornia.DISK.from_pretrained(model), f"DISK ({model})")
    return _load(kornia.DISK(), path, f"DISK {model}")


def create_lightglue(
    kornia: ModuleType, features: str, min_confidence: float, path: Path | None
) -> nn.Module:
    """Return LightGlue.

    Args:
        kornia: the module ``kornia.feature``.
        features: the features that LightGlue was trained for, by kornia's name.
        min_confidence: minimum confidence of a match.
        path: file of its weights; None lets kornia download them.

    Raises:
        InputError: the file holds no weights, or weights of another network, or the download
            fails.
    """
    if path is None:
        return _download(
            lambda: kornia.LightGlue(features, filter_threshold=min_confidence),
            f"LightGlue ({features})",
        )
    network = kornia.LightGlue(None, input_dim=_DESCRIPTOR, filter_threshold=min_confidence)
    return _load(network, path, f"LightGlue {features}")


def digest_weights(*networks: nn.Module) -> str:
    """Return a digest of the tensors of networks; it is the same for a file and a download."""
    pieces: list[Any] = []
    for network in networks:
        for name, value in sorted(network.state_dict().items()):
            pieces += [name, value.detach().cpu().numpy()]
    return sha256(*pieces)


def _load(network: nn.Module, path: Path, name: str) -> nn.Module:
    """Load a file of weights; every tensor of network and file must have its counterpart."""
    weights = read_weights(path, _GROUP)
    require_network(path, weights.sha256, name)
    created = network.state_dict()
    derived = {name: created[name] for name in _DERIVED & created.keys()}
    load_into(network, derived | _rename(weights.tensors), path)
    return network.eval()


def _rename(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return tensors by the names of the present release of LightGlue."""
    return {
        _OLD_LAYER.sub(r"transformers.\2.\1.", name): value
        for name, value in tensors.items()
        if not _UNUSED.match(name)
    }


def _download(create: Callable[[], nn.Module], what: str) -> nn.Module:
    try:
        return create().eval()
    except Exception as error:  # kornia passes on errors of urllib and torch
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(
            f"kornia cannot download the weights of {what}: {reason}; give files with --set "
            "weights=FILE and --set matcher_weights=FILE"
        ) from error
