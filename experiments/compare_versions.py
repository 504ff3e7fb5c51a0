"""Compare processor seconds and errors of queries between versions of the code.

    python -m experiments.compare_versions SCENE --versions BEFORE . --cache CACHE

BEFORE and ``.`` are folders of the code. Each version has its own process with one thread. All
versions localize a query before any localizes the next, so that other work on the machine slows
them equally: read the ratios. With ``--threads 2``, seconds are wall-clock time, which needs an
idle machine. ``--set`` applies to the last version only, or to all with ``--alike``. ``--prepare``
prepares the map with an empty cache instead.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

# Bounds of errors (m, deg) within which a pose counts in recall.
_BOUNDS = ((0.25, 2.0), (0.5, 5.0))


def main() -> None:
    """Print one line per version and condition."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--versions", type=Path, nargs="+", required=True)
    parser.add_argument("--cache", type=Path, help="folder; each version has one of its own in it")
    parser.add_argument("--method", default="objconnect")
    parser.add_argument("--start", default="error=3m,5deg")
    parser.add_argument("--every", type=int, default=1, help="take every n-th query")
    parser.add_argument(
        "--threads", type=int, default=1, help="above 1, seconds are wall-clock time"
    )
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE of the configuration")
    parser.add_argument("--alike", action="store_true", help="apply --set to all versions")
    parser.add_argument("--prepare", action="store_true")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        from objconnect.scene.runtime.tuning import ProcessTuning

        with ProcessTuning():  # as the command line
            _serve(args)
        return
    with tempfile.TemporaryDirectory() as scratch:
        caches = Path(scratch) if args.cache is None or args.prepare else args.cache
        last = len(args.versions) - 1
        workers = [
            _Worker(folder.resolve(), caches / f"version-{row}", args, args.alike or row == last)
            for row, folder in enumerate(args.versions)
        ]
        if args.prepare:
            _report_preparation(workers)
        else:
            _report_queries(workers, args.every)
        for worker in workers:
            worker.ask("end")


class _Worker:
    """A process that runs one version of the code.

    Args:
        folder: folder of the code.
        cache: cache folder of this version.
        args: arguments of the command.
        settings: whether the settings apply to this version.
    """

    def __init__(self, folder: Path, cache: Path, args: argparse.Namespace, settings: bool) -> None:
        chosen = [f"--set={each}" for each in args.set] if settings else []
        self.folder = folder
        command = [sys.executable, "-P", str(Path(__file__).resolve()), str(args.scene.resolve())]
        command += ["--serve", "--versions", str(folder), "--cache", str(cache.resolve())]
        command += ["--method", args.method, "--start", args.start, *chosen]
        command += ["--threads", str(args.threads)]
        threads = {"OMP_NUM_THREADS": str(args.threads)}
        environment = os.environ | {"PYTHONPATH": str(folder)} | threads
        self._process = subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, question: str) -> Any:
        """Return the answer of the process to a word."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(f"{question}\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            sys.exit(f"{self.folder}: the process ended")
        return json.loads(answer)


def _report_preparation(workers: list[_Worker]) -> None:
    """Print the processor seconds of every version per photograph of the map."""
    answers = [worker.ask("prepare") for worker in workers]
    for worker, answer in zip(workers, answers, strict=True):
        each, first = answer["seconds"] / answer["photographs"], answers[0]["seconds"]
        print(
            f"{worker.folder.name}: {each:.3f} s a photograph, {answer['seconds'] / first:.2f} "
            f"of the first's, {answer['faults'] / answer['photographs']:.0f} page faults"
        )


def _report_queries(workers: list[_Worker], every: int) -> None:
    """Print seconds and errors of the queries of every version, by condition and in all."""
    resident_mb = [worker.ask("prepare")["resident_mb"] for worker in workers]
    names = workers[0].ask("names")
    numbers = range(0, len(names), every)
    for worker in workers:  # warm-up
        worker.ask("0")
    found = [
        [worker.ask(str(number)) for worker in (workers if number % 2 else workers[::-1])][
            :: 1 if number % 2 else -1
        ]
        for number in numbers
    ]
    conditions = [names[number] for number in numbers]
    for condition in (*sorted(set(conditions)), "all"):
        rows = [row for row, name in enumerate(conditions) if condition in (name, "all")]
        for column, worker in enumerate(workers):
            answers = [found[row][column] for row in rows]
            first = [found[row][0] for row in rows]
            print(f"{condition:24s} {worker.folder.name:16s} {_summary(answers, first)}")
    for worker in workers:
        peak_mb = worker.ask("memory")
        print(
            f"{worker.folder.name}: {resident_mb.pop(0):.0f} MB resident before, "
            f"{peak_mb:.0f} MB at most"
        )
    for column, worker in enumerate(workers[1:], 1):
        distances = [
            float(np.linalg.norm(np.subtract(row[column]["centre"], row[0]["centre"])))
            for row in found
            if row[column]["centre"] and row[0]["centre"]
        ]
        print(
            f"{worker.folder.name}: poses move by {np.median(distances):.4f} m, "
            f"{max(distances):.3f} most"
        )


def _summary(answers: list[Any], first: list[Any]) -> str:
    """Return seconds with their ratio to the first version's, recall and median errors."""
    seconds = np.array([each["seconds"] for each in answers])
    first_seconds = np.array([each["seconds"] for each in first])
    errors = np.array([each["errors"] or (np.inf, np.inf) for each in answers])
    counts = (int(((errors < bound).all(1)).sum()) for bound in _BOUNDS)
    recall = ", ".join(
        f"{count} within {metres:g} m {degrees:g} deg"
        for count, (metres, degrees) in zip(counts, _BOUNDS, strict=True)
    )
    stages = {
        name: np.mean([each["stages"].get(name, 0.0) for each in answers])
        for name in answers[0]["stages"]
    }
    parts = " ".join(f"{name} {seconds:.3f}" for name, seconds in stages.items())
    return (
        f"{seconds.mean():.3f} s, {seconds.sum() / first_seconds.sum():.2f}, median ratio "
        f"{np.median(seconds / first_seconds):.2f}; {recall} of {len(answers)}; median "
        f"{np.median(errors[:, 0]):.3f} m {np.median(errors[:, 1]):.3f} deg; "
        f"{np.mean([each['faults'] for each in answers]):.0f} faults; clock {parts}"
    )


def _serve(args: argparse.Namespace) -> None:
    """Answer questions of the parent about this version."""
    import resource
    import time

    import torch

    from benchmark.cli.arguments import parse_settings
    from benchmark.datasets.open import open_datasets
    from benchmark.evaluation.starts import parse_start
    from objconnect.methods import create
    from objconnect.scene.runtime.memory import peak_megabytes, reset_peak, resident_bytes
    from objconnect.scene.runtime.tuning import trim_heap

    torch.set_num_threads(args.threads)
    seconds = time.process_time if args.threads == 1 else time.perf_counter
    (dataset,) = open_datasets(args.scene)
    sparse_map = dataset.load_map()
    method = create(args.method, parse_settings(args.set))
    load = parse_start(args.start).loader(dataset, sparse_map, args.cache)

    def faults() -> int:
        """Return the number of page faults so far."""
        return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

    for line in sys.stdin:
        word, faults_before, begin = line.strip(), faults(), seconds()
        answer: Any = None
        if word == "prepare":
            method.prepare(sparse_map, dataset.images, args.cache)
            answer = {"seconds": seconds() - begin, "photographs": len(sparse_map.names)}
            answer["faults"] = faults() - faults_before
            trim_heap()
            reset_peak()
            answer["resident_mb"] = resident_bytes() / 1e6
        elif word == "memory":
            answer = peak_megabytes()
        elif word == "names":
            answer = [query.condition or "" for query in dataset.queries]
        elif word != "end":
            reference, query = dataset.queries[int(word)], load(dataset.queries[int(word)])
            faults_before, begin = faults(), seconds()
            found = method.localize(query)
            answer = {"seconds": seconds() - begin, "faults": faults() - faults_before}
            pose = found.cam_from_world if found.status.value == "ok" else None
            answer["stages"] = dict(found.seconds)
            answer["centre"] = None if pose is None else pose.centre().tolist()
            errors = None if pose is None else pose.error_to(reference.reference)
            answer["errors"] = errors and [float(each) for each in errors]
        print(json.dumps(answer), flush=True)
        if word == "end":
            return


if __name__ == "__main__":
    main()
