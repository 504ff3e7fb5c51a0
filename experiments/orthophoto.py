"""Build a scene from the map of an orthophoto and the queries of another scene, for ``evaluate``.

    python -m experiments.orthophoto SCENE ORTHOPHOTO DSM --out OUT [--tilt DEGREES]
        [--altitude METRES] [--overlap SHARE]

The world of the new scene is that of SCENE, so that the queries keep their reference poses. The
photographs and frames of the queries are links to those of SCENE.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from objconnect.ingestion.virtual.command import photograph_orthophoto
from objconnect.ingestion.virtual.options import ViewOptions
from objconnect.mapping.build import build_map
from objconnect.scene.bundle.manifest import Splits, write_json
from objconnect.scene.bundle.scene import Scene, finish_scene


def main() -> None:
    """Photograph the orthophoto, build the map, and add the queries."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("orthophoto", type=Path)
    parser.add_argument("dsm", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    for name in ("tilt", "altitude", "overlap"):
        parser.add_argument(f"--{name}", type=float)
    args = parser.parse_args()
    views = {name: getattr(args, name) for name in ("tilt", "altitude", "overlap")}
    options = ViewOptions.model_validate({k: v for k, v in views.items() if v is not None})
    scene = Scene.open(args.scene)
    report = photograph_orthophoto(
        args.orthophoto, args.dsm, args.out, options=options, origin=scene.manifest.origin
    )
    print(report.text())
    print(build_map(args.out).text())
    add_queries(args.out, scene)


def add_queries(path: Path, scene: Scene) -> None:
    """Add the sessions of queries of another scene, whose world is the same."""
    new_scene = Scene.open(path)
    queries = scene.splits.queries
    for session in queries:
        shutil.copytree(
            scene.images_root / session, new_scene.images_root / session, copy_function=_link
        )
    write_json(path / "splits.json", Splits(map=new_scene.splits.map, queries=queries))
    sessions = {**new_scene.sessions, **{name: scene.sessions[name] for name in queries}}
    finish_scene(path, new_scene.manifest.model_copy(update={"sessions": sessions}))


def _link(source: str, target: str) -> None:
    Path(target).symlink_to(Path(source).resolve())


if __name__ == "__main__":
    main()
