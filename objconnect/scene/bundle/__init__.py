"""A scene as a folder on disk: manifest, frames, dense annotations, objects and splits.

- ``scene``: ``Scene``, which opens a folder and reads its parts when they are asked for.
- ``manifest``: the JSON files ``scene.json``, ``objects.json`` and ``splits.json``.
- ``frames``: ``frames.h5``, the poses, cameras, priors and dense annotations of one session.
- ``covisibility``: ``covisibility.h5``, which frames see the same surface.
- ``supplement``: ``supplement.json``, the points that were added to a map afterwards.
- ``object_points``: which object each point of the map lies on.
- ``labels``: the semantic label of every class.
- ``pictures``: a contact sheet and a flight plan for people.
"""
