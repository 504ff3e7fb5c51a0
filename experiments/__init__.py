"""Measuring scripts, which are not installed: costs, ablations, comparisons, fits of constants."""
