"""The evaluation behind the report: saved, repeatable, and of rollouts that belong together."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
from refusals import refuses
from report_inputs import make_demos, make_rollouts, rendered, report_inputs, report_page
from rich.console import Console

from animarl_algos.benchmark.scores import labels
from animarl_algos.evaluation import Evaluation, evaluate, measure
from animarl_algos.evaluation.metrics import METRICS, Metric, add_metric
from animarl_algos.evaluation.verdict_rows import SAME
from animarl_algos.report import evaluation_table
from animarl_algos.report.player import factual_rollouts
from animarl_envs.errors import InputError


def test_an_evaluation_is_saved_and_loaded(tmp_path: Path) -> None:
    inputs = report_inputs()
    read = Evaluation.load(inputs.evaluation.save(tmp_path / "evaluation"))
    for name in ("metrics", "comparison", "pairs"):
        pd.testing.assert_frame_equal(
            getattr(read, name), getattr(inputs.evaluation, name), check_dtype=False
        )
    # The same inputs give the same bytes, also after a passage through files.
    assert rendered(dataclasses.replace(inputs, evaluation=read)) == report_page()
    (tmp_path / "evaluation" / "metrics.csv").unlink()
    refuses(r"metrics\.csv is missing", Evaluation.load, tmp_path / "evaluation")


def test_evaluation_is_repeatable(tmp_path: Path) -> None:
    inputs = report_inputs()
    again, twice = (
        evaluate(
            inputs.rollouts, inputs.demos, seed=0, resamples=100,
        )
        for _ in range(2)
    )  # fmt: skip
    pd.testing.assert_frame_equal(again.comparison, inputs.evaluation.comparison)
    folders = [e.save(tmp_path / n) for n, e in (("a", again), ("b", twice))]
    written = [{p.name: p.read_bytes() for p in folder.iterdir()} for folder in folders]
    assert written[0] == written[1] and "comparison.csv" in written[0]
    refuses("no rollouts", evaluate, {}, inputs.demos, seed=0)


def test_rollouts_in_another_condition_alone_are_refused() -> None:
    demos = make_demos()
    made = make_rollouts(demos, "bc")
    changed = dataclasses.replace(made, condition=1 - made.condition)
    with pytest.raises(InputError, match="condition of its recording"):
        evaluate({"bc": changed}, demos, seed=0, resamples=50)


def test_examples_are_factual_and_in_order() -> None:
    """A flipped cue, or rollouts in another order, must not mix up paths and their distances."""
    flipped = dataclasses.replace(report_inputs(), learner="dqcil")
    rollouts, dtw = factual_rollouts(flipped)
    assert len(rollouts) == 24 and (rollouts.cue == rollouts.condition).all()
    assert dtw == pytest.approx(measure(rollouts, flipped.demos)["dtw"].to_numpy())


def test_the_terminal_table_names_every_method() -> None:
    console = Console(width=120)
    with console.capture() as printed:
        console.print(evaluation_table(report_inputs().evaluation))
    text = printed.get()
    for name in ("demonstrated", "random", "BC", "DQAAS", "DQCIL", "DQDIL", "all episodes"):
        assert name in text
    assert "record" not in text  # demonstrations may be synthetic


@pytest.fixture
def pace() -> Iterator[Metric]:
    """A metric of somebody's own: one entry, and nothing else changed."""
    metric = Metric(
        key="pace",
        label="Pace",
        unit="arena units/s",
        measure=lambda episodes: episodes.path_length / (episodes.rollouts.lengths - 1),
        planned=True,
        too_much="paces too fast",
        caption="Path length over duration.",
        heading="pace",
    )
    add_metric(metric)
    yield metric
    METRICS.remove(metric)


def test_a_new_metric_is_measured_compared_and_shown(pace: Metric) -> None:
    refuses("'pace' already", add_metric, pace)
    inputs = report_inputs()
    before = inputs.evaluation
    again = evaluate(
        inputs.rollouts, inputs.demos, seed=0, resamples=100,
    )  # fmt: skip
    for name in ("metrics", "comparison", "pairs"):
        table, known = getattr(again, name), getattr(before, name)
        if name == "metrics":
            assert (table["pace"] > 0).all()
            table = table[known.columns]
        else:
            assert "pace" in set(table["measure"])
            table = table[~table["measure"].isin(["pace", "energy of pace"])].reset_index(drop=True)
        pd.testing.assert_frame_equal(table, known)  # what was there stays as it was
    rows = again.comparison.query("method == 'dqdil' and counting == 'all'").set_index("measure")
    assert rows.loc[["pace", "energy of pace"], "value"].notna().all()
    page = rendered(dataclasses.replace(inputs, evaluation=again))
    assert page.count("Path length over duration.") == 1
    assert "energy of pace" in page
    assert again.verdict.row("pace")["verdict"] in (SAME, "paces too fast", "pace too low")
    assert "pace" in labels() and "pace" not in before.verdict.table["measure"].to_list()
    columns = [str(column.header) for column in evaluation_table(again).columns]
    assert columns[-2:] == ["pace\n(arena units/s)", "energy of pace"]
    # An evaluation from before it was added still makes its page.
    assert rendered(inputs) == report_page()
