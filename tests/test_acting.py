"""The acting rule: data that is checked, written and read, and what it chooses."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from animarl_algos.networks.acting_rule import Acting, Kind
from animarl_envs.errors import InputError

RULES = (
    Acting(),
    Acting.boltzmann(0.7),
    Acting.boltzmann([0.7, 0.25, 3.0]),
    Acting.epsilon_greedy(0.1),
)


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_a_rule_survives_writing(rule: Acting) -> None:
    assert Acting.parse(str(rule)) == rule
    assert Acting.from_json(json.loads(json.dumps(rule.to_json()))) == rule


def test_what_is_written_on_the_command_line() -> None:
    assert Acting.parse("greedy").kind is Kind.GREEDY
    assert Acting.parse("boltzmann:0.7").temperature == (0.7,)
    assert Acting.parse("boltzmann:0.7,0.4").temperature == (0.7, 0.4)
    assert Acting.parse("epsilon:0.1").epsilon == 0.1


def test_models_of_before_hold_two_numbers() -> None:
    assert Acting.from_json({"epsilon": 0.3, "temperature": None}) == Acting.epsilon_greedy(0.3)
    sampled = Acting.from_json({"epsilon": 0.3, "temperature": [0.5, 0.6]})
    assert (sampled.kind, sampled.temperature) == (Kind.BOLTZMANN, (0.5, 0.6))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Acting("argmax"), "'argmax': choose greedy, boltzmann, epsilon"),  # type: ignore[arg-type]
        (lambda: Acting.boltzmann(0.0), "temperature is 0.0"),
        (lambda: Acting.boltzmann([]), "holds no number"),
        (lambda: Acting.boltzmann([1.0, np.nan]), "temperature is nan"),
        (lambda: Acting.epsilon_greedy(1.5), "epsilon is 1.5"),
        (lambda: Acting.parse("boltzmann"), "write greedy, boltzmann"),
        (lambda: Acting.parse("greedy:1"), "write greedy, boltzmann"),
        (lambda: Acting.parse("epsilon:a"), "write greedy, boltzmann"),
        (lambda: Acting.from_json({"kind": "greedy"}), r"not \['kind'\]"),
        (lambda: Acting.boltzmann([1.0, 2.0]).check_individuals(3), "2 numbers for 3"),
    ],
)
def test_what_is_no_rule_is_refused(make: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


def test_greedy_takes_the_lowest_of_the_best_and_epsilon_0_is_greedy() -> None:
    values = np.zeros((6, 5))
    values[:, [2, 4]] = 1.0
    draw = np.linspace(0.0, 0.99, 6)
    assert (Acting().choose(values, draw, 3) == 2).all()
    assert (Acting.epsilon_greedy(0.0).choose(values, draw, 3) == 2).all()


def test_each_individual_is_sampled_at_its_own_temperature() -> None:
    values = np.array([[2.0, 1.0, 0.0]] * 2)
    draw = np.random.default_rng(0).random(40_000)
    chosen = Acting.boltzmann([0.5, 2.0]).choose(np.tile(values, (20_000, 1)), draw, 2)
    for k, temperature in enumerate((0.5, 2.0)):
        expected = np.exp(values[k] / temperature) / np.exp(values[k] / temperature).sum()
        counts = np.bincount(chosen[k::2], minlength=3) / 20_000
        np.testing.assert_allclose(counts, expected, atol=5 * np.sqrt(0.25 / 20_000))


def test_a_policy_holds_a_rule_and_schedules_of_epsilon_go_through_it() -> None:
    from test_policies import make

    policy = make(acting=Acting.boltzmann(0.7))
    assert policy.temperature == 0.7
    policy.epsilon = 0.2
    assert policy.acting.kind is Kind.BOLTZMANN  # epsilon leaves a sampling rule one
    policy.temperature = None
    assert policy.acting == Acting.epsilon_greedy(0.2)
    policy.acting = Acting()
    assert policy.temperature is None and policy.epsilon == 0.0
    with pytest.raises(InputError, match="2 numbers for 3 individuals"):
        policy.acting = Acting.boltzmann([1.0, 2.0])
