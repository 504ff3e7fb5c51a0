"""Constants of robust statistics."""

from typing import Final

SIGMA_OF_MEDIAN: Final = 1.4826
"""Ratio of the standard deviation of normal errors to the median of their absolute values."""

CAUCHY_SCALE: Final = 2.385
"""Scale of the Cauchy loss in standard deviations. With this scale it is 95 % as efficient as least
squares for normal errors (Holland and Welsch, Commun. Stat. 6, 1977)."""

MAX_CONDITION: Final = 1e15
"""Condition number above which an information matrix is singular in double precision."""
