"""Rendering processes: each binds itself to a core of its own."""

import os
import subprocess
import sys

import pytest

# The names that reserve cores are those of this test alone: other tests render meanwhile.
BIND_AND_PRINT = """
import os, sys
from simulate.render import process

process._CORE_LOCK_PREFIX = sys.argv[1]
process.keep_to_one_core()
print(*sorted(os.sched_getaffinity(0)), flush=True)
input()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux binds processes to cores")
def test_processes_keep_to_a_core_each_while_there_are_any():
    """And the next one gets the core of one that has ended, however it ended."""
    all_cores = sorted(os.sched_getaffinity(0))

    def another() -> tuple[subprocess.Popen, list[int]]:
        child = subprocess.Popen(
            [sys.executable, "-c", BIND_AND_PRINT, f"test-{os.getpid()}-binds"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
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


END_WITH_PARENT = """
import os, subprocess, sys, time
if len(sys.argv) == 1:
    with subprocess.Popen([sys.executable, "-c", sys.orig_argv[2], str(os.getpid())]):
        pass
from simulate.render.process import end_with
end_with(int(sys.argv[1]))
print(os.getpid(), flush=True)
time.sleep(600)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends processes with their parent")
def test_a_process_ends_with_the_one_that_asked_for_it():
    """However that one ends; the thorough part renders until then."""
    words = [sys.executable, "-c", END_WITH_PARENT]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        os.kill(child, 0)
        parent.kill()
        # The pipe ends once nobody holds it: ten minutes later if the child goes on.
        assert parent.communicate(timeout=300)[0] == ""
