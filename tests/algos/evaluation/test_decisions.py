"""What a policy would decide along a recorded path."""

from typing import Any

import numpy as np
import pytest
from report_inputs import make_demos

from animarl_algos.runs.inspecting import Decisions, decide_along
from animarl_envs.species import SPECIES


class Counter:
    """Values that show the policy's memory (steps counted) and the flag; 1 more for slot % 3."""

    def __init__(self) -> None:
        self.previous_actions: list[Any] = []

    def advance(self, observation: Any, state: Any, episode_start: Any) -> tuple[Any, Any, bool]:
        slots = len(observation)
        count = np.zeros((slots, 1)) if state is None else state[0].reshape(slots, 1)
        self.previous_actions.append(None if state is None else state[1])
        q = np.zeros((slots, 13)) + 10.0 * count + observation[:, -1:]
        q[np.arange(slots), np.arange(slots) % 3] += 1.0
        return q, count + 1, False


DEMOS = make_demos()
STEPS = int(DEMOS.lengths[3]) - 1
FLAG = float(DEMOS.condition[3])


def decisions(policy: Counter, focal: str | None = None) -> Decisions:
    return decide_along(policy, SPECIES["agent"], DEMOS, 3, condition_flag=True, focal=focal)


def test_decisions_follow_the_recorded_path() -> None:
    policy = Counter()
    made = decisions(policy)
    assert (made.individual, made.demo, len(made.q)) == ("predator_0", 3, STEPS)
    assert made.q[:, 0] == pytest.approx(10.0 * np.arange(STEPS) + 1.0 + FLAG)
    told = [actions[0] for actions in policy.previous_actions[1:STEPS]]
    assert np.array_equal(told, made.actions[: STEPS - 1])


def test_a_policy_of_a_single_individual_tells_that_ones_values() -> None:
    """From its own slots: no others are asked about."""
    policy = Counter()
    prey = decisions(policy, focal="prey")
    assert (prey.individual, len(prey.q)) == ("prey", STEPS)
    assert policy.previous_actions[-1].shape == (1,)
    assert not np.array_equal(prey.actions, decisions(Counter()).actions)
