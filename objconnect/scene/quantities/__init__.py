"""Quantities that files state: one function for each knows its units, orders and references.

A reader of files takes a number out of a file, and a module of this room says what it means. The
answer is a ``Reading``: a value with its source, or unknown with the reason. No module has a
default for a unit, an order or a reference that a file does not state.
"""
