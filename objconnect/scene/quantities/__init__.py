"""Interpretation of quantities in files: their units, order and reference.

The readers of files parse numbers; these modules interpret them. The result is a ``Reading``: a
value with its source, or unknown with the reason. If a file states no unit, order or reference, the
value is unknown, or the module documents the default that it takes.
"""
