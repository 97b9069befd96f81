"""What a policy would decide along a recorded path and over the arena, in a file and on a page."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_inputs import make_demos, rendered, report_inputs

from animarl_algos.evaluation.decisions import Decisions, decide_along
from animarl_envs.errors import InputError
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
MEDIAN = int(np.argsort(DEMOS.lengths, kind="stable")[6])  # the episode of median length
STEPS = int(DEMOS.lengths[MEDIAN]) - 1
FLAG = float(DEMOS.condition[MEDIAN])


def decisions(policy: Counter, focal: str | None = None) -> Decisions:
    return decide_along(policy, SPECIES["agent"], DEMOS, condition_flag=True, focal=focal)


def test_decisions_follow_the_recorded_path() -> None:
    policy = Counter()
    made = decisions(policy)
    assert (made.individual, made.demo, len(made.q)) == ("predator_0", MEDIAN, STEPS)
    assert made.q[:, 0] == pytest.approx(10.0 * np.arange(STEPS) + 1.0 + FLAG)
    told = [actions[0] for actions in policy.previous_actions[1:STEPS]]
    assert np.array_equal(told, made.actions[: STEPS - 1])
    # The map is taken with the memory of that moment, for each place of the arena.
    assert made.map_q[..., 0] == pytest.approx(10.0 * made.moment + 1.0 + FLAG)
    assert np.allclose(np.linalg.norm(made.focus, axis=-1), 1.0)


def test_a_policy_of_a_single_individual_tells_that_ones_values() -> None:
    """From its own slots: no others are asked about."""
    policy = Counter()
    prey = decisions(policy, focal="prey")
    assert (prey.individual, len(prey.q)) == ("prey", STEPS)
    assert policy.previous_actions[-1].shape == (len(prey.x) ** 2,)
    assert not np.array_equal(prey.actions, decisions(Counter()).actions)
    assert prey.map_q.max(axis=-1) == pytest.approx(10.0 * prey.moment + 1.0 + FLAG)
    assert np.array_equal(prey.others[0], DEMOS.episode(MEDIAN).positions[prey.moment, 0])
    assert "target a cross" not in rendered(dataclasses.replace(report_inputs(), decisions=prey))


def test_decisions_pass_through_a_file_onto_the_page(tmp_path: Path) -> None:
    made = decisions(Counter())
    made.save(tmp_path / "decisions.npz")
    read = Decisions.load(tmp_path / "decisions.npz")
    assert all(np.array_equal(getattr(read, k), v) for k, v in dataclasses.asdict(made).items())
    page = rendered(dataclasses.replace(report_inputs(), decisions=read))
    assert 'id="decisions"' in page and "over the arena" in page


def test_damaged_decisions_are_refused(tmp_path: Path) -> None:
    (tmp_path / "decisions.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(InputError, match="damaged"):
        Decisions.load(tmp_path / "decisions.npz")
