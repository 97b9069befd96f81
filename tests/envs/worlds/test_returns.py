"""What the DTW reward pays: following the recording most, and no way of ending early more.

``benchmarks/returns.py`` prints the table for more episodes and other rewards.
"""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from behaviours import FAITHFUL, UNFAITHFUL, Course, returns, shipped
from conftest import DATA
from numpy.typing import NDArray

import benchmarks.paper_readers  # noqa: F401  (registers the readers of published sets)
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.result import fit_locomotion
from animarl_envs.importing.readers import read
from animarl_envs.scenario import Scenario, make_scenario
from animarl_envs.species import AGENT
from animarl_envs.species.options import with_options

WORLDS: list[tuple[str, dict[str, Any]]] = [
    ("agent", {}),
    *((name, {"rebound": wall}) for name in ("fly", "newt") for wall in (False, True)),
    ("silkmoth", {}),
]


@cache
def scenario(species: str, **options: Any) -> Scenario:
    """The first validation episodes of a packaged species."""
    demos = load_packaged(species).select(split="val")
    few = demos.select(episodes=range(min(8, len(demos))))
    return make_scenario(species, demos=few, split=None, **options)


def recorded_scenario(file: Path) -> Scenario:
    """The same of the local agents, whose locomotion is fitted from their tracks."""
    demos = read(file, None)
    species = with_options(
        AGENT, arena=demos.arena, time_limit=int(demos.lengths.max()) - 1,
        locomotion=fit_locomotion(demos, seed=0).locomotion,
    )  # fmt: skip
    few = demos.select(split="val").select(episodes=range(8))
    return make_scenario(species, demos=few, split=None)


def mean_returns(
    where: Scenario, courses: dict[str, Course], kind: str, gamma: float
) -> NDArray[np.float64]:
    """``(courses, K)``, means over the episodes."""
    made = [
        returns(where, course, [shipped(kind)], gamma, repetitions=10)
        for course in courses.values()
    ]
    return np.array([each[0].mean(axis=0) for each in made])


@pytest.mark.parametrize("gamma", [1.0, 0.99])
@pytest.mark.parametrize(("species", "options"), WORLDS)
def test_following_earns_most_and_not_following_least(
    species: str, options: dict[str, Any], gamma: float
) -> None:
    """For each individual, with the task's reward in it."""
    refuse_another_order(scenario(species, **options), gamma)


@pytest.mark.realdata
@pytest.mark.parametrize("gamma", [1.0, 0.99])
@pytest.mark.parametrize("rewarded", ["indiv", "share"])
def test_the_same_of_recorded_agents(rewarded: str, gamma: float) -> None:
    file = DATA / "agents_collab_hunting" / f"episodes_c2ae_{rewarded}_slow2.4.npz"
    refuse_another_order(recorded_scenario(file), gamma)


def refuse_another_order(where: Scenario, gamma: float) -> None:
    faithful = mean_returns(where, FAITHFUL, "closeness", gamma)
    unfaithful = mean_returns(where, UNFAITHFUL, "closeness", gamma)
    assert (np.diff(faithful, axis=0) < 0.0).all(), faithful
    assert (faithful[-1] > unfaithful).all(), (faithful, unfaithful)


def test_contact_at_the_recorded_time_is_not_punished() -> None:
    """A whole recording that ends by contact is worth 1 a step, and the touch."""
    demos = load_packaged("agent").select(split="val")
    caught = demos.select(episodes=np.flatnonzero(demos.outcome > 0)[:4])
    where = make_scenario("agent", demos=caught, split=None)
    earned = returns(where, FAITHFUL["recorded"], [shipped("closeness")], 1.0)[0]
    steps = (caught.lengths - 1)[:, None]
    elapsed = (steps - 1) * where.species.dt  # the target's; nothing for the step it is caught in
    touching = np.array([[1.0, 0.0], [0.0, 1.0]])[caught.outcome - 1]
    shared = (caught.condition == 1)[:, None]
    touches = np.where(shared, 1.0, touching)
    np.testing.assert_allclose(earned[:, :2], steps + touches, atol=0.02)
    np.testing.assert_allclose(earned[:, 2:], steps + elapsed, atol=0.02)
