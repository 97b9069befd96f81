"""The evaluation behind the report: known answers of its measures; saved and repeatable."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from moving_pairs import rollouts_along
from numpy.typing import NDArray
from recordings import cut_short, episodes_along
from refusals import refuses
from report_inputs import make_demos, make_rollouts, rendered, report_inputs, report_page
from rich.console import Console
from small_runs import few

from animarl_algos.benchmark.scores import labels
from animarl_algos.evaluation import Evaluation, evaluate
from animarl_algos.evaluation.metrics import (
    METRICS,
    Metric,
    add_metric,
    measure,
    measure_recordings,
)
from animarl_algos.evaluation.prepared import dtw_alignments, path_lengths
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict_rows import UNKNOWN
from animarl_algos.report import evaluation_table
from animarl_algos.report.player import factual_rollouts
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations


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
    refuses("no rollouts", evaluate, {}, inputs.demos, seed=0)


def test_rollouts_in_another_condition_alone_are_refused() -> None:
    demos = make_demos()
    made = make_rollouts(demos, "bc")
    changed = dataclasses.replace(made, condition=1 - made.condition)
    refuses("condition of its recording", evaluate, {"bc": changed}, demos, seed=0, resamples=50)


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


def test_rollouts_are_measured_as_far_as_their_recording_goes() -> None:
    """As in the verdict: nothing is known of what came after a film was stopped."""
    whole = few().select(split="test")
    cut = cut_short(whole, 6)
    on = {"goes on": Rollouts.from_demonstrations(whole)}
    metrics = evaluate(on, cut, seed=0, resamples=20).metrics.set_index("method")
    for column in ("duration", "path_length"):
        same = metrics.loc["recorded", column].to_numpy()
        assert metrics.loc["goes on", column].to_numpy() == pytest.approx(same)


@pytest.fixture
def pace() -> Iterator[Metric]:
    """A metric of somebody's own: one entry, and nothing else changed."""
    metric = Metric(
        key="pace", label="Pace", unit="arena units/s",
        measure=lambda episodes: episodes.path_length / (episodes.rollouts.lengths - 1),
        planned=True, too_much="paces too fast", caption="Path length over duration.",
        heading="pace",
    )  # fmt: skip
    report_inputs()  # evaluated without it
    add_metric(metric)
    yield metric
    METRICS.remove(metric)


def test_a_new_metric_is_measured_compared_and_shown(pace: Metric) -> None:
    refuses("'pace' already", add_metric, pace)
    inputs = report_inputs()
    before = inputs.evaluation
    again = evaluate(inputs.rollouts, inputs.demos, seed=0, resamples=100)
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
    assert again.verdict.row("pace")["judgement"] == UNKNOWN  # five recordings
    assert "pace" in labels() and "pace" not in before.verdict.table["measure"].to_list()
    columns = [str(column.header) for column in evaluation_table(again).columns]
    assert columns[-2:] == ["pace\n(arena units/s)", "energy of pace"]
    # An evaluation from before it was added still makes its page.
    assert rendered(inputs) == report_page()


def line(frames: int, step: tuple[float, float], start: tuple[float, float]) -> NDArray[np.float64]:
    return np.asarray(start) + np.arange(frames)[:, None] * np.asarray(step)


def chase(frames: int, speed: float) -> NDArray[np.float64]:
    """Two pursuers, of step ``speed`` and twice that, and a target at rest."""
    return np.stack(
        [
            line(frames, (speed, 0.0), (-0.5, 0.0)),
            line(frames, (0.0, 2 * speed), (0.0, -0.5)),
            line(frames, (0.0, 0.0), (0.3, 0.3)),
        ],
        axis=1,
    )


@pytest.fixture
def demos() -> Demonstrations:
    paths = [chase(11, 0.02), chase(6, 0.01), chase(21, 0.03)]
    return episodes_along(paths, condition=[0, 1, 1], outcome=[1, 0, 2])


def rollouts(demos: Demonstrations, demo: list[int], paths: list[NDArray[np.float64]]) -> Rollouts:
    return rollouts_along(paths, demos, demo, outcome=[1, 0, -1, 2][: len(demo)])


def test_path_length_is_that_of_each_episode_alone(demos: Demonstrations) -> None:
    made = rollouts(demos, [0, 1], [chase(4, 0.1), chase(3, 0.2)])
    assert path_lengths(made) == pytest.approx(np.array([[0.3, 0.6, 0.0], [0.4, 0.8, 0.0]]))


def test_measures_of_the_recordings(demos: Demonstrations) -> None:
    table = measure_recordings(demos)
    assert table["method"].unique().tolist() == ["recorded"]
    assert table["reached"].tolist() == [1.0, 0.0, 1.0]
    assert table["duration"].to_numpy() == pytest.approx([1.0, 0.5, 2.0])
    assert table["path_length"].to_numpy() == pytest.approx([0.3, 0.075, 0.9])  # pursuers only
    assert (table["dtw"] == 0.0).all() and (table["dtw_per_step"] == 0.0).all()
    made = rollouts(demos, [2], [chase(3, 0.1)])
    refuses("were not made from", measure, made, demos.select(episodes=[0, 1]))


def test_reached_counts_captures_by_a_pursuer_only(demos: Demonstrations) -> None:
    """Contact counts; a target that leaves, a pursuer that leaves and a time-out do not."""
    table = measure(rollouts(demos, [0, 0, 0, 0], [chase(3, 0.1)] * 4), demos)
    assert table["reached"].tolist() == [1.0, 0.0, 0.0, 1.0]
    assert table["captured"].tolist() == [True, False, False, True]


def test_dtw_known_answers(demos: Demonstrations) -> None:
    shifted = demos.episode(0).positions + [0.0, 0.25]
    slower = np.repeat(demos.episode(0).positions, 2, axis=0)  # the same path at half the speed
    made = rollouts(demos, [0, 0, 0], [demos.episode(0).positions, slower, shifted])
    distances, pairs = dtw_alignments(made, demos)
    assert distances[0] == pytest.approx(0.0) and distances[1] == pytest.approx(0.0)
    assert distances[2, [0, 2]] == pytest.approx(11 * 0.25)  # crosswise to the path, or at rest
    table = measure(made, demos)
    assert table["dtw"][2] == pytest.approx(distances[2, :2].mean())
    # The second pursuer moves along the shift: its path is aligned in 17 pairs, not 11.
    assert pairs[2].tolist() == [11, 17, 11]
    per_step = (distances[2, 0] / 11 + distances[2, 1] / 17) / 2
    assert table["dtw_per_step"][2] == pytest.approx(per_step)


def test_a_lone_searcher_is_measured_itself() -> None:
    path = line(5, (0.1, 0.0), (0.0, 0.0))[:, None]
    demos = episodes_along(
        [path], species="silkmoth", individuals=("moth",), roles=("searcher",), dt=0.5,
        arena=Arena("open", size=1.0), outcome=[1],
    )  # fmt: skip
    table = measure_recordings(demos)
    assert table["path_length"][0] == pytest.approx(0.4)
    assert table["duration"][0] == 2.0 and table["reached"][0] == 1.0
