"""The kind of every parameter of every command. A new command or option gets a row here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from tests.robustness.fuzz.readers import CMU_QUERY
from tests.robustness.misuse.arguments import (
    CAMERA,
    CLUSTER,
    DEVICE,
    FLAG,
    HUGE,
    METHOD,
    NO_FILES,
    NUMBERS,
    OPTION,
    SEED,
    SETTINGS,
    UNDECODED,
    Argument,
    Fault,
    add_to_name,
    cache,
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
from tests.robustness.misuse.faults import LONG

MANIFEST = part("hamlet/scene.json", "manifest")
SPLITS = part("hamlet/splits.json", "splits")
OBJECTS = part("hamlet/objects.json", "our json")
COVISIBILITY = part("hamlet/covisibility.h5", "bytes")
# There are no layers in it, which is all that some look for.
UNREAD_FRAMES = part("hamlet/sessions/summer-nadir/frames.h5", "bytes")
ADDED = part("hamlet/map/supplement.json", "our json", optional=True)
MAP_FRAMES = part("hamlet/sessions/summer-nadir/frames.h5", "frames")
QUERY_FRAMES = part("hamlet/sessions/winter-grid/frames.h5", "frames")
LEARNED = (
    part("grove/scene.json", "manifest"),
    part("grove/covisibility.h5", "bytes"),
    part("grove/sessions/summer-nadir/frames.h5", "frames"),
)
MAP_PHOTOGRAPH = part("hamlet/sessions/summer-nadir/images/000001.jpg", "photograph")
QUERY_PHOTOGRAPH = part("hamlet/sessions/winter-grid/images/000002.jpg", "photograph")
MODEL = {
    name: fault
    for model in ("cameras", "images", "points3D")
    for name, fault in part(f"hamlet/map/{model}.bin", "bytes").items()
}
# Its cells are names: no number can be wrong.
CONDITIONS = {
    name: fault
    for name, fault in part("meadow/conditions.csv", "csv", optional=True).items()
    if name.partition(":")[2] not in ("nan", "inf", "word", "huge", "no_number")
}
FLIGHT_LISTS = (
    part("meadow/queries.txt", "words"),
    part("meadow/reference_poses.txt", "words"),
    part("meadow/gps.csv", "csv", optional=True),
    CONDITIONS,
)
FLIGHT = (
    *FLIGHT_LISTS,
    part("meadow/images/b.jpg", "photograph"),
    part("meadow/images/c.jpg", "photograph"),
    *(part(f"meadow/sparse/map/{m}.bin", "bytes") for m in ("cameras", "images", "points3D")),
)
CMU_TASK = (
    part("cmu/intrinsics.txt", "words"),
    part(f"cmu/slice2/query/{CMU_QUERY}", "photograph"),
    part("cmu/slice2/sparse/images.bin", "bytes"),
)
# Names are not numbers, and a pair may be listed twice.
SLICE_PAIRS = file("tables/slice-pairs.txt", "words").but(*NUMBERS, "twice")
CMU = (
    *CMU_TASK,
    part("cmu/slice2/camera-poses/slice-2-gt-query-images-20101019.txt", "words"),
)
QUERIED = (MANIFEST, SPLITS, QUERY_FRAMES, MODEL, MAP_PHOTOGRAPH, QUERY_PHOTOGRAPH)


ORTHOPHOTO: dict[str, Argument] = {
    "ortho": file("rasters/ortho.tif", "bytes"),
    "dsm": file("rasters/dsm.tif", "bytes"),
    "out": out_folder("out", "*"),
    "undulation": real("48", "0", "-1"),
    "altitude": real("30"),
    "overlap": real("0.5", "0"),
    "tilt": real("20", "0"),
    "georeference": real("0.5", "0"),
    "georeference_height": real("1", "0"),
}

OF_PAIRS = ("pair", "homography", "dsm", "undulation", "residual", "overrides")
OF_PHOTOGRAPHS = (
    *("gps", "poses", "poses_frame", "add", "gcp", "gcp_check", "gcp_sigma", "camera", "size"),
    *("mapper", "split", "every"),
)

SIMULATED = (
    *("out", "preset", "seed", "config", "area", "session", "frames", "size", "spp", "jobs"),
    *("cluster", "file_format", "as_json"),
)
SITE: dict[str, Argument] = {
    "from_scene": FLAG,
    "ortho": file("site/ortho.tif", "bytes"),
    "dsm": file("site/dsm.tif", "bytes"),
    "classes": file("site/classes.tif", "bytes"),
    "taken": values(
        "2026-07-01T10:30:00Z", "", "noon", "2026-07-01T10:30:00", "2026-13-01T10:30:00Z"
    ),
}

# What results say of themselves that no figure follows from.
RETOLD = ("sift.json:no_schema", "sift.json:name_is_path")


@dataclass(frozen=True)
class Row:
    """A command with its arguments.

    Attributes:
        arguments: arguments by the name of the parameter.
        work: functions at which its real work begins; the matrix stops there.
        writes: patterns of files that it writes into its inputs.
        keeps: patterns of files that stay for the next run, also after a failed run.
        reports: whether it reports faults of its input on standard output, and exits with 2.
    """

    arguments: Mapping[str, Argument]
    work: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    keeps: tuple[str, ...] = ()
    reports: bool = False

    def instead(self, **arguments: Argument) -> Row:
        """Return the same command with other arguments; the same ones are damaged only once."""
        same = {name: replace(found, faults={}) for name, found in self.arguments.items()}
        return replace(self, arguments={**same, **arguments})


EVALUATE = Row(
    {
        "datasets": folder("hamlet", *QUERIED),
        "method": METHOD,
        "out": out_folder("out", "*"),
        "overrides": SETTINGS,
        "start": start("prior", "tables/pairs.txt"),
        "cache": cache(),
        "jobs": integer("1", HUGE),
        "cluster": CLUSTER,
        "container": values(None, "", "--privileged", "a b", "a\nb", LONG),
        "as_json": FLAG,
    },
    keeps=("out", "out/*/.objconnect-*.journal", "out/hamlet", "out/meadow"),
)
LEADERBOARD = Row(
    {
        "results": folder(
            "results",
            part("results/meadow/sift.json", "results"),
            part("results/meadow/sift.basin.json", "our json"),
            part("results/meadow/album.h5", "bytes"),
        )
        # There are other results, and what lies beside them is shown where it is.
        .fine("sift.json:missing", "sift.json:folder", *RETOLD)
        .fine(*(f"{a}:{b}" for a in ("*.basin.json", "album.h5") for b in NO_FILES)),
        # A page may lie among the results that it shows.
        "out": out_folder("out", "leaderboard.*").beside_inputs(),
        "board": FLAG,
        "store": FLAG,
        "as_json": FLAG,
    }
)
VALIDATE = Row(
    {
        "scene": folder("hamlet", MANIFEST, SPLITS, OBJECTS, MAP_FRAMES, MODEL, MAP_PHOTOGRAPH),
        "cache": FLAG,
        "as_json": FLAG,
    },
    reports=True,
)
AUDIT = Row(
    {
        "data": file("tables/places.csv", "csv"),
        # A table states no size of photographs.
        "images": folder("photos", part("photos/p1.jpg", "photograph")).fine("p1.jpg:one_pixel"),
        "camera": CAMERA.left_out(),
        # A table has one frame.
        "poses_frame": choice("topocentric", "projected").left_out(),
        "out": out_file("out.html", "out.html"),
        "as_json": FLAG,
    },
    keeps=("out.html",),
    reports=True,
)
FORECAST = Row(
    {
        "scene": folder("hamlet", MANIFEST, MODEL),
        "out": out_folder("out", "forecast.*", "views"),
        "plan": FLAG,
        "flight": values("nadir", "", "magic", "plan=nowhere", "plan=", LONG),
        "season": values("snow-dusk", "", "snow", "monsoon-noon", "snow-noon-lava", LONG),
        "method": METHOD,
        "twin": values(None, "nowhere", "hamlet", LONG),
        "start": values("prior", "", "magic", "error=3m", "pairs=nowhere.txt"),
        "views": integer("1"),
        "overrides": values(
            None,
            *("colour=red", "=1", "", "weak=2", "forecast.weak=2", "forecast.size=many"),
            *("forecast.gap_m=.nan", "forecast.colour=red", "forecast=2", "forecast.start=none"),
            "ratio=high",
        ),
        "cache": cache(),
        "jobs": integer("1", HUGE),
        "as_json": FLAG,
    },
    work=("benchmark.forecasting.command.simulate",),
)
LOCALIZE = Row(
    {
        "source": folder(
            "meadow",
            part("meadow/origin.json", "json"),
            part("meadow/images/c.jpg", "photograph"),
            part("meadow/sparse/map/images.bin", "bytes"),
        ),
        # One of several photographs that cannot be read is a row of the answer.
        "images": folder("photos", part("photos/p1.jpg", "photograph")).fine("p1.jpg:*"),
        "video": FLAG,
        "srt": FLAG,
        "sequence": FLAG,
        "rate": real(None).also(without_a_sequence=Fault(("2",), says=(OPTION,))),
        "out": out_file("out.txt", "out.csv"),
        "method": METHOD,
        "camera": CAMERA,
        # An empty cell of a sigma is that of an option.
        "priors": file("tables/priors.csv", "csv").fine("no_number"),
        "gps_sigma": real("10"),
        "gimbal_sigma": real("5"),
        "also": out_file("out.geojson"),
        "undulation": real("48", "0", "-1"),
        "crs": values(
            "EPSG:32632", "", "EPSG:", "EPSG:99999", "EPSG:4978", "magic", "32632 1", LONG
        ),
        "risk": real(None).also(of_a_method_without=Fault(("0.1",), says=("--risk",))),
        "overrides": SETTINGS,
        "cache": cache(),
        "as_json": FLAG,
    }
)
INGEST = Row(
    {
        "photographs": folder("photos", part("photos/p1.jpg", "photograph")).fine(
            "p1.jpg:one_pixel"
        ),
        "out": out_folder("out", "*"),
        "gps": file("tables/gps.csv", "csv").fine("too_many"),
        "add": FLAG,
        "poses": file("tables/reconstruction.json", "json"),
        "poses_frame": choice("topocentric"),
        "gcp": file("tables/gcp_list.txt", "words").but(
            "nan",
            "inf",
            "word",
            "huge",
            "no_number",  # they change the name of a point
        ),
        "gcp_check": values("A", "", "magic", LONG),
        "gcp_sigma": real("0.05"),
        "camera": CAMERA,
        "size": integer("96", HUGE),
        "mapper": choice("incremental"),
        "split": choice("photo"),
        "every": integer("2", HUGE),
        **dict.fromkeys(OF_PAIRS, FLAG),
        "as_json": FLAG,
    },
    work=(
        "objconnect.ingestion.command.match_photographs",
        "objconnect.ingestion.addition.match_new",
    ),
)

PUBLISH = Row(
    {
        # The folder of all scenes is a folder of scenes.
        "scenes": folder("hamlet", *QUERIED, part("hamlet/objects.json", "our json", True)).but(
            "empty_word"
        ),
        # The name of the folder is the name of the data set.
        "out": out_folder("out", "*").also(
            not_utf8_name=Fault((add_to_name("out", UNDECODED),), says=("out",))
        ),
        "layer": values(None, "", "magic", "depth", LONG),
        "license_id": values(None, "", "my own", "a\nb", LONG),
        "creator": values("A. Author", "", " ", "two\nlines"),
        "url": values("https://example.org/fields", "", "example.org", "https://a b"),
        "date": values("2026-05-17", "", "yesterday", "17.5.2026", "2026-02-30", LONG),
        "release": values("1.0.0", "", "1", "v1.0.0", "1.0.x", LONG),
        "dry_run": FLAG,
        "sealed": FLAG,
        "as_json": FLAG,
    }
)

COMMANDS: dict[str, Row] = {
    "evaluate": EVALUATE,
    "evaluate:published": EVALUATE.instead(
        datasets=folder(
            "published",
            part("published/published.json", "our json"),
            part("published/data/hamlet/query-00000.parquet", "bytes"),
            part("published/scenes/hamlet/map/images.bin", "bytes"),
        )
    ),
    "evaluate:flight": EVALUATE.instead(datasets=folder("meadow", *FLIGHT)),
    "evaluate:cmu": EVALUATE.instead(datasets=folder("cmu", *CMU)),
    "submit": Row(
        {
            "path": folder("cmu", *CMU_TASK),
            "out": out_folder("out", "*"),
            "method": METHOD,
            "overrides": SETTINGS,
            "start": FLAG,
            "pairs": SLICE_PAIRS.left_out(),
            "jobs": integer("1", HUGE),
            "cache": cache(),
            "dry_run": FLAG,
            "as_json": FLAG,
        }
    ),
    "submit:scene": Row(
        {
            "path": folder("hamlet", *QUERIED),
            "out": out_folder("out", "*"),
            "method": METHOD,
            "overrides": SETTINGS,
            "start": start("prior", "tables/pairs.txt"),
            "jobs": integer("1", HUGE),
            **dict.fromkeys(("pairs", "dry_run"), FLAG),
            "cache": cache(),
            "as_json": FLAG,
        },
        keeps=("out", "out/poses", "out/poses/.objconnect-*.journal"),
    ),
    "score": Row(
        {
            "poses": file("tables/poses.txt", "words"),
            "reference": folder("meadow", *FLIGHT_LISTS),
            "out": out_folder("out", "*"),
            "method": values(
                "theirs",
                *("", "../../x", "/x", "a/b", ".hidden", "a\nb", "\x1b[31m", "a ", LONG),
            ),
            "start": start("none", "tables/pairs.txt"),
            "as_json": FLAG,
        }
    ),
    "leaderboard": LEADERBOARD,
    "leaderboard:board": Row(
        {
            "results": FLAG,
            "out": out_folder("out", "leaderboard.*").beside_inputs(),
            "board": folder(
                "tracks",
                part("tracks/uav-seasons/track.yaml", "yaml"),
                part("tracks/uav-seasons/queries/town-1.csv", "csv"),
                part("tracks/uav-seasons/results/none/town-1/sift.json", "results"),
            )
            # There are other methods, and a difficulty may be unknown.
            .fine("sift.json:missing", "town-1.csv:no_number", *RETOLD),
            "store": FLAG,
            "as_json": FLAG,
        }
    ),
    "leaderboard:store": replace(
        LEADERBOARD.instead(
            store=folder("board/kept", part("board/kept/track.yaml", "yaml")),
        ),
        writes=("board/kept/results*",),
    ),
    "basin": Row(
        {
            "datasets": folder("meadow", *FLIGHT),
            "method": METHOD,
            "out": out_folder("out", "*"),
            "errors": values(
                "1m/2deg",
                *("", "3m,5deg", "1m/2deg,", "nanm/5deg", "-1m/2deg"),
            ).also(
                angle=Fault(("1m/500deg",), says=("500 degrees",)),
                distance=Fault((f"{'9' * 400}m/1deg",), says=("inf metres",)),
            ),
            "seed": SEED,
            "overrides": SETTINGS,
            "cache": cache(),
            "as_json": FLAG,
        }
    ),
    "localize": LOCALIZE,
    "localize:scene": LOCALIZE.instead(source=folder("hamlet", MANIFEST, MODEL, MAP_PHOTOGRAPH)),
    "localize:video": LOCALIZE.instead(
        source=folder("hamlet").sound(),
        images=FLAG,
        priors=FLAG,
        video=file("film/flight.mp4", "bytes"),
        # Subtitles up to where a file is cut short are of use.
        srt=file("film/telemetry.srt", "bytes").fine("truncated"),
        rate=real("1"),
        out=out_file("out.txt", "out.csv", "out.json"),
        overrides=values(None, "sequence.colour=red", "sequence.gate=0", "sequence.motion=fast"),
    ),
    "options": Row({"method": METHOD, "as_json": FLAG}),
    "train": Row(
        {
            "method": values("objconnect", "", "magic", "sift", "../x", LONG),
            "data": folder("grove", *LEARNED),
            "out": out_folder("out", "*"),
            "validation": folder("grove", *LEARNED).left_out(),
            "config": file("configs/train.yaml", "yaml"),
            "overrides": values(
                None,
                *("steps", "=1", "", "colour=red", "steps=[", "steps=0", "steps=many", "rate=.nan"),
                *("rate=.inf", "crop=1", "batch=-1", f"seed={HUGE}", "photographs=nowhere"),
                *("weights=nowhere.safetensors", "weights=mine/notes.txt", "network=big"),
                "photographs=[mine]",
            ).also(network_key=Fault(("network={colour: red}",), says=("colour",))),
            "as_json": FLAG,
        },
        work=("objconnect.learning.training.command.train_loop",),
    ),
    "train:resumed": Row(
        {
            "method": values("objconnect"),
            "data": folder("grove", *LEARNED).sound(),
            "out": folder("run", part("run/run.json", "json"))
            .only("run.json:*")
            .fine("run.json:missing"),
            "validation": FLAG,
            "config": file("configs/train.yaml", "yaml").sound(),
            "overrides": FLAG,
            "as_json": FLAG,
        },
        work=("torch.optim.AdamW",),
        writes=("run/*",),
    ),
    "regress": Row(
        {
            "results": folder("results", part("results/meadow/sift.json", "results")).fine(*RETOLD),
            "against": folder("baseline", part("baseline/meadow/sift.json", "results")).fine(
                "sift.json:missing", "sift.json:folder", *RETOLD
            ),
            "update": FLAG,
            "as_json": FLAG,
        }
    ),
    "simulate": Row(
        {
            "out": out_folder("out", "*"),
            "preset": choice("town", "TOWN"),
            "seed": SEED,
            "config": file("configs/simulate.yaml", "yaml"),
            "area": real("120"),
            "session": values(
                "summer-noon:nadir",
                *("", "summer-noon", "rain:nadir", "summer-noon:", "summer-noon:magic", ":nadir"),
                *("summer-noon:nadir:magic", "summer-noon:nadir:map:cars_moved=nan"),
                *("summer-noon:nadir:map:cars_moved=2", "summer-noon:nadir:map:colour=red"),
                *("summer-noon:nadir:map:cars_moved=", "summer-noon:plan="),
                *("summer-noon:plan=nowhere", "summer-noon:plan=mine"),
                *("summer-noon:plan=/dev/zero", "summer-noon:flown=nowhere"),
            ),
            "frames": integer("2"),
            "size": integer("64"),
            "spp": integer("1"),
            "jobs": integer("1", HUGE),
            "cluster": CLUSTER,
            "file_format": choice("tum"),
            "as_json": FLAG,
            **dict.fromkeys(SITE, FLAG),
        },
        work=("simulate.command.render",),
    ),
    "simulate:site": Row(
        {
            **dict.fromkeys(SIMULATED, FLAG),
            **SITE,
            "out": out_folder("out", "*").sound(),
            "preset": values("site"),
            "area": values("120", "2000"),
            "size": integer("64").sound(),
            "spp": integer("1").sound(),
            "frames": integer("2").sound(),
        },
        work=("simulate.command.render",),
    ),
    "simulate:from": Row(
        {
            **dict.fromkeys((*SIMULATED, *SITE), FLAG),
            "out": out_folder("out", "*").sound(),
            "preset": values("site"),
            "from_scene": folder("hamlet", MANIFEST),
        },
        work=("simulate.scene_plan.base_place",),
    ),
    "simulate:plan": Row(
        {
            "out": out_folder("out", "*").sound(),
            "preset": FLAG,
            "seed": FLAG,
            "config": file("configs/planned.yaml", "yaml").sound(),
            "area": FLAG,
            "session": folder("configs/survey.plan", part("configs/survey.plan", "json"))
            .only("survey.plan:*")
            .given_as("summer-noon:plan=configs/survey.plan:map"),
            "frames": FLAG,
            "size": FLAG,
            "spp": FLAG,
            "jobs": FLAG,
            "cluster": FLAG,
            "file_format": FLAG,
            "as_json": FLAG,
            **dict.fromkeys(SITE, FLAG),
        },
        work=("simulate.command.render",),
    ),
    "track": Row(
        {
            "name": values("tiny", "", "magic", "TINY", "../board/tiny", "tiny\n", LONG),
            "out": out_folder("out", "*"),
            "place": values(None, "", "magic", "../x", LONG),
            "jobs": integer("1", HUGE),
            "cluster": CLUSTER,
            "board": folder(
                "board",
                part("board/tiny/track.yaml", "yaml"),
                part("board/tiny/place.yaml", "yaml"),
            ),
            "update": FLAG,
            "flights": FLAG,
            "sealed": values(None, "", "mine/notes.txt", "mine", "nowhere", "/dev/zero", LONG),
            "as_json": FLAG,
        },
        work=("simulate.command.render",),
    ),
    "track:flights": Row(
        {
            "name": values("flown"),
            "board": folder("board", part("board/flown/track.yaml", "yaml")),
            "flights": folder("flown", part("flown/meadow/queries.txt", "words")),
            **dict.fromkeys(
                ("out", "place", "jobs", "cluster", "update", "sealed", "as_json"), FLAG
            ),
        },
    ),
    "calibrate": Row(
        {
            "out": out_folder("out", "*"),
            "camera": file("configs/camera.yaml", "yaml"),
            "views": integer("4"),
            "seed": SEED,
            "as_json": FLAG,
        },
        work=("simulate.calibration.render",),
    ),
    "ingest": INGEST,
    "ingest:add": INGEST.instead(
        add=folder("hamlet", MANIFEST, SPLITS, COVISIBILITY, MAP_FRAMES, MODEL, MAP_PHOTOGRAPH),
        poses=FLAG,
        poses_frame=FLAG,
        gcp=FLAG,
        gcp_check=FLAG,
    ),
    "ingest:pair": replace(
        INGEST.instead(
            **dict.fromkeys(OF_PHOTOGRAPHS, FLAG),
            photographs=file("pair/ortho.tif", "bytes"),
            out=out_folder("out", "*"),
            pair=file("pair/ortho.tif", "bytes"),
            homography=file("tables/homography.txt", "words"),
            dsm=file("pair/dsm.tif", "bytes"),
            undulation=real("48", "0", "-1"),
            residual=real("0.2", "0"),
            overrides=values(
                "queries=2",
                *("queries", "=1", "", "colour=red", "queries=[", "queries=many", "queries=-1"),
                *("noise=.nan", "height_m=[30, 20]", "tilt_deg=90", "seed=99999999999"),
            ),
        ),
        work=("objconnect.mapping.pairs.command._align",),
    ),
    "map": Row(
        {
            "scene": folder("hamlet", MANIFEST, SPLITS, MAP_FRAMES, COVISIBILITY, MAP_PHOTOGRAPH),
            "method": choice("triangulate"),
            **dict.fromkeys(ORTHOPHOTO, FLAG),
            "cluster": CLUSTER,
            "as_json": FLAG,
        },
        work=("objconnect.scene.colmap.triangulation._triangulate",),
        writes=("hamlet/.objconnect-mapping*",),
    ),
    "map:ortho": Row(
        {
            "scene": FLAG,
            "method": FLAG,
            **ORTHOPHOTO,
            "cluster": FLAG,
            "as_json": FLAG,
        },
        work=("objconnect.ingestion.virtual.command._plan_views",),
    ),
    "diagnose": Row(
        {
            "scene": folder("hamlet", MANIFEST, MODEL, ADDED, OBJECTS, UNREAD_FRAMES),
            "masks": folder(
                "masks/labels",
                part("masks/labels/summer-nadir/images/000001.png", "bytes", optional=True),
            ),
            "cell": real("5"),
            "as_json": FLAG,
        },
        writes=("hamlet/pictures*",),
    ),
    "supplement": Row(
        {
            "scene": folder("hamlet", MANIFEST, MODEL, ADDED, OBJECTS, MAP_FRAMES, MAP_PHOTOGRAPH),
            "weights": file("weights/net.safetensors", "bytes"),
            "masks": file("masks/coco.json", "json"),
            "remove": FLAG,
            "as_json": FLAG,
        },
        work=("objconnect.mapping.supplement.command.add_to_map",),
    ),
    "landmarks": Row(
        {
            "scene": folder("hamlet", MANIFEST, MODEL, MAP_PHOTOGRAPH),
            "weights": file("weights/net.safetensors", "bytes"),
            "out": out_file("out.csv"),
            "device": DEVICE,
            "as_json": FLAG,
        },
        work=("objconnect.network.object_map.ObjectFinder.views",),
    ),
    "dense": Row(
        {
            "scene": folder("hamlet", MANIFEST, MODEL, MAP_FRAMES, MAP_PHOTOGRAPH),
            "size": integer("64", HUGE),
            "sources": integer("2", HUGE),
            "stereo": choice("own"),
            "seed": SEED,
            "cluster": CLUSTER,
            "device": DEVICE,
            "as_json": FLAG,
        },
        work=("objconnect.mapping.dense.command._make_maps",),
        writes=("hamlet/.objconnect-dense*",),
        keeps=("hamlet/.objconnect-dense*",),
    ),
    "export": Row(
        {
            "scene": folder("hamlet", MANIFEST, SPLITS, QUERY_FRAMES, COVISIBILITY),
            "file_format": choice("hloc", "HLOC"),
            "out": out_folder("out", "*"),
            "session": values("winter-grid", "", "magic", "../x", LONG),
            "resolution": real(None),
            "crs": values(None, "", "EPSG:1", "EPSG:32632", "magic", LONG),
            "as_json": FLAG,
        }
    ),
    "publish": PUBLISH,
    "publish:flight": PUBLISH.instead(
        scenes=folder("meadow", *FLIGHT).but("empty_word"),
        license_id=values("CC-BY-4.0"),
    ),
    "publish-weights": Row(
        {
            "weights": file("weights/net.safetensors", "bytes"),
            "out": out_folder("out", "*").also(
                not_utf8_name=Fault((add_to_name("out", UNDECODED),), says=("out",))
            ),
            # It is the only file, and a folder without results is named itself.
            "results": folder("weighed", part("weighed/meadow/net.json", "results"))
            .but("net.json:missing", "net.json:folder")
            .fine("net.json:no_schema"),
            "benchmark": values(None, "", "magic", "hf://owner/fields", "hf://a/b@main", LONG),
            "license_id": values("MIT", "", "my own", "a\nb", LONG),
            "creator": values("A. Author", "", " ", "two\nlines"),
            "dry_run": FLAG,
            "as_json": FLAG,
        }
    ),
    "forecast": FORECAST,
    "forecast:plan": FORECAST.instead(
        plan=file("configs/survey.plan", "json"),
        flight=FLAG,
    ),
    "validate": VALIDATE,
    "validate:flight": VALIDATE.instead(scene=folder("meadow", *FLIGHT), cache=cache()),
    "audit": AUDIT,
    "audit:flight": AUDIT.instead(data=folder("meadow", *FLIGHT), images=FLAG),
    "audit:scene": AUDIT.instead(
        data=folder("hamlet", MANIFEST, MAP_FRAMES, MODEL, MAP_PHOTOGRAPH), images=FLAG
    ),
    "submission": Row(
        {
            "folder": folder(
                "submission",
                part("submission/card.yaml", "yaml"),
                part("submission/poses/small-1.txt", "words"),
            ),
            "board": folder(
                "small",
                part("small/uav-small/track.yaml", "yaml"),
                part("small/uav-small/renders/small-1.json.xz", "bytes"),
            ),
            "as_json": FLAG,
        }
    ),
    "gate-scene": Row(
        {"out": out_folder("out", "*"), "name": choice("gate-snow"), "as_json": FLAG}
    ),
    "doctor": Row({"as_json": FLAG}, work=("benchmark.doctor.doctor",)),
    "view": Row(
        {
            "scene": folder(
                "hamlet", MANIFEST, SPLITS, OBJECTS, MAP_FRAMES, MODEL, ADDED, MAP_PHOTOGRAPH
            ).fine("000001.jpg:one_pixel"),
            "results": folder("results/hamlet", part("results/hamlet/sift.json", "results")).fine(
                "sift.json:no_schema"
            ),
            "out": out_file("out.html", "out.png"),
            "show": FLAG,
            "as_json": FLAG,
        }
    ),
}

# Readers are listed in tests/robustness/fuzz; here is a file for each that a command uses.
READ: dict[str, str] = {
    "arrays": "results/meadow/album.h5",
    "checkpoints": "run/run.json",
    "cmu": "cmu/intrinsics.txt",
    "colmap": "hamlet/map/points3D.bin",
    "configs": "configs/simulate.yaml",
    "covisibility": "hamlet/covisibility.h5",
    "features": "",  # written for other programs
    "flight": "meadow/reference_poses.txt",
    "foreign": "tables/places.csv",
    "frames": "hamlet/sessions/winter-grid/frames.h5",
    "manifests": "hamlet/scene.json",
    "masks": "masks/coco.json",
    "networks": "weights/net.safetensors",
    "photographs": "photos/p1.jpg",
    "plans": "configs/survey.plan",
    "published": "published/data/hamlet/query-00000.parquet",
    "rasters": "rasters/dsm.tif",
    "results": "results/meadow/sift.json",
    "scene": "hamlet/splits.json",
    "tables": "tables/gps.csv",
    "tracks": "tracks/uav-seasons/queries/town-1.csv",
    "videos": "film/flight.mp4",
    "weights": "weights/net.safetensors",
}
