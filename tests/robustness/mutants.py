"""Mutation tests: changes of single lines of the methods that the tests must notice.

    python -m tests.robustness.mutants [NAME...]

Each mutant is one changed text in a copy of the working tree, and the tests that must fail there.
On the unchanged copy the same tests must pass. What every loss, normalisation, detachment and
shipped default is for stands here once more, as the fault that its absence would be.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Final, NamedTuple

import pytest

ROOT: Final = Path(__file__).resolve().parents[2]
# What a test of the methods reads of the tree.
_READ: Final = ("objconnect", "simulate", "baselines", "benchmark")
_ALSO: Final = ("tests", "experiments", "pyproject.toml")
# Imported once, before the processes of the mutants begin: most of the time of a short test.
_SLOW_TO_IMPORT: Final = ("torch", "cv2", "skimage.segmentation", "hypothesis", "matplotlib.pyplot")


class Mutant(NamedTuple):
    """A fault.

    Attributes:
        name: what is wrong with it.
        file: of the tree.
        old: text that the file holds exactly once.
        new: what it becomes.
        killed_by: tests that fail, each with all of its parameters or with those in brackets.
    """

    name: str
    file: str
    old: str
    new: str
    killed_by: tuple[str, ...]


_TRAINING: Final = "tests/objconnect/network/test_training.py"
_NETWORK: Final = "tests/objconnect/network/test_network.py"
_FPN: Final = "tests/objconnect/network/test_fpn.py"
_LOCALIZER: Final = "tests/objconnect/network/test_localizer.py"
_PIXLOC: Final = "tests/baselines/pixloc/test_training.py"
_NEIGHBOURS: Final = "tests/objconnect/localization/depth/test_neighbours.py"
_CONTRAST: Final = "tests/objconnect/learning/training/test_contrastive.py"
_D2NET: Final = "tests/baselines/d2net/test_training.py"
_VGG: Final = "tests/objconnect/learning/test_vgg.py"
_STARTS: Final = "tests/objconnect/localization/align/test_hypotheses.py"

MUTANTS: Final = (
    Mutant(
        "objconnect learns nothing by the distance of features",
        "objconnect/network/loss.py",
        "loss = contrast + options.feature_share * features",
        "loss = contrast + 0.0 * features",
        (f"{_TRAINING}::test_the_loss_is_the_sum_of_its_parts",),
    ),
    Mutant(
        "objconnect learns nothing by the pose",
        "objconnect/network/loss.py",
        "loss + options.pose_share * poses",
        "loss + 0.0 * poses",
        (f"{_TRAINING}::test_the_loss_is_the_sum_of_its_parts[0.5-slic]",),
    ),
    Mutant(
        "the confidence of places is not taught",
        "objconnect/localization/featuremetric/training.py",
        "options.trust_share * confidence_loss",
        "0.0 * confidence_loss",
        (
            f"{_PIXLOC}::test_the_loss_is_the_sum_of_its_parts",
            f"{_PIXLOC}::test_confidence_learns_where_places_are_found_again",
        ),
    ),
    Mutant(
        "the pyramid has no path from coarse to fine",
        "objconnect/network/fpn.py",
        "step = lateral(blocks[-1 - number][..., :height, :width]) + up",
        "step = lateral(blocks[-1 - number][..., :height, :width])",
        (
            f"{_FPN}::test_fine_levels_see_what_only_the_coarsest_block_shows",
            f"{_FPN}::test_levels_are_laterals_plus_the_coarser_step_smoothed",
        ),
    ),
    Mutant(
        "the pyramid does not smooth",
        "objconnect/network/fpn.py",
        "yield smooth[number](step)",
        "yield step",
        (f"{_FPN}::test_what_one_cell_shows_is_smoothed_over_its_neighbours",),
    ),
    Mutant(
        "the vectors of V are means over objects",
        "objconnect/network/network.py",
        "vectors = sample(maps, cells)",
        "vectors = occupied.mean(maps.flatten(2).mT)",
        (f"{_NETWORK}::test_vectors_are_the_features_at_the_centre_not_their_mean",),
    ),
    Mutant(
        "trust bends the features",
        "objconnect/network/network.py",
        "self.trust(vectors.detach())",
        "self.trust(vectors)",
        (f"{_NETWORK}::test_trust_judges_features_and_does_not_bend_them",),
    ),
    Mutant(
        "picture b is given the segments of a",
        "objconnect/network/training.py",
        "labels = self._segments(images)",
        "labels = self._segments(images)\n"
        "        labels = labels if labels is None else labels.chunk(2)[0].repeat(2, 1, 1)",
        (f"{_TRAINING}::test_each_picture_is_cut_into_its_own_segments",),
    ),
    Mutant(
        "points in picture b are asked for the objects of a",
        "objconnect/network/training.py",
        "sample_pixels(b, batch.image_b, batch.xy_b)",
        "sample_pixels(a, batch.image_b, batch.xy_b)",
        (f"{_TRAINING}::test_each_picture_is_cut_into_its_own_segments",),
    ),
    Mutant(
        "photographs that share no points are never neighbours",
        "objconnect/localization/depth/neighbours.py",
        "        if len(chosen) < self._options.neighbours:\n",
        "        if chosen and len(chosen) < self._options.neighbours:\n",
        (
            f"{_NEIGHBOURS}::test_photographs_that_share_no_points_are_beside_each_other_by_their_poses",
        ),
    ),
    Mutant(
        "a photograph of few points tries their depths alone",
        "objconnect/localization/depth/neighbours.py",
        "if few := len(self._rows[row]) < options.least_depths:",
        "if few := len(self._rows[row]) < 0:",
        (
            f"{_NEIGHBOURS}::test_depths_are_those_of_the_photographs_around_where_a_photograph_has_few_points",
        ),
    ),
    Mutant(
        "no place beside the true one is a negative",
        "objconnect/learning/training/contrastive.py",
        "logits = torch.cat([to_near, to_far], -1)",
        "logits = torch.cat([to_near[..., :1], to_far], -1)",
        (f"{_CONTRAST}::test_places_beside_the_true_one_are_told_from_it",),
    ),
    Mutant(
        "objconnect is shipped to try one start",
        "objconnect/localization/featuremetric/options.py",
        '"multistart", True',
        '"multistart", False',
        (f"{_LOCALIZER}::test_a_start_beyond_the_reach_of_one_alignment",),
    ),
    Mutant(
        "no place elsewhere is a negative",
        "objconnect/learning/training/contrastive.py",
        "logits = torch.cat([to_near, to_far], -1)",
        "logits = to_near",
        (f"{_CONTRAST}::test_places_elsewhere_are_told_from_the_true_one",),
    ),
    Mutant(
        "the true place is its own negative",
        "objconnect/learning/training/contrastive.py",
        ".masked_fill(too_close, -torch.inf)",
        "",
        (f"{_CONTRAST}::test_the_true_place_is_no_other_place",),
    ),
    Mutant(
        "the length of features counts in the contrast",
        "objconnect/learning/training/contrastive.py",
        "points = functional.normalize(sample(features_a, cells_a), dim=-1)",
        "points = sample(features_a, cells_a)",
        (f"{_CONTRAST}::test_features_count_by_their_direction",),
    ),
    Mutant(
        "the confidence of places bends the features",
        "objconnect/localization/featuremetric/training.py",
        "torch.exp(-negative_log.detach())",
        "torch.exp(-negative_log)",
        (f"{_PIXLOC}::test_confidence_does_not_bend_features",),
    ),
    Mutant(
        "confidence is taught at the other picture's places",
        "objconnect/localization/featuremetric/training.py",
        "zip(confidence.chunk(2), cells, strict=True)",
        "zip(confidence.chunk(2), cells[::-1], strict=True)",
        (f"{_PIXLOC}::test_confidence_learns_where_places_are_found_again",),
    ),
    Mutant(
        "the length of features counts in the alignment",
        "objconnect/localization/featuremetric/training.py",
        "functional.normalize(b, dim=1),",
        "b,",
        (f"{_PIXLOC}::test_alignment_sees_directions_of_features_alone",),
    ),
    Mutant(
        "pixloc learns nothing by the pose",
        "baselines/pixloc/training.py",
        "contrast + self._losses.pose_share * pose_error",
        "contrast + 0.0 * pose_error",
        (
            f"{_PIXLOC}::test_the_loss_is_the_sum_of_its_parts[0.5]",
            f"{_PIXLOC}::test_every_part_of_the_loss_teaches",
        ),
    ),
    Mutant(
        "pixloc learns from points that do not count",
        "objconnect/localization/featuremetric/training.py",
        "factors, options, batch.valid)",
        "factors, options)",
        (f"{_PIXLOC}::test_poses_are_those_of_eight_plain_steps_on_the_points_that_count",),
    ),
    Mutant(
        "pixloc learns from the steps that help alone",
        "objconnect/localization/featuremetric/training.py",
        "Options(iterations=_ITERATIONS, adaptive_damping=False)",
        "Options(iterations=_ITERATIONS)",
        (f"{_PIXLOC}::test_poses_are_those_of_eight_plain_steps_on_the_points_that_count",),
    ),
    Mutant(
        "learned damping decays",
        "objconnect/localization/featuremetric/training.py",
        ', "weight_decay": 0}',
        "}",
        (f"{_PIXLOC}::test_damping_learns_thirty_times_faster_than_filters",),
    ),
    Mutant(
        "d2net learns by triplets alone",
        "baselines/d2net/training.py",
        "return contrast + means.loss,",
        "return means.loss,",
        (f"{_D2NET}::test_the_loss_is_the_sum_of_its_parts[0.25]",),
    ),
    Mutant(
        "d2net learns by no triplet",
        "baselines/d2net/training.py",
        "return contrast + means.loss,",
        "return contrast,",
        (f"{_D2NET}::test_the_loss_is_the_sum_of_its_parts[0.25]",),
    ),
    Mutant(
        "d2net has no warm-up",
        "baselines/d2net/training.py",
        "if progress < self._warm_up:",
        "if False:",
        (f"{_D2NET}::test_the_loss_is_the_sum_of_its_parts[0.24]",),
    ),
    Mutant(
        "d2net takes red for blue",
        "baselines/d2net/training.py",
        ".flip(1))",
        ")",
        (f"{_D2NET}::test_pixlocs_encoder_sees_the_same_in_other_units",),
    ),
    Mutant(
        "d2net takes the encoder in other units",
        "baselines/d2net/training.py",
        "(encoder[0].weight / deviation)",
        "encoder[0].weight",
        (f"{_D2NET}::test_pixlocs_encoder_sees_the_same_in_other_units",),
    ),
    Mutant(
        "objconnect begins blind",
        "objconnect/network/network.py",
        "        initialise_convolutions(self)\n",
        "",
        (f"{_VGG}::test_networks_that_begin_from_nothing_see_in_all_their_blocks[objconnect]",),
    ),
    Mutant(
        "confidence means doubt",
        "objconnect/network/network.py",
        "torch.sigmoid(-self.confidence[number](maps))",
        "torch.sigmoid(self.confidence[number](maps))",
        (f"{_NETWORK}::test_going_on_from_weights",),
    ),
    Mutant(
        "the distance of features is only logged",
        "objconnect/network/training.py",
        "total(contrast, distance, poses, self._losses)",
        "total(contrast, distance.detach(), poses, self._losses)",
        (f"{_TRAINING}::test_every_part_of_the_loss_teaches",),
    ),
    Mutant(
        "the confidence of objects is only logged",
        "objconnect/network/training.py",
        "loss = loss + confidence_loss",
        "loss = loss + confidence_loss.detach()",
        (f"{_TRAINING}::test_every_part_of_the_loss_teaches",),
    ),
    Mutant(
        "a few points that fit win over many",
        "objconnect/localization/align/hypotheses.py",
        "gain = aligned.points_in_view * (chance[:, None] - aligned.cost)",
        "gain = -aligned.cost",
        (f"{_STARTS}::test_many_points_in_place_are_worth_more_than_a_few_that_fit_perfectly",),
    ),
    Mutant(
        "hypotheses that have met stay many",
        "objconnect/localization/align/hypotheses.py",
        "kept[:, k] = ~(same[:, k, :k] & kept[:, :k]).any(-1)",
        "pass",
        (f"{_STARTS}::test_hypotheses_that_have_met_go_on_as_one",),
    ),
    Mutant(
        "a pose is answered whatever its probability",
        "objconnect/localization/featuremetric/attempt.py",
        "    if probability < 1 - options.risk:",
        "    if probability < -options.risk:",
        (f"{_LOCALIZER}::test_a_picture_of_something_else_is_no_fix",),
    ),
)


def main(names: Sequence[str]) -> int:
    """Try the mutants with these names, or all; print what came of each.

    Returns:
        how many live, or cannot be made.
    """
    chosen = [mutant for mutant in MUTANTS if not names or mutant.name in names]
    for module in _SLOW_TO_IMPORT:
        import_module(module)
    faults = 0
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = _copy(Path(folder))
        tests = sorted({test for mutant in chosen for test in mutant.killed_by})
        if failed := sorted(_failing(tree, tests)):
            print(f"these fail without any mutant: {', '.join(failed)}")
            return 1
        for mutant in chosen:
            wrong = _try(tree, mutant)
            print(f"{'LIVES' if wrong else 'dies '}  {mutant.name}{wrong and ': '}{wrong}")
            faults += bool(wrong)
    return faults


def list_unlisted(mutant: Mutant, tree: Path = ROOT) -> str:
    """Why an entry of the list is not true of a tree any more; empty if it is."""
    found = (tree / mutant.file).read_text().count(mutant.old)
    if found != 1:
        return f"{mutant.file} holds {mutant.old!r} {found} times, not once"
    for test in mutant.killed_by:
        file, _, function = test.partition("::")
        if f"def {function.partition('[')[0]}(" not in (tree / file).read_text():
            return f"there is no test {test}"
    return ""


def _try(tree: Path, mutant: Mutant) -> str:
    """What is wrong; empty if all its tests failed."""
    if wrong := list_unlisted(mutant, tree):
        return wrong
    with _make(tree, mutant):
        failed = _failing(tree, mutant.killed_by)
    alive = [test for test in mutant.killed_by if not any(_is_of(each, test) for each in failed)]
    return f"{', '.join(alive)} passed" if alive else ""


@contextmanager
def _make(tree: Path, mutant: Mutant) -> Iterator[None]:
    file = tree / mutant.file
    before = file.read_text()
    file.write_text(before.replace(mutant.old, mutant.new))
    try:
        yield
    finally:
        file.write_text(before)


def _is_of(test: str, named: str) -> bool:
    return test == named or test.startswith(f"{named}[")


def _copy(folder: Path) -> Path:
    """The tree as it stands here, without what was compiled of it."""
    for name in (*_READ, *_ALSO):
        source, target = ROOT / name, folder / name
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copyfile(source, target)
    return folder


class _Failures:
    """A plugin of pytest's that remembers which tests failed, not which could not be run."""

    def __init__(self) -> None:
        self.tests: list[str] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Called by pytest."""
        if report.when == "call" and report.failed:
            self.tests.append(report.nodeid)


def _failing(tree: Path, tests: Sequence[str]) -> list[str]:
    """Tests that fail in a tree, run there by a process of its own.

    Raises:
        RuntimeError: they cannot be run.
    """
    answer = tree / "failed.json"
    answer.unlink(missing_ok=True)
    child = os.fork()
    if not child:
        os._exit(_answer(tree, tests, answer))
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        raise RuntimeError(f"pytest ended with {code}: {(tree / 'said.txt').read_text()[-2000:]}")
    failed: list[str] = json.loads(answer.read_text())
    return failed


def _answer(tree: Path, tests: Sequence[str], answer: Path) -> int:
    """Run tests in this process, and write down which failed."""
    said = os.open(tree / "said.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(said, 1)
    os.dup2(said, 2)
    os.chdir(tree)
    # Files of one second and size would pass for what was compiled of them before.
    sys.dont_write_bytecode = True
    sys.path.insert(0, str(tree))
    for name in [name for name in sys.modules if name.split(".")[0] in (*_READ, "tests")]:
        del sys.modules[name]
    failures = _Failures()
    options = ["-q", "--tb=line", "-p", "no:cacheprovider", "--rootdir", str(tree)]
    code = pytest.main([*options, *tests], plugins=[failures])
    answer.write_text(json.dumps(failures.tests))
    return int(code)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("name", nargs="*", choices=[[], *(m.name for m in MUTANTS)])
    sys.exit(1 if main(parser.parse_args().name) else 0)
