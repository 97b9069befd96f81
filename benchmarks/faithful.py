"""Do trained simulators move like the recordings? Every data set, several seeds, one table.

    python benchmarks/faithful.py --quick
    python benchmarks/faithful.py --seed 0 --seed 1 --seed 2 --out docs/results/faithful
    python benchmarks/faithful.py --only agents-share --algo bc --out out/bc
    python benchmarks/faithful.py --test --seed 0 --seed 1 --seed 2 --out docs/results/test
    python benchmarks/faithful.py --unseen mine.npz --out out/unseen

Every cell (data set and seed) is imported, fitted, trained with the default preset and rolled out
by the functions of the pipeline; then comes the verdict on the validation split. ``--test`` asks
about the test split, once, at the end. Finished cells are kept under ``--out`` and not made again,
each with its recordings and rollouts for whoever wants to ask something else of them; rows of other
sets and seeds that stand in the table of ``--out`` stay, with the commit of each.

Sets are reported in three groups: those that defaults were chosen on, those made after the defaults
they are run with, and, by ``--unseen``, demonstrations of your own that ``animarl import`` wrote.
An unseen file is asked about once: its test split, with a seed that follows from its content.

The recordings lie in $ANIMARL_DATA (by default ../shared/data); those that are not there are left
out and named. ``chase-1`` and ``chase-3`` are made here: other numbers of predators are trained by
the program that made the packaged agents, and the table of their tracks is imported as a
stranger's. Sets whose name ends in ``-cut`` are others whose episodes merely stop, each at a random
frame, as films do.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import torch
import typer
from numpy.typing import NDArray
from rich.console import Console

from animarl_algos.evaluation import RandomPolicy, Rollouts, Verdict, collect_rollouts, verdict
from animarl_algos.evaluation.classifier import AUC, SEQUENCE
from animarl_algos.evaluation.headline import compare_with_law
from animarl_algos.evaluation.metrics import ORDER
from animarl_algos.evaluation.statistics import UNDEFINED
from animarl_algos.evaluation.verdict_rows import DIFFERS, FINDINGS, UNKNOWN
from animarl_algos.report.verdict_section import verdict_table
from animarl_algos.report.words import Words
from animarl_algos.runs import pipeline
from animarl_algos.runs.run_files import versions
from animarl_algos.runs.run_settings import CHOSEN, RunSettings, pipeline_settings
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.demos.splits import cross_validated, run_folds
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename
from animarl_envs.fitting.tracking import track
from animarl_envs.importing.sets import load_set, named_set
from animarl_envs.species import CUSTOM, SPECIES
from animarl_envs.worlds import make_world

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("ANIMARL_DATA", ROOT.parent / "shared" / "data"))
TEST_TABLE = ROOT / "docs" / "results" / "test" / "faithful.csv"
ROLLOUTS, QUICK_ROLLOUTS = 250, 60
READ = " How often this split was read is said [beside the results](../README.md)."
FOLDS = 6  # of the cross-validation over recordings, where there are few
RUN_FOLDS = 3  # as ``animarl run`` deals them
NEAR = 0.05  # above recordings among themselves, where even the floor may lie
CROSSED = "-folds"  # ends the name of a packaged set that is cross-validated
STOPPED = "-cut"  # ends the name of a set whose episodes merely stop
SHORTEST = 0.25  # of an episode, that is left of it
ANIMARL = [sys.executable, "-c", "from animarl_algos.cli.main import main; main()"]


@dataclass(frozen=True)
class Bar:
    """What must hold of one row of the verdict, or of the floor or the time that it took.

    ``kind``: ``"alike"`` (alike, or differs a little), ``"auc"`` (at most the limit), ``"floor"``
    (an area at most so much above closed-loop tracking), ``"tracking"`` (the area of this tracking
    at most the limit, or near that of recordings among themselves), ``"difference"`` and
    ``"relative"`` (of the means, at most the limit), ``"seconds"`` (of processor time, at most the
    limit).
    """

    measure: str
    kind: Literal["alike", "auc", "floor", "tracking", "seconds", "difference", "relative"]
    limit: float = math.nan

    def row(self, found: Verdict, seconds: float) -> dict[str, Any] | None:
        """What it is about, by the verdict's columns; None of an ending that neither side knows."""
        empty = dict.fromkeys(found.table.columns, math.nan)
        if self.kind == "tracking":
            areas = found.areas[AUC]
            floor = {"recorded": areas["among"].estimate, "simulated": areas["floor"].estimate}
            return empty | floor | {"label": "Closed-loop tracking told apart, the floor (AUC)"}
        if self.kind == "seconds":
            return empty | {"label": "Time from file to verdict (s)", "simulated": seconds}
        if self.measure not in set(found.table["measure"]):
            return None
        return found.row(self.measure)

    def met(self, found: Verdict, row: Mapping[str, Any]) -> bool | None:
        """Whether it holds; None where that cannot be said."""
        floor = found.areas[AUC].get("floor", UNDEFINED).estimate
        if self.kind == "alike":
            return None if row["judgement"] == UNKNOWN else row["judgement"] != DIFFERS
        value, limit = {
            "auc": (row["simulated"], self.limit),
            "floor": (row["simulated"], floor + self.limit),
            "tracking": (row["simulated"], self.either(row)),
            "seconds": (row["simulated"], self.limit),
            "difference": (abs(row["value"]), self.limit),
            "relative": (abs(row["value"]), self.limit * abs(row["recorded"])),
        }[self.kind]
        return bool(value <= limit) if math.isfinite(value) and math.isfinite(limit) else None

    def either(self, row: Mapping[str, Any]) -> float:
        """The limit of an area, or near that of recordings where this is needed."""
        return self.limit if row["simulated"] <= self.limit else row["recorded"] + NEAR

    def words(self, found: Verdict) -> str:
        floor = found.areas[AUC].get("floor", UNDEFINED).estimate
        return {
            "alike": "alike, or differs a little",
            "auc": f"at most {self.limit:g}",
            "floor": f"at most {self.limit:g} above the floor, {floor:.3g}",
            "tracking": f"at most {self.limit:g}, or within {NEAR:g} of recordings",
            "difference": f"within {self.limit:g}",
            "relative": f"within {100 * self.limit:g} %",
            "seconds": f"at most {self.limit:g} s of processor time",
        }[self.kind]


DISTRIBUTIONS = (Bar("duration", "alike"), Bar("path_length", "alike"))
TIME = Bar("seconds", "seconds", 240.0)  # of 500 episodes
ENDINGS = tuple(Bar(key, "alike") for key in ("reached", "target_out", "pursuer_out"))
AGENTS = (*DISTRIBUTIONS, *ENDINGS, Bar("auc", "auc", 0.65), TIME)
STRANGERS = (*ENDINGS, Bar("auc", "auc", 0.65), Bar(SEQUENCE, "auc", 0.65))
FILMED = (Bar("slow_steps", "difference", 0.05), Bar(SEQUENCE, "auc", 0.65))
MOTHS = (
    Bar("reached", "difference", 0.10), *DISTRIBUTIONS, Bar("median_speed", "relative", 0.10),
    Bar("auc", "auc", 0.70), Bar("turning", "alike"), Bar(ORDER, "alike"), Bar(SEQUENCE, "alike"),
)  # fmt: skip
WALLED = (
    Bar("leaving", "difference", 0.0), Bar("mean_speed", "relative", 0.15),
    Bar("slow_steps", "difference", 0.08), Bar("auc", "floor", 0.10),
    Bar("floor", "tracking", 0.75),
)  # fmt: skip
PACKAGED = tuple(
    Bar(key, "alike")
    for key in ("reached", "target_out", "pursuer_out", "leaving", "duration", "path_length",
                "mean_speed", "median_speed", "slow_steps", "turning")
) + (Bar("auc", "auc", 0.65),)  # fmt: skip
ALIVE = (
    Bar("slow_steps", "difference", 0.05), Bar("rests", "relative", 0.15),
    Bar("bouts", "relative", 0.15), Bar("spread_of_mean_speed", "relative", 0.25),
    Bar("auc", "alike"), Bar(SEQUENCE, "alike"), Bar("floor", "tracking", 0.60),
)  # fmt: skip
TUNED, ONCE, UNSEEN = "defaults were chosen on", "made after the defaults", "unseen"


@dataclass(frozen=True)
class DataSet:
    """A set of demonstrations: how it is imported, how it is split, and what must hold.

    ``importing`` are the arguments of ``animarl import``, paths below the data folder; without them
    the set is the packaged one whose name its own begins with, or the ``published`` one.
    ``folds``: cross-validated over recordings, or over episodes where there are fewer than three
    recordings. ``group`` says what is known of it: ``TUNED``, ``ONCE`` or ``UNSEEN``; the name of
    an unseen set is its file.
    ``pursuers``: of chases that are made here. ``first``: so many recordings of each condition.
    """

    name: str
    bars: tuple[Bar, ...]
    importing: str | None = None
    folds: int = 1
    group: str = TUNED
    pursuers: int = 0
    published: str = ""
    first: int | None = None

    @property
    def label(self) -> str:
        """The name that tables and folders of cells have."""
        return Path(self.name).stem if self.group == UNSEEN else self.name

    def files(self) -> list[Path]:
        """The recordings, none where they are not there."""
        if self.published:
            one = named_set(self.published)
            return [file for name in one.sha256 if (file := DATA / one.folder / name).exists()]
        pattern = "" if self.importing is None else shlex.split(self.importing)[0]
        return sorted(DATA.glob(pattern)) if pattern else []

    @property
    def there(self) -> bool:
        """Whether it can be loaded here."""
        made = self.importing is None and not self.published
        return made or self.pursuers > 0 or bool(self.files())

    def load(self, folder: Path) -> Demonstrations:
        if self.group == UNSEEN:
            return Demonstrations.load(Path(self.name))
        if self.name.endswith(STOPPED):
            return stopped(load_packaged(self.name.removesuffix(STOPPED)))
        if self.published:
            one = named_set(self.published)
            demos = load_set(one.name) if one.imported.exists() else one.build(DATA)
            return demos if self.first is None else first_recordings(demos, self.first)
        if self.importing is None:
            return load_packaged(self.name.removesuffix(CROSSED))
        folder = folder.resolve()
        out = folder / f"{self.name}.npz"
        if not out.exists():
            files, options = self.files(), shlex.split(self.importing)[1:]
            if self.pursuers:
                files = [folder / f"{self.name}.csv"]
                program = [sys.executable, "-m", "tools.packaged_data.trained_chase", "table"]
                told = {"pursuers": self.pursuers, "out": files[0], "folder": folder / self.name}
                asked = [f"--{key}={value}" for key, value in told.items()]
                subprocess.run([*program, *asked], check=True, cwd=Path(__file__).parents[1])
            import_files(files, options, out)
        return Demonstrations.load(out)


def first_recordings(demos: Demonstrations, count: int) -> Demonstrations:
    """Return the episodes of the first recordings of each condition."""
    kept: list[str] = []
    for condition in (0, 1):
        names = demos.recording[demos.condition == condition].tolist()
        kept += list(dict.fromkeys(names))[:count]
    return demos.select(episodes=np.flatnonzero(np.isin(demos.recording, kept)))


def import_files(files: Sequence[Path], options: Sequence[str], out: Path) -> None:
    """Import recordings as ``animarl import`` does, with the readers of published ones."""
    readers = ["--readers", str(Path(__file__).with_name("paper_readers.py"))]
    command = ["import", *map(str, files), *readers, *options, "--out", str(out)]
    subprocess.run([*ANIMARL, *command], check=True, stdout=subprocess.DEVNULL)


def stopped(demos: Demonstrations) -> Demonstrations:
    """Return episodes that merely stop, each at a random frame of its course, as films do."""
    rng = np.random.default_rng(0)
    whole = demos.lengths
    lengths = np.ceil(whole * rng.uniform(SHORTEST, 1.0, len(whole))).astype(int).clip(2)
    kept = demos.steps() < np.repeat(lengths, whole)
    return replace(
        demos, positions=demos.positions[kept], lengths=lengths, signals={},
        outcome=np.full(len(whole), UNFINISHED, dtype=np.int8),
    )  # fmt: skip


SETS = (
    *(
        DataSet(
            name, (*PACKAGED, TIME) if name == "agent" else PACKAGED,
            group=ONCE if name in ("shoal", "solo") else TUNED,
        )
        for name in packaged_names()
    ),
    # Ten, twenty and twelve test episodes are few: here every episode is tested once.
    *(DataSet(name + CROSSED, PACKAGED, folds=FOLDS) for name in ("fly", "newt")),
    DataSet("silkmoth" + CROSSED, PACKAGED, folds=5),  # they have searched in five plumes
    DataSet("agents-indiv", AGENTS, "agents_collab_hunting/episodes_c2ae_indiv_slow2.4.npz"),
    DataSet("agents-share", AGENTS, "agents_collab_hunting/episodes_c2ae_share_slow2.4.npz"),
    # A stranger's agents, with defaults.
    *(
        DataSet(
            f"chase-{number}", STRANGERS, "- --fps 10 --arena square --arena-width 2 --synthetic",
            group=ONCE, pursuers=number,
        )
        for number in (1, 3)
    ),
    DataSet("agent" + STOPPED, FILMED, group=ONCE),
    DataSet("moths", MOTHS, folds=FOLDS, published="moths"),
    DataSet(
        "termites", (*WALLED, Bar("duration", "alike")), folds=FOLDS, published="termites",
    ),
    DataSet(
        "fly-groups", WALLED,
        "fly_groups12/tracks_24fps_int16.npz --individuals fly_1,fly_2,fly_3 --piece 60", FOLDS,
    ),
    # Smoothed as the paper's flies: the tracks jump by a pixel, as far as a fly walks in a frame.
    DataSet("courtship", WALLED, folds=FOLDS, published="courtship"),
    *(
        DataSet(name, ALIVE, folds=RUN_FOLDS, group=ONCE, published=name)
        for name in ("termites_alone", "fish15", "locusts", "bats_obstacles")
    ),
    DataSet("larvae", ALIVE, folds=RUN_FOLDS, group=ONCE, published="larvae", first=40),
)  # fmt: skip


def lockbox(files: list[Path]) -> list[DataSet]:
    """Unseen sets: demonstrations of the reader's own, which nothing was chosen on.

    Raises
    ------
    typer.BadParameter
        If two files have one name, or episodes to choose on or to test on are lacking.
    """
    if len({path.stem for path in files}) < len(files):
        raise typer.BadParameter("two unseen files have one name: rename one, tables name it")
    for path in files:
        try:
            dealt = Demonstrations.load(path).split
        except InputError as error:
            raise typer.BadParameter(str(error)) from None
        if lacking := [part for part in ("train", "val", "test") if not (dealt == part).any()]:
            raise typer.BadParameter(
                f"{path}: it has no episodes in split {lacking[0]!r}: choices see train and val, "
                "the report sees test alone; import more recordings, or use --split-by episode"
            )
    return [DataSet(str(path), PACKAGED, group=UNSEEN) for path in files]


def own_seed(demos: Demonstrations) -> int:
    """The seed of an unseen set: it follows from the content, so that nobody picks it."""
    return int.from_bytes(hashlib.sha256(demos.fingerprint().encode()).digest()[:2], "big")


@dataclass(frozen=True, eq=False)
class Followed:
    """Recorded episodes as closed-loop tracking follows them, ``(frames, K, 2)``."""

    positions: NDArray[np.float64]


def trained(
    demos: Demonstrations,
    folder: Path,
    algo: str,
    seed: int,
    split: str,
    repetitions: int,
    cloning: str = CHOSEN,
    overrides: Mapping[str, Any] | None = None,
) -> tuple[Rollouts, Rollouts, list[NDArray[np.float64]]]:
    """Fit, train, roll out from the starts of a split.

    The learner's rollouts, random ones, and each episode as closed-loop tracking follows it.
    """
    species = demos.species if demos.species in SPECIES else CUSTOM
    asked = RunSettings(
        file=demos.name, species=species, algo=algo, steps=1, seed=seed, baselines=False,
        cloning=cloning, overrides=dict(overrides or {}),
        **pipeline_settings(environment_id(species), "default"),
    )  # fmt: skip
    preset = asked.learner()
    asked = asked.changed(steps=preset.n_timesteps, copies=preset.n_envs)
    run = pipeline.open_run(asked, folder, shlex.join(sys.argv), demos)
    policy = pipeline.learn(run, algo, progress_bar=False)
    policy.policy.seed(seed)
    pipeline.fit(run)
    spec = run.species
    world = partial(make_world, run.starting_from(split))
    collect = partial(collect_rollouts, world, seed=seed, repetitions=repetitions)
    told = run.environment(demos).condition_flag
    name = pipeline.method_name(algo)
    asked_for = demos.select(split=split)
    followed = track(asked_for, spec.locomotion, spec.arena).positions
    return (
        collect(policy, method=name, cue="actual" if told else None),
        collect(RandomPolicy(seed, spec.num_actions), method="random"),
        np.split(followed, asked_for.offsets[1:-1]),
    )


@dataclass(frozen=True, eq=False)
class Judged:
    """A cell: its verdict, the evaluated recordings and the rollouts from their starts.

    ``seconds`` is the processor time from the imported file to the verdict, of all of it if it is
    ``whole``: not where a stopped run or another cell has left run folders.
    """

    verdict: Verdict
    recorded: Demonstrations
    rollouts: Rollouts
    seconds: float
    whole: bool

    def save(self, folder: Path) -> None:
        """Everything, and last what says that the cell is finished."""
        self.verdict.save(folder)
        self.recorded.save(folder / "recorded.npz")
        self.rollouts.save(folder / "rollouts.npz")
        done = {"seconds": self.seconds, "whole": self.whole, "commit": commit()}
        with write_then_rename(folder / "cell.json") as part:
            part.write_text(json.dumps(done))


def judged(
    one: DataSet,
    out: Path,
    algo: str,
    seed: int,
    split: str,
    rollouts: int,
    cloning: str = CHOSEN,
    overrides: Mapping[str, Any] | None = None,
) -> Judged:
    """Train a cell, roll it out and judge it."""
    began = time.process_time()
    demos = one.load(out / "imported")
    parts, used, followed, whole = [], [], {}, True
    dealt = run_folds if one.folds == RUN_FOLDS else cross_validated
    folds = list(dealt(demos, one.folds)) if one.folds > 1 else [demos]
    starts = sum(int((fold.split == split).sum()) for fold in folds)
    repetitions = max(2, math.ceil(rollouts / starts))  # of each start, in whichever fold
    for number, fold in enumerate(folds):
        clone = algo if cloning == CHOSEN else f"{algo}-{cloning}"
        clone += re.sub(r"\W+", "-", str(overrides)).rstrip("-") if overrides else ""
        folder = out / "runs" / f"{one.label}-{clone}-{seed}-{number}"
        whole &= not folder.exists()
        index = np.flatnonzero(fold.split == split)
        *both, paths = trained(fold, folder, algo, seed, split, repetitions, cloning, overrides)
        parts.append([replace(r, demo=index[r.demo]) for r in both])
        followed |= dict(zip(index.tolist(), paths, strict=True))
        used.append(index)
    kept = np.sort(np.concatenate(used))
    joined = [Rollouts.concatenate(list(side)) for side in zip(*parts)]
    ours, random = (replace(r, demo=np.searchsorted(kept, r.demo)) for r in joined)
    others = np.setdiff1d(np.flatnonzero(demos.split != "test"), kept)
    recorded = demos.select(episodes=kept)
    found = verdict(
        recorded,
        ours,
        seed=seed,
        floor=Followed(np.concatenate([followed[episode] for episode in kept.tolist()])),
        baselines={"random": random},
        references=demos.select(episodes=others) if len(others) and one.folds == 1 else None,
    )
    return Judged(found, recorded, ours, time.process_time() - began, whole)


def bar_rows(one: DataSet, found: Verdict, seconds: float = math.nan) -> list[dict[str, Any]]:
    """Every bar of a data set beside what was found; the seconds of the whole, where known."""
    rows = []
    for bar in one.bars:
        if (row := bar.row(found, seconds)) is not None:
            met = {True: "yes", False: "no", None: "cannot be said"}[bar.met(found, row)]
            keys = ("label", *FINDINGS)
            rows.append({k: row[k] for k in keys} | {"bar": bar.words(found), "met?": met})
    return rows


def cell_row(found: Verdict) -> dict[str, Any]:
    """What the verdict of a cell says: how many questions have which word, and what differs."""
    classifier = {"auc": found.auc.estimate, "auc_low": found.auc.low, "auc_high": found.auc.high}
    differing = {"recordings": found.recordings, "complaints": "; ".join(found.complaints)}
    return differing | found.counts | classifier | {"law": compare_with_law(found.rows())}


def main(
    only: Annotated[list[str] | None, typer.Option(help="These data sets; repeatable.")] = None,
    algo: Annotated[str, typer.Option(help="The learner.")] = "soft-bc",
    seed: Annotated[list[int] | None, typer.Option(help="Of all; repeatable.")] = None,
    test: Annotated[bool, typer.Option(help="Ask about the test split.")] = False,
    quick: Annotated[bool, typer.Option(help="Packaged sets, one seed, few rollouts.")] = False,
    unseen: Annotated[
        list[Path] | None, typer.Option(help="Imported demonstrations, asked once; repeatable.")
    ] = None,
    cloning: Annotated[str, typer.Option(help="Recipe of the clones, of all sets.")] = CHOSEN,
    rollouts: Annotated[int | None, typer.Option(help="Per cell, at least two a start.")] = None,
    import_only: Annotated[bool, typer.Option(help="No more than OUT/imported/SET.npz.")] = False,
    out: Annotated[Path, typer.Option(help="Where cells and tables go.")] = Path("out/faithful"),
) -> None:
    """Import, fit, train, roll out, and ask for the verdict."""
    torch.set_num_threads(1)
    console = Console(width=128)
    known = [one.name for one in SETS]
    if unknown := sorted(set(only or []) - set(known)):
        raise typer.BadParameter(f"{unknown[0]!r} is unknown: choose among {', '.join(known)}")
    if unseen and (test or seed or only or quick):
        raise typer.BadParameter("--unseen stands alone: it asks the test split with its own seed")
    sets, seeds = (lockbox(unseen) if unseen else SETS), [0]
    split = "test" if test or unseen else "val"
    number = rollouts or (QUICK_ROLLOUTS if quick else ROLLOUTS)
    (out / "imported").mkdir(parents=True, exist_ok=True)
    chosen = []
    for one in sets:
        quickly = one.importing is None and one.folds == 1 and not one.name.endswith(STOPPED)
        if (only and one.name not in only) or (quick and not quickly):
            continue
        if not one.there:
            console.print(f"{one.name}: its recordings are not in {DATA}: left out")
            continue
        if import_only:
            one.load(out / "imported")
            continue
        if unseen:
            seeds = [own_seed(one.load(out))]
        chosen += [(one, s) for s in (seed or seeds)[: 1 if quick else None]]
    clone = algo if cloning == CHOSEN else f"{algo}-{cloning}"
    cells = {
        (one, s): out / "cells" / f"{one.label}-{clone}-{s}-{split}-{number}" for one, s in chosen
    }
    missing = [key for key, cell in cells.items() if not (cell / "cell.json").exists()]
    if missing:
        console.print(f"{len(missing)} of {len(cells)} cells to make, {estimated_time(missing)}")
    lines: list[dict[str, Any]] = []
    verdicts: list[dict[str, Any]] = []
    for (one, s), cell in cells.items():
        if (one, s) in missing:
            judged(one, out, algo, s, split, number, cloning).save(cell)
        found = Verdict.load(cell)
        done = json.loads((cell / "cell.json").read_text())
        console.print(f"\n[bold]{one.name}[/bold], seed {s}, {done['seconds']:.0f} s")
        console.print(verdict_table(found, Words.of(one.load(out / "imported"))))
        whole = done.pop("whole", False)  # older cells do not say
        head = {
            "set": one.label,
            "group": one.group,
            "seed": s,
            "headline": found.headline,
            "page": found.colour,
            **done,
        }
        took = done["seconds"] if whole else math.nan
        lines += [head | row for row in bar_rows(one, found, took)]
        verdicts.append(head | cell_row(found))
    if lines:
        table = with_others(pd.DataFrame(lines), out / "faithful.csv")
        write(table, out, split)
        with write_then_rename(out / "verdicts.csv") as part:
            with_others(pd.DataFrame(verdicts), out / "verdicts.csv").to_csv(part, index=False)
        console.print(markdown(table), soft_wrap=True, highlight=False, markup=False)


def estimated_time(cells: Sequence[tuple[DataSet, int]]) -> str:
    """Return how long cells take by the times of the last table of the test split, in words."""
    earlier = pd.read_csv(TEST_TABLE).drop_duplicates(["set", "seed"])
    seconds = earlier.groupby("set")["seconds"].mean()
    known = [float(seconds[one.label]) for one, _ in cells if one.label in seconds]
    if not known:
        return "of unknown duration"
    hours = sum(known) / len(known) * len(cells) / 3600
    return f"about {hours:.1f} h of processor time; what is finished is kept, run it again to go on"


def with_others(table: pd.DataFrame, file: Path) -> pd.DataFrame:
    """Beside the rows of an earlier table of other sets and seeds, in the order of the sets."""
    if file.exists():
        # A commit may look like a number, and numbers are to stay the same to the last digit.
        earlier = pd.read_csv(file, dtype={"commit": str}, float_precision="round_trip")
        cell = ["set", "seed"]
        anew = pd.MultiIndex.from_frame(table[cell])
        kept = earlier[~pd.MultiIndex.from_frame(earlier[cell]).isin(anew)]
        table = pd.concat([kept, table], ignore_index=True)
    order = {one.name: number for number, one in enumerate(SETS)}
    place = pd.DataFrame({"set": table["set"].map(order), "seed": table["seed"]})
    rows = place.sort_values(["set", "seed"], kind="stable").index
    return table.loc[rows].reset_index(drop=True)


def write(table: pd.DataFrame, out: Path, split: str) -> None:
    """Write the table as CSV and, with the command that made it and all versions, as Markdown."""
    command = shlex.join(["python", *sys.argv])
    with write_then_rename(out / "faithful.csv") as part:
        table.to_csv(part, index=False)
    found = ", ".join(f"{name} {number}" for name, number in versions().items())
    head = f"# Simulated against recorded, {split} split\n\n    {command}\n\n"
    made = "; ".join(
        f"{of} ({', '.join(dict.fromkeys(rows['set']))})"
        for of, rows in table.groupby("commit", sort=False)
    )
    read = READ if split == "test" else ""
    with write_then_rename(out / "faithful.md") as part:
        part.write_text(
            f"{head}Commit {commit()}; {found}. Rows are of the commits {made}.{read}\n\n"
            f"{markdown(table)}\n"
        )


def markdown(table: pd.DataFrame) -> str:
    """One table a group of sets, one line per bar."""
    findings = [name for name in FINDINGS if name not in ("judgement", "colour")]
    columns = ("set", "seed", "page", "label", *findings, "bar", "met?")

    def text(value: Any) -> str:
        if isinstance(value, float):
            return f"{value:.3g}" if math.isfinite(value) else ""
        return str(value)

    lines = []
    for group in (TUNED, ONCE, UNSEEN):
        rows = table[table["group"] == group].to_dict("records")
        if rows:
            lines += ["", f"## Sets: {group}", "", "| " + " | ".join(columns) + " |"]
            lines += ["|" + "---|" * len(columns)]
        lines += [
            "| " + " | ".join(text(row.get(c, math.nan)) for c in columns) + " |" for row in rows
        ]
    return "\n".join(lines[1:])


def commit() -> str:
    """Of the working tree, with a plus where its programs were changed."""

    def asked(*words: str) -> str:
        done = subprocess.run(
            ["git", *words], cwd=ROOT, capture_output=True, text=True, check=False
        )
        return done.stdout.strip()

    changed = asked("status", "--porcelain", "animarl_envs", "animarl_algos", "benchmarks")
    return (asked("describe", "--always", "--abbrev=9") or "unknown") + "+" * bool(changed)


if __name__ == "__main__":
    typer.run(main)
