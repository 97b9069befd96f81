"""How often a verdict cries wolf, and how often it sees a known fault.

    python benchmarks/verdict_power.py [--runs 300] [--starts 10 20 50] [--seed 0]
    python benchmarks/verdict_power.py --joint
    python benchmarks/verdict_power.py --quick

Perfect simulators and simulators with one known fault (:mod:`benchmarks.known_worlds`) are judged
as any other. Printed is, for each, the share of runs with a green page (*not distinguishable*).
``--joint`` asks the joint test of all measures alone, without the classifiers, which takes a
fiftieth of the time. Nothing was tuned on these worlds' seeds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for benchmarks and tools

from animarl_algos.evaluation.exchange_test import Exchanges, exchange_test
from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict import verdict
from animarl_algos.evaluation.verdict_rows import LEVEL, SAME, measure_columns
from animarl_envs.demos.demonstrations import Demonstrations
from benchmarks.known_worlds import FAULTS, KnownWorld, with_fault

EACH = 5  # rollouts from every start
EXCHANGES = 500
PERFECT = "perfect"
WORLDS = {"free pair": KnownWorld(chase=False), "chase": KnownWorld(chase=True)}


def whole_verdict(recorded: Demonstrations, rollouts: Rollouts, seed: int) -> bool:
    """Return whether the page is green."""
    return verdict(recorded, rollouts, seed=seed).judgement == SAME


def joint_test(recorded: Demonstrations, rollouts: Rollouts, seed: int) -> bool:
    """Return whether no measure differs."""
    prepared, rng = Prepared(recorded), np.random.default_rng(seed)
    columns = measure_columns(prepared, rollouts)
    exchanges = Exchanges.draw(rollouts.demo, len(recorded), rng, EXCHANGES)
    return not exchange_test(columns.values, exchanges, level=LEVEL).p <= LEVEL


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
    parser.add_argument("--runs", type=int, default=300, help="of perfect simulators; faults: 1/5")
    parser.add_argument("--starts", type=int, nargs="+", default=[10, 20, 50])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--faults", nargs="+", default=[PERFECT, *FAULTS], choices=[PERFECT, *FAULTS]
    )
    parser.add_argument("--joint", action="store_true", help="the joint test alone")
    parser.add_argument("--quick", action="store_true", help="few runs of 10 starts")
    args = parser.parse_args()
    runs, sizes = (5, [10]) if args.quick else (args.runs, args.starts)
    print(f"| world | simulator | {' | '.join(f'green, {n} starts' for n in sizes)} |")
    print("|---|---|" + "---|" * len(sizes))
    for name, world in WORLDS.items():
        for fault in args.faults:
            number = runs if fault == PERFECT else max(1, runs // 5)
            judge = joint_test if args.joint else whole_verdict
            shares = [green(judge, world, fault, n, number, args.seed) for n in sizes]
            told = " | ".join(f"{100 * share:.0f} %" for share in shares)
            print(f"| {name} | {fault} | {told} |", flush=True)


if __name__ == "__main__":
    main()
