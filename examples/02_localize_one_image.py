"""Find the pose of one photograph in a map, and compare it with the truth.

python examples/02_localize_one_image.py [SCENE]    (after 01_map.py)
"""

from pathlib import Path

import objconnect as oc


def main(path: Path = Path("runs/examples/scene")) -> float:
    scene = oc.open_scene(path)
    localizer = oc.create_localizer("sift", {"references": 4})
    localizer.prepare(scene.sparse_map(), scene.images_root)

    # One frame of a query session, with the noisy position that its GPS gave.
    frames = scene.frames("summer-noon-nadir-query")
    camera, truth = frames.cameras[0], oc.Pose.from_matrix(frames.cam_from_world[0])
    image = oc.read_rgb(scene.images_root / frames.names[0], camera)
    prior = oc.Prior(position=frames.gps_prior[0], position_sigma=frames.gps_sigma[0])

    estimate = localizer.localize(oc.Query("first", image, camera, prior))
    # Localizers never raise an error on a bad query: they return the reason instead of a pose.
    if estimate.status is not oc.Status.OK or estimate.cam_from_world is None:
        raise SystemExit(f"no pose: {estimate.reason}")
    metres, degrees = estimate.cam_from_world.error_to(truth)
    print(f"camera at {estimate.cam_from_world.centre().tolist()}")
    print(f"off by {metres:.3f} m and {degrees:.3f} degrees, {estimate.inliers} inliers")
    return float(metres)


if __name__ == "__main__":
    oc.run_script(main)
