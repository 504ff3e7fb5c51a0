"""What rendering processes know of themselves."""

import os
import subprocess
import sys

import pytest

CLAIM = (
    "import os; from simulate.render.process import keep_to_one_core; keep_to_one_core();"
    "print(*sorted(os.sched_getaffinity(0)), flush=True); input()"
)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux binds processes to cores")
def test_processes_keep_to_a_core_each_while_there_are_any():
    """And the next one gets the core of one that has ended, however it ended."""
    all_cores = sorted(os.sched_getaffinity(0))

    def another() -> tuple[subprocess.Popen, list[int]]:
        child = subprocess.Popen(
            [sys.executable, "-c", CLAIM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert child.stdout is not None
        return child, [int(core) for core in child.stdout.readline().split()]

    children = [another() for _ in all_cores]
    try:
        assert sorted(cores for _, cores in children) == [[core] for core in all_cores]
        children.append(another())
        assert children[-1][1] == all_cores
        killed, its_own = children[0]
        killed.kill()
        killed.wait()
        children.append(another())
        assert children[-1][1] == its_own
    finally:
        for child, _ in children:
            child.kill()
            child.communicate()
