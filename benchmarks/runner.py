"""What the benchmark's runner itself costs, beside its cells: ``python benchmarks/runner.py``.

Pieces that do nothing go the whole way of a cell: lock, threads, warnings, records, another
process. What is left is the runner's share, told per piece, and with ``--costs`` as a part of the
cells of a finished benchmark.
"""

from __future__ import annotations

import argparse
import csv
import resource
import tempfile
import time
from pathlib import Path
from statistics import mean

from animarl_algos.benchmark.pieces import Piece, attempt, perform_all
from animarl_algos.runs.run_files import write_json

PROCESSES, FEW = 2, 10


class Nothing(Piece):
    """A piece of work that writes a result and does nothing else."""

    STAGE = "nothing"
    key = "0"

    name = ""

    def __init__(self, name: str) -> None:
        self.name = name

    def ready(self, out: Path) -> bool:
        return True

    def perform(self, out: Path) -> None:
        write_json(self.folder(out) / "cost.json", {"processor_seconds": 0.0})


def alone(pieces: list[Nothing], out: Path) -> float:
    """Processor seconds of the runner per piece, in this process."""
    begun = time.process_time()
    for piece in pieces:
        attempt(piece, out)
    through = time.process_time() - begun
    begun = time.process_time()
    for piece in pieces:
        piece.perform(out)
    return (through - (time.process_time() - begun)) / len(pieces)


def of_all(number: int, out: Path) -> float:
    """Processor seconds of new processes and this one for so many pieces."""
    begun = processor_time()
    pieces = [Nothing(f"{number}-{i}") for i in range(number)]
    for _, error in perform_all([pieces], out, PROCESSES):
        if error:
            raise RuntimeError(error)
    return processor_time() - begun


def processor_time() -> float:
    """Of this process and of all that it started and that ended [s]."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pieces", type=int, default=200)
    parser.add_argument("--costs", type=Path, help="costs.csv of a finished benchmark")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        attempt(Nothing("first"), out)
        own = alone([Nothing(f"a{i}") for i in range(given.pieces)], out)
        few, many = of_all(FEW, out), of_all(FEW + given.pieces, out)
        each = (many - few) / given.pieces
    print(f"one process: {1000 * own:.1f} ms of processor time per piece")
    print(f"{PROCESSES} processes: {1000 * each:.1f} ms per piece, and once, for starting and")
    print(f"  importing, {(few - FEW * each) / PROCESSES:.1f} s each")
    if given.costs is not None:
        with given.costs.open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        trained = [float(row["processor_seconds"]) for row in rows if row["parameters"]]
        total = sum(float(row["processor_seconds"]) for row in rows)
        print(f"{given.costs}: {len(rows)} cells of {total:.0f} s in all")
        print(f"  the runner's share, one process: {own * len(rows) / total:.2%}")
        print(f"  {PROCESSES} processes: {each * len(rows) / total:.2%}")
        print(f"  of a trained cell ({mean(trained):.2f} s): {own / mean(trained):.2%}")


if __name__ == "__main__":
    main()
