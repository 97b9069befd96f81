"""``python -m tools.fuzz``: damaged files through every reader, and what became of them.

Every file is of the project's own making, damaged by a seeded generator; ``--show KIND NUMBER``
writes one of them again. ``--meanings`` counts whole tables of known meaning that are read wrongly.
See SECURITY.md for what the counts mean.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

from tools.fuzz.meanings import count_meanings
from tools.fuzz.targets import TARGETS
from tools.fuzz.workers import damage_number, fuzz

WORDS = {
    "ran": "code runs", "traceback": "tracebacks", "refused": "refused in a sentence",
    "crash": "of these: crashed in a process of their own",
    "hang": "of these: stopped by the limit of time", "memory": "of these: by that of memory",
    "equal": "accepted, equal to the clean import",
    "different": "accepted, different as their own bytes say",
    "unexplained": "accepted, different beyond that",
}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.fuzz", description=__doc__)
    parser.add_argument("-n", type=int, default=20_000, help="damaged files")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--kinds", default=",".join(TARGETS), help="some of them, by comma")
    parser.add_argument("--show", nargs=2, metavar=("KIND", "NUMBER"), help="write one file here")
    parser.add_argument("--meanings", type=int, default=0, help="tables of known meaning instead")
    asked = parser.parse_args()
    names = asked.kinds.split(",")
    if asked.show:
        return show(asked.show[0], int(asked.show[1]), asked.seed)
    if asked.meanings:
        counts, lines = count_meanings(asked.meanings, asked.workers, asked.seed)
        print("\n".join(lines))
        print(f"{asked.meanings:,} tables of known meaning, seed {asked.seed}:")
        for outcome in ("right", "refused", "wrong"):
            print(f"{counts[outcome]:>9,}  {outcome}")
        return int(counts["wrong"] > 0)
    began = time.monotonic()
    result = fuzz(asked.n, asked.workers, asked.seed, names)
    seconds = time.monotonic() - began
    for line in result.findings:
        print(line)
    print(
        f"\n{result.total:,} damaged files of {len(names)} kinds, seed {asked.seed}, "
        f"{result.total / seconds:.0f} a second"
    )
    for outcome, words in WORDS.items():
        print(f"{result.counts[outcome]:>9,}  {words}")
    return int(any(result.counts[name] for name in ("ran", "traceback")))


def show(name: str, number: int, seed: int) -> int:
    """Write the damaged file of a number into the present folder."""
    with tempfile.TemporaryDirectory() as folder:
        path = TARGETS[name].write(Path(folder))
        out = Path(f"{number}-{path.name}")
        out.write_bytes(damage_number(number, seed, path.read_bytes(), name).data)
    print(f"Wrote {out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
