"""What clones of animals that nobody pursues keep: the law that made them, and their distances.

    python -m benchmarks.free_animals laws --seed 0 --seed 1 --seed 2
    python -m benchmarks.free_animals group fish.npz --seed 0 --seed 1 --seed 2
    python -m benchmarks.free_animals alone runs/larvae

``laws``: clones of the packaged synthetic larva and shoal are rolled out from test starts; the rate
at which the larva's runs end and the radii of the shoal's zones are estimated from what they do, as
from the packaged tracks. The turn rate is counted. The radii are estimated twice. By single turns:
those that explain the turns best. By statistics: distances, and how courses of pairs agree by their
distance, of which radii are a regression that is learned on simulations of the law with other radii
(indirect inference, Gourieroux, Monfort & Renault 1993); its error on the law itself stands beside.

``group``: your own group without a target, from an import. A clone is rolled out longer than the
recordings, so that little is left of the order of its start. Beside it stand the recordings, the
clone that is shown the neighbours of another animal (blind), recorded animals of different moments
put together (strangers), and places drawn at random in the arena.

``alone``: runs of animals that were recorded alone: how much animals differ from each other, how
long speed lasts, by which a rhythm shows, such as that of strides, and how well order in time tells
simulated animals from recorded ones.

Runs are made by ``animarl run`` under ``--out`` and not made again.
"""

from __future__ import annotations

import subprocess
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from animarl_algos import load_run
from animarl_algos.evaluation.classifier import classify, sequence_windows, window_steps
from animarl_algos.evaluation.collect import Blindfolded
from animarl_algos.evaluation.prepared import resting_step, smoothed
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.runs.run import Run
from animarl_envs.arena import Arena
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.summary import unit_of
from animarl_envs.focus import nearest_other
from animarl_envs.species.traits import episode_traits
from animarl_envs.worlds import observation_components
from benchmarks.faithful import ANIMARL
from tools.packaged_data import larva, shoal
from tools.packaged_data.free_animals import BODY_LENGTHS, INSIDE, MM, NOISE

Floats = NDArray[np.float64]
app = typer.Typer(help=__doc__.split("\n\n", maxsplit=1)[0], no_args_is_help=True)

SIMULATED, GROUPS, BEFORE, FRAMES = 200, 24, 100, 200  # laws that the regression is learned on
SPREAD = 1.35  # factor by which their radii differ from the law's at most
RIDGE = 1.0  # of standardised statistics
COURSE = 5  # frames over which a course is taken: noise of single steps does not show
APART = (0.0, 0.7, 1.0, 1.4, 1.8, 2.2, 2.6, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 9.0)  # [body length]
LONELY = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.5, 20.0)  # from the nearest other [body length]
SMOOTH, LAGS = 3, (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0)  # frames; lags of a speed [s]
Seeds = Annotated[list[int] | None, typer.Option("--seed", help="Of the runs; repeatable.")]
Out = Annotated[Path, typer.Option(help="Where runs go.")]


def run_of(arguments: list[str], folder: Path) -> Run:
    """The run of ``animarl run``, made if it is not there."""
    if not (folder / "report.html").exists():
        subprocess.run([*ANIMARL, "run", *arguments, "--out", str(folder)], check=True)
    return load_run(folder)


# -- laws ------------------------------------------------------------------------------------------


def statistics(paths: Floats) -> Floats:
    """Numbers of a shoal ``(groups, frames, animals, 2)`` [body length] that its radii change."""
    moved = paths[:, COURSE:] - paths[:, :-COURSE]
    course = moved / np.maximum(np.linalg.norm(moved, axis=-1, keepdims=True), 1e-9)
    place = paths[:, COURSE // 2 : COURSE // 2 + course.shape[1]]
    apart = place[..., None, :, :] - place[..., :, None, :]
    distance = np.linalg.norm(apart, axis=-1)
    own = np.arange(paths.shape[2])
    distance[..., own, own] = np.inf
    nearest = distance.min(axis=-1)
    extent = np.linalg.norm(place - place.mean(axis=2, keepdims=True), axis=-1)
    found = [
        nearest.mean(), *np.quantile(nearest, [0.05, 0.25, 0.5, 0.75]), extent.mean(),
        np.linalg.norm(course.mean(axis=2), axis=-1).mean(),
    ]  # fmt: skip
    agree = np.einsum("gtix,gtjx->gtij", course, course)
    towards = np.einsum("gtix,gtijx->gtij", course, apart / distance[..., None])
    which = distance.argmin(axis=-1)[..., None]
    follows = np.take_along_axis(towards, which, axis=-1)[..., 0]
    for k in range(len(LONELY) - 1):  # what animals do that are alone
        here = (nearest >= LONELY[k]) & (nearest < LONELY[k + 1])
        found += [follows[here].sum() / max(int(here.sum()), 1), here.mean() ** 0.5]
    bins = np.digitize(distance, APART) - 1
    for k in range(len(APART) - 1):
        here = bins == k
        count = max(int(here.sum()), 1)
        found += [agree[here].sum() / count, towards[here].sum() / count, here.mean() ** 0.5]
    return np.array(found)


class RadiiByStatistics:
    """Ridge regression of log radii on statistics of simulated shoals."""

    def __init__(self, law: shoal.ZonalLaw, animals: int, rng: np.random.Generator) -> None:
        true = np.array([getattr(law, name) for name in shoal.RADII])
        factors = SPREAD ** rng.uniform(-1.0, 1.0, (SIMULATED, 3))
        radii = true * factors
        found = [self.simulated(law, one, animals, rng) for one in radii]
        rows, self.wanted = np.array(found), np.log(radii)
        self.centre, self.scale = rows.mean(axis=0), rows.std(axis=0) + 1e-9
        self.rows = self._design(rows)
        self.weights = self._fit(np.ones(SIMULATED, dtype=bool))

    @staticmethod
    def simulated(
        law: shoal.ZonalLaw, radii: Floats, animals: int, rng: np.random.Generator
    ) -> Floats:
        """Statistics of the law with these radii, tracked as noisily as the packaged shoal."""
        tried = replace(law, **dict(zip(shoal.RADII, radii.tolist(), strict=True)))
        paths = shoal.simulate(tried, GROUPS, animals, BEFORE + FRAMES, rng)[:, BEFORE:]
        return statistics(paths + NOISE["shoal"] * rng.normal(size=paths.shape))

    def _design(self, rows: Floats) -> Floats:
        scaled = np.clip((np.atleast_2d(rows) - self.centre) / self.scale, -4.0, 4.0)
        return np.concatenate([np.ones((len(scaled), 1)), scaled, scaled**2], axis=1)

    def _fit(self, chosen: NDArray[np.bool_]) -> Floats:
        rows, wanted = self.rows[chosen], self.wanted[chosen]
        penalty = RIDGE * np.eye(rows.shape[1])
        penalty[0, 0] = 0.0
        return np.asarray(np.linalg.solve(rows.T @ rows + penalty, rows.T @ wanted))

    def errors(self, folds: int = 5) -> Floats:
        """Median relative error of each radius where a law was not learned on."""
        fold = np.arange(SIMULATED) % folds
        missed = np.concatenate([
            self.rows[fold == k] @ self._fit(fold != k) - self.wanted[fold == k]
            for k in range(folds)
        ])  # fmt: skip
        return np.asarray(np.median(np.abs(np.expm1(missed)), axis=0))

    def __call__(self, paths: Floats) -> list[float]:
        return np.exp(self._design(statistics(paths)) @ self.weights)[0].tolist()


def paths_of(rollouts: Rollouts) -> Floats:
    """Positions ``(rollouts, frames, animals, 2)`` of the length that all have [body length]."""
    least = int(rollouts.lengths.min())
    paths = [rollouts.path(i)[:least] for i in range(len(rollouts))]
    return np.stack(paths) * BODY_LENGTHS / INSIDE


@app.command()
def laws(seed: Seeds = None, out: Out = Path("out/free_animals")) -> None:
    """Print the law of larva and shoal, as recovered from the packaged tracks and from clones."""
    console, seeds = Console(width=110), seed or [0]
    larvae, fish = (load_packaged(name).select(split="test") for name in ("solo", "shoal"))
    law, turning = shoal.ZonalLaw(dt=fish.dt), larva.RunAndTurnLaw()
    by_statistics = RadiiByStatistics(law, fish.num_individuals, np.random.default_rng(0))
    rows: list[tuple[str, list[float]]] = []

    def add(what: str, tracks: list[Floats], paths: Floats) -> None:
        rate = larva.recovered_turn_rate(turning, tracks, larvae.dt)
        turns = shoal.recovered_radii(law, paths, np.random.default_rng(0))
        rows.append((what, [rate, *turns.values(), *by_statistics(paths)]))

    true = [getattr(law, name) for name in shoal.RADII]
    rows.append(("the law", [turning.turn_rate, *true, *true]))
    add("packaged tracks (test)", _tracks(larvae), paths_of(Rollouts.from_demonstrations(fish)))
    for number in seeds:
        simulated = [
            run_of(["packaged", "--species", name, "--seed", str(number)], out / f"{name}-{number}")
            .simulate(repetitions=2)
            for name in ("solo", "shoal")
        ]  # fmt: skip
        add(f"clone, seed {number}", _tracks(simulated[0]), paths_of(simulated[1]))
    table = Table(title="Laws of synthetic animals that are recovered (radii in body lengths)")
    table.add_column("from")
    for heading in ("turn rate [1/s]", *(f"{n}, turns" for n in shoal.RADII),
                    *(f"{n}, statistics" for n in shoal.RADII)):  # fmt: skip
        table.add_column(heading, justify="right")
    for what, values in rows:
        table.add_row(what, *(f"{value:.3g}" for value in values))
    console.print(table)
    console.print(
        "Median error of radii by statistics on laws that were not learned on: "
        + ", ".join(f"{n} {e:.1%}" for n, e in zip(shoal.RADII, by_statistics.errors()))
    )


def _tracks(episodes: Any) -> list[Floats]:
    """Tracks ``(frames, 2)`` of single animals [mm]."""
    return [episodes.path(i)[:, 0] * MM for i in range(len(episodes))]


# -- groups ----------------------------------------------------------------------------------------


def measured(paths: list[Floats], dt: float, unit: float) -> list[float]:
    """Nearest neighbour, its 5 % quantile, speed and polarisation of groups, means over all."""
    nearest = np.concatenate([np.linalg.norm(nearest_other(p), axis=-1).ravel() for p in paths])
    step = [np.diff(p, axis=0) for p in paths]
    size = [np.linalg.norm(one, axis=-1) for one in step]
    course = [one / np.maximum(s, 1e-12)[..., None] for one, s in zip(step, size, strict=True)]
    together = np.concatenate([np.linalg.norm(one.mean(axis=1), axis=-1) for one in course])
    speed = np.concatenate([one.ravel() for one in size]).mean() / dt
    return [
        unit * nearest.mean(), unit * float(np.quantile(nearest, 0.05)), unit * speed,
        together.mean(),
    ]  # fmt: skip


def random_places(arena: Arena, shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Places drawn at random within a disc or square arena."""
    if arena.shape != "disc":
        return np.asarray(rng.uniform(-arena.size, arena.size, (*shape, 2)))
    radius, angle = arena.size * np.sqrt(rng.random(shape)), rng.uniform(0.0, 2 * np.pi, shape)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


@app.command()
def group(
    file: Annotated[Path, typer.Argument(help="Of animarl import, without a target.")],
    seed: Seeds = None,
    seconds: Annotated[float, typer.Option(help="Of each rollout; its later half counts.")] = 20.0,
    out: Out = Path("out/free_animals"),
) -> None:
    """Print distances of a recorded group, of its clone, and of what does not react."""
    rows: list[tuple[str, list[float]]] = []
    for number in seed or [0]:
        run = run_of([str(file), "--seed", str(number)], out / f"{file.stem}-{number}")
        demos, rng = run.demos, np.random.default_rng(0)
        unit = unit_of(demos)
        scale, where = unit.per_arena_unit, demos.positions
        if not rows:
            moments = [where[rng.permutation(len(where)), k] for k in range(where.shape[1])]
            still = np.stack(moments, axis=1)
            drawn = random_places(demos.arena, where.shape[:2], rng)
            rows.append(("recorded", measured(
                [demos.path(i) for i in range(len(demos))], demos.dt, scale)))  # fmt: skip
            for what, places in (("strangers", still), ("random places", drawn)):
                rows.append((what, [*measured([places], 1.0, scale)[:2], np.nan, np.nan]))
        names = [one.name for one in observation_components(run.species)]
        steps = round(seconds / demos.dt)
        for what, wrap in (("clone", None), ("blind", partial(Blindfolded, names=names))):
            paths = []
            for split in ("val", "test"):
                told: dict[str, Any] = {} if wrap is None else {"wrap": wrap}
                made = run.simulate(split=split, repetitions=5, time_limit=steps, **told)
                paths += [made.path(i)[steps // 2 :] for i in range(len(made))]
            rows.append((f"{what}, seed {number}", measured(paths, demos.dt, scale)))
    table = Table(
        title=f"{file.stem}: {demos.num_individuals} animals, later half of {seconds:g} s"
    )
    table.add_column("")
    for heading in (f"nearest neighbour [{unit.name}]", f"its 5 % quantile [{unit.name}]",
                    f"speed [{unit.name}/s]", "polarisation"):  # fmt: skip
        table.add_column(heading, justify="right")
    for what, values in rows:
        table.add_row(what, *(f"{value:.3g}" if np.isfinite(value) else "-" for value in values))
    Console(width=110).print(table)
    recorded, strangers = rows[0][1][0], rows[1][1][0]
    for what, values in rows[3:]:
        share = (strangers - values[0]) / (strangers - recorded)
        print(f"{what}: {share:.2f} of the way from strangers to recorded")


# -- one animal ------------------------------------------------------------------------------------


def lasting(paths: list[Floats], lags: list[int]) -> Floats:
    """Autocorrelation of the speed of single animals ``(frames, 2)``, means over all of them.

    Positions went through a moving average, as for the verdict.
    """
    kernel, found = np.ones(SMOOTH) / SMOOTH, []
    for path in paths:
        if len(path) <= lags[-1] + SMOOTH:
            continue
        smooth = np.stack([np.convolve(axis, kernel, "valid") for axis in path.T], axis=1)
        speed = np.linalg.norm(np.diff(smooth, axis=0), axis=1)
        speed = speed / speed.mean() - 1.0
        found.append([np.mean(speed**2), *(np.mean(speed[k:] * speed[:-k]) for k in lags)])
    variance, *shared = np.mean(found, axis=0)
    return np.array(shared) / variance


def order_told(recorded: Rollouts, simulated: Rollouts, arena: Arena) -> float:
    """Area under the ROC curve of a classifier of order in time, as in a verdict, dealt once."""
    smooth = [
        replace(side, positions=smoothed(side.positions, side.lengths, SMOOTH))
        for side in (recorded, simulated)
    ]
    rest, steps, each = resting_step(smooth[0]), window_steps(recorded), np.arange(len(recorded))
    first, second = (sequence_windows(side, arena, rest, steps, each) for side in smooth)
    return classify(first, second, np.random.default_rng(0), deals=1).auc.estimate


def as_long_as(recorded: Rollouts, made: Rollouts) -> Rollouts:
    """Rollouts cut to the length of the recording that each started from."""
    lengths = np.minimum(made.lengths, recorded.lengths[made.demo])
    paths = [made.path(i)[:length] for i, length in enumerate(lengths.tolist())]
    return replace(made, positions=np.concatenate(paths), lengths=lengths)


@app.command()
def alone(
    runs: Annotated[list[Path], typer.Argument(help="Folders of animarl run.")],
    split: Annotated[str, typer.Option(help="Of the recordings: test, or val.")] = "test",
) -> None:
    """Print how animals that were recorded alone differ, and how long they keep their speed."""
    table = Table(title=f"{split}: sd between animals, autocorrelation of speed by lag, AUC")
    for heading in ("", "mean speed", "turning [rad/s]", *(f"{lag:g} s" for lag in LAGS),
                    "order in time (AUC)"):  # fmt: skip
        table.add_column(heading, justify="right")
    for folder in runs:
        run = load_run(folder)
        demos = run.demos.select(split=split)
        true, unit = Rollouts.from_demonstrations(demos), unit_of(demos)
        made = as_long_as(true, run.simulate(split=split, repetitions=1))
        for what, side in (("recorded", true), (str(folder), made)):
            paths = [side.path(i)[:, 0] for i in range(len(side))]
            spread = episode_traits(side.positions, side.lengths, demos.dt)[:, 0].std(axis=0)
            kept = lasting(paths, [round(t / demos.dt) for t in LAGS])
            table.add_row(
                what, f"{spread[0] * unit.per_arena_unit:.3g} {unit.name}/s", f"{spread[1]:.3g}",
                *(f"{value:.3f}" for value in kept),
                "" if side is true else f"{order_told(true, made, demos.arena):.2f}",
            )  # fmt: skip
    Console(width=140).print(table)


if __name__ == "__main__":
    app()
