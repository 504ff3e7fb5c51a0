"""Interpretation of quantities in files: their units, order and reference.

The readers of files parse numbers; these modules interpret them. The result is a ``Reading``: a
value with its source, or unknown with the reason. No module assumes a unit, an order or a reference
that a file does not state.
"""
