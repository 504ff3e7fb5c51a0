"""Read the cameras, poses and positions that a data set states, in every known format."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.auditing.statements import StatedData, centres, to_geodetic
from benchmark.datasets.dataset import Dataset
from benchmark.datasets.open import READERS, open_datasets
from objconnect.scene.bundle.scene import Scene, is_scene
from objconnect.scene.errors import InputError
from objconnect.scene.flights.textfiles import read_gps
from objconnect.scene.geometry.camera import Camera
from objconnect.scene.geometry.geodesy import Geodetic
from objconnect.scene.imports.formats import FRAMELESS_FILES, read_foreign
from objconnect.scene.imports.names import match_files
from objconnect.scene.imports.poses import CoordinateFrame, ForeignPoses
from objconnect.scene.imports.unsupported import refuse_unsupported
from objconnect.scene.maps.colmap_files import read_model
from objconnect.scene.storage.exif import read_exif
from objconnect.scene.storage.listing import list_files
from objconnect.scene.storage.tables import read_table

Array = NDArray[np.float64]

_ENDINGS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp")
# Files of poses in the projects of other programs.
_POSE_FILES: Final = (
    "sparse/0",
    "sparse",
    "transforms.json",
    "reconstruction.json",
    "opensfm/reconstruction.json",
    "cameras.xml",
)
# Folders of photographs, relative to the file or folder of poses.
_PHOTOGRAPH_FOLDERS: Final = (
    ".", "images", "rgb", "photos", "../images", "../rgb", "../photos", "../../images", "..",
)  # fmt: skip
_GEODETIC = ("lat", "lon", "alt")


def open_data(
    path: Path,
    images: Path | None = None,
    camera: Camera | None = None,
    frame: CoordinateFrame | None = None,
) -> list[StatedData]:
    """Read what a data set states; a path may hold several data sets.

    Args:
        path: a scene, a flight, Extended CMU Seasons, or poses of another program: a file, its
            folder, or the folder of a project.
        images: folder of the photographs; None searches the usual folders of the format.
        camera: camera of the photographs if the data set states none.
        frame: frame of another program's poses, if their file does not state it.

    Raises:
        InputError: no reader supports the path, a file is damaged, every flight (session) of a
            scene has a rolling shutter, ``images`` is not a folder, has none of the photographs or
            is given for a scene, or ``frame`` is given for a format that states its frame.
    """
    if images is not None and not images.is_dir():
        raise InputError(f"{images} is not a folder: give the photographs' folder with --images")
    is_foreign = not is_scene(path) and not (path.is_dir() and _is_dataset(path))
    if frame is not None and not is_foreign:
        raise InputError(f"{path} is not {FRAMELESS_FILES}: leave out --poses-frame")
    if is_scene(path):
        if images is not None:
            raise InputError(f"{path} is a scene with its own photographs: leave out --images")
        return [_read_scene(Scene.open(path))]
    if not is_foreign:
        return [_read_dataset(dataset, images) for dataset in open_datasets(path)]
    return [_read_poses(_find_pose_file(path), images, camera, frame)]


def _is_dataset(path: Path) -> bool:
    """Return whether a folder is a flight or Extended CMU Seasons.

    A folder that holds only ``sparse`` is a COLMAP project.
    """
    if (path / "queries.txt").exists() or (path / "reference_poses.txt").exists():
        return True
    return bool(READERS.load("cmu").recognizes(path))


def _read_scene(scene: Scene) -> StatedData:
    """Return the photographs of all sessions with a global shutter, and the map if there is one."""
    names, cameras, poses, measured = [], [], [], []
    for session in scene.sessions:
        if scene.manifest.sessions[session].readout_s:
            continue  # rolling shutter: every pixel row has a pose of its own
        frames = scene.frames(session)
        names += list(frames.names)
        cameras += list(frames.cameras)
        poses.append(frames.cam_from_world)
        measured.append(np.where(frames.has_gps[:, None], frames.gps_prior, np.nan))
    if not names:
        raise InputError(
            f"{scene.path}: every session has a rolling shutter, which audit does not support: "
            "audit a scene with a global shutter"
        )
    matrices = np.concatenate(poses)
    return _sort(
        StatedData(
            subject=str(scene.path),
            kind="scene",
            names=tuple(names),
            files=tuple(scene.images_root / name for name in names),
            cameras=tuple(cameras),
            cam_from_world=matrices,
            geodetic=_geodetic_centres(matrices, scene.manifest.origin),
            measured=np.concatenate(measured),
            sparse_map=scene.sparse_map() if scene.map_path.is_dir() else None,
        )
    )


def _read_dataset(dataset: Dataset, images: Path | None) -> StatedData:
    """Return the photographs of the map and the queries together."""
    sparse_map = dataset.load_map()
    map_images = list(sparse_map.images.values())
    folder = dataset.images if images is None else images
    names = [*(image.name for image in map_images), *(query.name for query in dataset.queries)]
    files = [folder / image.name for image in map_images]
    files += [folder / q.name if images is not None else q.image for q in dataset.queries]
    poses = [image.cam_from_world for image in map_images]
    poses += [query.reference.matrix().numpy() for query in dataset.queries]
    fixes = _read_measured_positions(dataset)
    measured = np.array([fixes.get(name, np.full(3, np.nan)) for name in names])
    return _sort(
        StatedData(
            subject=dataset.name,
            kind=dataset.track,
            names=tuple(names),
            files=tuple(files),
            cameras=(*(i.camera for i in map_images), *(q.camera for q in dataset.queries)),
            cam_from_world=np.array(poses),
            measured=measured,
            sparse_map=sparse_map,
        )
    )


def _read_measured_positions(dataset: Dataset) -> dict[str, Array]:
    """Return the measured positions that a data set stores, world metres, by photograph."""
    table = dataset.images.parent / "gps.csv"
    if table.is_file():
        return read_gps(table)
    return {q.name: q.prior.position for q in dataset.queries if q.prior and q.prior.has_position}


def _find_pose_file(path: Path) -> Path:
    """Return the file of poses in a project; the path itself if it is one."""
    if path.is_dir() and not any((path / f"images.{end}").is_file() for end in ("bin", "txt")):
        for name in _POSE_FILES:
            if (path / name).exists():
                return path / name
    return path


def _read_poses(
    path: Path, images: Path | None, camera: Camera | None, frame: CoordinateFrame | None
) -> StatedData:
    """Return the poses of another program, or the positions of a table without poses."""
    refuse_unsupported(path)
    is_table = path.suffix.lower() == ".csv" and path.is_file()
    table_rows = _read_geodetic_table(path) if is_table else None
    if table_rows is not None and frame is not None:
        raise InputError(f"{path} is not {FRAMELESS_FILES}: leave out --poses-frame")
    if table_rows is not None:
        poses: ForeignPoses | None = None
        names: Sequence[str] = list(table_rows)
    else:
        poses = read_foreign(path, frame)
        names = poses.names
    files = _find_photographs(path, names, images)
    cameras = (None,) * len(names) if poses is None else poses.cameras
    if camera is not None:
        cameras = tuple(stated_camera or camera for stated_camera in cameras)
    positions_only = poses is None or not poses.has_attitude
    matrices = None if positions_only or poses is None else poses.cam_from_world
    stated = StatedData(
        subject=str(path),
        kind=_describe_format(path),
        names=tuple(names),
        files=files,
        cameras=cameras,
        cam_from_world=matrices,
        geodetic=np.array(list(table_rows.values()))
        if table_rows is not None
        else _geodetic_positions(poses),
        sparse_map=read_model(path) if path.is_dir() and (path / "images.bin").is_file() else None,
    )
    return _sort(stated)


def _geodetic_positions(poses: ForeignPoses | None) -> Array | None:
    if poses is None or poses.origin is None:
        return None
    return to_geodetic(poses.positions, poses.origin)


def _geodetic_centres(matrices: Array, origin: Geodetic | None) -> Array | None:
    if origin is None:
        return None
    return to_geodetic(centres(matrices), origin)


def _describe_format(path: Path) -> str:
    if path.is_dir():
        return "COLMAP model"
    kinds = {
        ".csv": "table of positions",
        ".xml": "Metashape cameras",
        ".txt": "TUM trajectory",
        ".tum": "TUM trajectory",
    }
    if path.suffix.lower() in kinds:
        return kinds[path.suffix.lower()]
    names = {
        "transforms.json": "nerfstudio transforms",
        "cameras.json": "3D Gaussian splatting cameras",
    }
    return names.get(path.name, "ODM reconstruction")


def _read_geodetic_table(path: Path) -> dict[str, list[float]] | None:
    """Return the rows of a table of geodetic positions, unchecked; None for local positions.

    A latitude beyond 90 degrees is a finding of the audit, not an error here.
    """
    rows: dict[str, list[float]] = {}
    for where, row in read_table(path, "table of positions", ("name",)):
        if not all(column in row for column in _GEODETIC):
            return None
        try:
            values = [float(row[column]) for column in _GEODETIC]
        except ValueError:
            values = [np.nan]
        if not np.isfinite(values).all():
            raise InputError(f"{where}: lat, lon and alt must be numbers")
        if row["name"] in rows:
            raise InputError(f"{where}: {row['name']!r} is listed twice: remove one row")
        rows[row["name"]] = values
    if not rows:
        raise InputError(f"{path} lists no photograph: add rows of name,lat,lon,alt")
    return rows


def _find_photographs(
    path: Path, names: Sequence[str], images: Path | None
) -> tuple[Path, ...] | None:
    """Return the paths of the photographs; None if no folder has any of them."""
    base = path if path.is_dir() else path.parent
    folders = [images] if images is not None else [base / name for name in _PHOTOGRAPH_FOLDERS]
    best: dict[str, Path] = {}
    for folder in folders:
        found = _find_by_name(folder, names, path) if folder.is_dir() else {}
        if len(found) > len(best):
            best, chosen = found, folder
        if len(best) == len(names):
            break
    if not best and images is not None:
        raise InputError(
            f"{images} has none of the photographs of {path}, such as {names[0]!r}: give another "
            "folder with --images"
        )
    if not best:
        return None
    return tuple(best.get(name, chosen / name) for name in names)


def _find_by_name(folder: Path, names: Sequence[str], path: Path) -> dict[str, Path]:
    """Return the files of a folder by stated name, which may be a path or a file name."""
    exact = {name: folder / name for name in names if (folder / name).is_file()}
    if len(exact) == len(names):
        return exact
    folder_files = list_files(folder, _ENDINGS)
    relative = {file.relative_to(folder).as_posix(): file for file in folder_files}
    found = {
        name: relative[file] for file, name in match_files(list(relative), names, path).items()
    }
    if not found and _are_times(names):
        return _match_by_time(list(relative.values()), names)
    return found


def _are_times(names: Sequence[str]) -> bool:
    try:
        return bool(np.isfinite([float(name) for name in names]).all())
    except ValueError:
        return False


def _match_by_time(files: Sequence[Path], names: Sequence[str]) -> dict[str, Path]:
    """Return the photograph of each pose of a trajectory, whose name is its time in seconds.

    If there are as many photographs as poses, they are matched in order; otherwise each photograph
    is matched by its time in EXIF.
    """
    in_order = sorted(names, key=float)
    if len(files) == len(names):
        return dict(zip(in_order, sorted(files), strict=True))
    times = np.array([float(name) for name in in_order])
    tolerance = float(np.median(np.diff(times))) / 2 if len(times) > 1 else 0.5
    found = {}
    for file, time in _read_times(files):
        row = int(np.abs(times - time).argmin())
        if abs(times[row] - time) < tolerance:
            found[in_order[row]] = file
    return found


def _read_times(files: Sequence[Path]) -> Iterator[tuple[Path, float]]:
    for file in files:
        try:
            time = read_exif(file).time
        except InputError:
            continue
        if time is not None:
            yield file, time.timestamp()


def _sort(stated: StatedData) -> StatedData:
    """Return the photographs sorted by name; names that are times are sorted as numbers."""
    key: Callable[[int], float | str] = stated.names.__getitem__
    if _are_times(stated.names):
        key = lambda row: float(stated.names[row])  # noqa: E731
    order = sorted(range(len(stated)), key=key)

    def arrange(array: Array | None) -> Array | None:
        return None if array is None else array[order]

    return replace(
        stated,
        names=tuple(stated.names[row] for row in order),
        files=None if stated.files is None else tuple(stated.files[row] for row in order),
        cameras=tuple(stated.cameras[row] for row in order),
        cam_from_world=arrange(stated.cam_from_world),
        geodetic=arrange(stated.geodetic),
        measured=arrange(stated.measured),
    )
