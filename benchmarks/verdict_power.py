"""How often a verdict errs, and how often it sees a known fault.

    python benchmarks/verdict_power.py [--runs 100] [--starts 10 20 50] [--seeds 0 1 2]
    python benchmarks/verdict_power.py --rows
    python benchmarks/verdict_power.py --quick

Perfect simulators and simulators with one known fault (:mod:`benchmarks.known_worlds`) are judged
as any other. Printed is, for each, in which share of runs something *differs*, and in which share
nothing differs and nothing is unknown (a green page). A perfect simulator should have the first in
at most 5 %, and a fault the second. ``--rows`` leaves the two classifiers out.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for benchmarks and tools

from animarl_algos.evaluation.classifier import classify_all
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict import compare
from animarl_algos.evaluation.verdict_rows import ALIKE, DIFFERS, LITTLE, classifier_row
from animarl_envs.demos.demonstrations import Demonstrations
from benchmarks.known_worlds import FAULTS, WORLDS, KnownWorld, with_fault

EACH = 5  # rollouts from every start
FAULTS_SHARE = 5  # so many times fewer runs of a fault than of a perfect simulator
PERFECT = "perfect"


def words_of(
    recorded: Demonstrations, rollouts: Rollouts, seed: int, *, classifiers: bool
) -> set[str]:
    """Return the words of a verdict without all that stands beside it.

    It takes a fraction of the time, and is asked thousands of times.
    """
    compared, streams = compare(recorded, rollouts, seed)
    words = {row.judgement for row in compared.rows()}
    if classifiers and DIFFERS not in words:
        prepared, counted = compared.prepared, compared.counted
        answers = classify_all(prepared, counted, {}, None, compared.unit, streams[:3], alone=True)
        words |= {classifier_row(*answer).judgement for answer in answers}
    return words


def shares(
    world: KnownWorld, fault: str, starts: int, runs: int, seed: int, *, classifiers: bool
) -> tuple[float, float]:
    """Return the share of runs in which something differs, and that of green pages."""
    differs = green = 0
    for run in range(runs):
        rng = np.random.default_rng([seed, run, starts, len(fault), world.chase])
        recorded = world.recordings(starts, rng)
        rollouts = world.rollouts(recorded, EACH, rng)
        if fault != PERFECT:
            rollouts = with_fault(rollouts, FAULTS[fault], rng)
        words = words_of(recorded, rollouts, run, classifiers=classifiers)
        differs += DIFFERS in words
        green += words <= {ALIKE, LITTLE}
    return differs / runs, green / runs


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=100, help="of perfect simulators; faults: 1/5")
    parser.add_argument("--starts", type=int, nargs="+", default=[10, 20, 50])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--worlds", nargs="+", default=[*WORLDS], choices=[*WORLDS])
    parser.add_argument(
        "--faults", nargs="+", default=[PERFECT, *FAULTS], choices=[PERFECT, *FAULTS]
    )
    parser.add_argument("--rows", action="store_true", help="without the classifiers")
    parser.add_argument("--quick", action="store_true", help="few runs of 10 starts, one seed")
    args = parser.parse_args()
    runs, sizes, seeds = (5, [10], [0]) if args.quick else (args.runs, args.starts, args.seeds)
    columns = [f"{what}, {n} starts" for n in sizes for what in ("differs", "green")]
    print(f"| world | simulator | {' | '.join(columns)} |")
    print("|---|---|" + "---|" * len(columns))
    for name in args.worlds:
        for fault in args.faults:
            number = runs if fault == PERFECT else max(1, runs // FAULTS_SHARE)
            told = []
            for n in sizes:
                each = [
                    shares(WORLDS[name], fault, n, number, seed, classifiers=not args.rows)
                    for seed in seeds
                ]
                told += [f"{100 * share:.0f} %" for share in np.mean(each, axis=0).tolist()]
            print(f"| {name} | {fault} | {' | '.join(told)} |", flush=True)
    print(f"\n{time.process_time():.0f} s of processor time", file=sys.stderr)


if __name__ == "__main__":
    main()
