"""Hostile files: every reader on mutated real files, a result or an InputError and nothing else.

``python -m tests.fuzz --inputs 200000 --seed 0``; see ``tests.fuzz.__main__``.
"""
