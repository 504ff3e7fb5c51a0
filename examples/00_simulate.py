"""Render a small scene: a map flight at summer noon, and queries at summer noon and winter dusk.

python examples/00_simulate.py [SCENE]    (about a minute on two cores)
"""

from pathlib import Path

import objconnect as oc
import simulate


def main(out: Path = Path("runs/examples/scene")) -> None:
    # The fields are those of a YAML configuration. The same seed gives the same scene.
    config = simulate.SimulateConfig.model_validate(
        {
            "preset": "town",
            "seed": 11,
            "area": 120,  # metres a side
            "size": 256,  # pixels a side
            "spp": 2,  # rendering samples per pixel
            "sessions": [
                {"condition": "summer-noon", "flight": "nadir", "role": "map", "frames": 12},
                {"condition": "summer-noon", "flight": "nadir", "role": "query", "frames": 4},
                {"condition": "winter-dusk", "flight": "oblique", "role": "query", "frames": 2},
            ],
        }
    )
    scene = simulate.simulate(config, out)

    # A scene holds the true pose and the true depth of every frame.
    for name in scene.sessions:
        frames = scene.frames(name)
        with scene.layers(name) as layers:
            depth = layers.read("depth", 0)
        print(f"{name}: {len(frames)} frames, first at {frames.poses.centre()[0].tolist()}")
        print(f"  depth of the first: {depth.shape}, {depth[depth > 0].mean():.1f} m in the mean")


if __name__ == "__main__":
    oc.run_script(main)
