"""Train a method on a rendered scene. A few steps only: this shows how, and learns nothing.

python examples/06_train.py [SCENE] [RUN]    (after 00_simulate.py)
"""

from pathlib import Path

import objconnect as oc


def main(
    path: Path = Path("runs/examples/scene"), out: Path = Path("runs/examples/training")
) -> None:
    # Every field but these has its default; a real run takes thousands of steps.
    config = oc.TrainConfig(
        steps=2, batch=1, crop=96, points=64, width=0.125, workers=0, validate_every=2, save_every=2
    )
    weights = oc.train("pixloc", oc.trainable("pixloc"), [path], out, config)
    print(f"weights: {weights}; log, curves and card lie beside them")

    # A localizer takes them by the option `weights`.
    localizer = oc.create_localizer("pixloc", {"weights": str(weights)})
    print(f"{localizer.name} with weights {localizer.weights_sha256}")


if __name__ == "__main__":
    oc.run_script(main)
