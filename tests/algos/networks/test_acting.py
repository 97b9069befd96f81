"""The acting rule: data that is checked, written and read, and what it chooses."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from animarl_algos.networks.acting_rule import Acting, two_stage_logits
from animarl_envs.errors import InputError

RULES = {
    "greedy": Acting(),
    "boltzmann:0.7": Acting.boltzmann(0.7),
    "boltzmann:0.7,0.25,3": Acting.boltzmann([0.7, 0.25, 3.0]),
    "boltzmann:0.7,0.4/0.6/0.35": Acting.boltzmann([0.7, 0.4], thrust=0.6, direction=0.35),
    "epsilon:0.1": Acting.epsilon_greedy(0.1),
}


@pytest.mark.parametrize("text", RULES)
def test_a_rule_survives_writing(text: str) -> None:
    rule = RULES[text]
    assert Acting.parse(text) == rule and str(rule) == text
    assert Acting.from_json(json.loads(json.dumps(rule.to_json()))) == rule


def test_a_policy_is_given_a_rule_for_its_own_individuals() -> None:
    from test_policies import make

    policy = make(acting=Acting.boltzmann(0.7))
    assert policy.acting.temperature == (0.7,)
    with pytest.raises(InputError, match="2 numbers for 3 individuals"):
        policy.acting = Acting.boltzmann([1.0, 2.0])


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
        (lambda: Acting.parse("boltzmann:1/0.5"), "write greedy, boltzmann"),
        (lambda: Acting.parse("epsilon:0.1/0.5/0.5"), "write greedy, boltzmann"),
        (lambda: Acting.boltzmann(1.0, direction=0.0), "direction is 0.0"),
        (lambda: Acting.boltzmann([1.0, 2.0]).checked(3, 13), "2 numbers for 3"),
        (lambda: Acting.boltzmann(1.0, thrust=0.5).checked(1, 12), "not 12 actions"),
    ],
)
def test_what_is_no_rule_is_refused(make: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


def test_each_individual_is_sampled_at_its_own_temperature() -> None:
    values = np.array([[2.0, 1.0, 0.0]] * 2)
    draw = np.random.default_rng(0).random(40_000)
    chosen = Acting.boltzmann([0.5, 2.0]).choose(np.tile(values, (20_000, 1)), draw, 2)
    for k, temperature in enumerate((0.5, 2.0)):
        expected = np.exp(values[k] / temperature) / np.exp(values[k] / temperature).sum()
        counts = np.bincount(chosen[k::2], minlength=3) / 20_000
        np.testing.assert_allclose(counts, expected, atol=5 * np.sqrt(0.25 / 20_000))


def odds(thrust: float, direction: float, logits: Any) -> Any:
    """What the rule's formula says, written out action by action."""
    p = np.exp(logits) / np.exp(logits).sum()
    together = [p[12 * m : 12 * m + 12].sum() for m in range(len(p) // 12)] + [p[-1]]
    hard = np.array(together) ** (1 / thrust)
    hard /= hard.sum()
    found = np.empty_like(p)
    for m in range(len(p) // 12):
        way = (p[12 * m : 12 * m + 12] / together[m]) ** (1 / direction)
        found[12 * m : 12 * m + 12] = hard[m] * way / way.sum()
    found[-1] = hard[-1]
    return found


@pytest.mark.parametrize("thrusts", [1, 2])
def test_how_hard_and_which_way_have_temperatures_of_their_own(thrusts: int) -> None:
    logits = np.random.default_rng(thrusts).normal(size=12 * thrusts + 1)
    for thrust, direction in ((1.0, 1.0), (0.5, 1.0), (1.0, 0.3), (0.6, 0.35)):
        sampled = np.exp(two_stage_logits(logits[None], thrust, direction)[0])
        np.testing.assert_allclose(sampled, odds(thrust, direction, logits), rtol=1e-12)
    assert np.isfinite(two_stage_logits(1e4 * logits[None], 0.1, 0.1)).all()
