"""Tests of ``benchmark.publishing``."""
