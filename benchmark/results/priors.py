"""The errors of priors, as the name of the starting information (``--start``) states them.

``--start error=3m,5deg`` and ``gps=50m`` give each query a position with an error of exactly
this size, so that the error is known, although files of earlier versions and submissions lack it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from benchmark.results.query_result import QueryResult

_EXACT: Final = re.compile(r"(?:error|gps)=([0-9]+(?:\.[0-9]+)?)m(?:,.*)?")


def add_prior_errors(queries: Sequence[QueryResult], start: str) -> tuple[QueryResult, ...]:
    """Return queries with the errors of their priors.

    Args:
        queries: results of queries; an error that they hold is kept.
        start: name of the starting information. Only "error" and "gps" determine the error.
    """
    match = _EXACT.fullmatch(start)
    if match is None:
        return tuple(queries)
    error = {"prior_t_m": float(match.group(1))}
    return tuple(
        query if query.prior_t_m is not None else query.model_copy(update=error)
        for query in queries
    )
