"""Turn a folder of JPEGs with GPS into a scene that every other command takes.

python examples/03_bring_your_own_photographs.py PHOTOS [SCENE]

PHOTOS defaults to the map flight of 00_simulate.py, whose EXIF is like a drone's.
"""

from pathlib import Path

import objconnect as oc

RENDERED = Path("runs/examples/scene/sessions/summer-noon-nadir-map/images")


def main(photographs: Path = RENDERED, out: Path = Path("runs/examples/own")) -> None:
    # Structure from motion of all photographs, placed on earth by GPS. Every sixth is a query.
    report = oc.ingest(photographs, out, size=1600, mapper="incremental", split="photo", every=6)
    print(report.text())

    # The poses are those of the reconstruction: no truth is known of real photographs.
    scene = oc.open_scene(out)
    print(f"reference poses: {scene.manifest.reference}; origin: {scene.manifest.origin}")
    print(f"map frames: {len(scene.splits.map)}, points: {len(scene.sparse_map().xyz)}")


if __name__ == "__main__":
    oc.run_script(main)
