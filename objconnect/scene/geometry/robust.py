"""Constants of robust statistics."""

from typing import Final

SIGMA_OF_MEDIAN: Final = 1.4826
"""Standard deviation of normal errors over the median of their absolute values."""

CAUCHY: Final = 2.385
"""Scale of the Cauchy loss, in standard deviations, at which it is 95 % as efficient as least
squares for normal errors (Holland and Welsch, Commun. Stat. 6, 1977)."""

SINGULAR: Final = 1e15
"""A larger condition number of an information matrix leaves no digit of double precision."""
