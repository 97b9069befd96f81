"""Whether the statistics of an evaluation hold what they say, in simulated experiments.

    python benchmarks/stated_coverage.py [--experiments 4000] [--only intervals energy ...]

Prints the tables of ``docs/statistics.md``: coverage of nominal 95 % intervals, how often the
energy score prefers a perfect simulator to a collapsed one, false alarms of the null references, of
the gate and of the classifier, and how long a comparison takes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import gammaincinv, ndtr, ndtri

from animarl_algos.evaluation.classifier import Windows, classify, window_features
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.comparison import comparison_table, pair_table
from animarl_algos.evaluation.comparison import gate as passed_gate
from animarl_algos.evaluation.differences import Differences, Sides, simultaneous_differences
from animarl_algos.evaluation.realism import over_groups
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import (
    Cells,
    Draws,
    bootstrap_difference,
    bootstrap_mean,
    cells,
    energy_cells,
    margins,
)
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SEEDS, DEMOS = (1, 3, 5, 10), (10, 20, 50)
ROLLOUTS, RESAMPLES, AT_ONCE = 3, 2000, 500
STARTS = (10, 20, 50)  # of the null references
SETS = tuple(packaged_names())  # that random actions are told from
EPISODES = 100  # of the comparison that is timed
GATES = ((1, 1, 1), (2, 2, 2), (3, 3), (3, 3, 3), (5, 5, 5), (3, 5, 4), (10, 10, 10))
# Standard deviations: of seeds, demonstrations, their cells and rollouts; of normal values, and of
# the logarithm of lognormal ones.
SPREAD = {"normal": (0.5, 1.0, 0.5, 1.0), "lognormal": (0.3, 0.6, 0.3, 0.5)}
OWN = {"normal": 0.5, "lognormal": 0.25}  # of a demonstration for one method or cue alone
EFFECT = 0.2
TOTAL = float(np.sqrt(np.square(SPREAD["normal"]).sum()))
LINKS: dict[str, Callable[[Floats], Floats]] = {
    "gamma": lambda z: gammaincinv(1.5, ndtr(z)),
    "mixture": lambda z: z + 4.0 * (z > ndtri(0.8)),  # one value in five is four sd farther
    "zero-inflated": lambda z: np.where(z > ndtri(0.3), np.exp(0.6 * z), 0.0),
    "censored": lambda z: np.exp(0.8 * np.minimum(z, ndtri(0.6))),  # two films in five end before
}
"""Further values, of normal ones in units of their standard deviation ``TOTAL``."""
OTHER_SEEDS = (1, 3)
SHARES = (0.02, 0.1, 0.5, 0.9, 0.98)
QUANTILES = ndtri((np.arange(2000) + 0.5) / 2000)


class World:
    """Experiments of one size at once: values ``(experiments, seeds, demos, rollouts)``, truths."""

    def __init__(self, kind: str, seeds: int, demos: int, many: int, rng: np.random.Generator):
        self.kind, self.rng, self.link = kind, rng, LINKS.get(kind)
        self.shape = (many, seeds, demos, ROLLOUTS)
        self.own = OWN.get(kind, OWN["normal"])
        self.sd = SPREAD.get(kind, SPREAD["normal"])
        self.demo = self.sd[1] * self.noise(1, 0, 1, 0)

    def noise(self, *axes: int) -> Floats:
        """Standard normal numbers, of their own along the marked axes."""
        return self.rng.normal(size=[n if own else 1 for n, own in zip(self.shape, axes)])

    def network(self) -> Floats:
        return self.sd[0] * self.noise(1, 1, 0, 0)

    def cell(self) -> Floats:
        return self.sd[2] * self.noise(1, 1, 1, 0)

    def values(self, exponent: Floats) -> Floats:
        """Cell means ``(experiments, seeds, demos)``, rollouts added."""
        drawn = exponent + self.sd[3] * self.noise(1, 1, 1, 1)
        if self.link is not None:
            return np.asarray(self.link(drawn / TOTAL).mean(axis=3))
        return np.asarray((np.exp(drawn) if self.kind == "lognormal" else drawn).mean(axis=3))

    def truth(self, network: Floats, *spreads: float, effect: float = 0.0) -> Floats:
        """The expected value; of one seed, for its network."""
        number = self.shape[1]
        fixed = network[:, 0, 0, 0] if number == 1 else np.zeros(self.shape[0])
        if self.kind == "normal":
            return fixed + effect
        varying = [*self.sd[1:], *spreads, *(() if number == 1 else self.sd[:1])]
        if self.link is not None:
            rest = np.sqrt(np.square(varying).sum()) * QUANTILES
            return np.asarray(self.link((fixed[:, None] + effect + rest) / TOTAL).mean(axis=1))
        return np.asarray(np.exp(fixed + effect + 0.5 * np.square(varying).sum()))


def centred(table: Floats) -> Floats:
    return np.asarray(table - table.mean(axis=(-2, -1), keepdims=True))


def mean_inside(world: World, draws: Draws) -> NDArray[np.bool_]:
    network = world.network()
    found = world.values(network + world.demo + world.cell())
    below, above = margins([centred(found)], draws)
    miss = world.truth(network) - found.mean(axis=(1, 2))
    return np.asarray((-below <= miss) & (miss <= above))


def pair_inside(world: World, draws: Draws) -> NDArray[np.bool_]:
    """Two methods of networks of their own, on the same demonstrations."""
    own, tables, truths = world.own, [], []
    for effect in (EFFECT, 0.0):
        network = world.network()
        exponent = network + world.demo + own * world.noise(1, 0, 1, 0) + world.cell() + effect
        tables.append(world.values(exponent))
        truths.append(world.truth(network, own, effect=effect))
    below, above = margins([centred(tables[0]), -centred(tables[1])], draws)
    miss = truths[0] - truths[1] - (tables[0] - tables[1]).mean(axis=(1, 2))
    return np.asarray((-below <= miss) & (miss <= above))


def shift_inside(world: World, draws: Draws) -> NDArray[np.bool_]:
    """The same networks told two cues: each shifts by an amount of its own, at each start."""
    own, network = world.own, world.network()
    base = network + world.demo + world.cell()
    of_network = 0.5 * world.network()
    shift = EFFECT + of_network + own * world.noise(1, 0, 1, 0)
    gap = world.values(base + shift) - world.values(base)
    below, above = margins([centred(gap)], draws)
    if world.shape[1] == 1:
        told = world.truth(network + of_network, own, effect=EFFECT)
    else:
        told = world.truth(network, own, 0.5 * world.sd[0], effect=EFFECT)
    miss = told - world.truth(network) - gap.mean(axis=(1, 2))
    return np.asarray((-below <= miss) & (miss <= above))


STATISTICS: dict[str, Callable[[World, Draws], NDArray[np.bool_]]] = {
    "mean": mean_inside,
    "paired difference": pair_inside,
    "cue shift": shift_inside,
}


def coverage(
    name: str, kind: str, seeds: int, demos: int, experiments: int, seed: int = 0
) -> float:
    """Share of experiments in which the nominal 95 % interval holds the truth."""
    inside = []
    for start in range(0, experiments, AT_ONCE):
        rng = np.random.default_rng([seed, start, seeds, demos, len(name), len(kind)])
        world = World(kind, seeds, demos, min(AT_ONCE, experiments - start), rng)
        inside.append(STATISTICS[name](world, Draws.by(rng, RESAMPLES)))
    return float(np.concatenate(inside).mean())


def intervals(experiments: int) -> None:
    heading = [f"{kind}, {demos}" for kind in SPREAD for demos in DEMOS]
    rows = [
        [name, str(seeds)]
        + [
            f"{coverage(name, kind, seeds, demos, experiments):.3f}"
            for kind in SPREAD
            for demos in DEMOS
        ]
        for name in STATISTICS
        for seeds in SEEDS
    ]
    show(f"Coverage, {experiments:,} experiments", ["statistic", "seeds", *heading], rows)


def others(experiments: int) -> None:
    heading = [f"{kind}, {demos}" for kind in LINKS for demos in DEMOS]
    rows = []
    for name in STATISTICS:
        for seeds in OTHER_SEEDS:
            found = [
                coverage(name, kind, seeds, demos, experiments) for kind in LINKS for demos in DEMOS
            ]
            rows.append([name, str(seeds), *(f"{share:.3f}" for share in found)])
    show(
        f"Coverage of other values, {experiments:,} experiments",
        ["statistic", "seeds", *heading], rows,
    )  # fmt: skip


def shares(experiments: int) -> None:
    """Of a share of episodes, and of what it differs from the recorded one."""
    heading = [f"{100 * share:g} %, {demos}" for share in SHARES for demos in DEMOS]
    rows = {(name, seeds): [name, str(seeds)] for name in ("share", "difference to the recorded")
            for seeds in OTHER_SEEDS}  # fmt: skip
    for seeds in OTHER_SEEDS:
        for share in SHARES:
            for demos in DEMOS:
                inside = shares_inside(share, seeds, demos, experiments)
                for name, found in zip(("share", "difference to the recorded"), inside):
                    rows[name, seeds].append(f"{found:.3f}")
    show(
        f"Coverage of shares, {experiments:,} experiments",
        ["statistic", "seeds", *heading], list(rows.values()),
    )  # fmt: skip


def shares_inside(share: float, seeds: int, demos: int, experiments: int) -> Floats:
    """How often the intervals of a share and of a difference of shares hold the truth."""
    rng = np.random.default_rng([6, round(1000 * share), seeds, demos])
    of_network, of_demo, of_cell, of_rollout = SPREAD["normal"]
    apart = np.sqrt(of_demo**2 + of_cell**2 + of_rollout**2)
    limit = -ndtri(share) * TOTAL
    recorded_truth = float(ndtr(-limit / apart))
    inside = np.zeros(2)
    for _ in range(experiments):
        demo, network = of_demo * rng.normal(size=demos), of_network * rng.normal(size=(seeds, 1))
        centre = network + demo + of_cell * rng.normal(size=(seeds, demos))
        drawn = centre[..., None] + of_rollout * rng.normal(size=(seeds, demos, ROLLOUTS)) > limit
        many = Cells(drawn.sum(axis=2).astype(float), np.full((seeds, demos), float(ROLLOUTS)))
        noise = np.hypot(of_cell, of_rollout) * rng.normal(size=(1, demos))
        one = Cells((demo + noise > limit).astype(float), np.ones((1, demos)))
        truth = ndtr(float(network[0, 0] - limit) / apart) if seeds == 1 else share
        found = bootstrap_mean(many, rng, share=True), bootstrap_difference(
            many, one, rng, share=True
        )  # fmt: skip
        truths = truth, truth - recorded_truth
        inside += [each.low <= true <= each.high for each, true in zip(found, truths)]
    return np.asarray(inside / experiments)


def realism(experiments: int) -> None:
    """Of the mean of scores between 0 and 1, one a recording."""
    rng, row = np.random.default_rng(7), []
    draws, truth = Draws.by(rng), float(ndtr(QUANTILES - 0.8).mean())
    for demos in DEMOS:
        inside = 0
        for _ in range(experiments):
            found = over_groups(ndtr(rng.normal(size=demos) - 0.8), np.arange(demos), draws)
            inside += found.low <= truth <= found.high
        row.append(f"{inside / experiments:.3f}")
    show(
        f"Coverage of the realism score, {experiments:,} experiments",
        [f"{demos} recordings" for demos in DEMOS], [row],
    )  # fmt: skip


def energy(experiments: int) -> None:
    rng, rows = np.random.default_rng(1), []
    for starts in (50, 100):
        for each in (2, 5):
            demo, seed = np.repeat(np.arange(starts), each), np.zeros(starts * each)
            wins = gap_wins = 0
            for _ in range(experiments):
                centre = rng.normal(size=starts)
                recorded = centre + rng.normal(size=starts)
                perfect = centre[demo] + rng.normal(size=len(demo))
                scores = [energy_cells(v, seed, demo, recorded) for v in (perfect, centre[demo])]
                wins += scores[0].mean < scores[1].mean
                means = perfect.reshape(starts, each).mean(axis=1)
                gap_wins += np.abs(means - recorded).mean() < np.abs(centre - recorded).mean()
            rows.append([str(starts), str(each), percent(wins, experiments)])
            rows[-1].append(percent(gap_wins, experiments))
    heading = ["starts", "rollouts a start", "energy score", "absolute difference"]
    show(
        f"The perfect simulator beats the collapsed one, {experiments:,} experiments", heading, rows
    )


def compared(
    recorded: Floats, simulated: Floats, demo: Ints, rng: np.random.Generator,
    unit: Ints | None = None,
) -> Differences:  # fmt: skip
    """Take the differences of measures that are tested at 5 % together."""
    starts, measures = recorded.shape
    sides = Sides(
        demo=demo,
        unit=np.arange(starts) if unit is None else unit,
        weight=np.ones((starts, measures)),
        binary=np.zeros(measures, dtype=bool),
        primary=np.ones(measures, dtype=bool),
    )
    return simultaneous_differences(recorded, simulated, sides, rng)


def differs(
    recorded: Floats, simulated: Floats, demo: Ints, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return which intervals of differences exclude zero."""
    found = compared(recorded, simulated, demo, rng)
    return np.asarray(np.abs(found.value) > found.margin)


def clustered(experiments: int) -> None:
    """Of recordings that were cut into pieces, of animals that differ.

    Coverage of the mean, of the difference of a simulator that does not know the animal, and how
    often any of ten intervals together misses.
    """
    rows = []
    for apart in (0.3, 0.5):
        for animals in (5, 10, 20, 50):
            rng = np.random.default_rng([9, animals, round(10 * apart)])
            pieces, each, measures = 5, 3, 10
            unit = np.repeat(np.arange(animals), pieces)
            demo = np.repeat(np.arange(len(unit)), each)
            mean = one = together = 0
            for _ in range(experiments):
                own = apart * rng.normal(size=(animals, measures))[unit]
                recorded = 1 + own + 0.2 * rng.normal(size=own.shape)
                anybody = apart * rng.normal(size=(len(demo), measures))
                simulated = 1 + anybody + 0.2 * rng.normal(size=anybody.shape)
                column = cells(recorded[:, 0], np.zeros(len(unit)), unit, animals)
                found = bootstrap_mean(column, rng)
                mean += found.low <= 1 <= found.high
                alone = compared(recorded[:, :1], simulated[:, :1], demo, rng, unit)
                one += bool(abs(alone.value[0]) <= alone.margin[0])
                every = compared(recorded, simulated, demo, rng, unit)
                together += bool((np.abs(every.value) > every.margin).any())
            found_rates = (f"{mean / experiments:.3f}", f"{one / experiments:.3f}")
            rows.append([f"{100 * apart:g} %", str(animals), *found_rates])
            rows[-1].append(percent(together, experiments))
    heading = ["animals differ by", "animals", "mean", "difference", "one of ten misses"]
    show(f"Five pieces an animal, {experiments:,} experiments", heading, rows)


def null(experiments: int) -> None:
    rows = []
    for kind in SPREAD:
        for starts in STARTS:
            rng, demo = (
                np.random.default_rng([2, starts, len(kind)]),
                np.repeat(np.arange(starts), 5),
            )
            alarms = 0
            for _ in range(experiments):
                centre = rng.normal(size=starts)
                recorded, perfect = centre + rng.normal(size=starts), centre[demo]
                perfect = perfect + rng.normal(size=len(demo))
                sides = [np.exp(0.7 * v) if kind == "lognormal" else v for v in (recorded, perfect)]
                alarms += bool(differs(sides[0][:, None], sides[1][:, None], demo, rng)[0])
            rows.append([kind, str(starts), percent(alarms, experiments)])
    heading = ["values", "starts", "difference of means"]
    show(f"Perfect simulators called different, {experiments:,} experiments", heading, rows)


def copies(experiments: int) -> None:
    """Simulators that do the same from a start however often, five rollouts of each start."""
    rows = []
    for counted in (False, True):
        for starts in STARTS:
            rng, demo = np.random.default_rng([5, starts]), np.repeat(np.arange(starts), 5)
            kept = slice(None, None, 1 if counted else 5)
            alarms = 0
            for _ in range(experiments):
                centre = rng.normal(size=starts)
                recorded, simulated = centre + rng.normal(size=(2, starts))
                drawn = demo[kept]
                found = differs(recorded[:, None], simulated[drawn][:, None], drawn, rng)
                alarms += bool(found[0])
            name = "five rollouts" if counted else "one"
            rows.append([name, str(starts), percent(alarms, experiments)])
    heading = ["copies count as", "starts", "difference of means"]
    show(f"Simulators without chance called different, {experiments:,} experiments", heading, rows)


def gate(experiments: int) -> None:
    rng, rows = np.random.default_rng(3), []
    for sizes in GATES:
        passed, decided = 0, False
        for _ in range(experiments):
            found = passed_gate([rng.normal(size=n) for n in sizes], rng, 499)
            decided = not found.decision.startswith("cannot")
            passed += found.decision == "passed"
        words = percent(passed, experiments) if decided else "cannot be decided"
        rows.append([" + ".join(map(str, sizes)), f"{found.least:.4f}", words])
    heading = ["seeds of the methods", "smallest p there is", "passed though nothing differs"]
    show(f"The gate, {experiments:,} experiments", heading, rows)


def classifier(experiments: int) -> None:
    rng, rows = np.random.default_rng(4), []
    for starts in (20, 50):
        inside = 0
        for _ in range(experiments):
            centre = rng.normal(size=(2 * starts, 8))
            sides = []
            for group in np.arange(2 * starts).reshape(2, starts):
                episode = np.repeat(rng.normal(0, 0.5, (starts, 8)), 6, axis=0)
                group = np.repeat(group, 6)
                values = centre[group] + episode + rng.normal(size=(len(group), 8))
                sides.append(Windows(values, group, np.array(["speed"] * 8)))
            auc = classify(*sides, rng).auc
            inside += auc.low <= 0.5 <= auc.high
        rows.append([str(starts), percent(inside, experiments)])
    heading = ["demonstrations in each half", "0.5 within the interval"]
    show(f"Two halves of one sample, {experiments:,} experiments", heading, rows)
    random_actions()


def random_actions() -> None:
    """The other end: recordings, or what stands for them, against random actions."""
    rows = []
    for name in SETS:
        demos, scenario = load_packaged(name).select(split="val"), make_scenario(name, split="val")
        rollouts = collect_rollouts(
            partial(make_world, scenario), RandomPolicy(0), method="random", seed=0, repetitions=1
        )
        sides = [
            window_features(each, demos.arena)
            for each in (Rollouts.from_demonstrations(demos), rollouts)
        ]
        told = classify(*sides, np.random.default_rng(0)).auc
        held = f"{told.estimate:.3f} [{told.low:.3f}, {told.high:.3f}]"
        rows.append([name, str(demos.num_episodes), held])
    show("Random actions", ["packaged demonstrations", "episodes", "AUC"], rows)


def speed(_: int) -> None:
    rng, tables, number = np.random.default_rng(5), [], EPISODES
    for name in ("recorded", *"ABCDEF"):
        recorded = name == "recorded"
        values = rng.lognormal(size=(number, 4))
        each = np.arange(number)
        row = {"method": name, "seed": -1 if recorded else each % 2, "repetition": each % 2}
        row |= {"demo": each if recorded else each // 2, "condition": 0, "cue": -1, "factual": True}
        row |= dict(zip(("path_length", "duration", "dtw", "dtw_per_step"), values.T))
        row["captured"] = rng.random(number) < 0.5
        row["reached"] = row["captured"].astype(float)
        tables.append(pd.DataFrame(row))
    metrics = pd.concat(tables, ignore_index=True)
    start, wall = time.process_time(), time.perf_counter()
    comparison_table(metrics, np.arange(number), rng)
    pair_table(metrics, np.arange(number), rng)
    used = f"{time.process_time() - start:.1f}", f"{time.perf_counter() - wall:.1f}"
    what = f"6 methods, 5 metrics, {number} episodes, 10,000 resamples, distances and pairs"
    show("Speed", ["comparison", "processor s", "wall s"], [[what, *used]])


def percent(part: int, of: int) -> str:
    return f"{100 * part / of:.1f} %"


def show(title: str, heading: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    print(f"\n{title}\n\n| {' | '.join(heading)} |\n|{'---|' * len(heading)}")
    for row in rows:
        print(f"| {' | '.join(row)} |", flush=True)


SECTIONS: dict[str, tuple[Callable[[int], None], int]] = {
    "intervals": (intervals, 4000),
    "others": (others, 1000),
    "shares": (shares, 1000),
    "realism": (realism, 2000),
    "energy": (energy, 1000),
    "clustered": (clustered, 400),
    "null": (null, 400),
    "copies": (copies, 400),
    "gate": (gate, 4000),
    "classifier": (classifier, 200),
    "speed": (speed, 1),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--experiments", type=int, help="instead of each table's own number")
    parser.add_argument("--only", nargs="+", choices=list(SECTIONS), default=list(SECTIONS))
    args = parser.parse_args()
    for name in args.only:
        section, number = SECTIONS[name]
        section(args.experiments or number)


if __name__ == "__main__":
    main()
