"""The training loop of all methods, in one or several processes; interrupted runs resume."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
import torch
from pydantic import BaseModel, TypeAdapter, ValidationError
from torch import Tensor, distributed, nn
from torch.utils.data import DataLoader, Dataset

from objconnect.learning.checkpoint import describe_fault, write_weights
from objconnect.learning.training.config import TrainConfig
from objconnect.learning.training.curves import draw_curves
from objconnect.learning.training.pairs import Pair, PairBatch, PairSource, collate
from objconnect.scene.config import take_recorded
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.device import torch_device
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import atomic_write, write_text
from objconnect.scene.storage.files import parse_json, read_text
from objconnect.scene.storage.resumable import ResumableFolder

WEIGHTS: Final = "weights.safetensors"
LOG: Final = "log.jsonl"
_CHECKPOINT = "checkpoint.pt"
_RUN = "run.json"
_CURVES = "curves.png"
# Settings that may differ when a run resumes, because they do not change the weights.
_FREE_SETTINGS: Final = ("workers", "device", "save_every", "validate_every")
# Number of steps in which the learning rate rises to its maximum.
_RISE_STEPS: Final = 50
# Weight decay, and the norm to which larger gradients are clipped.
_DECAY: Final = 1e-4
_MAX_GRADIENT: Final = 5.0
# Number of batches of a validation.
_VALIDATION_BATCHES = 8
# Seed of the validation pairs, which are the same in all runs.
_VALIDATION_SEED = 987654321


class Trainable(Protocol):
    """A method that can be trained."""

    @property
    def network(self) -> nn.Module:
        """Return the network that is trained and written as weights."""
        ...

    @property
    def network_config(self) -> BaseModel:
        """Return the configuration of the network, which is written with the weights."""
        ...

    def loss(self, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
        """Return the loss of a batch, and values for the log by name.

        Args:
            batch: pairs of images.
            progress: 0 at the first step, 1 after the last.
        """
        ...

    def groups(self, rate: float) -> list[dict[str, Any]]:
        """Return parameter groups with learning rates for torch's optimizers."""
        ...


class _PairDataset(Dataset[Pair]):
    """The pairs of a run, drawn from sources by shares. Seed and index determine a pair."""

    def __init__(self, sources: Sequence[PairSource], shares: Sequence[float], seed: int) -> None:
        self._sources, self._shares, self._seed = sources, shares, seed

    def __getitem__(self, index: int) -> Pair:
        rng = np.random.default_rng([self._seed, index])
        return self._sources[rng.choice(len(self._sources), p=self._shares)].draw(rng)


class _BatchIndices:
    """The indices of the pairs of steps ``first`` to ``last`` - 1, batch by batch, for one process.

    ``rank`` is the number of the process among ``world`` processes.
    """

    def __init__(self, first: int, last: int, batch: int, rank: int, world: int) -> None:
        self._steps, self._batch, self._rank, self._world = range(first, last), batch, rank, world

    def __iter__(self) -> Iterator[list[int]]:
        for step in self._steps:
            start = (step * self._world + self._rank) * self._batch
            yield list(range(start, start + self._batch))

    def __len__(self) -> int:
        return len(self._steps)


@dataclass(frozen=True)
class PairSources:
    """The sources of the pairs of a run.

    Attributes:
        rendered: pairs of frames of the scenes.
        photographs: pairs made of single photographs; None for none.
        validation: pairs of frames of validation scenes; None for no validation.
    """

    rendered: PairSource
    photographs: PairSource | None = None
    validation: PairSource | None = None

    def draw(self, photograph_share: float, seed: int) -> _PairDataset:
        """Return the training pairs; without photographs, all are rendered."""
        if self.photographs is None:
            return _PairDataset([self.rendered], [1.0], seed)
        shares = [1 - photograph_share, photograph_share]
        return _PairDataset([self.rendered, self.photographs], shares, seed)


def train_loop(
    method: Trainable,
    config: TrainConfig,
    sources: PairSources,
    out: Path,
    description: Mapping[str, Any],
) -> Path:
    """Train a method, or resume its interrupted training, and write the weights.

    The seed determines every pair, so that a resumed run has the same pairs as an uninterrupted
    one. Under ``torchrun`` each process takes its share of the pairs.

    Args:
        method: the method to train.
        config: configuration of the training.
        sources: pairs of the training and of the validation.
        out: folder of the run: checkpoint, log, curves, weights.
        description: further values that describe the run. A folder of a run with other values
            is refused.

    Returns:
        The file of the weights.

    Raises:
        InputError: ``out`` belongs to another run, holds other files, has a damaged checkpoint or
            log, or cannot be written; or a data loading process died.
    """
    device = torch_device(config.device)
    rank, world = join(device)
    if config.device == "cuda":
        device = torch.device("cuda", rank % torch.cuda.device_count())
    _claim(out, {"config": config.model_dump(mode="json"), **description}, rank)
    method.network.to(device)
    # torch's annotations lack this argument.
    network = method.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(method.groups(config.rate), weight_decay=_DECAY)
    peaks = [group["lr"] for group in optimizer.param_groups]
    first = _restore(out / _CHECKPOINT, network, optimizer, device)
    borders = sorted({0, round(config.warm_up * config.steps), config.steps})
    bar = progress_bar("training", config.steps)
    with _report_dead_worker(), _log(out / LOG, first, rank) as log, bar as advance:
        for begin, end in pairwise(borders):
            share = config.photograph_share * (1 if begin == 0 else 0.5)
            drawn = sources.draw(share, config.seed)
            start = max(first, begin)
            indices = _BatchIndices(start, max(start, end), config.batch, rank, world)
            loader = _loader(drawn, indices, config.workers)
            wait_start = time.perf_counter()
            for step, batch in enumerate(loader, start):
                step_start = time.perf_counter()
                _schedule(optimizer, peaks, step, config)
                torch.manual_seed(config.seed * 1_000_003 + step * world + rank)
                loss, figures = _step(method, batch.to(device), step / config.steps)
                loss.backward()  # type: ignore[no-untyped-call]
                _average_gradients(network, world)
                norm = nn.utils.clip_grad_norm_(network.parameters(), _MAX_GRADIENT)
                if torch.isfinite(norm):
                    optimizer.step()
                optimizer.zero_grad()
                spent = time.perf_counter() - step_start
                seconds = {"waited": step_start - wait_start, "seconds": spent}
                log(step, figures | {"norm": float(norm), **seconds})
                done = step + 1
                is_validation_step = done % config.validate_every == 0 or done == config.steps
                if sources.validation is not None and is_validation_step:
                    progress = done / config.steps
                    log(step, _validate(method, sources.validation, config, device, progress))
                if rank == 0 and (done % config.save_every == 0 or done == config.steps):
                    _save(out / _CHECKPOINT, network, optimizer, done)
                    draw_curves(out / LOG, out / _CURVES)
                advance(done)
                wait_start = time.perf_counter()
    if rank == 0:
        write_weights(out / WEIGHTS, network, method.network_config.model_dump(mode="json"))
    if world > 1:
        distributed.barrier()
    return out / WEIGHTS


class Processes(NamedTuple):
    """The rank of this process and the number of processes that train together."""

    rank: int
    world: int


def join(device: torch.device) -> Processes:
    """Connect to the other processes of ``torchrun``, if any, by NCCL on CUDA or else by Gloo."""
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if world > 1 and not distributed.is_initialized():
        distributed.init_process_group("nccl" if device.type == "cuda" else "gloo")
    return Processes(int(os.environ.get("RANK", "0")), world)


def _claim(out: Path, run: Mapping[str, Any], rank: int) -> None:
    """Claim the folder for this run, or resume the run that it holds.

    Runs with different numbers of steps are different, because the learning rate depends on it.
    """
    folder = _resumable(out, run)
    if folder.can_resume(
        lambda difference: (
            f"{out} holds a run with another {difference}: give the same to resume that run, or "
            "another folder for a new one"
        )
    ):
        return
    if rank == 0:
        folder.require_empty("training run")
        folder.begin()


def _resumable(out: Path, run: Mapping[str, Any]) -> ResumableFolder:
    """Return the folder of a run, which compares its record with the description ``run``."""
    request = json.dumps(run, indent=2, sort_keys=True) + "\n"

    def difference(record: Path) -> str | None:
        """Return the first key of ``run`` that differs from the record; None if none does."""
        text = read_text(record, "description of the run")
        try:
            recorded = parse_json(text)
            # Settings that did not exist when the run began have their defaults. Settings that
            # this version does not have are ignored.
            settings = take_recorded(TrainConfig, dict(recorded["config"]))
            recorded["config"] = TrainConfig.model_validate(settings).model_dump(mode="json")
            recorded["config"] |= {name: run["config"][name] for name in _FREE_SETTINGS}
        except (ValueError, KeyError, TypeError):
            raise InputError(f"{record} is damaged: name another folder, or remove {out}") from None
        wanted = json.loads(request)
        return next((key for key in run if recorded.get(key) != wanted[key]), None)

    return ResumableFolder(out, out / _RUN, request, difference)


def _loader(drawn: _PairDataset, indices: _BatchIndices, workers: int) -> DataLoader[Pair]:
    # A forked worker would inherit the locks of torch's threads, which may be locked.
    return DataLoader(
        drawn,
        batch_sampler=indices,
        collate_fn=collate,
        num_workers=workers,
        multiprocessing_context="spawn" if workers else None,
        prefetch_factor=3 if workers else None,
    )


@contextmanager
def _report_dead_worker() -> Iterator[None]:
    """Report the death of a data loading process in an error message of one line."""
    try:
        yield
    except RuntimeError as error:
        if "DataLoader worker" not in str(error):
            raise
        raise InputError(
            f"a data loading process died ({str(error).splitlines()[0]}): run the same command to "
            "resume from the last checkpoint; give fewer workers if memory ran out"
        ) from error


def _step(method: Trainable, batch: PairBatch, progress: float) -> tuple[Tensor, dict[str, float]]:
    method.network.train()
    return method.loss(batch, progress)


@torch.no_grad()
def _validate(
    method: Trainable,
    source: PairSource,
    config: TrainConfig,
    device: torch.device,
    progress: float,
) -> dict[str, float]:
    """Return the means of the logged values over pairs that are the same in each validation."""
    method.network.eval()
    rng_state = torch.random.get_rng_state()
    torch.manual_seed(_VALIDATION_SEED)
    drawn = _PairDataset([source], [1.0], _VALIDATION_SEED)
    total: dict[str, list[float]] = {}
    for number in range(_VALIDATION_BATCHES):
        pairs = [drawn[number * config.batch + k] for k in range(config.batch)]
        for name, value in method.loss(collate(pairs).to(device), progress)[1].items():
            total.setdefault(name, []).append(value)
    torch.random.set_rng_state(rng_state)
    return {f"val/{name}": float(np.mean(values)) for name, values in total.items()}


def _schedule(
    optimizer: torch.optim.Optimizer, peaks: Sequence[float], step: int, config: TrainConfig
) -> None:
    """Set the learning rates: a linear rise at first, times a cosine from 1 to 1 / 100."""
    rise = min(1.0, (step + 1) / _RISE_STEPS)
    fall = 0.505 + 0.495 * math.cos(math.pi * step / config.steps)
    for group, peak in zip(optimizer.param_groups, peaks, strict=True):
        group["lr"] = peak * rise * fall


def _average_gradients(network: nn.Module, world: int) -> None:
    """Average gradients over the processes. A missing gradient is taken as zero."""
    if world == 1:
        return
    for parameter in network.parameters():
        if parameter.grad is None:
            parameter.grad = torch.zeros_like(parameter)
        distributed.all_reduce(parameter.grad)
        parameter.grad /= world


def _save(path: Path, network: nn.Module, optimizer: torch.optim.Optimizer, done: int) -> None:
    state = {"network": network.state_dict(), "optimizer": optimizer.state_dict(), "done": done}
    with atomic_write(path) as partial:
        torch.save(state, partial)


def _restore(
    path: Path, network: nn.Module, optimizer: torch.optim.Optimizer, device: torch.device
) -> int:
    """Restore a checkpoint, if there is one; return the number of finished steps."""
    if not path.is_file():
        return 0
    try:
        state = torch.load(path, map_location=device, weights_only=True)
        network.load_state_dict(state["network"])
        optimizer.load_state_dict(state["optimizer"])
        return int(state["done"])
    except Exception as error:
        raise InputError(
            f"{path} is damaged ({describe_fault(error)}): remove it to begin again"
        ) from error


_LOG_LINE: Final = TypeAdapter(dict[str, float])


def _read_log(path: Path, until: int) -> Iterator[str]:
    """Yield the complete lines of a log whose step is before ``until``."""
    for number, line in enumerate(read_text(path, "training log").splitlines(), 1):
        if not line.endswith("}"):
            continue
        try:
            step = _LOG_LINE.validate_json(line)["step"]
        except (ValidationError, KeyError):
            raise InputError(
                f"line {number} of {path} is damaged: remove the line, or the whole log to begin a "
                "new one"
            ) from None
        if step < until:
            yield line


class _Logger(Protocol):
    def __call__(self, step: int, figures: Mapping[str, float]) -> None: ...


@contextmanager
def _log(path: Path, first: int, rank: int) -> Iterator[_Logger]:
    """Remove steps from ``first`` on from a log, and yield a function that appends a line to it."""
    if rank > 0:
        yield lambda step, figures: None
        return
    kept = _read_log(path, first) if path.is_file() else ()
    write_text(path, "".join(f"{line}\n" for line in kept))
    with path.open("a") as file:

        def log(step: int, figures: Mapping[str, float]) -> None:
            rounded = {name: float(f"{value:.5g}") for name, value in figures.items()}
            file.write(json.dumps({"step": step, **rounded}) + "\n")
            file.flush()

        yield log
