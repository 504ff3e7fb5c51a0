"""The gate on two fixed scenes: our own recall, planted faults, and chance.

The scene ``gate`` is a town in one season, which `sift` alone localizes, for faults that leave
every network as it is. ``gate-snow`` has queries in snow over a map of the summer, and guards every
method with and without a prior. Both lie in ``benchmark/gate``; ``tests/data/make_gate.py`` makes
them. After a change that is meant to change recall, such as new weights:
``pytest tests/benchmark/test_gate.py -m "" -k has_not --update-recall``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray
from torch import Tensor
from typer.testing import CliRunner, Result

from benchmark.cli import app
from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from benchmark.evaluation.starts import parse_start
from benchmark.gate.scene import GATE_SCENES
from objconnect.localization.featuremetric import problem, references
from objconnect.localization.featuremetric.localizer import FeaturemetricLocalizer
from objconnect.localization.featuremetric.maps import Network
from objconnect.localization.matching import pnp
from objconnect.localization.matching.structure import StructureLocalizer
from objconnect.methods import create
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.localizer import Estimate, Localizer, Query, Status
from objconnect.scene.maps.features import Features
from objconnect.scene.maps.sparse_map import SparseMap

DATA: Final = Path(__file__).parents[1] / "data"
BASELINE: Final = DATA / "gate-baseline"
SNOW_BASELINE: Final = DATA / "gate-snow-baseline"
# Told the pose with an error: small, about as far as one alignment reaches, too large for one; told
# nothing. From nearer `pixloc` hardly misses its coarsest level, and `objconnect` its many starts.
STARTS: Final = {
    "near": "error=3m,5deg",
    "reach": "error=5m,5deg",
    "far": "error=13m,10deg",
    "none": "none",
    "search": "none",
}
# Objects find most places, and would hide that the place search is lost: there it is asked alone.
OPTIONS: Final[dict[tuple[str, str], dict[str, Any]]] = {
    ("objconnect", "search"): {"objects": None},
}
# All but the quick one are thorough. Told nothing, `d2net` and `pixloc` find no query of either
# season: these networks know no heading.
QUICK: Final = ("pixloc", "reach")
THOROUGH: Final = (
    ("sift", "near"),
    ("sift", "none"),
    ("d2net", "near"),
    ("objconnect", "far"),
    ("objconnect", "search"),
)
GUARDED: Final = [
    QUICK,
    *(pytest.param(*guarded, marks=pytest.mark.thorough) for guarded in THOROUGH),
]

pytestmark = pytest.mark.usefixtures("extracted_once")


@pytest.fixture(scope="module")
def gate() -> Dataset:
    (dataset,) = open_datasets(GATE_SCENES["gate"])
    return dataset


@pytest.fixture(scope="module")
def snow() -> Dataset:
    (dataset,) = open_datasets(GATE_SCENES["gate-snow"])
    return dataset


class Remembering:
    """An extractor of local features that extracts those of a picture once."""

    def __init__(self, extractor: Any, known: dict[bytes, Features]) -> None:
        self._extractor, self._known = extractor, known

    def __getattr__(self, name: str) -> Any:
        return getattr(self._extractor, name)

    def __call__(self, rgb: Any) -> Features:
        key = rgb.tobytes()
        if key not in self._known:
            self._known[key] = self._extractor(rgb)
        return self._known[key]


@pytest.fixture(scope="module")
def make() -> Iterator[Callable[..., Localizer]]:
    """Makes a method; what it extracts of queries serves all tests, as far as it is local."""
    known: dict[str, dict[bytes, Features]] = {}

    def create_remembering(method: str, **options: Any) -> Localizer:
        localizer = create(method, options)
        if isinstance(localizer, StructureLocalizer):
            remembered = known.setdefault(method, {})
            localizer._extractor = Remembering(localizer._extractor, remembered)  # type: ignore[assignment]
        return localizer

    yield create_remembering
    known.clear()


class Faulty:
    """A method with something between it and its queries."""

    def __init__(self, localizer: Localizer, fault: Callable[[Query], Query | None]) -> None:
        self.name, self.config = localizer.name, localizer.config
        self.weights_sha256 = localizer.weights_sha256
        self._localizer, self._fault = localizer, fault

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        self._localizer.prepare(sparse_map, images, cache)

    def localize(self, query: Query) -> Estimate:
        changed = self._fault(query)
        if changed is None:
            return Estimate(Status.FAILED, reason="dropped")
        return self._localizer.localize(changed)


def regress(results: Path, baseline: Path = BASELINE) -> Result:
    return CliRunner().invoke(app, ["regress", str(results), "--against", str(baseline)])


@pytest.mark.thorough
def test_recall_has_not_dropped(
    gate: Dataset,
    make: Callable[..., Localizer],
    tmp_path: Path,
    cache: Path,
    no_recall_drop: Callable[[Path, Path], None],
) -> None:
    evaluate(gate, make("sift"), tmp_path, cache=cache)
    no_recall_drop(tmp_path, BASELINE)


def two_pixels(query: Query) -> Query:
    fx, fy, cx, cy, *rest = query.camera.params
    camera = query.camera
    biased = Camera(camera.model, camera.width, camera.height, (fx, fy, cx + 2, cy + 2, *rest))
    return replace(query, camera=biased)


@pytest.mark.thorough
def test_a_bias_of_two_pixels_is_caught(
    gate: Dataset, make: Callable[..., Localizer], tmp_path: Path, cache: Path
) -> None:
    evaluate(gate, Faulty(make("sift"), two_pixels), tmp_path, cache=cache)
    answer = regress(tmp_path)
    assert answer.exit_code == 1
    assert "DROP sift on gate (flight), all, 0.25m_2deg: -" in answer.stdout


@pytest.mark.thorough
def test_one_query_in_ten_dropped_is_caught(
    gate: Dataset, make: Callable[..., Localizer], tmp_path: Path, cache: Path
) -> None:
    dropped = {query.name for query in gate.queries[::10]}
    faulty = Faulty(make("sift"), lambda q: None if q.name in dropped else q)
    evaluate(gate, faulty, tmp_path, cache=cache)
    answer = regress(tmp_path)
    assert answer.exit_code == 1
    assert "DROP sift on gate" in answer.stdout


@pytest.mark.thorough
def test_swapped_cameras_are_caught(
    gate: Dataset, make: Callable[..., Localizer], tmp_path: Path, cache: Path
) -> None:
    first, second = dict.fromkeys(query.camera for query in gate.queries)
    other = {first: second, second: first}
    faulty = Faulty(make("sift"), lambda q: replace(q, camera=other[q.camera]))
    evaluate(gate, faulty, tmp_path, cache=cache)
    answer = regress(tmp_path)
    assert answer.exit_code == 1
    assert "DROP sift on gate" in answer.stdout


def record(method: str, start: str) -> Path:
    """The folder of the recorded results of a method in snow."""
    return SNOW_BASELINE / f"{method}-{start}"


@pytest.mark.parametrize(("method", "start"), GUARDED)
def test_recall_in_snow_has_not_dropped(
    method: str,
    start: str,
    snow: Dataset,
    make: Callable[..., Localizer],
    tmp_path: Path,
    cache: Path,
    no_recall_drop: Callable[[Path, Path], None],
) -> None:
    localizer = make(method, **OPTIONS.get((method, start), {}))
    evaluate(snow, localizer, tmp_path, parse_start(STARTS[start]), cache)
    no_recall_drop(tmp_path, record(method, start))


class Lost:
    """A network whose features of one level say nothing."""

    def __init__(self, network: Network, level: int) -> None:
        self.config, self.damping = network.config, network.damping
        self._network, self._level = network, level

    def __call__(
        self, image: Tensor, *, levels: int | None = None, needed: NDArray[np.bool_] | None = None
    ) -> list[tuple[Tensor, Tensor]]:
        # All levels at once: half precision is on only while the network is called.
        return [
            (features * (level != self._level), confidence)
            for level, (features, confidence) in enumerate(
                self._network(image, levels=levels, needed=needed)
            )
        ]


@pytest.mark.thorough
@pytest.mark.parametrize(("method", "start"), [("objconnect", "far"), ("pixloc", "reach")])
def test_a_lost_level_of_the_network_is_caught(
    method: str, start: str, snow: Dataset, tmp_path: Path
) -> None:
    """Its own cache: the file of the weights, by which a cache goes, has not changed."""
    lossy = create(method, {})
    assert isinstance(lossy, FeaturemetricLocalizer)
    lossy._extract.network = Lost(lossy._extract.network, level=0)
    evaluate(snow, lossy, tmp_path, parse_start(STARTS[start]))
    answer = regress(tmp_path, record(method, start))
    assert answer.exit_code == 1, answer.stdout


@pytest.mark.thorough
def test_multistart_off_is_caught(snow: Dataset, tmp_path: Path, cache: Path) -> None:
    off = create("objconnect", {"multistart": False})
    evaluate(snow, off, tmp_path, parse_start(STARTS["far"]), cache)
    answer = regress(tmp_path, record("objconnect", "far"))
    assert answer.exit_code == 1, answer.stdout
    assert "DROP objconnect on gate-snow (flight), all, 0.5m_5deg: -" in answer.stdout


@pytest.mark.slow
def test_no_place_search_is_caught(snow: Dataset, tmp_path: Path, cache: Path) -> None:
    off = create("objconnect", {"objects": None, "place": {"candidates": 0}})
    evaluate(snow, off, tmp_path, parse_start(STARTS["search"]), cache)
    answer = regress(tmp_path, record("objconnect", "search"))
    assert answer.exit_code == 1, answer.stdout


@pytest.mark.thorough
def test_photographs_not_turned_north_up_are_caught(
    snow: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (problem, references):
        monkeypatch.setattr(module, "north_angle", lambda _: 0.0)
    evaluate(snow, create("pixloc", {}), tmp_path, parse_start(STARTS["reach"]))
    answer = regress(tmp_path, record("pixloc", "reach"))
    assert answer.exit_code == 1, answer.stdout
    assert "DROP pixloc on gate-snow (flight), snow-dusk" in answer.stdout


@pytest.mark.slow
def test_another_seed_is_not_flagged_in_twenty_of_twenty(
    gate: Dataset,
    make: Callable[..., Localizer],
    tmp_path: Path,
    cache: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for seed in range(1, 21):
        monkeypatch.setattr(pnp, "_SEED", seed)
        evaluate(gate, make("sift"), tmp_path, cache=cache)
        answer = regress(tmp_path)
        assert answer.exit_code == 0, f"seed {seed}:\n{answer.stdout}"


def last_bits(seed: int) -> Callable[[Query], Query]:
    """Give every last bit of a picture at random: far more than processors differ by."""

    def reseed(query: Query) -> Query:
        rng = np.random.default_rng([seed, *query.name.encode()])
        noise = rng.integers(0, 2, query.image.shape, np.uint8)
        return replace(query, image=(query.image & np.uint8(0xFE)) | noise)

    return reseed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "start"),
    [("sift", "near"), ("d2net", "near"), ("pixloc", "reach"), ("objconnect", "far")],
)
def test_other_last_bits_are_not_flagged_in_twenty_of_twenty(
    method: str,
    start: str,
    snow: Dataset,
    tmp_path: Path,
    cache: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """RANSAC draws by another seed, too."""
    for seed in range(1, 21):
        monkeypatch.setattr(pnp, "_SEED", seed)
        localizer = create(method, OPTIONS.get((method, start), {}))
        noisy = Faulty(localizer, last_bits(seed))
        evaluate(snow, noisy, tmp_path, parse_start(STARTS[start]), cache)
        answer = regress(tmp_path, record(method, start))
        assert answer.exit_code == 0, f"seed {seed}:\n{answer.stdout}"
