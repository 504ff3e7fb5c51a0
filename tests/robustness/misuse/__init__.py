"""Misuse of the command line: every command with every kind of fault in every argument.

``commands`` holds a row for each command, ``arguments`` what can be given to one, ``faults`` the
ways a file is spoiled, ``world`` the small tree that all of it happens in, and ``harness`` runs a
command line in this process and holds the tree of before against the tree of after.
"""
