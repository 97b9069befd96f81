"""How often a verdict cries wolf, and how often it sees a known fault.

    python benchmarks/verdict_power.py [--runs 300] [--starts 10 20 50] [--seed 0]
    python benchmarks/verdict_power.py --quick

Perfect simulators and simulators with one known fault (:mod:`benchmarks.known_worlds`) are judged
as any other. Printed is, for each, the share of runs with a green page (*not distinguishable*), and
beside it those in amber (*differs, but by little*). Nothing was tuned on these worlds' seeds.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np

from animarl_algos.evaluation.verdict import verdict
from animarl_algos.evaluation.verdict_rows import BY_LITTLE, DIFFERS, SAME
from benchmarks.known_worlds import FAULTS, KnownWorld, with_fault

EACH = 5  # rollouts from every start
PERFECT = "perfect"
WORLDS = {"free pair": KnownWorld(chase=False), "chase": KnownWorld(chase=True)}


def judgements(
    world: KnownWorld, fault: str, starts: int, runs: int, seed: int
) -> tuple[Counter[str], Counter[str]]:
    """Return how often each judgement came out, and which rows differed."""
    found, rows = Counter[str](), Counter[str]()
    for run in range(runs):
        rng = np.random.default_rng([seed, run, starts, len(fault), world.chase])
        recorded = world.recordings(starts, rng)
        rollouts = world.rollouts(recorded, EACH, rng)
        if fault != PERFECT:
            rollouts = with_fault(rollouts, FAULTS[fault], rng)
        judged = verdict(recorded, rollouts, seed=run)
        found[judged.judgement] += 1
        rows.update(
            judged.table.loc[judged.table["judgement"].isin([DIFFERS, BY_LITTLE]), "measure"]
        )
    return found, rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=300, help="of perfect simulators; faults: 1/3")
    parser.add_argument("--starts", type=int, nargs="+", default=[10, 20, 50])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--faults", nargs="+", choices=[PERFECT, *FAULTS], default=[PERFECT, *FAULTS]
    )
    parser.add_argument("--quick", action="store_true", help="few runs of 10 starts")
    args = parser.parse_args()
    runs, sizes = (9, [10]) if args.quick else (args.runs, args.starts)
    print("| world | simulator | starts | runs | green | amber | red | rows that differ |")
    print("|---|---|---|---|---|---|---|---|")
    for name, world in WORLDS.items():
        for fault in args.faults:
            for starts in sizes:
                number = runs if fault == PERFECT else max(1, runs // 3)
                began = time.process_time()
                found, rows = judgements(world, fault, starts, number, args.seed)
                shares = [
                    f"{100 * found[one] / number:.0f} %" for one in (SAME, BY_LITTLE, DIFFERS)
                ]
                told = ", ".join(f"{row} {n}" for row, n in rows.most_common(4))
                cells = [name, fault, str(starts), str(number), *shares, told]
                print(f"| {' | '.join(cells)} |", flush=True)
                if args.quick:
                    print(f"<!-- {(time.process_time() - began) / number:.1f} s a verdict -->")


if __name__ == "__main__":
    main()
