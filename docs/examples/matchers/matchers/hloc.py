"""A localizer from matches of hloc: `--method hloc --set features=F.h5 --set matches=M.h5`."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from objconnect.localization.matching.lifting import interpolate_points
from objconnect.localization.matching.pnp import PnpConfig, solve_pose
from objconnect.scene.config import load_config
from objconnect.scene.errors import HDF5_DAMAGE, InputError
from objconnect.scene.localizer import Estimate, Query, Status, Stopwatch, query_error
from objconnect.scene.maps.sparse_map import SparseMap
from objconnect.scene.storage.files import require_readable
from objconnect.scene.storage.hdf5 import array, group

# In hloc the centre of the top left pixel is (0, 0), in this project (0.5, 0.5).
CORNER = 0.5


class HlocConfig(PnpConfig):
    """The files of hloc's `extract_features` and `match_features`."""

    features: Path = Field(description="Keypoints of the queries and of the map's photographs.")
    map_features: Path | None = Field(
        None, description="Keypoints of the map's photographs, if they are in another file."
    )
    matches: Path = Field(description="Matches of each query with photographs of the map.")


class Hloc:
    name = "hloc"
    weights_sha256 = None  # the files do not name the weights of their matcher

    def __init__(self, config: HlocConfig) -> None:
        self.config = config

    def prepare(self, sparse_map: SparseMap, images: Path, cache: Path | None = None) -> None:
        config = self.config
        self._map = sparse_map
        self._features = open_hdf5(config.features)
        self._map_features = open_hdf5(config.map_features or config.features)
        self._matches = open_hdf5(config.matches)

    def localize(self, query: Query) -> Estimate:
        if reason := query_error(query):
            return Estimate(Status.FAILED, reason=reason)
        clock = Stopwatch()
        with clock.stage("matching"):
            names = self._map.names if query.references is None else query.references
            paired = [name for name in names if name in self._map.images]
            pairs = {name: self._pair(query.name, name) for name in paired}
            lifted = [self._lift(query.name, name, pair) for name, pair in pairs.items() if pair]
        if not lifted:
            reason = f"{self.config.matches} pairs it with no photograph of the map"
            return Estimate(Status.FAILED, seconds=clock.seconds, reason=reason)
        xy, xyz = (np.concatenate(part) for part in zip(*lifted, strict=True))
        return solve_pose(query, xy, xyz, self.config, clock)

    def _pair(self, query: str, name: str) -> tuple[str, bool] | None:
        """Return the group of a pair, and whether the query comes second; None without one."""
        parts = [part.replace("/", "-") for part in (query, name)]
        for second, (a, b) in enumerate((parts, parts[::-1])):
            for group_name in (f"{a}/{b}", f"{a}_{b}"):  # the latter in files of older hloc
                if group_name in self._matches:
                    return group_name, bool(second)
        return None

    def _lift(
        self, query: str, name: str, pair: tuple[str, bool]
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the query's pixels (K, 2) of a pair's matches, and their points (K, 3)."""
        try:
            matches = array(group(self._matches, pair[0]), "matches0").astype(np.int64)
            rows = np.stack([np.arange(len(matches)), matches], -1)[matches >= 0]
            own_rows, rows = rows.T[::-1] if pair[1] else rows.T
            xy = keypoints(self._features, query)[own_rows]
            xy_map = keypoints(self._map_features, name)[rows]
        except HDF5_DAMAGE as error:
            raise InputError(
                f"{self.config.matches}, {pair[0]}: no matches of the keypoints in "
                f"{self.config.features}: {error}"
            ) from None
        xyz = interpolate_points(xy_map, self._map.images[name], self._map.xyz)
        seen = np.isfinite(xyz).all(1)
        return xy[seen], xyz[seen]


def keypoints(file: h5py.File, name: str) -> NDArray[np.float64]:
    """Read the keypoints of a photograph, (N, 2) COLMAP pixels."""
    stored = array(group(file, name), "keypoints").astype(np.float64)
    if stored.ndim != 2 or stored.shape[1] != 2 or not np.isfinite(stored).all():
        raise ValueError(f"keypoints of {name} are not finite pixels (N, 2)")
    return stored + CORNER


def open_hdf5(path: Path) -> h5py.File:
    """Open a file of hloc."""
    require_readable(path, "file of hloc")
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise InputError(f"{path} is not an HDF5 file, or is damaged: {error}") from None


def make(overrides: dict[str, Any]) -> Hloc:
    return Hloc(load_config(HlocConfig, None, overrides))
