"""The benchmark of what-ifs: what made the recordings, in the changed world, beside a clone."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from animarl_algos import load_run
from animarl_envs.errors import InputError
from benchmarks.whatif_bars import bars, held_out_rules, page, summary, warned
from benchmarks.whatif_truth import Truth, answered, entered_run, false_claims, rows


def test_a_clone_of_agents_is_right_about_a_weaker_prey_and_its_absurd_answer_is_caught() -> None:
    run = load_run("agent")
    found = list(answered([run], ("prey.thrust=x0.8", "arena=x3"), 2, None))
    table = pd.DataFrame([row for one in found for row in rows("agent", [run], one)])
    # A thrust is asked in both readings, an arena has one.
    assert [(one.scenario.name, one.reading) for one in found] == [
        ("prey.thrust=x0.8", "habit"), ("arena=x3", "habit"), ("prey.thrust=x0.8", "knows"),
    ]  # fmt: skip
    of = table.set_index(["change", "reading", "quantity"])
    caught_sooner = of.loc[("prey.thrust=x0.8", "habit", "duration")]
    assert caught_sooner["true_high"] < 0 and caught_sooner["clear"]
    assert caught_sooner["sign_right"] and caught_sooner["covered"] and not caught_sooner["wrong"]
    absurd = of.loc[("arena=x3", "habit", "duration")]
    assert absurd["wrong"] and not absurd["covered"] and absurd["warning"] == "red"
    short = summary(table).set_index("warning")
    assert short.loc["red", "wrong"] >= 4 and short["rows"].sum() == len(table)
    held = bars(table).set_index(["set", "bar"])
    assert held.loc[("agent", "no warning: sign right in all"), "met"] == "yes"
    caught = held.loc[("all", "90 % of wrong rows are warned of"), "found"].split(" of ")
    assert int(caught[0]) >= 4 and caught[1] == str(table["wrong"].sum())
    assert "1 of 3 changes are predicted wrongly" in warned(table)
    assert "1 of these have a red warning" in warned(table)
    written = page(table.assign(commit="abc"), summary(table), bars(table))
    assert "agent: 1 training seed, commit abc" in written
    assert "judged on the set" not in written  # there is no other


def test_a_rule_of_a_warning_is_judged_on_the_set_that_it_was_not_made_on() -> None:
    rng = np.random.default_rng(0)
    wrong, sets = np.tile([True, False], 60), np.repeat(["a", "b", "c"], 40)
    table = pd.DataFrame({"set": sets, "change": "arena=x2", "reading": "habit", "wrong": wrong})
    table["beyond"] = np.where(wrong, 0.5, 0.0) + rng.uniform(0.0, 0.1, 120)
    for column in ("predicted", "low", "high", "gap", "seeds_low", "seeds_high", "other_reading"):
        table[column] = rng.normal(size=120)
    found = held_out_rules(table).set_index("rule")
    told = found.loc["inputs beyond training"]
    assert told["wrong rows"] > 0.8 and told["right rows"] == 0
    assert found.loc["all of them", "right rows"] < 0.1 < 0.8 < found.loc["all of them"].iloc[0]
    assert found.loc["seeds disagree", "right rows"] > 0.6  # chance: as many of both
    # A set whose wrong rows look otherwise is not warned of, however well the others are known.
    table.loc[table["set"] == "c", "beyond"] = 0.0
    assert held_out_rules(table).iloc[0]["wrong rows"] < 0.75


def test_claims_of_permuted_conditions_are_counted_with_and_without_their_null() -> None:
    run = load_run("agent")
    found = false_claims("agent", [run, run], 1).set_index(["told", "quantity"])
    assert (found["clones"] == 2).all() and set(found.index.levels[0]) == {"individual", "shared"}
    # A network that learned a true difference claims it by its rollouts; beside itself it cannot.
    assert found.loc[("shared", "any of them"), "by rollouts"] == 2
    assert (found["by the null"] == 0).all()


def test_simulators_of_others_can_enter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "examples" / "benchmark"))
    run = entered_run("agent", "methods:make_gliding", 0)
    (one,) = answered([run], ("contact=x1.5",), 1, None)
    table = pd.DataFrame(rows("agent", [run], one)).set_index("quantity")
    # Nobody sets out, so nobody's path gets shorter: the whole true shift is missed.
    path = table.loc["path length"]
    assert np.isfinite(table["predicted"]).all() and path["predicted"] == 0.0
    assert path["miss"] == pytest.approx(-path["true"]) and path["clear"] and not path["covered"]
    with pytest.raises(InputError, match="make_nothing"):
        entered_run("agent", "methods:make_nothing", 0)


@pytest.mark.parametrize("name", ["agent", "fly", "silkmoth"])
def test_the_truth_in_the_unchanged_world_is_like_the_recordings(name: str) -> None:
    run = load_run(name)
    truth = Truth(run, None, 4)
    made = truth.roll_out(None, "habit", 0)
    assert set(made.demo) == set(range(len(truth.test)))
    seconds = (truth.test.lengths - 1).mean() * run.demos.dt
    assert (made.lengths - 1).mean() * made.dt == pytest.approx(seconds, rel=0.55)
    starts = made.positions[made.offsets[:-1]]
    assert np.allclose(starts, truth.test.positions[truth.test.offsets[:-1]][made.demo], atol=1e-5)
