"""A made-up run, as a report takes it, and the page made of it."""

from functools import cache
from typing import Any

import numpy as np
from moving_pairs import rollouts_along
from recordings import episodes_along

from animarl_algos import load_run
from animarl_algos.evaluation import Rollouts, evaluate
from animarl_algos.report import ReportInputs
from animarl_algos.report.run_page import run_page
from animarl_algos.whatif.answer import ask
from animarl_algos.whatif.answer_page import answer_page
from animarl_algos.whatif.truth import find_truth
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.species import AGENT

HOSTILE = '<script>alert("x")</script> & $\\frac{a}$'
MADE: dict[str, Any] = {
    "environment": {"time_limit": 20, "arena": None}, "wall_time": {"training DQDIL": 150.0},
    "machine": {"commit": "0123456789abcdef", "processor": "Some processor"},
}  # fmt: skip


def walk(rng: np.random.Generator, frames: int) -> np.ndarray:
    return np.clip(np.cumsum(rng.normal(0, 0.02, (frames, 3, 2)), axis=0), -0.9, 0.9)


def make_demos(
    individuals: tuple[str, ...] = ("predator_0", "predator_1", "prey"),
) -> Demonstrations:
    rng = np.random.default_rng(0)
    lengths = rng.integers(8, 20, 12)
    return episodes_along(
        [walk(rng, n) for n in lengths], individuals=individuals, condition=np.repeat([0, 1], 6),
        outcome=np.tile([1, 0, 2], 4),
        provenance={"source": HOSTILE, "licence": "MIT", "synthetic": True, "made": {"seed": 1}},
    )  # fmt: skip


def make_rollouts(demos: Demonstrations, method: str, flipped: bool = False) -> Rollouts:
    rng = np.random.default_rng(len(method))
    demo = np.tile(np.arange(12), 4)
    lengths = rng.integers(8, 25, len(demo))
    condition = demos.condition[demo]
    cue = np.full(len(demo), -1)
    if flipped:
        cue = np.where(np.arange(len(demo)) < 24, condition, 1 - condition)
    return rollouts_along(
        [walk(rng, n) for n in lengths], demos, demo, method=method, cue=cue,
        outcome=rng.integers(0, 2, len(demo)), seed=np.tile(np.repeat([0, 1], 12), 2),
        repetition=np.repeat([0, 1], 24),
    )  # fmt: skip


@cache
def report_inputs() -> ReportInputs:
    """Five methods, one of them asked about the other condition, with all that a report shows."""
    demos = make_demos()
    rollouts = {
        method: make_rollouts(demos, method, flipped=method == "dqcil")
        for method in ("random", "bc", "dqaas", "dqcil", "dqdil")
    }
    return ReportInputs(
        title="A run", learner="dqdil", demos=demos, rollouts=rollouts,
        evaluation=evaluate(rollouts, demos, seed=0, learner="dqdil", resamples=100), species=AGENT,
        settings={"algo": "dqdil", "online": {"alpha": 1.0, "prioritised": True}}, seeds=(0, 1),
        versions={"torch": "2.13.0"}, command="animarl run demos.npz --algo dqdil",
        created="2026-11-21", episodes={"train": 80, "val": 10, "test": 12}, **MADE,
    )  # fmt: skip


def bare_inputs(demos: Demonstrations, rollouts: dict[str, Rollouts], **more: Any) -> ReportInputs:
    """A run of which nothing else is known; the first method is the learner."""
    learner = next(iter(rollouts))
    evaluation = evaluate(rollouts, demos, seed=0, learner=learner, resamples=50)
    return ReportInputs(
        **{"title": "x", "learner": learner, **more},
        demos=demos, rollouts=rollouts, evaluation=evaluation,
    )  # fmt: skip


def rendered(inputs: ReportInputs) -> str:
    """The page of such inputs."""
    return run_page(inputs).html()


@cache
def report_page() -> str:
    """That run's page."""
    return rendered(report_inputs())


@cache
def group_page() -> str:
    """The page of a group, whose verdict has all columns that there are."""
    rng, start = np.random.default_rng(0), np.tile(np.arange(12), 2)
    paths = [walk(rng, 60) for _ in start]
    demos = episodes_along(paths[:12], roles=("pursuer",) * 3)
    methods = ("dqdil", "random", "blind")
    rollouts = {one: rollouts_along(paths, demos, start, method=one) for one in methods}
    return rendered(bare_inputs(demos, rollouts))


@cache
def whatif_page() -> str:
    """The page of an answer: packaged agents told the other condition, beside their teams."""
    run = load_run("agent")
    truth = find_truth("teams", run, 1)
    found = ask([run], ["condition=shared"], repetitions=1, truth=truth)
    return answer_page(found, "animarl whatif agent --change condition=shared --truth teams").html()
