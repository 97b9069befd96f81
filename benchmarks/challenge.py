"""Make the reference entries of the challenge, and score them into its table.

    python benchmarks/challenge.py [--set fly ...] [--entry law ...] [--out docs/results/challenge]

``ceiling``: the recordings themselves, 32 times; ``law``: a persistent random walk that turns
towards its focus (``animarl_algos/evaluation/laws.py``; it is given the lengths of the recordings);
``default``: the packaged model, made by ``animarl run`` with its defaults; ``random``: random
actions; ``floor``: animals that stop as soon as they can. An entry's file goes to ``--files``, by
default ``out/challenge``. A row that is there is not made again. docs/challenge.md gets all rows.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from animarl_algos.benchmark.challenge import (
    ROLLOUTS,
    add_row,
    frozen_sets,
    load_set,
    read_table,
    row_of,
    score_entry,
)
from animarl_algos.benchmark.methods import Steering
from animarl_algos.evaluation.collect import Policy, RandomPolicy, collect_rollouts
from animarl_algos.evaluation.laws import EACH, Law
from animarl_algos.evaluation.prepared import Prepared, comparison_smoothing
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.runs.pretrained import load_run, pretrained_names
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.drawing import markdown_table
from animarl_envs.scenario import Scenario, make_scenario
from animarl_envs.worlds import make_world

SEED = 0


def repeated(recorded: Rollouts, episode: Callable[[int, int], int], starts: int) -> Rollouts:
    """Return the recorded ``episode(start, repetition)`` as rollouts from every start."""
    demo, repetition = np.indices((starts, ROLLOUTS)).reshape(2, -1)
    taken = np.array(
        [episode(d, r) for d, r in zip(demo.tolist(), repetition.tolist(), strict=True)]
    )
    return replace(
        recorded.select(taken), demo=demo, repetition=repetition, seed=np.zeros_like(demo)
    )


def ceiling(demos: Demonstrations) -> Rollouts:
    """Return the test recordings themselves."""
    test = demos.select(split="test")
    return repeated(Rollouts.from_demonstrations(test), lambda start, _: start, len(test))


def law(demos: Demonstrations) -> Rollouts:
    """Return rollouts of the law of motion, fitted to the recordings that may be learned from."""
    test, rng = demos.select(split="test"), np.random.default_rng(SEED)
    fitted = Law.fit(Rollouts.from_demonstrations(learnable(demos)))
    prepared, parts = Prepared(test, comparison_smoothing(test)), []
    for first in range(0, ROLLOUTS, EACH):
        made = fitted.rollouts(prepared, rng)
        parts.append(replace(made, repetition=made.repetition + first))
    return Rollouts.concatenate(parts)


def driven(policy: Callable[[Scenario], Policy], demos: Demonstrations) -> Rollouts:
    """Return rollouts of a policy in the species' own world."""
    scenario = make_scenario(demos.species, demos=demos, split="test")
    return collect_rollouts(
        partial(make_world, scenario),
        policy(scenario),
        method="",
        seed=SEED,
        repetitions=ROLLOUTS,
    )


ENTRIES: dict[str, Callable[[Demonstrations], Rollouts]] = {
    "ceiling": ceiling,
    "law": law,
    "default": lambda demos: load_run(demos.species).simulate(repetitions=ROLLOUTS, seed=SEED),
    "random": partial(driven, lambda one: RandomPolicy(SEED, one.species.num_actions)),
    "floor": partial(driven, lambda one: Steering(one, 0.0)),
}


def write_page(rows: list[dict[str, str]], page: Path) -> None:
    """Write the rows into the page, between its marks."""
    listed = []
    for row in rows:
        interval = f" [{row['low']}, {row['high']}]" if row["low"] else ""
        listed.append((row["set"], row["entry"], f"{row['realism']}{interval}", row["verdict"]))
    before, _, rest = page.read_text().partition("<!-- table -->\n")
    _, end, after = rest.partition("<!-- end -->")
    table = markdown_table(("set", "entry", "realism", "verdict"), listed)
    page.write_text(f"{before}<!-- table -->\n{table}\n{end}{after}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--set", action="append", choices=list(frozen_sets()))
    parser.add_argument("--entry", action="append", choices=list(ENTRIES))
    parser.add_argument("--out", type=Path, default=Path("docs/results/challenge"))
    parser.add_argument("--files", type=Path, default=Path("out/challenge"))
    arguments = parser.parse_args()
    table = arguments.out / "table.csv"
    for name in arguments.set or frozen_sets():
        for entry in arguments.entry or ENTRIES:
            if entry == "default" and name not in pretrained_names():
                continue
            if any((row["set"], row["entry"]) == (name, entry) for row in read_table(table)):
                continue
            began = time.process_time()
            made = replace(ENTRIES[entry](load_set(name)), method=entry)
            arguments.files.mkdir(parents=True, exist_ok=True)
            file = made.save(arguments.files / f"{name}_{entry}.npz")
            row = row_of(score_entry(file, name), name, file)
            add_row(row, table)
            print(*list(row.values())[:-1], f"{time.process_time() - began:.0f} s", flush=True)
    write_page(read_table(table), Path("docs/challenge.md"))


if __name__ == "__main__":
    main()
