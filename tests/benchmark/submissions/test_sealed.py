"""Sealed scenes: the public half tells no pose of a query, and the organiser scores submissions."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image
from typer.testing import CliRunner

from benchmark.cli import app
from benchmark.datasets.open import open_datasets
from benchmark.evaluation.evaluate import evaluate
from benchmark.evaluation.starts import NONE, parse_start
from benchmark.publishing.command import publish
from benchmark.publishing.index import read_index
from benchmark.publishing.shards import read_shards
from benchmark.submissions.answers import open_tasks, write_answers
from benchmark.submissions.command import submission
from benchmark.tracks.command import track
from benchmark.tracks.compact import store, targets_of
from benchmark.tracks.description import Track, load_track
from benchmark.tracks.sealing import read_key, sealed_seed
from objconnect.methods import create
from objconnect.scene.bundle.frames import Frames, read_frames, write_frames
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.config import MAX_NUMBER
from objconnect.scene.errors import InputError
from objconnect.scene.geometry.pose import Pose
from objconnect.scene.localizer import Estimate, Status
from simulate.config import SimulateConfig
from simulate.planner import session_generator
from tests.benchmark.made_data import FakeLocalizer, write_flight
from tests.conftest import RENDERED
from tests.robustness.misuse.world import make_scene

KEY = bytes(range(7, 39))
SEED = 2**127 + 987654321
QUERY_SESSION = "winter-grid"


@pytest.fixture(autouse=True)
def _photographs_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))


@pytest.fixture
def key(tmp_path: Path) -> Path:
    (tmp_path / "key").write_bytes(KEY)
    return tmp_path / "key"


@pytest.fixture
def hamlet(tmp_path: Path) -> Path:
    """A small scene that was rendered from a key."""
    return rename_seed(make_scene(tmp_path / "scenes" / "hamlet"), SEED)


def rename_seed(path: Path, seed: int) -> Path:
    manifest = Scene.open(path).manifest
    config = manifest.config | {"seed": seed}
    finish_scene(path, manifest.model_copy(update={"seed": seed, "config": config}))
    return path


def move_queries(path: Path) -> None:
    """Move the reference poses of the queries, and nothing else."""
    file = path / "sessions" / QUERY_SESSION / "frames.h5"
    frames = read_frames(file)
    values = {key: value for key, value in vars(frames).items() if key not in ("names", "cameras")}
    values["cam_from_world"] = frames.cam_from_world.copy()
    values["cam_from_world"][:, :3, 3] += 5.0
    write_frames(file, Frames(frames.names, frames.cameras, **values), (), iter(()))
    finish_scene(path, Scene.open(path).manifest)


def files_of(folder: Path) -> dict[str, bytes]:
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_other_query_poses_give_the_same_public_half(hamlet: Path, tmp_path: Path) -> None:
    publish([hamlet], tmp_path / "one" / "public", sealed=True)
    publish([hamlet], tmp_path / "one" / "whole")
    move_queries(hamlet)
    publish([hamlet], tmp_path / "two" / "public", sealed=True)
    publish([hamlet], tmp_path / "two" / "whole")
    assert files_of(tmp_path / "one" / "public") == files_of(tmp_path / "two" / "public")
    assert files_of(tmp_path / "one" / "whole") != files_of(tmp_path / "two" / "whole")


def secrets(scene: Path) -> dict[str, list[bytes]]:
    """What must not be in the public half, in the notations in which it could be there."""
    poses = Scene.open(scene).frames(QUERY_SESSION).cam_from_world
    # Numbers that also stand elsewhere, such as 0 and 1, tell nothing.
    numbers = [float(x) for x in np.unique(poses) if abs(x) not in (0, 1) and x != round(x, 2)]
    centres = [float(x) for pose in poses for x in (-pose[:3, :3].T @ pose[:3, 3])]
    numbers += [x for x in centres if x != round(x, 2)]
    assert numbers
    return {
        "poses": [note for x in numbers for note in (np.float64(x).tobytes(), repr(x).encode())],
        "seed": [str(SEED).encode(), SEED.to_bytes(16, "big"), SEED.to_bytes(16, "little")],
        "key": [KEY, KEY.hex().encode()],
    }


def find_secrets(folder: Path, sought: dict[str, list[bytes]]) -> set[str]:
    """Return which secrets stand in the bytes of files or in the values of rows."""
    texts = list(files_of(folder).values())
    for shard in sorted(folder.glob("data/*/*.parquet")):
        columns = (*read_columns(shard),)
        for row in read_shards([shard], columns):
            texts.append(json.dumps(row, default=lambda data: data.hex()).encode())
            texts.append(b"".join(np.asarray(v, float).tobytes() for v in numbers_in(row)))
    return {what for what, notes in sought.items() if any(n in t for n in notes for t in texts)}


def read_columns(shard: Path) -> list[str]:
    import pyarrow.parquet

    return list(pyarrow.parquet.read_schema(shard).names)


def numbers_in(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [x for inner in value.values() for x in numbers_in(inner)]
    if isinstance(value, list):
        return [x for inner in value for x in numbers_in(inner)]
    return [value] if isinstance(value, int | float) else []


def test_no_pose_seed_or_key_is_in_the_public_half(hamlet: Path, tmp_path: Path) -> None:
    shear_queries(hamlet)
    sought = secrets(hamlet)
    publish([hamlet], tmp_path / "public", sealed=True)
    publish([hamlet], tmp_path / "whole")
    assert find_secrets(tmp_path / "public", sought) == set()
    # The search finds what is there.
    assert find_secrets(tmp_path / "whole", sought) == {"poses", "seed"}


def shear_queries(path: Path) -> None:
    """Give the queries poses whose numbers stand nowhere else, as those of a flight in wind."""
    file = path / "sessions" / QUERY_SESSION / "frames.h5"
    frames = read_frames(file)
    rng = np.random.default_rng(4)
    values = {key: value for key, value in vars(frames).items() if key not in ("names", "cameras")}
    poses = frames.cam_from_world.copy()
    poses[:, :3, 3] += rng.uniform(-0.3, 0.3, (len(poses), 3))
    values["cam_from_world"] = poses
    write_frames(file, Frames(frames.names, frames.cameras, **values), (), iter(()))
    finish_scene(path, Scene.open(path).manifest)


def test_rows_of_queries_hold_photographs_without_metadata(hamlet: Path, tmp_path: Path) -> None:
    publish([hamlet], tmp_path / "public", sealed=True)
    (published,) = read_index(tmp_path / "public").scenes
    assert published.seed is None
    assert "seed" not in published.config
    assert "sessions" not in published.config
    assert not (tmp_path / "public" / "scenes" / "hamlet" / "objects.json").exists()
    croissant = json.loads((tmp_path / "public" / "croissant.json").read_text())
    assert "queries without metadata" in croissant["rai:dataPreprocessingProtocol"]
    shards = sorted((tmp_path / "public").glob("data/*/query-*.parquet"))
    empty = ("cam_from_world", "time", "overlap", "scale", "angle_deg", "days")
    rows = list(read_shards(shards, ("name", "image", "gps_prior", *empty)))
    assert len(rows) == 6
    for row in rows:
        assert not any(row[column] for column in empty)
        assert row["gps_prior"] is not None
        original = hamlet / "sessions" / row["name"]
        with Image.open(io.BytesIO(row["image"]["bytes"])) as bare, Image.open(original) as whole:
            assert not bare.getexif()
            assert b"Exif" not in row["image"]["bytes"]
            assert np.array_equal(np.asarray(bare), np.asarray(whole))


def test_metadata_and_what_follows_a_picture_are_removed(tmp_path: Path) -> None:
    from objconnect.scene.storage.jpeg import read_bare_jpeg

    path, rgb = tmp_path / "a.jpg", np.random.default_rng(0).integers(0, 255, (40, 30, 3))
    exif = Image.Exif()
    exif[0x010E] = "secret"
    Image.fromarray(rgb.astype(np.uint8)).save(
        path, "JPEG", exif=exif, comment=b"secret", xmp=b"secret", icc_profile=b"secret"
    )
    path.write_bytes(path.read_bytes() + b"secret")
    assert path.read_bytes().count(b"secret") == 5
    bare = read_bare_jpeg(path)
    assert b"secret" not in bare
    with Image.open(io.BytesIO(bare)) as one, Image.open(path) as other:
        assert np.array_equal(np.asarray(one), np.asarray(other))
    for data in (b"", b"\xff\xd8", path.read_bytes()[:60], b"\x89PNG", bare[:-2]):
        path.write_bytes(data)
        with pytest.raises(InputError, match="is not a JPEG file, or is damaged"):
            read_bare_jpeg(path)


def test_a_scene_of_a_public_seed_and_layers_are_refused(hamlet: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="leave out --layer"):
        publish([hamlet], tmp_path / "public", layers=["depth"], sealed=True)
    rename_seed(hamlet, MAX_NUMBER)
    with pytest.raises(InputError, match="cannot be sealed, because its seed can be found"):
        publish([hamlet], tmp_path / "public", sealed=True)
    assert not (tmp_path / "public").exists()


def test_a_flight_is_not_sealed(tmp_path: Path) -> None:
    flight = write_flight(tmp_path / "meadow")
    with pytest.raises(
        InputError, match="meadow cannot be sealed, because its poses do not depend on a key"
    ):
        publish([flight], tmp_path / "public", sealed=True)


def test_what_leads_to_the_seed_is_left_out(hamlet: Path, tmp_path: Path) -> None:
    publish([hamlet], tmp_path / "public", sealed=True)
    publish([hamlet], tmp_path / "whole")
    (sealed,), (whole,) = (read_index(tmp_path / each).scenes for each in ("public", "whole"))
    assert whole.seed == SEED and "scenes/hamlet/objects.json" in whole.files
    assert sealed.seed is None and "scenes/hamlet/objects.json" not in sealed.files
    assert "seed" in whole.config and set(sealed.config) <= {"size", "spp", "site"}


def test_commands_that_score_say_that_poses_are_sealed(hamlet: Path, tmp_path: Path) -> None:
    publish([hamlet], tmp_path / "public", sealed=True)
    for command in ("evaluate", "basin"):
        words = [command, tmp_path / "public", "--method", "sift", "--out", tmp_path / "results"]
        result = CliRunner().invoke(app, list(map(str, words)))
        assert result.exit_code == 2
        assert "are withheld, so it cannot be scored here: 'objconnect submit'" in result.output
        assert len(result.output.strip().splitlines()) == 1
    assert not (tmp_path / "results").exists()


def test_a_start_from_reference_poses_is_refused(hamlet: Path, tmp_path: Path) -> None:
    publish([hamlet], tmp_path / "public", sealed=True)
    for start in ("error=3m,5deg", "gps=50m", "gravity"):
        with pytest.raises(InputError, match="made from the reference poses, which are withheld"):
            write_answers(
                tmp_path / "public", FakeLocalizer({}), tmp_path / "out", parse_start(start)
            )
    assert not (tmp_path / "out").exists()


def test_only_poses_of_status_ok_are_written_and_a_run_goes_on(
    hamlet: Path, tmp_path: Path
) -> None:
    publish([hamlet], tmp_path / "public", sealed=True)
    (task,) = open_tasks(tmp_path / "public")
    first, second, third = (query.name for query in task.queries[:3])
    pose = Pose.from_quaternion([1.0, 0.0, 0.0, 0.0], [1.0, 2.0, 3.0])
    answers = {first: Estimate(Status.OK, pose), second: Estimate(Status.FALLBACK, pose)}

    class Interrupted(FakeLocalizer):
        def localize(self, query: Any) -> Estimate:
            if query.name == third:
                raise KeyboardInterrupt
            return super().localize(query)

    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        write_answers(tmp_path / "public", Interrupted(answers), out, NONE)
    assert not (out / "poses" / "hamlet.txt").exists()
    again = FakeLocalizer(answers)
    report = write_answers(tmp_path / "public", again, out, NONE)
    assert (report.found, report.queries) == ({"hamlet": 1}, {"hamlet": 6})
    lines = (out / "poses" / "hamlet.txt").read_text().splitlines()
    assert [line.split()[0] for line in lines] == ["#", first]
    assert f"  hamlet: {task.sha256}" in report.text()
    assert [path.name for path in out.rglob("*") if path.is_file()] == ["hamlet.txt"]


def write_track(folder: Path, places: list[dict[str, Any]], **others: Any) -> Path:
    config = RENDERED.model_dump(mode="json", exclude={"preset", "seed"})
    (folder / "tiny").mkdir(parents=True)
    (folder / "tiny" / "config.yaml").write_text(yaml.safe_dump(config))
    description = {
        "name": "tiny",
        "title": "Tiny",
        "config": str(folder / "tiny" / "config.yaml"),
        "places": places,
        "starts": ["none"],
        "methods": ["sift"],
    }
    (folder / "tiny" / "track.yaml").write_text(yaml.safe_dump(description | others))
    return folder


@pytest.fixture
def private(tmp_path: Path) -> Path:
    """The organiser's folder of tracks, with a sealed place."""
    return write_track(tmp_path / "private", [{"dataset": "town-1", "preset": "town"}])


def test_a_submission_scores_as_evaluate_does(
    rendered: Scene, private: Path, key: Path, tmp_path: Path, extracted_once: None
) -> None:
    seed = sealed_seed(KEY, load_track("tiny", private), load_track("tiny", private).places[0])
    scene = tmp_path / "scenes" / "town-1"
    shutil.copytree(rendered.path, scene)
    rename_seed(scene, seed)

    (place,) = track("tiny", scene.parent, tracks_folder=private, update=True, key=key).places
    (recorded,) = load_track("tiny", private).places
    assert recorded.renders == (place.sha256, place.public_sha256)
    assert recorded.seed is None
    publish([scene], tmp_path / "public", sealed=True)
    (task,) = open_tasks(tmp_path / "public")
    assert task.sha256 == place.public_sha256
    with pytest.raises(InputError, match="are withheld"):
        open_datasets(tmp_path / "public")

    (dataset,) = open_datasets(scene)
    theirs = evaluate(dataset, create("sift", {}), tmp_path / "results", NONE)
    store(targets_of([tmp_path / "results"], private / "tiny"))
    folder = tmp_path / "submission"
    report = write_answers(tmp_path / "public", create("sift", {}), folder, NONE)
    card = {
        "track": "tiny",
        "method": "theirs",
        "authors": "A. Author",
        "description": "sift",
        "trained_on": "nothing",
        "start": report.start,
        "datasets": report.digests,
    }
    (folder / "card.yaml").write_text(yaml.safe_dump(card))
    ours = submission(folder, private).results["town-1"]
    assert ours.summary.recall == theirs.summary.recall
    assert any(query.t_err_m is not None for query in theirs.queries)
    for one, other in zip(ours.queries, theirs.queries, strict=True):
        assert (one.name, one.group, one.condition) == (other.name, other.group, other.condition)
        if other.status is Status.OK:
            # The record of the render rounds rotations too, to 1e-6.
            assert one.t_err_m == pytest.approx(other.t_err_m, abs=1e-4)
            assert one.r_err_deg == pytest.approx(other.r_err_deg, abs=1e-4)
        else:
            assert one.t_err_m is None


def test_a_key_and_sealed_places_belong_together(private: Path, key: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"town-1 of tiny is sealed, as it has no seed"):
        track("tiny", tmp_path / "out", tracks_folder=private)
    open_place = [{"dataset": "town-1", "preset": "town", "seed": 3}]
    public = write_track(tmp_path / "tracks", open_place)
    with pytest.raises(InputError, match=r"no place of tiny is sealed"):
        track("tiny", tmp_path / "out", tracks_folder=public, key=key)
    spoiled = write_track(
        tmp_path / "other", [{"dataset": "a", "preset": "town"}], starts=["gps=5m"]
    )
    with pytest.raises(InputError, match=r"gps=5m is made from reference poses"):
        load_track("tiny", spoiled)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "has 0 bytes"),
        (b"short key", "has 9 bytes, not 16 to 4096"),
        (b"\xff\xd8" * 4000, "has 8000 bytes"),
        (b"0" * 32, "is not random"),
    ],
)
def test_a_weak_key_is_refused(content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "key").write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_key(tmp_path / "key")


def test_a_key_is_a_file() -> None:
    with pytest.raises(InputError, match="device or a pipe"):
        read_key(Path("/dev/urandom"))


def test_seeds_follow_from_key_track_and_place_and_cannot_be_tried() -> None:
    one = Track.model_validate(
        {
            **{"name": "one", "title": "One", "config": "uav-small", "starts": ["none"]},
            "methods": ["sift"],
            "places": [{"dataset": name, "preset": "town"} for name in ("a", "b")],
        }
    )
    other = one.model_copy(update={"name": "other"})
    seeds = [
        sealed_seed(key, track, place)
        for key in (KEY, KEY[::-1])
        for track in (one, other)
        for place in track.places
    ]
    assert len(set(seeds)) == 8
    assert all(MAX_NUMBER < seed < 2**128 for seed in seeds)
    # A session's generator does not follow from that of another one, or from the raw seed.
    config = SimulateConfig.load(None, {"seed": seeds[0]})
    drawn = [session_generator(config, index).random() for index in (0, 1)]
    assert drawn[0] != drawn[1]
    assert drawn[0] != np.random.default_rng([seeds[0], 0]).random()
    assert SimulateConfig.model_validate_json(config.model_dump_json()) == config
