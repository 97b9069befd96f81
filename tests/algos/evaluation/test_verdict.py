"""The verdict: a true simulator passes, and every way of being wrong is called by its name."""

from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from moving_pairs import recorded_pairs, simulated_pairs
from refusals import refuses

from animarl_algos.evaluation.collect import collect_rollouts
from animarl_algos.evaluation.metrics import METRICS, judged_metrics, measures
from animarl_algos.evaluation.order_in_time import KINEMATIC, MEASURES
from animarl_algos.evaluation.prepared import (
    Prepared,
    censored,
    log_rank_scores,
    mean_survival,
    slow_speeds,
)
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict import FEWEST, WORSE, Verdict, verdict
from animarl_algos.evaluation.verdict_rows import (
    BY_LITTLE,
    DIFFERS,
    SAME,
    UNKNOWN,
    Exchanges,
    exchange_test,
)
from animarl_algos.report.page import Table
from animarl_algos.report.verdict_section import verdict_blocks, verdict_sentence, verdict_table
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.summary import unit_of
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world
from benchmarks.verdict_power import whole_verdict


@cache
def judged(kind: str) -> Verdict:
    demos = recorded_pairs()
    return verdict(demos, simulated_pairs(demos, kind), seed=0, references=recorded_pairs(seed=9))


def test_the_true_simulator_moves_like_the_recordings() -> None:
    found = judged("true")
    assert found.judgement == found.overall == SAME
    assert (found.table["judgement"] == SAME).all()
    assert found.auc.low <= 0.5 <= found.auc.high
    demos = recorded_pairs()  # the quick answer is the colour of the page
    for kind in ("true", "still"):
        green = whole_verdict(demos, simulated_pairs(demos, kind), seed=0)
        assert green == (judged(kind).judgement == SAME)


def test_the_recordings_themselves_move_like_the_recordings() -> None:
    demos = recorded_pairs()
    found = verdict(
        demos, replace(Rollouts.from_demonstrations(demos), method="replay"), seed=0,
        references=recorded_pairs(seed=9),
    )  # fmt: skip
    assert found.judgement == SAME
    assert found.row("duration")["distance"] == 0
    assert found.auc.estimate == 0.5


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("still", {"too slow", "paths too short", "stands still too often"}),
        ("dead", {"episodes too short", "paths too short"}),
        ("slow", {"too slow", "paths too short"}),
        ("leaving", {"leaves the arena"}),
    ],
)
def test_what_is_wrong_is_called_by_its_name(kind: str, words: set[str]) -> None:
    found = judged(kind)
    assert words <= set(found.words)
    assert found.auc.estimate > 0.9 or kind == "leaving"


def test_a_headline_says_no_more_than_the_weakest_row() -> None:
    for judgement, others in ((DIFFERS, {SAME, BY_LITTLE, UNKNOWN}), (BY_LITTLE, {SAME})):
        table = judged("true").table.copy()
        assert set(table["judgement"]) == {SAME}
        for other, place in zip(sorted(others), range(len(others))):
            table.loc[place, "judgement"] = other
        table.loc[len(table) - 1, "judgement"] = judgement
        assert replace(judged("true"), table=table).judgement == judgement
    unknown = judged("true").table.copy()
    unknown.loc[0, "judgement"], unknown.loc[1, "judgement"] = UNKNOWN, BY_LITTLE
    assert replace(judged("true"), table=unknown).judgement == UNKNOWN


def test_what_differs_by_little_is_said_with_how_much() -> None:
    demos = recorded_pairs()
    replayed = replace(Rollouts.from_demonstrations(demos), method="replay")
    first = np.repeat(replayed.positions[replayed.offsets[:-1]], replayed.lengths, axis=0)
    faster = replace(replayed, positions=first + 1.06 * (replayed.positions - first))
    row = verdict(demos, faster, seed=0).row("mean_speed")
    assert row["judgement"] == BY_LITTLE
    assert row["verdict"] == "differs, but by little: too fast by 6 %"
    much = replace(replayed, positions=first + 1.3 * (replayed.positions - first))
    row = verdict(demos, much, seed=0).row("mean_speed")
    assert (row["judgement"], row["verdict"]) == (DIFFERS, "too fast")


def test_order_in_time_is_told_in_the_unit_of_the_recordings() -> None:
    demos = recorded_pairs()
    scales = {name: {"unit": 50.0} for name in np.unique(demos.recording).tolist()}
    own = replace(demos, provenance={**demos.provenance, "unit": "mm", "scales": scales})
    plain, told = (
        verdict(one, simulated_pairs(demos, "slow"), seed=0, references=one).row(KINEMATIC)
        for one in (demos, own)
    )
    assert told["unit"] == "mm/s" and plain["unit"] == "arena units/s"
    for column in ("recorded", "simulated", "value", "distance", "null"):
        assert told[column] == pytest.approx(50 * plain[column])
    assert f"recorded {told['recorded']:.2g} mm/s" in told["verdict"]
    assert told["p"] == plain["p"]


def test_tracking_excuses_nothing() -> None:
    demos = recorded_pairs()
    slow = simulated_pairs(demos, "slow")
    first = np.repeat(demos.positions[demos.offsets[:-1]], demos.lengths, axis=0)
    floor = replace(demos, positions=first)  # as bad as can be: everybody stays at the start
    excused = verdict(demos, slow, seed=0, floor=floor, references=demos)
    assert excused.areas["auc"]["floor"].estimate > 0.9
    assert excused.row("auc")["judgement"] == DIFFERS


def test_few_starts_or_recordings_are_too_little_to_say() -> None:
    demos = recorded_pairs()
    few = demos.select(episodes=np.arange(FEWEST - 1))
    found = verdict(few, simulated_pairs(few, "true"), seed=0, references=demos)
    assert found.judgement == UNKNOWN
    assert found.too_little == "9 test starts, and 10 are needed"
    assert "Too little data to say whether TRUE moves like" in verdict_sentence(found)
    pieces = replace(demos, recording=np.full(len(demos), "one"))
    found = verdict(pieces, simulated_pairs(pieces, "true"), seed=0, references=demos)
    assert (found.judgement, found.too_little) == (UNKNOWN, "1 recording, and 10 are needed")


def test_tied_scores_are_no_evidence_of_likeness() -> None:
    demos = recorded_pairs().select(episodes=np.arange(2))
    found = verdict(demos, simulated_pairs(demos, "dead"), seed=0)
    row = found.row("auc")
    assert row["judgement"] == UNKNOWN and "all scores are tied" in row["verdict"]


def test_a_simulator_without_spread_is_found_out() -> None:
    found = judged("uniform")
    assert "durations too much alike" in found.words
    row = found.row("duration")
    assert row["energy"] > judged("true").row("duration")["energy"]


def test_starts_that_were_rolled_out_more_often_weigh_no_more() -> None:
    demos = recorded_pairs()
    every = simulated_pairs(demos, "slow")
    later = np.flatnonzero(every.demo >= demos.num_episodes // 2)
    uneven = every.select(np.concatenate([np.arange(len(every)), later, later]))
    rows = [verdict(demos, each, seed=0, references=demos).row for each in (every, uneven)]
    for name in ("duration", "path_length", "mean_speed"):
        once, often = (row(name) for row in rows)
        assert often["simulated"] == pytest.approx(once["simulated"])
        assert often["value"] == pytest.approx(often["simulated"] - often["recorded"])


def test_worse_than_untrained_is_said_only_where_it_holds() -> None:
    demos = recorded_pairs()
    dead, true = simulated_pairs(demos, "dead"), simulated_pairs(demos, "true")
    worse = verdict(demos, dead, seed=0, baselines={"untrained": true}, references=demos)
    same = verdict(demos, dead, seed=0, baselines={"untrained": dead}, references=demos)
    assert worse.words == (WORSE, *same.words)


def test_floor_ceiling_and_references_stand_beside_the_area() -> None:
    demos, others = recorded_pairs(), recorded_pairs(seed=9)
    slow, still = (simulated_pairs(demos, kind) for kind in ("slow", "still"))
    found = verdict(demos, slow, seed=0, floor=demos, baselines={"random": still})
    below = str(verdict_table(found).caption)
    assert "The classifier's AUC is 0.500 [0.500, 0.500] for closed-loop tracking" in below
    assert "] for random actions." in below and "The AUC of order is" in below
    assert "tracking" not in str(verdict_table(judged("slow")).caption)
    assert found.areas["auc"]["floor"].estimate == 0.5  # tracked without any error
    assert found.areas["auc"]["ceiling"].estimate > 0.95
    assert set(found.areas["auc_sequence"]) == {"among", "floor", "ceiling"}
    assert 0 < found.realism.estimate < found.realism_beside["ceiling"]
    among = found.areas["auc"]["among"]
    assert among.low < 0.5 < among.high
    refuses("track the evaluated ones", verdict, demos, slow, seed=0, floor=others)


def test_rollouts_told_the_other_condition_do_not_count() -> None:
    demos = recorded_pairs()
    true, bad = simulated_pairs(demos, "true"), simulated_pairs(demos, "dead")
    told = Rollouts.concatenate([
        replace(true, cue=np.zeros(len(true))), replace(bad, cue=np.ones(len(bad)))
    ], "both")  # fmt: skip
    assert verdict(demos, told, seed=0, references=demos).rollouts == len(true)
    refuses("were not made from", verdict, demos, replace(true, demo=true.demo + 1), seed=0)


def test_it_is_saved_and_loaded_and_told(tmp_path: Path) -> None:
    found = judged("slow")
    found.save(tmp_path)
    again = Verdict.load(tmp_path)
    assert again.table.equals(found.table)
    for key in ("words", "learner", "starts", "rollouts", "auc", "areas", "realism", "importance"):
        assert getattr(again, key) == getattr(found, key)
    assert "floor" not in again.areas["auc"]
    sentence = verdict_sentence(found)
    assert sentence.startswith("SLOW differs from the demonstrations (")
    assert "60 rollouts from 30 starts" in sentence
    table, blocks = verdict_table(found), list(verdict_blocks(found))
    assert table.row_count == len(found.table)
    tables = [block for block in blocks if isinstance(block, Table)]
    assert [table.label for table in tables] == ["Verdict", "Realism", "Realism by component"]
    rows = [row for table in tables for group in table.groups for row in group.rows]
    assert not any("nan" in cell for row in rows for cell in row.cells)


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
    found = verdict(demos, simulated_pairs(demos, "true"), seed=0)
    for key in ("duration", "path_length", "slow_steps"):
        assert found.row(key)["judgement"] == SAME
    row = verdict(demos, simulated_pairs(demos, "dead"), seed=0).row("duration")
    assert row["judgement"] == DIFFERS and row["verdict"] == "episodes too short"


def test_survival_of_known_durations() -> None:
    duration, ended = [1.0, 2.0, 2.0, 4.0], [True, True, False, True]
    hazard = np.array([1 / 4, 1 / 4 + 1 / 3, 1 / 4 + 1 / 3, 1 / 4 + 1 / 3 + 1])
    assert log_rank_scores(duration, ended) == pytest.approx(np.array(ended) - hazard)
    curve = 1.0 + 3 / 4 + 2 * (3 / 4 * 2 / 3)
    assert mean_survival(duration, ended, 4.0) == pytest.approx(curve)
    assert mean_survival([3.0, 3.0], [False, False], 3.0) == 3.0


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
    found = {metric.key: metric.measure(prepared.episodes(one)) for metric in judged_metrics(demos)}
    assert set(found) < {metric.key for metric in METRICS}
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


@pytest.mark.parametrize("shared", [0.0, 3.0])
def test_a_perfect_simulator_falls_inside_its_null_in_95_percent(shared: float) -> None:
    rng = np.random.default_rng(7)
    starts, each, experiments = 12, 3, 300
    demo = np.repeat(np.arange(starts), each)
    inside = np.zeros(2)
    for _ in range(experiments):
        centre = shared * rng.normal(size=starts)  # what a start decides of the value
        drawn = np.exp(np.concatenate([centre, centre[demo]]) / 3 + rng.normal(size=48))
        exchanges = Exchanges.draw(demo, starts, rng, 99)
        inside += [
            exchange_test(drawn[:, None], exchanges).p > 0.05,
            exchanges.chi_squared(np.digitize(drawn, [0.5, 2.0])).p > 0.05,
        ]
    share = inside / experiments
    assert (share >= 0.92).all()
    assert share[0] <= 0.985  # counts tie, so the test of shares may be more careful


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


def test_the_null_of_a_verdict_does_not_count_copies() -> None:
    demos = recorded_pairs()
    once = simulated_pairs(demos, "true", each=1)
    again = [replace(once, repetition=once.repetition + i) for i in range(5)]
    tables = [verdict(demos, one, seed=0).table for one in (once, Rollouts.concatenate(again))]
    motion = ~tables[0]["measure"].str.startswith("auc")
    for column in ("distance", "null", "p"):
        one, five = (table.loc[motion, column].to_numpy(float) for table in tables)
        np.testing.assert_allclose(five, one, rtol=1e-12)


def test_recordings_without_rollouts_are_left_out() -> None:
    rng = np.random.default_rng(9)
    exchanges = Exchanges.draw([0, 0, 2], 3, rng, 5)
    values = np.array([1.0, 1e9, 1.0, 1.0, 1.0, 2.0])
    assert exchange_test(values[:, None], exchanges).recorded[0] == 1.0
    refuses("recordings 0 to 2", Exchanges.draw, [3], 3, rng)


def test_circles_are_said_in_words() -> None:
    assert MEASURES["turn autocorrelation at"].words(more=True) == "walks in circles"
    assert MEASURES["turning"].words(more=True) == "turns too much"
    own = replace(MEASURES["spread of speed"], name="spread of speed, larva")
    assert own.words(more=False) == "spread of speed, larva too low"


def test_lengths_are_told_in_the_recordings_unit_where_it_is_known() -> None:
    demos = recorded_pairs()
    assert unit_of(demos).name == "arena units"
    scales = {name: {"centre": [0, 0], "unit": 72.5, "y_sign": 1} for name in demos.recording}
    in_mm = replace(demos, provenance={**demos.provenance, "unit": "mm", "scales": scales})
    assert (unit_of(in_mm).name, unit_of(in_mm).per_arena_unit) == ("mm", 72.5)
    in_px = replace(in_mm, provenance={**in_mm.provenance, "unit": "px"})
    assert unit_of(in_px).name == "arena units"
