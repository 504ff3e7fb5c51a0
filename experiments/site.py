"""Realism of a twin: compare it with the scene that it was built from.

    python -m experiments.site flown FLIGHT --out YAML       # configuration of the same flight
    python -m experiments.site cross MAP QUERIES --out OUT   # queries in the map of another scene
    python -m experiments.site compare REAL TWIN             # colours, classes
    python -m experiments.site features FLIGHT TWIN          # colours, features by class
    python -m experiments.site strip REAL TWIN --out JPG     # photographs side by side
    python -m experiments.site classes REAL                  # classes, without a twin

Both scenes have the same world, and the same sessions where they are compared. The folder of
``cross`` is a scene that ``evaluate`` reads; its photographs are links.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from benchmark.forecasting.views import most_common_camera
from experiments.orthophoto import _link
from objconnect.scene.bundle.manifest import Splits, write_json
from objconnect.scene.bundle.scene import Scene, finish_scene
from objconnect.scene.storage.images import read_rgb
from simulate.place.site_files import load_site
from simulate.place.world import World
from simulate.twin.build import build_site
from simulate.twin.classes import CROWN, LOW_VEGETATION, NAMES, PAVED, ROOF, WATER
from simulate.twin.options import SiteConfig
from simulate.twin.report import PLACE_FILE

# The classes of a simulated scene for each class of a twin's ground. Other classes are objects.
_TRUTH = {
    LOW_VEGETATION: ("grass", "field"),
    PAVED: ("road", "pavement", "parking", "driveway", "path"),
    WATER: ("water",),
    ROOF: ("building",),
    CROWN: ("tree",),
}
WHAT = ("flown", "cross", "compare", "features", "strip", "classes")
_MAX_WIDTH = 520  # pixels of a photograph in a strip
_STEP = 4  # every n-th row and column of a photograph is compared
_FACES_UP = 30  # minimum z of a normal, of 127; surface models from above have no walls


def main() -> None:
    """Run one of the comparisons."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=WHAT)
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path, nargs="?")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--query", type=int, default=0, help="number of the query to draw")
    parser.add_argument("--size", type=int, default=800, help="longer side of the twin's pictures")
    args = parser.parse_args()
    first = Scene.open(args.first)
    if args.what == "classes":
        site = SiteConfig(scene=args.first)
        side_m = first.manifest.config["area"]
        world, _ = build_site(site, side_m, first.manifest.origin, 0, Path(tempfile.gettempdir()))
        compare_classes(first, world)
        return
    if args.what == "flown":
        write_flown(first, args.size, args.out)
        return
    second = Scene.open(args.second)
    if args.what == "cross":
        cross(first, second, args.out)
    elif args.what == "features":
        compare_features(first, second)
    elif args.what == "strip":
        strip(first, second, args.out, args.query)
    else:
        compare_colours(first, second)
        compare_classes(first, load_site(second.path / PLACE_FILE, 0))


def write_flown(scene: Scene, size: int, out: Path) -> None:
    """Write the configuration of a twin with its scene's flight, in summer and in snow."""
    flights = {"map": "map", "summer": "queries", "snow": "queries"}
    sessions = [
        {
            "name": name,
            "condition": "snow-dusk" if name == "snow" else "summer-noon",
            "role": "map" if name == "map" else "query",
            "flight": {"kind": "flown", "scene": str(scene.path), "photographs": photographs},
        }
        for name, photographs in flights.items()
    ]
    config = {
        "preset": "site",
        "site": {"scene": str(scene.path)},
        "camera": most_common_camera(scene.sparse_map(), size),
        "sessions": sessions,
    }
    out.write_text(yaml.safe_dump(config, sort_keys=False))


def cross(map_scene: Scene, query_scene: Scene, out: Path) -> None:
    """Build a scene of the map of one scene and the queries of another in the same world."""
    owners = {name.split("/")[0]: map_scene for name in map_scene.splits.map}
    if in_both := owners.keys() & query_scene.splits.queries.keys():
        raise SystemExit(
            f"session {min(in_both)} has the map of one scene and queries of the other"
        )
    owners |= dict.fromkeys(query_scene.splits.queries, query_scene)
    for session, owner in owners.items():
        shutil.copytree(
            owner.images_root / session, out / "sessions" / session, copy_function=_link
        )
    shutil.copytree(map_scene.map_path, out / "map", copy_function=_link)
    shutil.copyfile(map_scene.path / "objects.json", out / "objects.json")
    splits = Splits(map=map_scene.splits.map, queries=query_scene.splits.queries)
    write_json(out / "splits.json", splits)
    changed = {
        "sessions": {name: owner.sessions[name] for name, owner in owners.items()},
        "reference": max(
            map_scene.manifest.reference, query_scene.manifest.reference
        ),  # "sfm" if any
        "pixels_sha256": {},
    }
    finish_scene(out, map_scene.manifest.model_copy(update=changed))


def compare_colours(real: Scene, twin: Scene) -> None:
    """Print mean and deviation of the colours of each session."""
    for session in real.sessions:
        for name, scene in (("real", real), ("twin", twin)):
            pixels = _photographs(scene, session)
            mean, spread = pixels.mean((0, 1, 2)).round(), pixels.std((0, 1, 2)).round()
            print(f"{session} {name}: mean {mean.tolist()}, deviation {spread.tolist()}")


def compare_classes(real: Scene, world: World) -> None:
    """Print the shares of the twin's classes within each true class, for upward surfaces."""
    count = np.zeros((256, 256), np.int64)
    for session in {name.split("/")[0] for name in real.splits.map}:
        frames = real.frames(session)
        with real.layers(session) as layers:
            for k, camera in enumerate(frames.cameras):
                rays = camera.unproject(camera.pixel_grid()[::_STEP, ::_STEP])[0].numpy()
                depth, label, normal = (
                    layers.read(layer, k)[::_STEP, ::_STEP]
                    for layer in ("depth", "semantic", "normal")
                )
                pose = frames.cam_from_world[k]
                points = (rays * depth[..., None] - pose[:3, 3]) @ pose[:3, :3]
                is_on_site = (np.abs(points[..., :2]) < 0.5 * world.side_m).all(-1)
                up = is_on_site & (depth > 0) & (normal[..., 2] > _FACES_UP)
                found = world.ground.label(points[up][:, 0], points[up][:, 1])
                np.add.at(count, (label[up], found), 1)
    classes = real.objects.classes
    for label, names in _TRUTH.items():
        row = count[[classes[name] for name in names]].sum(0)
        if row.sum():
            shares = {NAMES[k]: f"{100 * row[k] / row.sum():.0f} %" for k in NAMES if row[k]}
            print(f"{NAMES[label]}: {row.sum()} points, {shares}")


def compare_features(flight: Scene, twin: Scene) -> None:
    """Print colours and SIFT features of a flight's queries and of the same flight over its twin.

    The same pixel shows the same ground in both, so that the twin's classes hold for both.
    Photographs of the flight get the size of the twin's.
    """
    (photographs,) = flight.splits.queries.values()
    session = next(iter(twin.splits.queries))
    frames = twin.frames(session)
    found = {}
    with twin.layers(session) as layers:
        for k, name in enumerate(frames.names):
            rendered = read_rgb(twin.images_root / name)
            labels, (height, width) = layers.read("semantic", k), rendered.shape[:2]
            resized = cv2.resize(
                read_rgb(flight.images_root / photographs[k]),
                (width, height),
                interpolation=cv2.INTER_AREA,
            )
            for source, rgb in (("flight", resized), ("twin", rendered)):
                points = cv2.SIFT_create().detect(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
                x, y = np.array([point.pt for point in points], int).reshape(-1, 2).T
                for label in NAMES:
                    mask = labels == label
                    pixels, features = found.setdefault((label, source), ([], []))
                    pixels.append(rgb[mask])
                    features.append(int(mask[y, x].sum()))
    for (label, source), (pixels, features) in found.items():
        colours = np.concatenate(pixels)
        if len(colours):
            print(
                f"{NAMES[label]}, {source}: {len(colours)} pixels, mean "
                f"{colours.mean(0).round().tolist()}, deviation {colours.std(0).round().tolist()}, "
                f"{1e4 * sum(features) / len(colours):.1f} features in 10,000 pixels"
            )


def strip(real: Scene, twin: Scene, out: Path, query: int) -> None:
    """Draw one query: real and twin in summer, twin in winter, and real in winter if it exists."""
    first, *later = real.splits.queries
    summer, winter = list(twin.splits.queries)
    order = [(real, first), (twin, summer), (twin, winter), *((real, s) for s in later[:1])]
    names = [(scene, scene.splits.queries[session][query]) for scene, session in order]
    pictures = [Image.fromarray(read_rgb(scene.images_root / name)) for scene, name in names]
    width, height = min(picture.size for picture in pictures)
    size = (min(width, _MAX_WIDTH), round(height * min(1, _MAX_WIDTH / width)))
    Image.fromarray(np.hstack([np.asarray(p.resize(size)) for p in pictures])).save(out, quality=80)


def _photographs(scene: Scene, session: str) -> NDArray[np.uint8]:
    """Read the photographs of a session, (N, H, W, 3)."""
    frames = scene.frames(session)
    return np.stack([read_rgb(scene.images_root / name) for name in frames.names])


if __name__ == "__main__":
    main()
