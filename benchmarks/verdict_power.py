"""How often a verdict cries wolf, and how often it sees a known fault.

    python benchmarks/verdict_power.py [--runs 100] [--starts 10 20 50] [--seeds 0 1 2]
    python benchmarks/verdict_power.py --joint
    python benchmarks/verdict_power.py --quick

Perfect simulators and simulators with one known fault (:mod:`benchmarks.known_worlds`) are judged
as any other. Printed is, for each, the share of runs with a green page (*not distinguishable*), of
all seeds together and of each. ``--joint`` asks the joint test of all measures alone, without the
classifiers.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for benchmarks and tools

from animarl_algos.evaluation.classifier import judges
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict import compared
from animarl_algos.evaluation.verdict_rows import SAME
from animarl_envs.demos.demonstrations import Demonstrations
from benchmarks.known_worlds import FAULTS, KnownWorld, with_fault

EACH = 5  # rollouts from every start
FAULTS_SHARE = 5  # so many times fewer runs of a fault than of a perfect simulator
PERFECT = "perfect"
WORLDS = {"free pair": KnownWorld(chase=False), "chase": KnownWorld(chase=True)}


def whole_verdict(recorded: Demonstrations, rollouts: Rollouts, seed: int) -> bool:
    """Return whether the page is green, without all that stands beside the verdict.

    It takes a fraction of the time, and is asked thousands of times.
    """
    prepared, counted, tests, unit, streams = compared(recorded, rollouts, seed)
    if tests.differs:
        return False
    asked = judges(prepared, counted, {}, None, unit, (*streams[1:3], streams[4]), alone=True)
    return all(row.judgement == SAME for row, _ in asked)


def joint_test(recorded: Demonstrations, rollouts: Rollouts, seed: int) -> bool:
    """Return whether no measure differs, and the endings do not."""
    return not compared(recorded, rollouts, seed)[2].differs


def green(
    judge: Callable[[Demonstrations, Rollouts, int], bool],
    world: KnownWorld,
    fault: str,
    starts: int,
    runs: int,
    seed: int,
) -> float:
    """Return the share of runs in which nothing differs."""
    count = 0
    for run in range(runs):
        rng = np.random.default_rng([seed, run, starts, len(fault), world.chase])
        recorded = world.recordings(starts, rng)
        rollouts = world.rollouts(recorded, EACH, rng)
        if fault != PERFECT:
            rollouts = with_fault(rollouts, FAULTS[fault], rng)
        count += judge(recorded, rollouts, run)
    return count / runs


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=100, help="of perfect simulators; faults: 1/5")
    parser.add_argument("--starts", type=int, nargs="+", default=[10, 20, 50])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument(
        "--faults", nargs="+", default=[PERFECT, *FAULTS], choices=[PERFECT, *FAULTS]
    )
    parser.add_argument("--joint", action="store_true", help="the joint test alone")
    parser.add_argument("--quick", action="store_true", help="few runs of 10 starts, one seed")
    args = parser.parse_args()
    runs, sizes, seeds = (5, [10], [0]) if args.quick else (args.runs, args.starts, args.seeds)
    judge = joint_test if args.joint else whole_verdict
    print(f"| world | simulator | {' | '.join(f'green, {n} starts' for n in sizes)} |")
    print("|---|---|" + "---|" * len(sizes))
    for name, world in WORLDS.items():
        for fault in args.faults:
            number = runs if fault == PERFECT else max(1, runs // FAULTS_SHARE)
            told = []
            for n in sizes:
                shares = [green(judge, world, fault, n, number, seed) for seed in seeds]
                each = ", ".join(f"{100 * share:.0f}" for share in shares)
                told.append(f"{100 * sum(shares) / len(shares):.0f} % ({each})")
            print(f"| {name} | {fault} | {' | '.join(told)} |", flush=True)
    print(f"\n{time.process_time():.0f} s of processor time", file=sys.stderr)


if __name__ == "__main__":
    main()
