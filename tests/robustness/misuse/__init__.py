"""Misuse: every command, with every argument spoiled in every way its kind can be.

``commands`` holds a row for each command, ``arguments`` what can be given to one, ``faults`` the
ways a file is spoiled, ``world`` the small tree that all of it happens in, and ``harness`` runs a
command line in this process and holds the tree of before against the tree of after.
"""
