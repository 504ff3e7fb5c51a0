"""Every command: what each of its parameters is. A new command or option joins here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tests.fuzz.readers import CMU_QUERY
from tests.misuse.faults import LONG
from tests.misuse.arguments import (
    CAMERA,
    CLUSTER,
    FLAG,
    METHOD,
    SEED,
    SETTINGS,
    Argument,
    Fault,
    choice,
    file,
    folder,
    integer,
    out_file,
    out_folder,
    part,
    real,
    start,
    values,
)

MANIFEST = part("hamlet/scene.json", "our json")
SPLITS = part("hamlet/splits.json", "our json")
OBJECTS = part("hamlet/objects.json", "our json")
COVISIBILITY = part("hamlet/covisibility.h5", "bytes")
MAP_FRAMES = part("hamlet/sessions/summer-nadir/frames.h5", "bytes")
QUERY_FRAMES = part("hamlet/sessions/winter-grid/frames.h5", "bytes")
LEARNED = (
    part("grove/scene.json", "our json"),
    part("grove/covisibility.h5", "bytes"),
    part("grove/sessions/summer-nadir/frames.h5", "bytes"),
)
MAP_PHOTOGRAPH = part("hamlet/sessions/summer-nadir/images/000001.jpg", "photograph")
QUERY_PHOTOGRAPH = part("hamlet/sessions/winter-grid/images/000002.jpg", "photograph")
MODEL = {
    name: fault
    for model in ("cameras", "images", "points3D")
    for name, fault in part(f"hamlet/map/{model}.bin", "bytes").items()
}
FLIGHT = (
    part("meadow/queries.txt", "words"),
    part("meadow/reference_poses.txt", "words"),
    part("meadow/gps.csv", "csv"),
    part("meadow/images/b.jpg", "photograph"),
    part("meadow/images/c.jpg", "photograph"),
    *(part(f"meadow/sparse/map/{m}.bin", "bytes") for m in ("cameras", "images", "points3D")),
)
CMU = (
    part("cmu/intrinsics.txt", "words"),
    part("cmu/slice2/camera-poses/slice-2-gt-query-images-20101019.txt", "words"),
    part(f"cmu/slice2/query/{CMU_QUERY}", "photograph"),
    part("cmu/slice2/sparse/images.bin", "bytes"),
)
QUERIED = (MANIFEST, SPLITS, QUERY_FRAMES, MODEL, MAP_PHOTOGRAPH, QUERY_PHOTOGRAPH)


@dataclass(frozen=True)
class Row:
    """A command.

    Attributes:
        arguments: by the name of the parameter.
        work: functions at which its real work begins, which the matrix does not wait for.
    """

    arguments: Mapping[str, Argument]
    work: tuple[str, ...] = ()


def row(*work: str, **arguments: Argument) -> Row:
    """A command by its parameters."""
    return Row(arguments, work)


COMMANDS: dict[str, Row] = {
    "evaluate": row(
        datasets=folder("hamlet", *QUERIED),
        method=METHOD,
        out=out_folder("out", "*"),
        overrides=SETTINGS,
        start=start("prior", "tables/pairs.txt"),
        cache=out_folder("cache", "*"),
        jobs=integer("1"),
        cluster=CLUSTER,
        as_json=FLAG,
    ),
    "submit": row(
        path=folder("cmu", *CMU),
        out=out_folder("out", "*"),
        method=METHOD,
        overrides=SETTINGS,
        cache=out_folder("cache", "*"),
        as_json=FLAG,
    ),
    "score": row(
        poses=file("tables/poses.txt", "words"),
        reference=folder("meadow", *FLIGHT),
        out=out_folder("out", "*"),
        method=values("theirs", "", "../../x", "/x", "a/b", ".hidden", "a\nb", "\x1b[31m", LONG),
        start=start("none", "tables/pairs.txt"),
        as_json=FLAG,
    ),
    "leaderboard": row(
        results=folder("results", part("results/meadow/sift.json", "our json"),
                       part("results/meadow/sift.basin.json", "our json"),
                       part("results/meadow/album.h5", "bytes")),
        out=out_folder("out", "leaderboard.*"),
        as_json=FLAG,
    ),
    "basin": row(
        datasets=folder("meadow", *FLIGHT),
        method=METHOD,
        out=out_folder("out", "*"),
        errors=values("1m/2deg", "", "3m,5deg", "1m/2deg,", "nanm/5deg", "1m/500deg", "-1m/2deg", f"{'9' * 400}m/1deg"),
        seed=SEED,
        overrides=SETTINGS,
        cache=out_folder("cache", "*"),
        as_json=FLAG,
    ),
    "localize": row(
        place=folder("meadow", part("meadow/origin.json", "json"),
                     part("meadow/images/c.jpg", "photograph"),
                     part("meadow/sparse/map/images.bin", "bytes")),
        images=folder("photos", part("photos/p1.jpg", "photograph")),
        out=out_file("out.txt", "out.csv"),
        method=METHOD,
        camera=CAMERA,
        priors=file("tables/priors.csv", "csv"),
        gps_sigma=real("10"),
        overrides=SETTINGS,
        cache=out_folder("cache", "*"),
        as_json=FLAG,
    ),
    "train": row(
        "baselines.training.command.train_loop",
        method=values("objconnect", "", "magic", "sift", "../x", LONG),
        data=folder("grove", *LEARNED),
        out=out_folder("out", "*"),
        validation=folder("grove", *LEARNED).left_out(),
        config=file("configs/train.yaml", "yaml"),
        overrides=SETTINGS,
        as_json=FLAG,
    ),
    "ablate": row(
        "baselines.training.command.train_loop",
        plan=file("configs/plan.yaml", "yaml"),
        datasets=folder("meadow", *FLIGHT),
        data=folder("grove", *LEARNED),
        out=out_folder("out", "*"),
        validation=folder("grove", *LEARNED).left_out(),
        start=start(None, "tables/pairs.txt"),
        as_json=FLAG,
    ),
    "regress": row(
        results=folder("results", part("results/meadow/sift.json", "our json")),
        against=folder("baseline", part("baseline/meadow/sift.json", "our json")),
        update=FLAG,
        as_json=FLAG,
    ),
    "simulate": row(
        "simulate.command.render",
        out=out_folder("out", "*"),
        preset=choice("town", "TOWN"),
        seed=SEED,
        config=file("configs/simulate.yaml", "yaml"),
        area=real("120"),
        session=values(
            "summer-noon:nadir",
            *("", "summer-noon", "rain:nadir", "summer-noon:", "summer-noon:magic"),
            *("summer-noon:nadir:magic", "summer-noon:nadir:map:cars_moved=nan", ":nadir"),
            *("summer-noon:nadir:map:cars_moved=2", "summer-noon:nadir:map:colour=red"),
            *("summer-noon:nadir:map:cars_moved=", "summer-noon:plan=", "summer-noon:plan=nowhere"),
            *("summer-noon:plan=mine", "summer-noon:plan=/dev/zero"),
        ),
        frames=integer("2"),
        size=integer("64"),
        spp=integer("1"),
        jobs=integer("1"),
        cluster=CLUSTER,
        file_format=choice("tum"),
        as_json=FLAG,
    ),
    "gallery": row(
        "simulate.gallery.preset",
        out=out_folder("out", "*"),
        preset=choice("town"),
        condition=choice("summer-noon", "summer", "rain-noon", "summer-noon-lava"),
        seed=SEED,
        area=real("120"),
        size=integer("64"),
        spp=integer("1"),
        as_json=FLAG,
    ),
    "calibrate": row(
        "simulate.calibrate.render",
        out=out_folder("out", "*"),
        camera=file("configs/camera.yaml", "yaml"),
        views=integer("4"),
        seed=SEED,
        as_json=FLAG,
    ),
    "ingest": row(
        "ingest.command.match_photographs",
        photographs=folder("photos", part("photos/p1.jpg", "photograph")),
        out=out_folder("out", "*"),
        gps=file("tables/gps.csv", "csv"),
        camera=CAMERA,
        size=integer("96"),
        mapper=choice("incremental"),
        split=choice("photo"),
        every=integer("2"),
        as_json=FLAG,
    ),
    "map": row(
        "simulate.mapping.triangulate",
        scene=folder("hamlet", MANIFEST, SPLITS, MAP_FRAMES, COVISIBILITY, MAP_PHOTOGRAPH),
        method=choice("triangulate"),
        cluster=CLUSTER,
        as_json=FLAG,
    ),
    "diagnose": row(
        scene=folder("hamlet", MANIFEST, MODEL, OBJECTS, MAP_FRAMES, MAP_PHOTOGRAPH),
        masks=folder("masks/labels", part("masks/labels/summer-nadir/images/000001.png", "picture")),
        cell=real("5"),
        as_json=FLAG,
    ),
    "supplement": row(
        "objconnect.supplement.command.supplement_points",
        scene=folder("hamlet", MANIFEST, MODEL, OBJECTS, MAP_FRAMES, MAP_PHOTOGRAPH),
        weights=file("weights/net.safetensors", "bytes"),
        masks=file("masks/coco.json", "json"),
        remove=FLAG,
        as_json=FLAG,
    ),
    "dense": row(
        "dense.command._make_maps",
        scene=folder("hamlet", MANIFEST, MODEL, MAP_FRAMES, MAP_PHOTOGRAPH),
        size=integer("64"),
        sources=integer("2"),
        stereo=choice("own"),
        seed=SEED,
        cluster=CLUSTER,
        as_json=FLAG,
    ),
    "export": row(
        scene=folder("hamlet", MANIFEST, SPLITS, QUERY_FRAMES, COVISIBILITY),
        file_format=choice("hloc", "HLOC"),
        out=out_folder("out", "*"),
        session=values("winter-grid", "", "magic", "../x", LONG),
        as_json=FLAG,
    ),
    "validate": row(
        scene=folder("hamlet", MANIFEST, SPLITS, OBJECTS, MAP_FRAMES, MODEL, MAP_PHOTOGRAPH),
        cache=out_folder("cache", "*"),
        as_json=FLAG,
    ),
    "doctor": row("benchmark.doctor.doctor", as_json=FLAG),
    "view": row(
        scene=folder("hamlet", MANIFEST, SPLITS, OBJECTS, MAP_FRAMES, MODEL, MAP_PHOTOGRAPH),
        results=folder("results", part("results/meadow/sift.json", "our json")),
        out=out_file("out.html", "out.png"),
        show=FLAG,
        as_json=FLAG,
    ),
}
