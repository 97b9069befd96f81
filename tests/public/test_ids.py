"""Ids of environments and names of species mean the same wherever they are given."""

import numpy as np
import pytest
from refusals import refuses

from animarl_algos import DQCIL, DQDIL, SlotVecEnv
from animarl_envs import parallel_env

NAMES = ("AnimaRL/Newt-v0", "Newt", "newt")


@pytest.mark.parametrize("name", NAMES)
def test_every_front_door_takes_ids_and_names(name: str) -> None:
    assert parallel_env(name).possible_agents == ["male_0", "male_1", "female"]
    assert SlotVecEnv(name, 1).individuals == ("male_0", "male_1", "female")


def test_a_learner_in_an_id_trains_all_individuals() -> None:
    learner = DQDIL("GruPolicy", "AnimaRL/Newt-v0", seed=0, policy_kwargs={"hidden": 8})
    assert learner.policy.individuals == ("male_0", "male_1", "female")
    before = [weight.clone() for weight in learner.policy.q_net.parameters()]
    learner.learn(500)
    after = list(learner.policy.q_net.parameters())
    for individual in range(3):  # each has learned something
        assert any(
            not np.array_equal(a[individual].detach(), b[individual]) for a, b in zip(after, before)
        )


def test_an_id_brings_the_condition_where_the_recordings_have_both() -> None:
    learner = DQCIL("GruPolicy", "AnimaRL/Agent-v0", seed=0, policy_kwargs={"hidden": 8})
    assert learner.layout.condition_flag


@pytest.mark.parametrize("name", ["AnimaRL/Dodo-v0", "dodo"])
def test_an_unknown_species_is_one_sentence(name: str) -> None:
    for door in (parallel_env, lambda text: SlotVecEnv(text, 1)):
        refuses("is unknown: choose one of agent, fly, newt, silkmoth", door, name)
    refuses("choose one of agent", DQDIL, "GruPolicy", "AnimaRL/Dodo-v0")
