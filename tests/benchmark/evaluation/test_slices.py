"""Slices of a simulated drive: pairs of hloc, interruptions, threads, and what is missing."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmark.datasets.cmu import Slice, open_slices
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from benchmark.evaluation.starts import parse_start
from benchmark.evaluation.submission import check_submission, submit
from objconnect.scene.errors import InputError
from objconnect.scene.localizer import Estimate, Query, Status
from objconnect.scene.maps.colmap_files import read_model
from tests.benchmark.made_data import FakeLocalizer, pose_at
from tests.benchmark.test_cli import invoke
from tests.objconnect.scene.exports.test_cmu import street, tree  # noqa: F401

STRANGER = "img_00001_c0_1303398474779439us.jpg"


def pairs_of(each: Slice) -> dict[str, list[str]]:
    """Two map photographs for each query image, other ones for neighbours."""
    names = read_model(each.folder / "sparse").names
    return {q: [names[(k + i) % len(names)] for i in (0, 1)] for k, q in enumerate(each.queries)}


@pytest.fixture
def pairs(tree: Path, tmp_path: Path) -> Path:  # noqa: F811
    """The lists of all slices in one file, as hloc writes them."""
    listed = [pairs_of(each) for each in open_slices(tree)]
    lines = [f"{q} {r}" for each in listed for q, references in each.items() for r in references]
    (tmp_path / "pairs.txt").write_text("\n".join(lines))
    return tmp_path / "pairs.txt"


def found(tree: Path) -> FakeLocalizer:  # noqa: F811
    """A method that localizes every query image."""
    names = [name for each in open_slices(tree) for name in each.queries]
    return FakeLocalizer({name: Estimate(Status.OK, pose_at(k)) for k, name in enumerate(names)})


def test_pairs_reach_the_method(tree: Path, pairs: Path, tmp_path: Path) -> None:  # noqa: F811
    localizer = found(tree)
    assert submit(tree, localizer, tmp_path / "out", pairs=pairs) == (12, 12)
    expected = {q: tuple(r) for each in open_slices(tree) for q, r in pairs_of(each).items()}
    assert {query.name: query.references for query in localizer.seen} == expected
    assert len((tmp_path / "out" / "submission.txt").read_text().splitlines()) == 12
    # The start of evaluate takes the file of all slices, too.
    (dataset, *_) = open_datasets(tree)
    localizer.seen.clear()
    evaluate(dataset, localizer, tmp_path / "results", parse_start(f"pairs={pairs}"))
    assert [query.references for query in localizer.seen] == [
        expected[query.name] for query in dataset.queries
    ]


def test_without_pairs_the_method_retrieves(tree: Path, tmp_path: Path) -> None:  # noqa: F811
    localizer = found(tree)
    submit(tree, localizer, tmp_path / "out")
    assert {query.references for query in localizer.seen} == {None}


def test_an_interrupted_slice_goes_on_in_the_middle(
    tree: Path,  # noqa: F811
    pairs: Path,
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    submit(tree, found(tree), tmp_path / "whole", pairs=pairs)
    names = [name for each in open_slices(tree) for name in each.queries]
    stopped = found(tree)
    stopped.answers = {**stopped.answers, names[6]: KeyboardInterrupt()}
    with pytest.raises(KeyboardInterrupt):
        submit(tree, stopped, out, pairs=pairs)
    journal = out / "slices" / ".objconnect-slice9.journal"
    # The last entry is cut short, as by a full disk.
    journal.write_bytes(journal.read_bytes()[:-9])
    again = found(tree)
    assert submit(tree, again, out, pairs=pairs) == (12, 12)
    assert [query.name for query in again.seen] == names[5:]
    assert not journal.exists()
    written = (out / "submission.txt").read_bytes()
    assert written == (tmp_path / "whole" / "submission.txt").read_bytes()


def test_poses_of_other_pairs_are_not_replaced(
    tree: Path,  # noqa: F811
    pairs: Path,
    tmp_path: Path,
) -> None:
    submit(tree, found(tree), tmp_path / "out", pairs=pairs)
    lines = pairs.read_text().splitlines()
    pairs.write_text("\n".join(lines[:-9] + lines[-8:]))
    again = found(tree)
    with pytest.raises(InputError, match=r"slice9.txt holds poses of fake, start pairs="):
        submit(tree, again, tmp_path / "out", pairs=pairs)
    assert not again.seen


def test_hlocs_list_of_test_images_is_enough(
    tree: Path,  # noqa: F811
    pairs: Path,
    tmp_path: Path,
) -> None:
    """hloc lists the images without a public pose alone; the others are then left out."""
    first = open_slices(tree)[0]
    (first.folder / "test-images-slice2.txt").write_text(f"{first.queries[1]}\n")
    lines = pairs.read_text().splitlines()
    pairs.write_text("\n".join(lines[2:4] + lines[8:]))
    localizer = found(tree)
    assert submit(tree, localizer, tmp_path / "out", pairs=pairs) == (9, 9)
    assert not {query.name for query in localizer.seen} & set(first.queries[2:])


def test_jobs_are_images_at_a_time(tree: Path, tmp_path: Path) -> None:  # noqa: F811
    met = threading.Barrier(2, timeout=300)

    class Pairwise(FakeLocalizer):
        def localize(self, query: Query) -> Estimate:
            met.wait()
            return super().localize(query)

    submit(tree, found(tree), tmp_path / "one")
    assert submit(tree, Pairwise(found(tree).answers), tmp_path / "two", jobs=2) == (12, 12)
    one, two = ((tmp_path / name / "submission.txt").read_bytes() for name in ("one", "two"))
    assert one == two


def add(line: str) -> Callable[[str], str]:
    return lambda text: f"{text}\n{line}\n"


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda text: text.replace(text.split()[0], STRANGER), "not among the query images of"),
        (lambda text: text.replace(text.split()[1], STRANGER), "not among the map photographs of"),
        (lambda text: text.partition("\n")[2].partition("\n")[2], "has no line for 1 of 4 test"),
        (lambda text: text.replace(" ", "\t\t", 3), ""),
        (add("one two three"), "expected 'query reference'"),
        (add("lonely.jpg"), "expected 'query reference'"),
        (lambda text: "\n# nothing\n", "holds no pair"),
        (lambda text: "", "holds no pair"),
        (lambda text: b"\x89HDF\r\n\x1a\n\xff\xfe", "not a UTF-8 text file"),
    ],
)
def test_wrong_pairs_are_one_line(
    edit: Callable[[str], str | bytes],
    message: str,
    tree: Path,  # noqa: F811
    pairs: Path,
    tmp_path: Path,
) -> None:
    edited = edit(pairs.read_text())
    pairs.write_bytes(edited if isinstance(edited, bytes) else edited.encode())
    out = tmp_path / "out"
    if not message:
        assert submit(tree, found(tree), out, pairs=pairs) == (12, 12)
        return
    for words in ((), ("--dry-run",)):
        result = invoke("submit", tree, "--out", out, "--pairs", pairs, *words)
        assert result.exit_code == 2
        assert message in (result.stdout if words else result.stderr)
        assert len(result.stderr.splitlines()) == (0 if words else 1)
        assert not out.exists()


def test_references_are_of_the_same_slice(
    tree: Path,  # noqa: F811
    pairs: Path,
    tmp_path: Path,
) -> None:
    first, _, last = open_slices(tree)
    foreign = read_model(last.folder / "sparse").names[0]
    pairs.write_text(add(f"{first.queries[0]} {foreign}")(pairs.read_text()))
    with pytest.raises(InputError, match=f"{foreign}: not among the map photographs of slice2"):
        submit(tree, found(tree), tmp_path / "out", pairs=pairs)


def test_nothing_is_missing_from_a_whole_tree(
    tree: Path,  # noqa: F811
    pairs: Path,
    tmp_path: Path,
) -> None:
    result = invoke("submit", tree, "--out", tmp_path / "out", "--pairs", pairs, "--dry-run")
    assert result.exit_code == 0, result.stderr
    assert "slice9   4 map photographs, 4 query images, 4 public query poses" in result.stdout
    assert "24 pairs of 12 query images" in result.stdout
    assert not (tmp_path / "out").exists()


def test_everything_that_is_missing_is_named_at_once(
    tree: Path,  # noqa: F811
    pairs: Path,
    tmp_path: Path,
) -> None:
    first, second, third = (each.folder for each in open_slices(tree))
    for file in (first / "database").iterdir():
        file.write_bytes(b"")
    (second / "query" / "IMG_0001.jpg").touch()
    sorted((second / "query").glob("img*"))[0].unlink()
    (third / "sparse" / "points3D.bin").unlink()
    shutil.rmtree(third / "camera-poses")
    (third / f"test-images-{third.name}.txt").unlink()
    (tree / "slice3.tar").touch()
    text = (tree / "intrinsics.txt").read_text()
    (tree / "intrinsics.txt").write_text(text.partition("\n")[2].replace("c1", "c5"))
    result = invoke(
        *("submit", tree, "--out", tmp_path / "out", "--pairs", pairs, "--dry-run", "--json")
    )
    assert result.exit_code == 2
    report = json.loads(result.stdout)
    faults = [(c["name"], c["detail"]) for c in report["checks"] if not c["ok"]]
    expected = [
        ("intrinsics.txt", "download https://"),
        ("slice3.tar", "run tar -xf slice3.tar in"),
        ("slices", "slice4, slice5, slice6, slice13"),
        ("slice2/database", "4 of 4 map photographs are missing or empty"),
        ("slice9/query", "IMG_0001.jpg not named like"),
        ("slice9/query", "IMG_0001.jpg empty"),
        ("slice9/query", "1 listed photographs are missing"),
        ("slice18/sparse", "unpack slice18.tar again"),
        ("slice18/camera-poses", "missing; unpack slice18.tar again"),
        ("slice18/test list", "unpack slice18.tar again"),
        ("pairs", "not checked: mend slice9/query"),
    ]
    assert [name for name, _ in faults] == [name for name, _ in expected]
    for (_, detail), (_, part) in zip(faults, expected, strict=True):
        assert part in detail
        assert "\n" not in detail


def test_images_in_two_slices_are_named(tree: Path) -> None:  # noqa: F811
    first, second, _ = open_slices(tree)
    shutil.copy(first.folder / "query" / first.queries[0], second.folder / "query")
    (*slices, names) = check_submission(tree).checks
    assert all(check.ok for check in slices)
    assert names.name == "names" and "names must be unique" in names.detail


def test_missing_files_stop_a_run_before_its_first_slice(
    tree: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    next((tree / "slice18" / "database").iterdir()).unlink()
    localizer = found(tree)
    with pytest.raises(InputError, match="slice18/database: 1 of 4 map photographs are missing"):
        submit(tree, localizer, tmp_path / "out")
    assert not localizer.seen
    assert not (tmp_path / "out").exists()


def test_a_download_that_has_not_begun(tree: Path) -> None:  # noqa: F811
    for folder in tree.glob("slice*"):
        shutil.rmtree(folder)
    assert [check.name for check in check_submission(tree).checks] == ["slices"]
    (tree / "intrinsics.txt").unlink()
    with pytest.raises(InputError, match="is not Extended CMU Seasons"):
        check_submission(tree)
    with pytest.raises(InputError, match="slice5 is not Extended CMU Seasons: it is not a folder"):
        check_submission(tree / "slice5")
    (tree / "slice2.tar").touch()
    assert [check.name for check in check_submission(tree).checks] == [
        *("intrinsics.txt", "slice2.tar", "slices"),
    ]
