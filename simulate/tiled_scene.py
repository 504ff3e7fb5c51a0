"""Plan the flights of a scene over a tiled place, and number the objects that they show."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from objconnect.scene.bundle.manifest import DeclaredChange
from objconnect.scene.errors import InputError
from objconnect.scene.runtime.progress import progress_bar
from simulate.camera.pinhole import PinholeCamera
from simulate.flight.clearance import find_blocking, is_free
from simulate.place.change import Change, ChangedWorld, change_world, change_worlds, list_objects
from simulate.place.tiles import Index, TiledPlace, move
from simulate.place.world import WorldObject
from simulate.render.window import MAX_SCENE_ID, TileIds, View, Window, find_view, group_views

Array = NDArray[np.float64]


class TiledScene:
    """The tiled place of a scene. A tile is built when a flight needs it.

    Args:
        place: The tiled place.
        changes: The change of each session.
    """

    def __init__(self, place: TiledPlace, changes: Sequence[Change]) -> None:
        self._place, self._changes = place, changes
        self.land = place.land()
        """The place without objects."""
        nodes = self.land.terrain.nodes
        self._heights = float(nodes.min()), float(nodes.max())

    def free_test(self, session: int) -> Callable[[Array], NDArray[np.bool_]]:
        """Return the function that tells which positions (N, 3) are free for a camera."""

        def test(centres: Array) -> NDArray[np.bool_]:
            free = is_free(centres, self.land)
            inside = np.flatnonzero(free)
            for index, here in self._place.group_by_tile(centres[inside, :2]):
                at = inside[here]
                changed = change_world(self._place.tile(index), self._changes[session]).world
                moved = replace(
                    changed, objects=tuple(move(changed.objects, self._place.centre(index)))
                )
                free[at] = find_blocking(centres[at], moved) == 0
            return free

        return test

    def find_views(self, name: str, camera: PinholeCamera, poses: Array) -> dict[int, View]:
        """Return the tiles that each photograph of a session needs, by number.

        Raises:
            InputError: A photograph of the session called ``name`` shows too many tiles.
        """
        views = {}
        for frame, pose in enumerate(poses):
            try:
                views[frame] = find_view(self._place, camera, pose, self._heights)
            except InputError as error:
                raise InputError(f"session {name}: photograph {frame}: {error}") from error
        return views

    def number(self, views: Iterable[Mapping[int, View]]) -> NumberedTiles:
        """Number the objects of all tiles that the photographs of a scene may show.

        Args:
            views: The views of each session.

        Raises:
            InputError: There are more objects than ids.
        """
        shown = sorted({index for view in views for each in view.values() for index in each.shown})
        objects: list[WorldObject] = []
        per_session: list[list[WorldObject]] = [[] for _ in self._changes]
        declared: list[list[DeclaredChange]] = [[] for _ in self._changes]
        ids: list[dict[Index, TileIds]] = [{} for _ in self._changes]
        offset = 0
        with progress_bar("tiles", len(shown)) as advance:
            for done, index in enumerate(shown, 1):
                tile = self._place.tile(index)
                worlds = change_worlds(tile, self._changes)
                listed = list_objects(tile, worlds)
                objects += self._in_scene(listed, index, offset)
                for k, changed in enumerate(worlds):
                    per_session[k] += self._in_scene(changed.world.objects, index, offset)
                    declared[k].append(_shift_ids(changed.declared, offset))
                    ids[k][index] = TileIds(offset=offset, first_new_id=changed.first_new_id)
                offset += max((item.id for item in listed), default=0)
                if offset > MAX_SCENE_ID:
                    raise InputError(
                        f"the photographs show more than {MAX_SCENE_ID} objects: fly over a part "
                        "of the place, and render the other parts as further scenes of the same "
                        "area and seed"
                    )
                advance(done)
        worlds = [
            ChangedWorld(replace(self.land, objects=tuple(items)), change, 0, _join(each))
            for items, change, each in zip(per_session, self._changes, declared, strict=True)
        ]
        return NumberedTiles(tuple(objects), worlds, ids)

    def _in_scene(
        self, objects: Iterable[WorldObject], index: Index, offset: int
    ) -> list[WorldObject]:
        """Return objects of a tile with the coordinates and ids of the scene."""
        moved = move(objects, self._place.centre(index))
        return [replace(item, id=item.id + offset) for item in moved]


class NumberedTiles(NamedTuple):
    """The objects that the photographs of a scene may show.

    Attributes:
        objects: The objects of all sessions, by ascending id.
        worlds: The world of each session, with the session's own share of these objects. The
            ground of a world has the heights of the tiles.
        ids: For each session, the ids of each tile's objects.
    """

    objects: tuple[WorldObject, ...]
    worlds: list[ChangedWorld]
    ids: list[dict[Index, TileIds]]

    def windows(self, session: int, views: Mapping[int, View]) -> tuple[Window, ...]:
        """Return the windows (squares of tiles) in which a session is rendered, by its views."""
        return group_views(views, self.ids[session])


def _shift_ids(declared: DeclaredChange, offset: int) -> DeclaredChange:
    """Return declared changes whose ids are larger by ``offset``."""
    return DeclaredChange(
        moved=tuple((old + offset, new + offset) for old, new in declared.moved),
        removed=tuple(each + offset for each in declared.removed),
        added=tuple(each + offset for each in declared.added),
        bare=tuple(each + offset for each in declared.bare),
    )


def _join(tiles: Sequence[DeclaredChange]) -> DeclaredChange:
    """Return the declared changes of all tiles."""
    return DeclaredChange(
        moved=tuple(pair for tile in tiles for pair in tile.moved),
        removed=tuple(each for tile in tiles for each in tile.removed),
        added=tuple(each for tile in tiles for each in tile.added),
        bare=tuple(each for tile in tiles for each in tile.bare),
    )
