"""The report: one file that loads nothing, all sections, hostile names harmless, honest claims."""

from __future__ import annotations

import base64
import dataclasses
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from animarl_algos.evaluation import (
    Evaluation,
    ReportInputs,
    Rollouts,
    evaluate,
    evaluation_table,
    measure,
    panels,
    write_report,
)
from animarl_algos.evaluation.decisions import Decisions, decide_along
from animarl_algos.evaluation.figures import shared_bins, trajectory_pair
from animarl_algos.evaluation.interpretation import advantage, value_map, values_along_path
from animarl_algos.evaluation.learning import chosen_curves
from animarl_algos.evaluation.report import render_report
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.style import to_image
from animarl_algos.evaluation.wording import cautions, headline, number, with_interval
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting import IndividualFit, LocomotionFit
from animarl_envs.species import SPECIES

HOSTILE = '<script>alert("x")</script> & $\\frac{a}$'


def walk(rng: np.random.Generator, frames: int) -> np.ndarray:
    return np.clip(np.cumsum(rng.normal(0, 0.02, (frames, 3, 2)), axis=0), -0.9, 0.9)


def make_demos(
    individuals: tuple[str, ...] = ("predator_0", "predator_1", "prey"),
) -> Demonstrations:
    rng = np.random.default_rng(0)
    lengths = rng.integers(8, 20, 12)
    return Demonstrations(
        species="agent",
        individuals=individuals,
        roles=("pursuer", "pursuer", "target"),
        dt=0.1,
        arena=Arena(),
        positions=np.concatenate([walk(rng, n) for n in lengths]),
        lengths=lengths,
        initial_velocity=np.zeros((12, 3, 2)),
        condition=np.repeat([0, 1], 6),
        outcome=np.tile([1, 0, 2], 4),
        split=np.array(["test"] * 12),
        recording=np.array([f"r{i}" for i in range(12)]),
        provenance={"source": HOSTILE, "licence": "MIT", "synthetic": True, "made": {"seed": 1}},
    )


def make_rollouts(demos: Demonstrations, method: str, flipped: bool = False) -> Rollouts:
    rng = np.random.default_rng(len(method))
    demo = np.tile(np.arange(12), 4)
    lengths = rng.integers(8, 25, len(demo))
    condition = demos.condition[demo]
    cue = np.full(len(demo), -1)
    if flipped:
        cue = np.where(np.arange(len(demo)) < 24, condition, 1 - condition)
    return Rollouts(
        method=method,
        individuals=demos.individuals,
        roles=demos.roles,
        dt=0.1,
        positions=np.concatenate([walk(rng, n) for n in lengths]),
        lengths=lengths,
        outcome=rng.integers(0, 2, len(demo)),
        condition=condition,
        cue=cue,
        demo=demo,
        seed=np.tile(np.repeat([0, 1], 12), 2),
        repetition=np.repeat([0, 1], 24),
    )


def make_inputs(**changes: object) -> ReportInputs:
    demos = make_demos()
    rollouts = {
        "random": make_rollouts(demos, "random"),
        "bc": make_rollouts(demos, "bc"),
        "dqaas": make_rollouts(demos, "dqaas"),
        "dqcil": make_rollouts(demos, "dqcil", flipped=True),
        "dqdil": make_rollouts(demos, "dqdil"),
    }
    fit = LocomotionFit(
        method="joint",
        species="agent",
        dt=0.1,
        individuals=tuple(
            IndividualFit(
                name=name,
                damping=0.25,
                thrust=2.4,
                damping_interval=(0.24, 0.26),
                thrust_interval=(2.3, 2.5),
                velocity_rmse=0.0123,
                steps=100,
                top_speed=0.9,
                terminal_speed=0.96,
                braking_time=0.3476,
            )
            for name in demos.individuals
        ),
        fitted_on="train",
        validated_on="val",
        episodes=80,
        validation_episodes=10,
        onset_threshold=None,
        bootstrap=100,
        seed=0,
        fingerprint="0",
    )
    curves = pd.DataFrame(
        [
            ("dqdil", phase, seed, step, "loss", 1.0 / (1 + step))
            for phase in ("offline", "online")
            for seed in (0, 1)
            for step in range(5)
        ],
        columns=["method", "phase", "seed", "step", "quantity", "value"],
    )
    inputs = ReportInputs(
        title="A run",
        focus="dqdil",
        demos=demos,
        rollouts=rollouts,
        evaluation=evaluate(
            rollouts, demos, seed=0, planned_flip=(0, 1), resamples=100, distance_resamples=50
        ),
        conditions=("individual", "shared"),
        fit=fit,
        learning_curves=curves,
        settings={"algo": "dqdil", "online": {"alpha": 1.0, "prioritised": True}},
        seeds=(0, 1),
        versions={"torch": "2.13.0"},
        command="animarl run demos.npz --algo dqdil",
        created="2026-11-21",
        episodes={"train": 80, "val": 10, "test": 12},
    )
    return dataclasses.replace(inputs, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def inputs() -> ReportInputs:
    return make_inputs()


@pytest.fixture(scope="module")
def html(inputs: ReportInputs) -> str:
    return render_report(inputs)


class Page(HTMLParser):
    """Collects headings, links, loaded things, and whether tags are balanced."""

    VOID = frozenset({"meta", "img", "br", "link", "hr", "input"})

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.headings: list[str] = []
        self.loads: list[str] = []
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.tags: set[str] = set()
        self.alts: list[str | None] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag not in self.VOID:
            self.open.append(tag)
        given = dict(attrs)
        self.ids |= {str(given["id"])} if "id" in given else set()
        for key in ("src", "srcset", "data", "poster", "action"):
            if key in given:
                self.loads.append(str(given[key]))
        if "href" in given:
            self.links.append(str(given["href"]))
        if tag == "img":
            self.alts.append(given.get("alt"))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("h1", "h2", "h3"):
            self.headings.append(data.strip())


def test_the_page_has_every_section(html: str) -> None:
    page = Page(html)
    assert not page.open
    for heading in (
        "A run", "What was found", "Trajectories", "Speeds", "Metrics", "Target reached",
        "Path length", "Duration", "DTW distance", "Distance to the recordings",
        "Planned contrasts", "Counterfactual", "Locomotion", "Learning", "How this was made",
    ):  # fmt: skip
        assert heading in page.headings
    assert all(link.startswith("#") and link[1:] in page.ids for link in page.links)
    assert len(page.alts) > 15 and all(page.alts)


def test_the_page_loads_nothing(html: str) -> None:
    page = Page(html)
    assert page.loads and all(s.startswith("data:image/svg+xml;base64,") for s in page.loads)
    assert not page.tags & {"script", "link", "iframe", "object", "embed"}
    css = re.search(r"<style>(.*?)</style>", html, re.DOTALL)
    assert css is not None and "url(" not in css[1] and "@import" not in css[1]
    for source in page.loads:
        svg = base64.b64decode(source.partition(",")[2]).decode()
        assert "<script" not in svg and "@import" not in svg
        assert not re.search(r'href="(?!#|data:)', svg)


def test_what_made_the_run_is_on_the_page(html: str, inputs: ReportInputs) -> None:
    for text in (
        "animarl run demos.npz --algo dqdil", "torch", "2.13.0", "online.alpha",
        inputs.demos.fingerprint(), "synthetic demonstrations", "made.seed", "2026-11-21",
        "0.250 [0.240, 0.260]",
    ):  # fmt: skip
        assert text in html


def test_numbers_on_the_page_are_those_of_the_tables(html: str, inputs: ReportInputs) -> None:
    table = inputs.evaluation.comparison
    row = table[
        (table["method"] == "dqdil") & (table["metric"] == "dtw") & (table["counting"] == "all")
    ].iloc[0]
    text = with_interval(Interval(row["mean"], row["mean_low"], row["mean_high"]))
    assert html.count(text) >= 2  # in the summary and in the table


def test_hostile_names_are_harmless() -> None:
    demos = make_demos((HOSTILE, "predator_1", "prey"))
    rollouts = {HOSTILE: make_rollouts(demos, HOSTILE)}
    result = evaluate(rollouts, demos, seed=0, resamples=50, distance_resamples=50)
    html = render_report(
        ReportInputs(
            title=HOSTILE,
            focus=HOSTILE,
            demos=demos,
            rollouts=rollouts,
            evaluation=result,
            command=HOSTILE,
            settings={HOSTILE: HOSTILE},
        )
    )
    assert "<script" not in html
    assert "&lt;script&gt;alert" in html
    for source in Page(html).loads:
        assert "<script" not in base64.b64decode(source.partition(",")[2]).decode()


def test_a_bare_run_without_captures_leaves_out_what_it_lacks(tmp_path: Path) -> None:
    demos = make_demos()
    never = dataclasses.replace(make_rollouts(demos, "bc"), outcome=np.zeros(48))
    result = evaluate({"bc": never}, demos, seed=0, resamples=50, distance_resamples=50)
    path = write_report(
        ReportInputs(title="x", focus="bc", demos=demos, rollouts={"bc": never}, evaluation=result),
        tmp_path / "deep" / "report.html",
    )
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]
    html = path.read_text(encoding="utf-8")
    assert "in 0 % [0, 0] of 48 rollouts" in html
    headings = Page(html).headings
    for absent in ("Planned contrasts", "Counterfactual", "Locomotion", "Learning"):
        assert absent not in headings
    assert "Metrics" in headings


def test_inputs_that_do_not_belong_together_are_refused(inputs: ReportInputs) -> None:
    with pytest.raises(InputError, match="other demonstrations"):
        dataclasses.replace(inputs, demos=inputs.demos.select(condition=0))
    with pytest.raises(InputError, match="no rollouts of 'dqn'"):
        dataclasses.replace(inputs, focus="dqn")
    assert inputs.learning_curves is not None
    with pytest.raises(InputError, match="lack the column 'phase'"):
        dataclasses.replace(inputs, learning_curves=inputs.learning_curves.drop(columns="phase"))


# -- the evaluation behind it ----------------------------------------------------------


def test_an_evaluation_is_saved_and_loaded(inputs: ReportInputs, html: str, tmp_path: Path) -> None:
    read = Evaluation.load(inputs.evaluation.save(tmp_path / "evaluation"))
    for name in ("metrics", "comparison", "pairs", "contrasts", "counterfactual"):
        pd.testing.assert_frame_equal(
            getattr(read, name), getattr(inputs.evaluation, name), check_dtype=False
        )
    # The same inputs give the same bytes, also after a passage through files.
    assert render_report(dataclasses.replace(inputs, evaluation=read)) == html
    (tmp_path / "evaluation" / "metrics.csv").unlink()
    with pytest.raises(InputError, match=r"metrics\.csv is missing"):
        Evaluation.load(tmp_path / "evaluation")


def test_evaluation_is_repeatable(inputs: ReportInputs) -> None:
    again = evaluate(
        inputs.rollouts, inputs.demos, seed=0, planned_flip=(0, 1), resamples=100,
        distance_resamples=50,
    )  # fmt: skip
    pd.testing.assert_frame_equal(again.comparison, inputs.evaluation.comparison)
    with pytest.raises(InputError, match="no rollouts"):
        evaluate({}, inputs.demos, seed=0)


def test_rollouts_in_another_condition_alone_are_refused() -> None:
    demos = make_demos()
    made = make_rollouts(demos, "bc")
    changed = dataclasses.replace(made, condition=1 - made.condition)
    with pytest.raises(InputError, match="condition of its recording"):
        evaluate({"bc": changed}, demos, seed=0, resamples=50, distance_resamples=50)


def test_examples_are_factual_and_in_order(inputs: ReportInputs) -> None:
    """A flipped cue, or rollouts in another order, must not mix up paths and their distances."""
    flipped = dataclasses.replace(inputs, focus="dqcil")
    rollouts, dtw = panels._factual(flipped)
    assert len(rollouts) == 24 and (rollouts.cue == rollouts.condition).all()
    assert dtw == pytest.approx(measure(rollouts, inputs.demos)["dtw"].to_numpy())


def test_the_terminal_table_names_every_method(inputs: ReportInputs) -> None:
    console = Console(width=120, record=True, file=open("/dev/null", "w"))  # noqa: SIM115, PTH123
    console.print(evaluation_table(inputs.evaluation, focus="dqdil"))
    text = console.export_text()
    for name in ("recorded", "random", "BC", "DQAAS", "DQCIL", "DQDIL", "all episodes"):
        assert name in text


# -- words and figures -----------------------------------------------------------------


def comparison(mean: float, low: float, high: float) -> pd.DataFrame:
    """A table of one method, its difference to the recordings, and random actions beside it."""
    rows = []
    for method, metric in [("bc", "path_length"), ("bc", "dtw"), ("random", "dtw")]:
        row = {"method": method, "metric": metric, "counting": "all", "rollouts": 5, "seeds": 1}
        keys = ("mean", "to_recorded", "kde", "kde_null", "wasserstein")
        for key in keys:
            row |= {key: mean, f"{key}_low": low, f"{key}_high": high}
        rows.append(row)
    return pd.DataFrame(rows)


def pairs(low: float, high: float) -> pd.DataFrame:
    """Random actions minus BC in DTW distance."""
    row = {"metric": "dtw", "counting": "all", "first": "random", "second": "bc"}
    ends = {"difference": (low + high) / 2, "difference_low": low, "difference_high": high}
    return pd.DataFrame([row | ends])


@pytest.mark.parametrize(
    ("mean", "low", "high", "other", "said"),
    [
        (2.0, 1.0, 3.0, (1.0, 2.0), ["longer than recorded", "closer than random"]),
        (-2.0, -3.0, -1.0, (-2.0, -1.0), ["2.0 [1.0, 3.0] arena units shorter", "farther than"]),
        (0.5, -1.0, 2.0, (-1.0, 3.0), ["not told apart", "not told apart from random"]),
    ],
)
def test_claims_follow_the_numbers(
    mean: float, low: float, high: float, other: tuple[float, float], said: list[str]
) -> None:
    text = " ".join(headline(comparison(mean, low, high), pairs(*other), "bc"))
    for words in said:
        assert words in text


def test_cautions_say_what_limits_the_conclusions() -> None:
    table = comparison(1.0, 0.0, 2.0)
    one = cautions(table, "bc", synthetic=True)
    assert "synthetic" in one[0] and "One training seed" in one[1]
    assert cautions(table.assign(seeds=3), "bc", synthetic=False)[0].startswith("Only 3")
    assert cautions(table.assign(seeds=5), "bc", synthetic=False) == []


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (Interval(1.2345, 1.0, 1.5), "1.23 [1.00, 1.50]"),
        (Interval(-12.34, -15.0, -9.0), "\u221212.3 [\u221215.0, \u22129.0]"),
        (Interval(112.3, 92.0, 133.0), "112 [92, 133]"),
        (Interval(-0.2, -20.0, 18.0), "0 [\u221220, 18]"),
        (Interval(0.25, 0.25, 0.25), "0.250 [0.250, 0.250]"),
        (Interval(0.5, float("nan"), float("nan")), "0.500"),
        (Interval(float("nan"), 0.0, 0.0), "\u2013"),
    ],
)
def test_numbers_have_the_digits_their_interval_allows(value: Interval, text: str) -> None:
    assert with_interval(value) == text


def test_numbers() -> None:
    assert [number(v) for v in (0.0, 1234.5, -0.5, 3e-7, float("nan"))] == [
        "0", "1234", "\u22120.500", "3e\u221207", "\u2013",
    ]  # fmt: skip


def test_bins_are_shared_and_hold_everything() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.exponential(size=500), rng.exponential(2.0, size=90)
    edges = shared_bins(first, second)
    assert edges[0] == 0.0 and edges[-1] == max(first.max(), second.max())
    assert len(shared_bins(np.zeros(5), np.zeros(3))) == 51
    assert np.histogram(first, edges)[0].sum() == 500


def test_learning_curves_are_chosen_and_named() -> None:
    logged = [
        ("bc", "offline/val/top_1"), ("bc", "offline/val/top_1/prey"),
        ("dqdil", "offline/val/top_1"), ("dqdil", "offline/train/td"),
        ("dqdil", "offline/train/td/prey"), ("dqdil", "offline/train/td/predator_0"),
        ("dqdil", "offline/train/l2"), ("dqdil", "offline/odd_one"),
    ]  # fmt: skip
    rows = [(method, 0, step, name, 1.0) for method, name in logged for step in range(3)]
    curves = pd.DataFrame(rows, columns=["method", "seed", "step", "quantity", "value"])
    shown = {c.title: sorted(c.rows["method"].unique()) for c in chosen_curves(curves, "DQDIL")}
    assert shown == {
        "Demonstrated action first (share)": ["bc", "dqdil"],
        "Temporal-difference loss": ["predator_0", "prey"],
        "odd_one": ["dqdil"],
    }
    assert list(shown)[-1] == "odd_one"
    assert all(len(c.rows) == 6 for c in list(chosen_curves(curves, "DQDIL"))[:2])


def test_interpretation_figures() -> None:
    rng = np.random.default_rng(0)
    q = rng.normal(size=(30, 13))
    assert advantage(q).mean(axis=1) == pytest.approx(0.0, abs=1e-12)
    assert (advantage(q).argmax(axis=1) == q.argmax(axis=1)).all()
    along = to_image(values_along_path(q, rng.integers(-1, 13, 30), 0.1), "values")
    assert "Advantage" in base64.b64decode(along.source.partition(",")[2]).decode()
    x, y = np.linspace(-1, 1, 20), np.linspace(-1, 1, 15)
    focus = np.tile([1.0, 0.0], (15, 20, 1))
    others = np.array([[0.5, 0.5], [0.0, 0.0]])
    drawn = to_image(
        value_map(x, y, rng.normal(size=(15, 20, 13)), focus, Arena("disc"), others=others), "map"
    )
    assert drawn.source.startswith("data:image/svg+xml;base64,")
    with pytest.raises(InputError, match="one value per action"):
        values_along_path(q[:, :5], np.zeros(30, dtype=int), 0.1)
    with pytest.raises(InputError, match="15 rows"):
        value_map(x, y, rng.normal(size=(20, 15, 13)), focus, Arena())


def test_a_lost_searcher_does_not_hide_the_recording() -> None:
    recorded = np.linspace([0.3, 0.0], [0.02, 0.01], 30)[:, None]
    lost = np.linspace([0.3, 0.0], [-40.0, 9.0], 90)[:, None]
    figure = trajectory_pair(lost, recorded, Arena("open", size=0.35), ("searcher",))
    for panel in figure.axes:
        low, high = panel.get_xlim()
        assert low < 0.0 and 0.3 < high < 1.0
    indoors = trajectory_pair(
        np.full((4, 1, 2), 1.1), recorded, Arena("square"), ("pursuer",)
    )  # fmt: skip
    low, high = indoors.axes[0].get_xlim()
    assert low < -1.0 and high > 1.1


def test_decisions_follow_the_recorded_path_and_pass_through_a_file(tmp_path: Path) -> None:
    """A policy that counts its steps shows its memory, its previous action and the flag."""

    class Counter:
        def advance(
            self, observation: Any, state: Any, episode_start: Any
        ) -> tuple[Any, Any, bool]:
            slots = len(observation)
            count = np.zeros((slots, 1)) if state is None else state[0].reshape(slots, 1)
            seen.append(None if state is None else state[1])
            q = np.zeros((slots, 13)) + 10.0 * count + observation[:, -1:]
            q[np.arange(slots), np.arange(slots) % 3] += 1.0
            return q, count + 1, False

    seen: list[Any] = []
    demos = make_demos()
    made = decide_along(Counter(), SPECIES["agent"], demos, condition_flag=True)
    median = int(np.argsort(demos.lengths, kind="stable")[6])
    steps = int(demos.lengths[median]) - 1
    assert (made.individual, made.demo, len(made.q)) == ("predator_0", median, steps)
    flag = float(demos.condition[median])
    assert made.q[:, 0] == pytest.approx(10.0 * np.arange(steps) + 1.0 + flag)
    assert np.array_equal([s[0] for s in seen[1:steps]], made.actions[: steps - 1])
    # The map is taken with the memory of that moment, for each place of the arena.
    assert made.map_q[..., 0] == pytest.approx(10.0 * made.moment + 1.0 + flag)
    assert np.allclose(np.linalg.norm(made.focus, axis=-1), 1.0)
    # One that knows a single individual tells that one's values, from its own slots.
    prey = decide_along(Counter(), SPECIES["agent"], demos, condition_flag=True, focal="prey")
    assert (prey.individual, len(prey.q), seen[-1].shape) == ("prey", steps, (len(prey.x) ** 2,))
    assert not np.array_equal(prey.actions, made.actions)
    assert prey.map_q.max(axis=-1) == pytest.approx(10.0 * prey.moment + 1.0 + flag)
    assert np.array_equal(prey.others[0], demos.episode(median).positions[prey.moment, 0])
    assert "target dark" not in render_report(dataclasses.replace(make_inputs(), decisions=prey))
    made.save(tmp_path / "decisions.npz")
    read = Decisions.load(tmp_path / "decisions.npz")
    assert all(np.array_equal(getattr(read, k), v) for k, v in dataclasses.asdict(made).items())
    page = render_report(dataclasses.replace(make_inputs(), decisions=read))
    assert 'id="decisions"' in page and "over the arena" in page
    (tmp_path / "decisions.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(InputError, match="damaged"):
        Decisions.load(tmp_path / "decisions.npz")
