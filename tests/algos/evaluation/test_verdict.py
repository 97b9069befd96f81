"""The verdict: a true simulator passes, and every way of being wrong is called by its name."""

import json
import math
import re
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from moving_pairs import implausible, recorded_pairs, rollouts_along, simulated_pairs
from refusals import refuses
from scipy import stats
from scipy.stats import CensoredData, ecdf

from animarl_algos.evaluation.classifier import ClassifierResult, interval_over_recordings
from animarl_algos.evaluation.collect import collect_rollouts
from animarl_algos.evaluation.differences import Differences, Sides, simultaneous_differences
from animarl_algos.evaluation.metrics import (
    KINEMATIC,
    METRICS,
    ORDER_METRICS,
    judged_metrics,
    measures,
)
from animarl_algos.evaluation.prepared import (
    Prepared,
    censored,
    restricted_mean_scores,
    slow_speeds,
)
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.verdict import Verdict, compare, verdict
from animarl_algos.evaluation.verdict_rows import (
    ALIKE,
    DIFFERS,
    JUDGEMENTS,
    LITTLE,
    UNKNOWN,
    Questions,
    Row,
    classifier_row,
    judge,
    judge_area,
)
from animarl_algos.report.page import Table
from animarl_algos.report.verdict_section import (
    verdict_blocks,
    verdict_lines,
    verdict_sentence,
    verdict_table,
)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.summary import unit_of
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world


@cache
def judged(kind: str) -> Verdict:
    demos = recorded_pairs()
    return verdict(demos, simulated_pairs(demos, kind), seed=0, references=recorded_pairs(seed=9))


@cache
def compared(kind: str) -> dict[str, Row]:
    """Rows without the classifiers, by measure: the answers that take no time."""
    demos = recorded_pairs()
    return rows_of(demos, simulated_pairs(demos, kind))


def rows_of(demos: Demonstrations, rollouts: Rollouts, **questions: Any) -> dict[str, Row]:
    found = compare(demos, rollouts, 0, Questions(**questions))[0]
    return {row.measure: row for row in found.rows()}


def replayed(demos: Demonstrations, factor: float = 1.0) -> Rollouts:
    """The recordings themselves, with every distance from the start multiplied."""
    found = replace(Rollouts.from_demonstrations(demos), method="replay")
    first = np.repeat(found.positions[found.offsets[:-1]], found.lengths, axis=0)
    return replace(found, positions=first + factor * (found.positions - first))


@pytest.mark.parametrize(
    ("value", "low", "high", "word"),
    [
        (0.0, -0.1, 0.1, ALIKE), (0.0, -0.1, 0.1001, UNKNOWN), (0.0, -0.1001, 0.1, UNKNOWN),
        (0.05, 0.01, 0.09, ALIKE), (0.05, 0.01, 0.11, LITTLE), (0.1, 0.01, 0.19, LITTLE),
        (0.11, 0.01, 0.21, DIFFERS), (0.11, 0.0, 0.22, UNKNOWN), (0.11, -0.01, 0.23, UNKNOWN),
        (-0.11, -0.21, -0.01, DIFFERS), (-0.1, -0.19, -0.01, LITTLE),
        (0.5, math.nan, math.nan, UNKNOWN),
    ],
)  # fmt: skip
def test_equivalence_a_word_follows_from_interval_and_tolerance(
    value: float, low: float, high: float, word: str
) -> None:
    assert judge(value, low, high, 0.1) == word
    assert judge(value, low, high, 0.0) == UNKNOWN  # without a tolerance nothing can be said


@pytest.mark.parametrize(
    ("low", "high", "word"),
    [
        (0.45, 0.60, ALIKE), (0.55, 0.60, ALIKE), (0.50, 0.61, UNKNOWN), (0.51, 0.61, LITTLE),
        (0.60, 0.70, LITTLE), (0.601, 0.70, DIFFERS), (math.nan, math.nan, UNKNOWN),
    ],
)  # fmt: skip
def test_equivalence_of_a_classifier(low: float, high: float, word: str) -> None:
    assert judge_area(Interval(0.6, low, high)) == word


def test_tolerance_of_means_of_shares_and_of_what_may_be_zero() -> None:
    rows = compared("true")
    speed, slow = rows["mean_speed"], rows["slow_steps"]
    assert speed.tolerance == pytest.approx(0.1 * speed.recorded)
    assert slow.tolerance == 0.05
    demos = recorded_pairs()
    found = compare(demos, simulated_pairs(demos, "true"), 0)[0]
    place = [metric.key for metric in found.metrics].index("turning_to_the_left_male")
    own = Prepared(demos).order(Rollouts.from_demonstrations(demos))
    spread = own.column("turning to the left, male").std(ddof=1)
    assert found.tolerances[place] == pytest.approx(0.25 * spread)


def test_tolerance_of_the_users_choice() -> None:
    demos = recorded_pairs()
    sixth = rows_of(demos, replayed(demos, 1.06))["mean_speed"]
    assert sixth.judgement in (ALIKE, LITTLE)
    strict = rows_of(demos, replayed(demos, 1.06), tolerances={"speed": 0.01})["mean_speed"]
    assert strict.judgement == DIFFERS and strict.value == sixth.value
    assert strict.tolerance == pytest.approx(0.01 * strict.recorded)
    refuses("no measure of this verdict is named 'haste'", rows_of, demos, replayed(demos),
            tolerances={"haste": 0.2})  # fmt: skip
    Questions(primary=("Mean speed",)).check(demos)
    refuses("choose one of", Questions(primary=("haste",)).check, demos)
    assert Questions.parse(["speed=0.2"], ["duration"]) == Questions({"speed": 0.2}, ("duration",))
    for wrong in ("speed", "speed=x", "speed=0", "speed=nan"):
        refuses("give NAME=NUMBER", Questions.parse, [wrong])


def test_primary_measures_have_narrower_intervals() -> None:
    demos = recorded_pairs()
    usual = compared("true")
    first = rows_of(demos, simulated_pairs(demos, "true"), primary=("speed",))
    assert first["mean_speed"].primary and not first["turning"].primary
    assert first["mean_speed"].high < usual["mean_speed"].high
    assert first["turning"].high == pytest.approx(usual["turning"].high, rel=0.02)


def test_the_true_simulator_differs_in_nothing() -> None:
    found = judged("true")
    assert found.colour in ("green", "grey")
    assert found.counts[DIFFERS] == 0 and not found.complaints
    assert found.auc.low <= 0.5 <= found.auc.high
    assert found.headline.startswith(f"Of {len(found.table)} questions ")
    assert "30 recordings are too few; about" in found.headline


def test_the_recordings_themselves_are_alike_with_a_width() -> None:
    demos = recorded_pairs()
    for row in rows_of(demos, replayed(demos)).values():
        assert abs(row.value) < 1e-9 and row.judgement in (ALIKE, UNKNOWN)
        assert row.low < 0 < row.high or math.isnan(row.low)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("still", {"mean_speed": "too slow: 0 for", "slow_steps": "stands still too often: 100"}),
        ("dead", {"duration": "episodes too short", "path_length": "paths too short"}),
        ("slow", {"mean_speed": "too slow", "path_length": "paths too short"}),
        ("leaving", {"leaving": "leaves the arena"}),
    ],
)
def test_what_is_wrong_is_called_by_its_name(kind: str, words: dict[str, str]) -> None:
    for measure, text in words.items():
        row = compared(kind)[measure]
        assert row.judgement == DIFFERS and row.colour == "red"
        assert row.verdict.startswith(text) and " for " in row.verdict


def test_a_simulator_without_spread_is_found_out() -> None:
    demos, path = recorded_pairs(), recorded_pairs().episode(0).positions
    same = rollouts_along([path] * len(demos), demos, np.arange(len(demos)))
    row = rows_of(demos, same)["spread_of_path_length"]
    assert row.verdict.startswith("path lengths too much alike: 0 for")


def test_a_headline_says_what_differs_whatever_is_not_known() -> None:
    true = judged("true")
    for words, colour in (
        ((DIFFERS, UNKNOWN, LITTLE), "red"), ((UNKNOWN, LITTLE), "grey"), ((LITTLE,), "green"),
        ((), "green"),
    ):  # fmt: skip
        table = true.table.copy()
        table["judgement"] = ALIKE
        for place, word in enumerate(words):
            table.loc[place, "judgement"] = word
        found = replace(true, table=table)
        assert found.colour == colour
        assert found.counts == {w: 1 for w in words} | {
            w: 0 for w in JUDGEMENTS if w not in (*words, ALIKE)
        } | {ALIKE: len(table) - len(words)}  # fmt: skip


def test_a_headline_has_at_most_three_complaints() -> None:
    found = judged("still")
    assert len(found.complaints) > 3
    assert f"; and {len(found.complaints) - 3} more)" in found.headline
    assert found.headline.count("stands still") <= 1


def test_order_in_time_is_told_in_the_unit_of_the_recordings() -> None:
    demos = recorded_pairs()
    scales = {name: {"unit": 50.0} for name in np.unique(demos.recording).tolist()}
    own = replace(demos, provenance={**demos.provenance, "unit": "mm", "scales": scales})
    plain, told = (rows_of(one, simulated_pairs(demos, "slow")) for one in (demos, own))
    name = "mean_speed"
    assert told[name].unit == "mm/s" and plain[name].unit == "arena units/s"
    for column in ("recorded", "simulated", "value", "low", "high", "tolerance"):
        own_value, arena_value = (getattr(rows[name], column) for rows in (told, plain))
        assert own_value == pytest.approx(50 * arena_value)
    assert told[KINEMATIC].judgement == plain[KINEMATIC].judgement == DIFFERS


@pytest.mark.parametrize(
    ("part", "floor", "word"),
    [
        ("turning", 0.97, UNKNOWN),  # the file or the locomotion is told
        ("speed", 0.97, DIFFERS),  # by something else
        ("turning", 0.90, DIFFERS),  # not as well
        ("", 0.97, DIFFERS),  # tracking is alike
    ],
)
def test_a_classifier_that_tells_tracking_as_well_judges_no_policy(
    part: str, floor: float, word: str
) -> None:
    told = ClassifierResult(
        Interval(0.98, 0.95, 1.0),
        importance={"speed": 0.1, "turning": 0.3},
        areas={"floor": Interval(floor, 0.85, 1.0)},
        units=20,
        tracking_part=part,
    )
    row = classifier_row("auc", "Classifier", told)
    assert row.judgement == word and "most of all by turning" in row.verdict


def test_tracking_that_is_told_by_another_feature_excuses_nothing() -> None:
    demos = recorded_pairs()
    slow = simulated_pairs(demos, "slow")
    first = np.repeat(demos.positions[demos.offsets[:-1]], demos.lengths, axis=0)
    floor = replace(demos, positions=first)  # as bad as can be: everybody stays at the start
    excused = verdict(demos, slow, seed=0, floor=floor, references=demos)
    assert excused.areas["auc"]["floor"].estimate > 0.9
    assert excused.row("auc")["judgement"] == DIFFERS


def test_few_recordings_leave_things_unknown_and_say_how_many_would_do() -> None:
    demos = recorded_pairs()
    few = demos.select(episodes=np.arange(5))
    found = rows_of(few, simulated_pairs(few, "true"))["mean_speed"]
    assert found.judgement == UNKNOWN and found.needed > 5
    assert found.verdict.startswith("not known: about ")
    still = rows_of(few, simulated_pairs(few, "still"))["slow_steps"]
    assert still.judgement == DIFFERS  # what differs is said, whatever the number


@pytest.mark.parametrize("number", [1, 2])
def test_equivalence_of_two_recordings_is_not_known_without_impossible_numbers(number: int) -> None:
    demos = recorded_pairs()
    parts = np.array([f"recording {i % number}" for i in range(len(demos))])
    pieces = replace(demos, recording=parts)
    found = verdict(pieces, simulated_pairs(pieces, "still"), seed=0)
    assert set(found.table["judgement"]) == {UNKNOWN} and found.colour == "grey"
    assert found.table[["low", "high"]].isna().all(axis=None)
    assert f"{number} recording{'s' * (number > 1)} {'are' if number > 1 else 'is'} too few" in (
        found.headline
    )
    assert "too few for an interval" in found.row("mean_speed")["verdict"]


def test_pieces_of_a_recording_are_one_observation() -> None:
    """Copying every piece within its recording must not shorten an interval."""
    demos = recorded_pairs()
    six = replace(demos, recording=np.array([f"r{i % 6}" for i in range(len(demos))]))
    twice = six.select(episodes=np.repeat(np.arange(len(six)), 2))
    one, other = (rows_of(d, replayed(d, 1.2))["mean_speed"] for d in (six, twice))
    assert other.value == pytest.approx(one.value)
    assert other.high - other.low == pytest.approx(one.high - one.low)
    assert compared("true")["mean_speed"].high < 10 * one.high


def test_pieces_weigh_by_their_time() -> None:
    demos = recorded_pairs()
    whole = replace(demos, recording=np.array([f"r{i % 6}" for i in range(len(demos))]))
    row = rows_of(whole, replayed(whole))["mean_speed"]
    speed = Prepared(whole).episodes(Rollouts.from_demonstrations(whole)).motion[0]
    steps, place = whole.lengths - 1, np.arange(len(whole)) % 6
    means = [np.average(speed[place == i], weights=steps[place == i]) for i in range(6)]
    assert row.recorded == pytest.approx(np.mean(means))


def test_tied_scores_are_no_evidence_of_likeness() -> None:
    demos = recorded_pairs().select(episodes=np.arange(4))
    found = verdict(demos, simulated_pairs(demos, "dead"), seed=0)
    row = found.row("auc")
    assert row["judgement"] == UNKNOWN and math.isnan(row["value"])
    assert "all scores are tied" in row["verdict"]


@pytest.mark.parametrize(("recordings", "low"), [(4, 0.9), (20, 0.976)])
def test_an_area_of_one_still_has_a_width(recordings: int, low: float) -> None:
    found = interval_over_recordings(Interval(1.0, 1.0, 1.0), recordings)
    assert found.low == pytest.approx(low, abs=1e-3) and found.high == 1.0
    assert "too few" in interval_over_recordings(Interval(1.0, 1.0, 1.0), 2).reason


def test_starts_that_were_rolled_out_more_often_weigh_no_more() -> None:
    demos = recorded_pairs()
    every = simulated_pairs(demos, "slow")
    later = np.flatnonzero(every.demo >= demos.num_episodes // 2)
    uneven = every.select(np.concatenate([np.arange(len(every)), later, later]))
    rows = [rows_of(demos, each) for each in (every, uneven)]
    for name in ("duration", "path_length", "mean_speed"):
        once, often = (each[name] for each in rows)
        assert often.simulated == pytest.approx(once.simulated)
        assert often.value == pytest.approx(often.simulated - often.recorded)


@pytest.mark.slow
def test_worse_than_untrained_is_said_only_where_it_holds() -> None:
    demos = recorded_pairs()
    dead, true = simulated_pairs(demos, "dead"), simulated_pairs(demos, "true")
    worse = verdict(demos, dead, seed=0, baselines={"untrained": true}, references=demos)
    same = verdict(demos, dead, seed=0, baselines={"untrained": dead}, references=demos)
    assert worse.worse_than_untrained and not same.worse_than_untrained
    assert "An untrained network comes nearer" in implausible(worse)[0]
    assert not any("untrained" in sentence for sentence in implausible(same))


@pytest.mark.slow
def test_floor_ceiling_and_references_stand_beside_the_area() -> None:
    demos, others = recorded_pairs(), recorded_pairs(seed=9)
    slow, still = (simulated_pairs(demos, kind) for kind in ("slow", "still"))
    found = verdict(demos, slow, seed=0, floor=demos, baselines={"random": still})
    below = str(verdict_table(found).caption)
    assert "0.500 [0.500, 0.500] for closed-loop tracking" in below
    assert "] for random actions." in below and "The area of that of order is" in below
    assert "tracking" not in str(verdict_table(judged("slow")).caption)
    assert found.areas["auc"]["floor"].estimate == 0.5  # tracked without any error
    assert found.areas["auc"]["ceiling"].estimate > 0.95
    assert set(found.areas["auc_sequence"]) == {"among"}
    assert 0 < found.realism.estimate < found.components.iloc[-1]["ceiling"]
    among = found.areas["auc"]["among"]
    assert among.low < 0.5 < among.high
    refuses("track the evaluated ones", verdict, demos, slow, seed=0, floor=others)


def test_rollouts_told_the_other_condition_do_not_count() -> None:
    demos = recorded_pairs()
    true, bad = simulated_pairs(demos, "true"), simulated_pairs(demos, "dead")
    told = Rollouts.concatenate([
        replace(true, cue=np.zeros(len(true))), replace(bad, cue=np.ones(len(bad)))
    ], "both")  # fmt: skip
    assert len(compare(demos, told, 0)[0].counted) == len(true)
    refuses("were not made from", verdict, demos, replace(true, demo=true.demo + 1), seed=0)


def test_it_is_saved_and_loaded_and_told(tmp_path: Path) -> None:
    found = judged("slow")
    found.save(tmp_path)
    again = Verdict.load(tmp_path)
    assert again.table.equals(found.table)
    for key in ("learner", "starts", "rollouts", "auc", "areas", "realism", "importance"):
        assert getattr(again, key) == getattr(found, key)
    stored = json.loads((tmp_path / "verdict.json").read_text())
    assert (stored["headline"], stored["colour"]) == (found.headline, "red")
    assert "floor" not in again.areas["auc"]
    sentence = verdict_sentence(found)
    assert sentence.startswith("SLOW: of ") and "of 100 pairs" in sentence
    table, blocks = verdict_table(found), list(verdict_blocks(found))
    assert table.row_count == len(found.table)
    tables = [block for block in blocks if isinstance(block, Table)]
    assert [table.label for table in tables] == ["Verdict", "Realism", "Realism by component"]
    rows = [row for table in tables for group in table.groups for row in group.rows]
    assert not any("nan" in cell for row in rows for cell in row.cells)


def test_the_terminal_has_few_lines_with_both_values_and_the_unit() -> None:
    lines = verdict_lines(judged("slow"))
    assert 3 <= len(lines) <= 5
    assert lines[0].startswith("SLOW: of ") and lines[-1].startswith("A classifier takes")
    for line in lines[1:-1]:
        assert re.search(r" for .*\((differs|not known|differs a little)\)$", line)
    assert not any(word in " ".join(lines) for word in ("kinematic", "interactive", "auc", "null"))


def cut_pairs() -> Demonstrations:
    """Recordings of which the film stops after three seconds, as a rule before anything ends."""
    demos = recorded_pairs()
    short = np.minimum(demos.lengths, 25)
    paths = [demos.episode(i).positions[:n] for i, n in enumerate(short.tolist())]
    ends = np.where(demos.lengths > 25, UNFINISHED, demos.outcome)
    return replace(demos, positions=np.concatenate(paths), lengths=short, outcome=ends)


def test_rollouts_stop_where_their_recording_merely_stops() -> None:
    demos = cut_pairs()
    cut = demos.outcome == UNFINISHED
    made = simulated_pairs(demos, "true")
    stopped = censored(made, demos)
    limit = demos.lengths[made.demo]
    assert (
        stopped.lengths == np.where(cut[made.demo], np.minimum(made.lengths, limit), made.lengths)
    ).all()
    assert (stopped.outcome[cut[made.demo] & (made.lengths > limit)] == UNFINISHED).all()
    for i in range(len(made)):
        assert np.array_equal(stopped.path(i), made.path(i)[: stopped.lengths[i]])
    whole = recorded_pairs()
    assert censored(simulated_pairs(whole, "true"), whole).lengths.sum() > 0


def test_an_end_of_the_film_is_no_difference_and_an_early_death_is() -> None:
    demos = cut_pairs()
    assert (demos.outcome == UNFINISHED).sum() > 20
    found = rows_of(demos, simulated_pairs(demos, "true"))
    for key in ("duration", "path_length", "slow_steps"):
        assert found[key].judgement != DIFFERS
    row = rows_of(demos, simulated_pairs(demos, "dead"))["duration"]
    assert row.judgement == DIFFERS and row.verdict.startswith("episodes too short")


def test_survival_of_known_durations() -> None:
    """The scores are the pseudo-values of the mean survival, and durations where nothing is cut."""
    duration, ended = np.array([1.0, 2.0, 2.0, 4.0]), np.array([True, True, False, True])
    scores = restricted_mean_scores(duration, ended)
    assert scores.mean() == pytest.approx(1.0 + 3 / 4 + 2 * (3 / 4 * 2 / 3))
    assert restricted_mean_scores(duration, np.ones(4, bool)).tolist() == duration.tolist()
    rng = np.random.default_rng(0)
    life, film = rng.exponential(5, 200), rng.uniform(0, 12, 200)
    duration, ended = np.minimum(life, film), life <= film

    def mean_survival(chosen: np.ndarray) -> float:
        curve = ecdf(CensoredData(uncensored=duration[chosen & ended],
                                  right=duration[chosen & ~ended])).sf  # fmt: skip
        times = np.concatenate([[0.0], curve.quantiles, [duration.max()]])
        return float((np.diff(times) * np.concatenate([[1.0], curve.probabilities])).sum())

    every = np.ones(200, bool)
    left_out = [mean_survival(np.arange(200) != i) for i in range(200)]
    pseudo = 200 * mean_survival(every) - 199 * np.array(left_out)
    scores = restricted_mean_scores(duration, ended)
    assert np.corrcoef(scores, pseudo)[0, 1] > 0.999
    assert scores.mean() == pytest.approx(mean_survival(every))


def test_measures_of_a_known_path() -> None:
    demos = recorded_pairs()
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], dtype=float)
    both = np.stack([square, np.zeros((5, 2))], axis=1)
    recorded = Rollouts.from_demonstrations(demos)
    one = replace(
        recorded.select(np.array([0])), positions=both, lengths=np.array([5]), outcome=[-2]
    )
    prepared = Prepared(demos)
    vars(prepared)["slow"] = np.array([5.0, 5.0])
    found = {
        metric.key: metric.measure(prepared.episodes(one)) for metric in judged_metrics(prepared)
    }
    assert {metric.key for metric in METRICS if metric.of_recordings} >= {"leaving"} <= set(found)
    assert found["duration"][0] == pytest.approx(0.4)
    assert found["path_length"][0] == pytest.approx(4.0)  # of the pursuer
    assert found["mean_speed"][0] == found["median_speed"][0] == pytest.approx(5.0)
    assert found["slow_steps"][0] == pytest.approx(0.5)  # the target's
    assert found["turning"][0] == pytest.approx(3 * np.pi / 2 / 2 / 0.4)
    assert found["pursuer_out"][0] == found["leaving"][0] == 1.0


def test_who_is_held_by_a_wall_has_not_left() -> None:
    """Stored positions are rounded, so that one at a wall may lie a little beyond it."""
    demos = load_packaged("fly").select(episodes=np.arange(12))
    scenario = make_scenario("fly", demos=demos, start="demo")
    away = SimpleNamespace(predict=lambda seen, *_, **__: (np.full(len(seen), 6), None))
    rollouts = collect_rollouts(
        partial(make_world, scenario), away, method="away", seed=0, repetitions=1
    )
    reach = np.hypot(*np.moveaxis(rollouts.positions, -1, 0))
    assert reach.max() > 1.0 - 1e-5  # somebody is at the wall
    prepared = Prepared(demos)
    assert not measures(prepared, rollouts)["leaving"].any()
    beyond = replace(rollouts, positions=rollouts.positions * 1.001)
    assert measures(prepared, beyond)["leaving"].any()


def test_slow_is_a_quarter_of_the_median_moving_speed() -> None:
    demos = recorded_pairs()
    steps = np.repeat([0.0, 0.1], [60, 40])
    line = np.concatenate([[0.0], np.cumsum(steps)])
    path = np.zeros((101, 2, 2))
    path[:, :, 0] = line[:, None]
    recorded = Rollouts.from_demonstrations(demos).select(np.array([0]))
    one = replace(recorded, positions=path, lengths=np.array([101]))
    assert slow_speeds(one) == pytest.approx([0.25, 0.25])  # moving at 1 arena unit / s


def differences(
    recorded: np.ndarray, simulated: np.ndarray, demo: np.ndarray, rng: np.random.Generator,
    unit: np.ndarray | None = None,
) -> Differences:  # fmt: skip
    starts, measures = recorded.shape
    no = np.zeros(measures, dtype=bool)
    unit = np.arange(starts) if unit is None else unit
    sides = Sides(demo=demo, unit=unit, weight=np.ones((starts, measures)), binary=no, primary=no)
    return simultaneous_differences(recorded, simulated, sides, rng)


@pytest.mark.parametrize("shared", [0.0, 3.0])
def test_simultaneous_intervals_of_a_perfect_simulator_hold_zero(shared: float) -> None:
    """What a start decides of a value (``shared``) makes no difference, nor do long tails."""
    rng = np.random.default_rng(7)
    starts, each, measures, experiments = 12, 3, 4, 100
    demo, outside = np.repeat(np.arange(starts), each), 0
    for _ in range(experiments):
        centre = shared * rng.normal(size=(starts, measures))
        drawn = np.exp(np.concatenate([centre, centre[demo]]) / 3 + rng.normal(size=(48, measures)))
        found = differences(drawn[:starts], drawn[starts:], demo, rng)
        outside += bool((np.abs(found.value) > found.margin).any())
    assert outside <= 0.08 * experiments


def test_simultaneous_intervals_of_clustered_pieces_hold_zero() -> None:
    """Animals differ, and each was cut into five pieces: without its unit 30 % would be alarms."""
    rng = np.random.default_rng(8)
    animals, pieces, each, outside = 10, 5, 3, 0
    unit = np.repeat(np.arange(animals), pieces)
    demo = np.repeat(np.arange(len(unit)), each)
    for _ in range(100):
        own = np.exp(0.5 * rng.normal(size=(animals, 3)))[unit]
        recorded = own * np.exp(0.2 * rng.normal(size=own.shape))
        anybody = np.exp(0.5 * rng.normal(size=(len(demo), 3)))
        simulated = anybody * np.exp(0.2 * rng.normal(size=anybody.shape))
        found = differences(recorded, simulated, demo, rng, unit)
        outside += bool((np.abs(found.value) > found.margin).any())
    assert outside <= 8


def test_simultaneous_intervals_are_wider_the_more_measures_there_are() -> None:
    rng = np.random.default_rng(0)
    recorded, simulated = rng.normal(size=(20, 30)), rng.normal(size=(60, 30))
    demo = np.repeat(np.arange(20), 3)
    many = differences(recorded, simulated, demo, np.random.default_rng(1))
    one = differences(recorded[:, :1], simulated[:, :1], demo, np.random.default_rng(1))
    assert one.value[0] == pytest.approx(many.value[0]) and one.margin[0] < 0.9 * many.margin[0]
    t = stats.t.ppf(1 - 0.03 / 2, 19)
    assert one.margin[0] >= 0.95 * t * one.error[0]


def test_copies_are_of_one_policy_and_one_start() -> None:
    demos = recorded_pairs()
    recorded = Rollouts.from_demonstrations(demos)
    twice = Rollouts.concatenate([recorded, replace(recorded, repetition=recorded.repetition + 1)])
    count = len(recorded)
    assert twice.copies.tolist() == [False] * count + [True] * count
    another = Rollouts.concatenate([recorded, replace(recorded, seed=recorded.seed + 1)])
    assert not another.copies.any()
    moved = Rollouts.concatenate([recorded, replace(recorded, positions=recorded.positions + 1e-9)])
    assert not moved.copies.any()
    by_chance = Rollouts.concatenate([twice, moved.select(np.arange(len(moved)) == count)])
    assert not by_chance.copies.any()  # it may do otherwise, so that each counts


def test_copies_do_not_count() -> None:
    demos = recorded_pairs()
    once = simulated_pairs(demos, "true", each=1)
    again = [replace(once, repetition=once.repetition + i) for i in range(5)]
    one, five = (rows_of(demos, some) for some in (once, Rollouts.concatenate(again)))
    for name, row in one.items():
        assert five[name].low == pytest.approx(row.low, nan_ok=True)


def test_recordings_without_rollouts_are_left_out() -> None:
    rng = np.random.default_rng(9)
    recorded = np.array([[1.0], [1e9], [1.0], [2.0]])
    found = differences(recorded, np.ones((4, 1)), np.array([0, 0, 2, 3]), rng)
    assert found.recorded[0] == pytest.approx(4 / 3) and found.units[0] == 3


def test_circles_are_said_in_words() -> None:
    assert ORDER_METRICS["turn autocorrelation at"].complaint(more=True).startswith("keeps turning")
    assert ORDER_METRICS["turning"].complaint(more=True) == "turns too much"
    own = replace(ORDER_METRICS["spread of speed"], label="Spread of speed, larva")
    assert own.complaint(more=False) == "spread of speed, larva too low"


def test_lengths_are_told_in_the_recordings_unit_where_it_is_known() -> None:
    demos = recorded_pairs()
    assert unit_of(demos).name == "arena units"
    scales = {name: {"centre": [0, 0], "unit": 72.5, "y_sign": 1} for name in demos.recording}
    in_mm = replace(demos, provenance={**demos.provenance, "unit": "mm", "scales": scales})
    assert (unit_of(in_mm).name, unit_of(in_mm).per_arena_unit) == ("mm", 72.5)
    in_px = replace(in_mm, provenance={**in_mm.provenance, "unit": "px"})
    assert unit_of(in_px).name == "arena units"
