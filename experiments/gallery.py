"""Write a page of pictures of all kinds of places and all conditions.

``python -m experiments.gallery --out docs --preset town --condition summer-noon``; a
second run continues an interrupted one.
"""

from __future__ import annotations

import argparse
import shutil
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from objconnect.scene.errors import InputError
from objconnect.scene.runtime.escaping import for_terminal
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import TEMPORARY_PREFIX, atomic_write, write_text
from objconnect.scene.storage.digests import sha256
from objconnect.scene.storage.leftovers import remove_partial
from objconnect.scene.storage.outputs import OutputFile, check_outputs
from objconnect.scene.storage.provenance import JPEG_MARK
from simulate.command import render_job
from simulate.config import SessionConfig, SimulateConfig
from simulate.flight.clearance import check_flight
from simulate.flight.config import NadirFlight, ObliqueFlight, StreetFlight
from simulate.look.conditions import LIGHTS, WEATHER, condition
from simulate.look.seasons import SEASONS
from simulate.place.presets import PRESETS, preset
from simulate.place.world import World
from simulate.planner import plan_session
from simulate.render.job import RenderJob, frame_path
from simulate.render.pool import RenderError, render

PAGE, PICTURES = "gallery.md", "gallery"
_SEASON, _LIGHT, _WEATHER = "season", "light", "weather"
_RENDERED = f"{TEMPORARY_PREFIX}gallery"
# Every page has this text near its beginning, by which it is recognised.
_MARK = b"Every kind of place and every condition, as the simulator renders them."
# The views of a place, each with the number of exposures from which one is chosen.
_VIEWS = ((ObliqueFlight(), 1), (NadirFlight(), 1), (StreetFlight(yaws_deg=(15,)), 40))
_AHEAD_M = 40.0  # distance of the point at which a picture from the street is aimed
_COLUMNS = 3  # photographs side by side
_INCH = 100  # pixels per inch of a picture
_JPEG_QUALITY = 82


@dataclass(frozen=True)
class _Picture:
    """Photographs with their titles, each of which is a frame of a render job."""

    name: str
    titles: tuple[str, ...]
    shots: tuple[tuple[RenderJob, int], ...]


def gallery(config: SimulateConfig, out: Path, base_condition: str = "summer-noon") -> Path:
    """Write a page of pictures, or continue an interrupted run.

    The page shows every preset from an orbit, from above and from the street. Then it shows
    ``config.preset`` from the orbit in every season, in every light and in every weather; the
    other parts of the condition are those of ``base_condition``. Presets, seasons, lights and
    weathers are those of the registries.

    Args:
        config: seed, minimum area, camera and samples of all pictures, and the place that is shown
            under every condition; its sessions are not used.
        out: folder of ``gallery.md`` and of the folder ``gallery/`` of its pictures.
        base_condition: condition of the pictures of every place.

    Returns:
        The page.

    Raises:
        InputError: the condition is unknown, a place has no room for a view, rendering failed, or
            ``out`` cannot be written.
    """
    base_condition = condition(base_condition, config.origin).name
    _refuse_foreign_files(out)
    config = config.model_copy(update={"position_jitter_m": 0.0, "attitude_jitter_deg": 0.0})
    configs = {
        name: config.model_copy(update={"preset": name, "area": max(config.area, plan.min_side_m)})
        for name, plan in PRESETS.items()
    }
    places = {name: preset(name)(config.seed, each.area) for name, each in configs.items()}
    kinds = [
        _picture_of_place(configs[name], world, base_condition) for name, world in places.items()
    ]
    whole = _pictures_of_conditions(configs[config.preset], places[config.preset], base_condition)
    pictures = [*kinds, *whole]
    rendered = out / _RENDERED
    jobs = {_folder(job): job for picture in pictures for job, _ in picture.shots}
    try:
        (out / PICTURES).mkdir(parents=True, exist_ok=True)
        remove_partial(out / PICTURES)
        with progress_bar("gallery", len(jobs)) as advance:
            for done, (folder, job) in enumerate(jobs.items(), 1):
                render(job, rendered / folder)
                advance(done)
        for picture in pictures:
            _draw(picture, config, rendered, out / PICTURES / f"{picture.name}.jpg")
        write_text(out / PAGE, _page(config, out, base_condition, places))
        shutil.rmtree(rendered)
    except RenderError as error:
        raise InputError(str(error)) from error
    except OSError as error:
        raise InputError(f"cannot write {out}: {error.strerror or error}") from error
    return out / PAGE


def _refuse_foreign_files(out: Path) -> None:
    """Refuse to replace files of another program."""
    page = OutputFile(out / PAGE, _MARK)
    # If this command wrote the page, it also wrote the pictures beside it.
    mark = b"" if page.path.is_file() else JPEG_MARK
    names = (*PRESETS, _SEASON, _LIGHT, _WEATHER)
    check_outputs(
        [page, *(OutputFile(out / PICTURES / f"{name}.jpg", mark) for name in names)], within=out
    )


def _picture_of_place(config: SimulateConfig, world: World, base_condition: str) -> _Picture:
    """Return the picture of a place from every view."""
    name = config.preset
    job = _job(config, base_condition, world, len(_VIEWS))
    shots = tuple((job, k) for k in range(len(_VIEWS)))
    return _Picture(name, tuple(view.kind for view, _ in _VIEWS), shots)


def _pictures_of_conditions(
    config: SimulateConfig, world: World, base_condition: str
) -> tuple[_Picture, ...]:
    """Return pictures of a place in every season, in every light and in every weather.

    The other two parts of the conditions are those of ``base_condition``.
    """
    season, light, *_ = base_condition.split("-")

    def picture(name: str, parts: Iterable[str], text: str) -> _Picture:
        names = [condition(text.format(part), config.origin).name for part in parts]
        shots = tuple((_job(config, each, world, 1), 0) for each in names)
        return _Picture(name, tuple(parts), shots)

    return (
        picture(_SEASON, SEASONS, base_condition.replace(season, "{}", 1)),
        picture(_LIGHT, LIGHTS, base_condition.replace(f"-{light}", "-{}", 1)),
        picture(_WEATHER, WEATHER, f"{season}-{light}-{{}}"),
    )


def _job(config: SimulateConfig, base_condition: str, world: World, views: int) -> RenderJob:
    """Return the job of the first ``views`` views of a place under a condition."""
    camera = config.photo_camera()
    poses = []
    for view, frames in _VIEWS[:views]:
        session = SessionConfig(condition=base_condition, flight=view, role="query", frames=frames)
        rng = np.random.default_rng(config.seed)
        planned = plan_session(session, config, camera, world, rng)
        # The photograph whose target is nearest to the middle of the place.
        middle = planned[:, :3, 3] - [0, 0, _AHEAD_M]  # target of each camera
        pose = planned[[np.linalg.norm(middle, axis=1).argmin()]]
        check_flight(f"{config.preset} {view.kind}", pose, camera, world)
        poses.append(pose)
    return render_job(config, session, np.concatenate(poses))


def _folder(job: RenderJob) -> str:
    """Return the name of the folder of a job's frames, which is a digest of the job."""
    return sha256(job.model_dump_json())[:16]


def _draw(picture: _Picture, config: SimulateConfig, rendered: Path, path: Path) -> None:
    camera = config.photo_camera()
    width, height = camera.width / _INCH, camera.height / _INCH
    rows, columns = -(-len(picture.shots) // _COLUMNS), min(len(picture.shots), _COLUMNS)
    top, gap = 0.22, 0.04
    size = (columns * (width + gap), rows * (top + height + gap))
    figure = Figure(figsize=size, facecolor="white")
    for k, (job, frame) in enumerate(picture.shots):
        row, column = divmod(k, columns)
        x, y = column * (width + gap), size[1] - (row + 1) * (top + height + gap) + gap
        ax = figure.add_axes((x / size[0], y / size[1], width / size[0], height / size[1]))
        ax.set_axis_off()
        ax.imshow(_photograph(rendered / _folder(job), frame), aspect="auto")
        ax.set_title(picture.titles[k], fontsize=9, pad=3)
    with atomic_write(path) as partial:
        figure.savefig(partial, format="jpeg", dpi=_INCH,
                       pil_kwargs={"quality": _JPEG_QUALITY, "comment": JPEG_MARK})  # fmt: skip


def _photograph(folder: Path, frame: int) -> NDArray[np.uint8]:
    with np.load(frame_path(folder, frame)) as layers:
        return np.asarray(layers["rgb"])


def _page(
    config: SimulateConfig, out: Path, base_condition: str, places: Mapping[str, World]
) -> str:
    """Return the Markdown of the page."""
    kinds = "\n".join(
        f"""
### {name}

{_inventory(world)}

![{name} from an orbit, from above and from the street]({PICTURES}/{name}.jpg)"""
        for name, world in places.items()
    )
    return f"""# Gallery

Every kind of place and every condition, as the simulator renders them. This command made the page:

```sh
python -m experiments.gallery --out {for_terminal(out)} --preset {config.preset} \\
  --condition {base_condition} --seed {config.seed} --area {config.area:g} \\
  --size {config.size} --spp {config.spp}
```

## Places in {base_condition}

All places have seed {config.seed} and a side of {config.area:g} m, or the smallest side that the
place allows. Each is shown from an orbit, from above and from the street.
{kinds}

## The preset {config.preset} under all conditions

No object moves between conditions. In the season leafoff, broadleaved trees are bare; a
scene records them as changed objects. Every season, light and weather can be combined. Each
figure varies one of the three; the other two are those of {base_condition}.

### Seasons

![{config.preset} in every season]({PICTURES}/{_SEASON}.jpg)

### Light

![{config.preset} in every light]({PICTURES}/{_LIGHT}.jpg)

### Weather

![{config.preset} in every weather]({PICTURES}/{_WEATHER}.jpg)
"""


def _inventory(world: World) -> str:
    """Return the number of objects of each class as text, the most frequent first."""
    counts = Counter(item.class_name for item in world.objects)
    return f"{len(world.objects)} objects: " + ", ".join(
        f"{name} {count}" for name, count in counts.most_common()
    )


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")
    parser.add_argument(
        "--preset", default="town", help="place that is shown under every condition"
    )
    parser.add_argument("--condition", default="summer-noon", help="condition of every place")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--area", type=float, default=140.0)
    parser.add_argument("--size", type=int, default=240)
    parser.add_argument("--spp", type=int, default=4)
    args = vars(parser.parse_args(words))
    out, base_condition = args.pop("out"), args.pop("condition")
    print(gallery(SimulateConfig(**args), out, base_condition))


if __name__ == "__main__":
    main()
