"""Memory over many queries without a prior is flat: what a query takes goes when it is answered."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

from objconnect.localization.featuremetric.localizer import _RETURN_FREED_MB
from objconnect.localization.featuremetric.options import FeaturemetricConfig

ROOT: Final = Path(__file__).parents[2]
# Ten queries of the gate, of which six are aligned with the network and the others matched.
FIRST, LAST, QUERIES = 40, 50, 64
# Each has been asked three times before the rest: bounded caches hold what they will hold.
WARM: Final = 30
# MB by which the heap in use may differ. It is equal to 1 MB, and grew by 67 MB in a trial where
# the features of queries were kept.
FLAT_MB: Final = 4.0


# Of the default part is ``test_a_query_leaves_no_tensor_behind``.
@pytest.mark.thorough
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the heap is told by glibc")
def test_memory_is_flat_over_64_queries_told_nothing(tmp_path: Path) -> None:
    """See docs/evidence/robustness.md, where 64 queries are 32 of the demo asked twice."""
    command = [sys.executable, "-m", "experiments.query_memory", "benchmark/gate/gate"]
    command += ["--cache", str(tmp_path), "--queries", str(QUERIES)]
    command += ["--among", str(FIRST), str(LAST)]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines()[1:]]
    assert len(rows) == QUERIES
    aligned = [row for row in rows[WARM:] if "alignment" in row]
    assert len(aligned) >= 8
    used = [float(row[3]) for row in rows]
    assert used[-1] - used[WARM - 1] <= FLAT_MB, used
    resident = [float(row[1]) for row in rows]
    config = FeaturemetricConfig()
    assert resident[-1] - resident[WARM - 1] <= _RETURN_FREED_MB, resident
    assert max(float(row[2]) for row in rows) <= config.memory_mb
