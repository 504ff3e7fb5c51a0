"""Build the map of a scene and read it.

python examples/01_map.py [SCENE]    (after 00_simulate.py)
"""

from pathlib import Path

import objconnect as oc


def main(path: Path = Path("runs/examples/scene")) -> None:
    # COLMAP triangulates SIFT matches with the exact poses of the map frames.
    report = oc.build_map(path)
    print(report.text())

    # The map is a set of arrays, in world metres.
    sparse_map = oc.open_scene(path).sparse_map()
    print(
        f"{len(sparse_map.xyz)} points between {sparse_map.xyz.min(0)} and {sparse_map.xyz.max(0)}"
    )
    print(f"{len(sparse_map.images)} photographs, the first is {sparse_map.names[0]}")


if __name__ == "__main__":
    oc.run_script(main)
