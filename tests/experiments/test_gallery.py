"""The gallery: what the registries hold is on the page, and an interrupted run goes on."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import experiments.gallery
from experiments.gallery import gallery, main
from objconnect.scene.errors import InputError
from objconnect.scene.storage.images import read_rgb
from simulate.config import SimulateConfig
from simulate.look import conditions, seasons
from simulate.look.conditions import condition
from simulate.place.presets import PRESETS
from simulate.render.job import RenderJob, frame_path
from simulate.render.pool import RenderError

# The built-in entries, which tests may change.
PLANS: Any = PRESETS.built_in
SEASONS: Any = seasons.SEASONS.built_in
LIGHTS: Any = conditions.LIGHTS.built_in
WEATHER: Any = conditions.WEATHER.built_in

SMALL = SimulateConfig(seed=5, area=120, size=64, spp=1)


@pytest.fixture(autouse=True)
def restored() -> Iterator[None]:
    """The registries, whose order is part of messages, are afterwards what they were."""
    registries: tuple[dict[str, Any], ...] = (PLANS, SEASONS, LIGHTS, WEATHER)
    before = [dict(registry) for registry in registries]
    yield
    for registry, entries in zip(registries, before, strict=True):
        registry.clear()
        registry.update(entries)
    condition.cache_clear()


def keep(registry: dict[str, Any], *names: str) -> None:
    for name in registry.keys() - set(names):
        del registry[name]


@pytest.fixture
def few() -> None:
    """Registries of one place and two seasons, lights and weathers: default sessions need them."""
    keep(PLANS, "town")
    keep(SEASONS, "summer", "winter")
    keep(LIGHTS, "noon", "dusk")
    keep(WEATHER, "clear", "fog")


def shade(job: RenderJob) -> int:
    return sum(job.condition.encode()) % 256


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[RenderJob]:
    """The jobs that were given to a renderer of plain grey pictures."""
    jobs: list[RenderJob] = []

    def grey(job: RenderJob, out_dir: Path) -> None:
        missing = [k for k in job.poses if not frame_path(out_dir, k).exists()]
        if missing:
            jobs.append(job)
        out_dir.mkdir(parents=True, exist_ok=True)
        for k in missing:
            picture = np.full((job.camera.height, job.camera.width, 3), shade(job), np.uint8)
            np.savez(frame_path(out_dir, k), rgb=picture)

    monkeypatch.setattr(experiments.gallery, "render", grey)
    return jobs


def read_pictures(page: Path) -> list[NDArray[np.uint8]]:
    """The pictures the page shows."""
    links = re.findall(r"!\[.+\]\((.+)\)", page.read_text())
    pictures = [read_rgb(page.parent / link) for link in links]
    assert {page.parent / link for link in links} == set((page.parent / "gallery").iterdir())
    return pictures


def test_new_places_and_conditions_come_in_by_themselves(
    few: None, rendered: list[RenderJob], tmp_path: Path
) -> None:
    PLANS["hamlet"] = PLANS["town"]
    SEASONS["monsoon"] = SEASONS["summer"]
    WEATHER["smog"] = WEATHER["fog"]
    page = gallery(SMALL, tmp_path)
    assert "### hamlet" in page.read_text()
    assert {job.preset for job in rendered} == {"town", "hamlet"}
    shown = {job.condition for job in rendered}
    assert shown == {
        "summer-noon", "winter-noon", "monsoon-noon", "summer-dusk", "summer-noon-fog",
        "summer-noon-smog",
    }  # fmt: skip
    assert len(rendered) == 2 + len(shown)  # each once, whatever pictures it is in
    town, hamlet, season, light, weather = read_pictures(page)
    assert town.shape == hamlet.shape == season.shape == weather.shape
    assert light.shape[1] < weather.shape[1], "two lights, three weathers"
    # The last photograph is that of its own condition.
    job = next(job for job in rendered if job.condition == "summer-noon-smog")
    assert weather[-40, -40] == pytest.approx(shade(job), abs=3)


def test_an_interrupted_run_goes_on(
    few: None, rendered: list[RenderJob], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    whole: Callable[[RenderJob, Path], None] = experiments.gallery.render

    def dies(job: RenderJob, out_dir: Path) -> None:
        if len(rendered) == 3:
            raise RenderError("Blender died")
        whole(job, out_dir)

    monkeypatch.setattr(experiments.gallery, "render", dies)
    with pytest.raises(InputError, match="^Blender died$"):
        gallery(SMALL, tmp_path)
    assert not (tmp_path / "gallery.md").exists()
    monkeypatch.setattr(experiments.gallery, "render", whole)
    read_pictures(gallery(SMALL, tmp_path))
    assert len(rendered) == 1 + 4
    assert {path.name for path in tmp_path.iterdir()} == {"gallery", "gallery.md"}
    # Finished, it renders anew: the look may have changed.
    gallery(SMALL, tmp_path)
    assert len(rendered) == 2 * (1 + 4)


def test_the_page_says_how_it_was_made(few: None, rendered: list[RenderJob], tmp_path: Path):
    where = tmp_path / "pages"
    words = ["--out", where, "--preset", "town", "--condition", "winter-noon-fog"]
    words += ["--seed", 5, "--area", 120, "--size", 64, "--spp", 1]
    main([str(word) for word in words])
    said = (where / "gallery.md").read_text().replace("\\\n", "")
    assert " ".join(
        f"python -m experiments.gallery {' '.join(map(str, words))}".split()
    ) in " ".join(said.split())


@pytest.mark.thorough
def test_a_rendered_gallery(few: None, tmp_path: Path) -> None:
    town, season, light, weather = read_pictures(gallery(SMALL, tmp_path))
    assert all(picture.std() > 30 for picture in (town, season, light, weather))
    assert town.shape[1] > 3 * 64
