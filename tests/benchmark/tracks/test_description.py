from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmark.evaluation.starts import parse_start
from benchmark.tracks.description import TRACKS_FOLDER, Track, TrackPlace, load_track, write_track
from objconnect.methods import LOCALIZERS
from objconnect.scene.errors import InputError
from simulate.config import SimulateConfig

TRACKS = sorted(path.parent.name for path in TRACKS_FOLDER.glob("*/track.yaml"))
TRACK = Track(
    name="tiny",
    title="Two parks",
    config="uav-seasons",
    places=(
        TrackPlace(dataset="park-1", preset="park", seed=1),
        TrackPlace(dataset="b", preset="b", seed=2),
    ),
    starts=("error=3m,5deg", "none"),
    methods=("sift",),
)


def test_the_project_has_its_tracks() -> None:
    assert TRACKS == [
        "real-seasons",
        "street-seasons",
        "uav-night",
        "uav-seasons",
        "uav-small",
        "uav-surprise",
    ]
    assert [name for name in TRACKS if load_track(name).config is None] == ["real-seasons"]


@pytest.mark.parametrize("name", TRACKS)
def test_a_track_can_be_rendered_and_run(name: str) -> None:
    track = load_track(name)
    for place in track.places:
        if track.config is None:
            continue
        given = {"preset": place.preset, "seed": place.seed}
        config = SimulateConfig.load(Path(track.config), given)
        assert (config.preset, config.seed) == (place.preset, place.seed)
        assert config.seed < 100, "seeds of reports"
        assert {session.role for session in config.sessions} == {"map", "query"}
    for start in track.starts:
        assert parse_start(start).name == start
    assert {"sift", "objconnect"} <= set(track.methods) <= set(LOCALIZERS)


def test_the_headline_cells_are_large_enough() -> None:
    """At least 400 queries in each condition of the aerial track, 200 in each part of a street."""
    for name, least in (("uav-seasons", 400), ("street-seasons", 3 * 200)):
        track = load_track(name)
        assert track.config is not None
        asked: dict[str, int] = {}
        for place in track.places:
            given = {"preset": place.preset, "seed": place.seed}
            for session in SimulateConfig.load(Path(track.config), given).sessions:
                if session.role == "query":
                    key = session.condition if name == "uav-seasons" else "all"
                    asked[key] = asked.get(key, 0) + (session.frames or 0)
        assert min(asked.values()) >= least, asked


def test_a_description_survives_writing_and_reading(tmp_path: Path) -> None:
    recorded = TRACK.with_renders({"park-1": ("0" * 63 + "a", "b" * 64)})
    assert [len(place.renders) for place in recorded.places] == [2, 0]
    for track in (TRACK, recorded):
        write_track(track, tmp_path)
        assert load_track("tiny", tmp_path) == track
    text = (tmp_path / "tiny" / "track.yaml").read_text()
    digests = f"{'0' * 63}a, {'b' * 64}"
    assert f"  renders: [{digests}]\n" in text, "a line"


def test_digests_of_digits_are_words(tmp_path: Path) -> None:
    """YAML would read them as a number."""
    for digest in ("1" * 64, "0" * 64, "1" * 20 + "e" + "1" * 43):
        write_track(TRACK.with_renders({"park-1": (digest,)}), tmp_path)
        assert load_track("tiny", tmp_path).places[0].renders == (digest,)


def test_sites_are_selected_by_name() -> None:
    assert TRACK.select() == TRACK.places
    assert TRACK.select(("b", "park-1")) == TRACK.places, "in the track's order"
    assert TRACK.select(("b",)) == TRACK.places[1:]
    with pytest.raises(InputError, match="no place 'c'; it has park-1, b"):
        TRACK.select(("b", "c"))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("name: tiny", "name: other", "called 'other', its folder 'tiny'"),
        ("dataset: b", "dataset: park-1", "two places have the same name"),
        ("dataset: b", "dataset: ../b", "places.1.dataset"),
        ("seed: 2", "seed: -2", "places.1.seed"),
        ("  seed: 2\n", "", "a rendered place has a preset and a seed"),
        ("config: uav-seasons\n", "", "a flight has none of them"),
        ("renders: []", "renders: [abc]", "places.0.renders.0"),
        ("title: Two", "colour: red\ntitle: Two", "unknown key 'colour'"),
        ("title: Two parks", "", "missing key 'title'"),
    ],
)
def test_a_wrong_description_is_refused(old: str, new: str, says: str, tmp_path: Path) -> None:
    write_track(TRACK, tmp_path)
    path = tmp_path / "tiny" / "track.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=re.escape(says)):
        load_track("tiny", tmp_path)


def test_an_unknown_track_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        InputError,
        match=f"no track named 'uav'; there are {', '.join(TRACKS)}",
    ):
        load_track("uav")
    for name in ("tiny", "", "..", "../tracks/tiny"):
        with pytest.raises(InputError, match=f"has no track named '{name}'$"):
            load_track(name, tmp_path)
