"""The command ``submit``, which writes the file of poses that visuallocalization.net scores."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from benchmark.datasets.cmu import Slice, open_slices
from objconnect.localization.pipeline.failures import localize_safely
from objconnect.scene.errors import InputError, WriteError
from objconnect.scene.flights.textfiles import pose_line
from objconnect.scene.localizer import Localizer, Query, Status
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.runtime.progress import progress_bar
from objconnect.scene.storage.atomic import write_text
from objconnect.scene.storage.digests import digest_of, digests
from objconnect.scene.storage.files import read_text
from objconnect.scene.storage.images import read_rgb
from objconnect.scene.storage.outputs import OutputFile, check_output_folder, check_outputs
from objconnect.scene.storage.scratch import cache_or_scratch

SUBMISSION: Final = "submission.txt"
_DECIMALS: Final = 6
# The first bytes of the file of a finished slice.
_HEAD: Final = b"# finished by objconnect: "


def submit(
    path: Path, localizer: Localizer, out: Path, cache: Path | None = None
) -> tuple[int, int]:
    """Localize every query image of Extended CMU Seasons and write ``OUT/submission.txt``.

    Its lines are ``name qw qx qy qz tx ty tz`` for the images of all slices, with names without a
    folder. The translation is that of the pose from world to camera, although the data set's own
    files hold camera centres. Images that were not localized are left out, as the server requires.
    Finished slices are kept in ``OUT/slices``, and an interrupted run goes on after them.

    Args:
        path: folder of the data set, or of one of its slices.
        localizer: method to run.
        out: folder of the submission.
        cache: folder for what the method keeps per map; None for a scratch folder in ``out``.

    Returns:
        The number of localized images, and the number of all images.

    Raises:
        InputError: a file of the data set is missing or damaged, two slices share an image name, or
            ``out`` cannot be written.
    """
    chosen = open_slices(path)
    check_output_folder(out, [path, *(part.folder for part in chosen)])
    finished = [out / "slices" / f"{part.folder.name}.txt" for part in chosen]
    check_outputs([*(OutputFile(file, _HEAD) for file in finished), out / SUBMISSION], within=out)
    if (out / SUBMISSION).exists() and not any(file.is_file() for file in finished):
        # A submission holds only poses, so nothing in it tells which program wrote it.
        raise WriteError(
            f"cannot write {out / SUBMISSION}: it exists without the slices of an earlier run, so "
            "another program may have written it: choose another --out"
        )
    seen: dict[str, Slice] = {}
    for part in chosen:
        for name in part.queries:
            if name in seen:
                raise InputError(
                    f"{name} is in {seen[name].folder} and in {part.folder}: a submission gives no "
                    "slice, so names must be unique"
                )
            seen[name] = part
    lines: list[str] = []
    for part, file in zip(chosen, finished, strict=True):
        lines += _slice(part, localizer, file, cache)
    write_text(out / SUBMISSION, "".join(f"{line}\n" for line in lines))
    return len(lines), len(seen)


def _slice(part: Slice, localizer: Localizer, path: Path, cache: Path | None) -> list[str]:
    """Return the pose lines of one slice; a finished slice is read from ``path``."""
    sparse_map = read_model(part.folder / "sparse")
    words = [localizer.name, localizer.config.model_dump_json(), str(localizer.weights_sha256)]
    words += [sparse_map.sha256, *digests(part.folder / "database" / n for n in sparse_map.names)]
    words += [f"{name} {part.camera(name)}" for name in part.queries]
    words += digests(part.folder / "query" / name for name in part.queries)
    header = f"{_HEAD.decode()}{digest_of(*words)}"
    if path.is_file():
        first, *lines = read_text(path, "finished slice").splitlines() or [""]
        if first == header:
            return lines
    with cache_or_scratch(cache, path.parent) as kept:
        localizer.prepare(sparse_map, part.folder / "database", kept)
    lines = []
    with progress_bar(f"{part.folder.name} {localizer.name}", len(part.queries)) as advance:
        for count, name in enumerate(part.queries, 1):
            camera = part.camera(name)
            image = read_rgb(part.folder / "query" / name, camera)
            estimate = localize_safely(localizer, Query(name, image, camera))
            if estimate.status is Status.OK and estimate.cam_from_world is not None:
                lines.append(pose_line(name, estimate.cam_from_world, _DECIMALS))
            advance(count)
    write_text(path, "".join(f"{line}\n" for line in [header, *lines]))
    return lines
