"""Hostile files: every reader on mutated real files, a result or an InputError and nothing else.

``python -m tests.robustness.fuzz --inputs 200000 --seed 0``; see ``__main__``.
"""
