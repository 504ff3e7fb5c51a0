"""A scene as a folder on disk: manifest, frames, dense annotations, objects and splits.

- ``scene``: ``Scene``, which opens a folder and reads its parts on demand.
- ``manifest``: the JSON files ``scene.json``, ``objects.json`` and ``splits.json``.
- ``frames``: ``frames.h5``: poses, cameras, priors and dense annotations of one session (flight).
- ``covisibility``: ``covisibility.h5``, which frames see the same surface.
- ``georeference``: the absolute accuracy of a map.
- ``thermal``: thermal pictures, which have the poses of the photographs.
- ``held_out``: the conditions, sites and cameras that benchmark tracks reserve for tests.
- ``supplement``: ``supplement.json``, the points that were added to a map after it was built.
- ``object_points``: which object each point of the map lies on.
- ``labels``: the semantic label of every class.
- ``pictures``: figures of a scene: contact sheet and top view of the flights.
"""
