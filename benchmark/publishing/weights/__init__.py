"""Weights of a method as a model repository of a hub.

- ``local_weights``: the file of weights, with the card and the calibration files beside it.
- ``evaluations``: the stored results that were made with these weights.
- ``benchmarks``: scores on published data sets, as the hub's leaderboards read them.
- ``card``: the model card.
- ``command``: the command ``publish-weights``.
"""
