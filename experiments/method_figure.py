"""Draw the features of the object-connect network in a query, and the steps of the alignment.

``python -m experiments.method_figure SCENE SESSION WEIGHTS OUT.png`` draws the first query of a
session of a finished scene with a map, with a prior that is wrong by 3 m and 5 degrees.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from skimage.segmentation import find_boundaries

from benchmark.datasets.open import open_datasets
from benchmark.evaluation.starts import move_prior
from objconnect.localization.align.aligner import align
from objconnect.localization.align.hypotheses import align_from_many
from objconnect.localization.align.options import SearchRadius
from objconnect.localization.featuremetric.references import MAX_POINTS
from objconnect.localization.initial_poses import list_initial_poses
from objconnect.network.localizer import ObjConnectConfig, ObjConnectLocalizer
from objconnect.network.network import read_network
from objconnect.network.segmentation import segment
from objconnect.scene.geometry.pose import Pose


@torch.inference_mode()
def main(scene: Path, session: str, weights: Path, out: Path) -> None:
    """Draw the picture."""
    (dataset,) = open_datasets(scene)
    benchmark_query = next(q for q in dataset.queries if q.name.split("/")[0] == session)
    query = benchmark_query.load(
        move_prior(benchmark_query.reference, benchmark_query.name, 3.0, 5.0)
    )
    localizer = ObjConnectLocalizer(ObjConnectConfig(weights=weights))
    with tempfile.TemporaryDirectory() as cache:
        localizer.prepare(dataset.load_map(), dataset.images, Path(cache))
        refine = localizer.map_state.refine
        chosen = refine.retrieval.choose(query, 5, lambda: np.empty((0, 1)), tilt_invariant=False)
        (start,) = list_initial_poses(query.prior, dataset.load_map(), chosen)
        view, maps = refine.problems.view(query, chosen, start)
        problem = refine.problems.build(view, maps, chosen, start, MAX_POINTS)
    network, _ = read_network(weights)
    image = torch.from_numpy(view.picture.astype(np.float32)).permute(2, 0, 1)[None] / 255

    figure = Figure(figsize=(14, 14), dpi=90, layout="constrained")
    axes = figure.subplots(2, 2)
    for axis in axes.flat:
        axis.imshow(view.picture)
        axis.set(xticks=[], yticks=[])
    if network.config.segmentation != "none":
        labels = segment(image, network.config)
        objects = network.objects(image, labels)
        height, width = view.picture.shape[:2]
        borders = find_boundaries(labels[0].numpy(), mode="inner").astype(float)
        borders = np.ma.masked_equal(borders, 0)
        axes[0, 0].imshow(borders, extent=(0, width, height, 0), cmap="autumn", alpha=0.8)
        present = objects.present[0]
        x, y = objects.centres[0, present].T.numpy()
        dots = axes[0, 0].scatter(x, y, c=objects.confidence[0, present], cmap="viridis", s=40)
        figure.colorbar(dots, ax=axes[0, 0], shrink=0.7, label="confidence of a centre")
    axes[0, 0].set_title("objects and their centres")
    size = (0, maps[1].confidence.shape[3] * 4, maps[1].confidence.shape[2] * 4, 0)
    overlay = axes[0, 1].imshow(maps[1].confidence[0, 0].float(), extent=size, alpha=0.75)
    figure.colorbar(overlay, ax=axes[0, 1], shrink=0.7)
    axes[0, 1].set_title("confidence of places (stride 4)")

    (world,), batch = problem.points, problem.start
    true = view.camera.project(view.pose(benchmark_query.reference).transform(world))
    for axis, title, found in (
        (axes[1, 0], "one start", align(problem)),
        (axes[1, 1], "many starts", align_from_many(problem, SearchRadius())),
    ):
        poses = [batch, *found.level_poses]
        names = ("start", *(f"stride {level.stride}" for level in problem.levels))
        for pose, name, colour in zip(
            poses, names, ("red", "orange", "yellow", "cyan"), strict=True
        ):
            projected = view.camera.project(
                Pose(pose.rotation[0], pose.translation[0]).transform(world)
            )
            drawn_points = (projected.valid & true.valid).numpy()
            drawn_points &= view.camera.contains(true.xy).numpy()
            # Every eighth point is drawn.
            drawn_points[drawn_points] = np.arange(drawn_points.sum()) % 8 == 0
            x, y = projected.xy.numpy()[drawn_points].T
            error_px = float(
                (projected.xy - true.xy)[torch.from_numpy(drawn_points)].norm(dim=-1).median()
            )
            axis.plot(x, y, ".", color=colour, markersize=4, label=f"{name}: {error_px:.1f} px")
        last = Pose(found.pose.rotation[0], found.pose.translation[0])
        metres, _ = view.photograph_pose(last).error_to(benchmark_query.reference)
        axis.legend(loc="lower right", title="points, median off by")
        axis.set_title(f"{title}: {float(metres):.2f} m off")
        axis.set(xlim=(0, view.camera.width), ylim=(view.camera.height, 0))
    figure.savefig(out)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]), Path(sys.argv[4]))
