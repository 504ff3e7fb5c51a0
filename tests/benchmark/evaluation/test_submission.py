"""The submission file: names, translation rather than centre, six decimals of a unit quaternion."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.evaluation.submission import submit
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose, so3_exp
from objconnect.scene.localizer import Estimate, Query, Status
from tests.benchmark.datasets.test_cmu import AUTUMN, HIDDEN, SNOW, cmu  # noqa: F401
from tests.benchmark.made_data import FakeLocalizer, pose_at
from tests.benchmark.test_cli import invoke


@pytest.fixture
def one(cmu: Path) -> Path:  # noqa: F811
    """The data set with one slice."""
    shutil.rmtree(cmu / "slice22")
    return cmu


def tilt() -> Pose:
    """A pose whose centre and translation differ in every number."""
    turn = so3_exp(torch.tensor([0.3, -0.5, 0.7], dtype=torch.float64))
    return Pose(turn @ pose_at(4).rotation, turn @ pose_at(4).translation)


def test_a_submission_has_a_line_per_localized_image(one: Path, tmp_path: Path) -> None:
    answers = {
        SNOW: Estimate(Status.OK, tilt()),
        AUTUMN: Estimate(Status.FALLBACK, pose_at(2), reason="prior"),
        HIDDEN: Estimate(Status.OK, pose_at(3)),
    }
    assert submit(one, FakeLocalizer(answers), tmp_path / "out") == (2, 3)
    lines = (tmp_path / "out" / "submission.txt").read_text().splitlines()
    # Public or hidden, every image that was found; a fallback is not found.
    assert [line.split()[0] for line in lines] == [SNOW, HIDDEN]
    name, *words = lines[0].split(" ")
    assert "/" not in name
    assert [len(word.split(".")[1]) for word in words] == [6] * 7
    numbers = np.array([float(word) for word in words])
    assert np.linalg.norm(numbers[:4]) == pytest.approx(1, abs=2e-6)
    assert numbers[4:] == pytest.approx(tilt().translation.numpy(), abs=1e-6)
    assert numbers[4:] != pytest.approx(tilt().centre().numpy(), abs=0.1)


def test_each_image_has_its_own_camera(one: Path, tmp_path: Path) -> None:
    localizer = FakeLocalizer({})
    submit(one, localizer, tmp_path / "out")
    focal = {query.name: query.camera.focal[0] for query in localizer.seen}
    assert focal == {SNOW: 82.0, AUTUMN: 81.0, HIDDEN: 81.0}


def test_an_interrupted_submission_goes_on_after_the_last_slice(
    cmu: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    later = "img_00099_c1_1287503834901037us.jpg"
    for name in (SNOW, AUTUMN, HIDDEN):
        (cmu / "slice22" / "query" / name).unlink()
    shutil.copy(cmu / "slice2" / "query" / SNOW, cmu / "slice22" / "query" / later)
    answers = {SNOW: Estimate(Status.OK, pose_at(1)), later: KeyboardInterrupt()}
    with pytest.raises(KeyboardInterrupt):
        submit(cmu, FakeLocalizer(answers), tmp_path / "out")
    assert not (tmp_path / "out" / "submission.txt").exists()
    again = FakeLocalizer({later: Estimate(Status.OK, pose_at(2))})
    assert submit(cmu, again, tmp_path / "out") == (2, 4)
    assert [query.name for query in again.seen] == [later]


def test_poses_of_other_options_are_not_replaced(one: Path, tmp_path: Path) -> None:
    submit(one, FakeLocalizer({SNOW: Estimate(Status.OK, pose_at(3))}), tmp_path / "out")
    written = (tmp_path / "out" / "submission.txt").read_bytes()
    other = FakeLocalizer({})
    other.config = other.config.model_copy(update={"strength": 2.0})
    with pytest.raises(InputError, match="slice2.txt holds poses of fake, start none, options"):
        submit(one, other, tmp_path / "out")
    assert not other.seen
    assert (tmp_path / "out" / "submission.txt").read_bytes() == written


def test_names_must_be_unique(cmu: Path, tmp_path: Path) -> None:  # noqa: F811
    with pytest.raises(InputError, match="names must be unique"):
        submit(cmu, FakeLocalizer({}), tmp_path / "out")


def test_a_folder_of_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    result = invoke("submit", tmp_path / "mine", "--out", tmp_path / "out")
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert f"{tmp_path / 'mine'} is not a data set: it has neither published.json" in line
    assert "nor intrinsics.txt and slice folders (Extended CMU Seasons)" in line
    assert not (tmp_path / "out").exists()


def test_it_has_no_starts(one: Path, tmp_path: Path) -> None:
    result = invoke("submit", one, "--start", "prior", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert (
        "is read as Extended CMU Seasons, which has no starts: leave out --start" in result.stderr
    )


def test_poses_of_another_data_set_are_those_of_a_submission(
    made_flight: Path, tmp_path: Path
) -> None:
    result = invoke("submit", made_flight, "--start", "none", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.stderr
    assert (tmp_path / "out" / "poses" / f"{made_flight.name}.txt").is_file()
    assert not (tmp_path / "out" / "submission.txt").exists()


def test_sift_writes_a_submission_end_to_end(one: Path, tmp_path: Path) -> None:
    """Noise finds nothing, and says so."""
    result = invoke("submit", one, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.stderr
    assert "of 3 images found" in result.stdout


def test_queries_never_carry_a_pose(one: Path, tmp_path: Path) -> None:
    localizer = FakeLocalizer({})
    submit(one, localizer, tmp_path / "out")
    assert all(isinstance(query, Query) and query.prior is None for query in localizer.seen)
