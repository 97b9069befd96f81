"""The slot VecEnv: the same numbers as the PettingZoo view, and what learners ask of it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from refusals import refuses

import animarl_envs
from animarl_algos.data.species_data import demonstration_rewards
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.dtw import DTWTracker
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT
from animarl_envs.worlds import make_world


def test_slots_are_the_individuals_of_the_parallel_view() -> None:
    copies, K = 3, 3
    options = {"time_limit": 25, "observation": "full"}
    venv = SlotVecEnv("agent", copies, dtw=None, **options)
    venv.seed(7)
    observations = venv.reset()
    views = [animarl_envs.parallel_env("agent", recorded=True, **options) for _ in range(copies)]
    streams = np.random.SeedSequence(7).generate_state(copies, np.uint64)
    expected = [view.reset(seed=int(streams[b]))[0] for b, view in enumerate(views)]
    rng = np.random.default_rng(0)
    ends = []
    for _ in range(150):
        for b, view in enumerate(views):
            for k, name in enumerate(view.possible_agents):
                assert np.array_equal(observations[b * K + k], expected[b][name])
        actions = rng.integers(13, size=copies * K)
        observations, rewards, dones, infos = venv.step(actions)
        for b, view in enumerate(views):
            mine = actions[b * K : (b + 1) * K]
            agents = list(view.agents)
            seen, paid, terminated, truncated, _ = view.step(dict(zip(agents, mine.tolist())))
            for k, name in enumerate(agents):
                assert rewards[b * K + k] == np.float32(paid[name])
                assert dones[b * K + k] == (terminated[name] or truncated[name])
                if dones[b * K + k]:
                    info = infos[b * K + k]
                    assert np.array_equal(info["terminal_observation"], seen[name])
                    assert info["TimeLimit.truncated"] == truncated[name]
                    ends.append(truncated[name])
            if not view.agents:
                seen, _ = view.reset()
            expected[b] = seen
    assert set(ends) == {True, False}


def test_the_state_of_all_copies_can_be_taken_and_put_back() -> None:
    first, second = SlotVecEnv("agent", 4), SlotVecEnv("agent", 4)
    first.seed(1)
    first.reset()
    rng = np.random.default_rng(0)
    for _ in range(20):
        first.step(rng.integers(13, size=12))
    second.set_state(first.get_state())
    for _ in range(60):
        actions = rng.integers(13, size=12)
        one, two = first.step(actions), second.step(actions)
        assert np.array_equal(one[0], two[0])
        assert np.array_equal(one[1], two[1])
        assert np.array_equal(first.extras["dtw_penalty"], second.extras["dtw_penalty"])


def test_demonstrated_rewards_are_those_of_the_world() -> None:
    demos = load_packaged("agent").select(split="val")
    expected = demonstration_rewards(AGENT, demos)
    world = make_world(make_scenario(AGENT, demos=demos, split=None), demos.num_episodes)
    world.reset(demo=np.arange(demos.num_episodes))
    for t in range(int(demos.lengths.max()) - 1):
        actions = np.full((demos.num_episodes, 3), 12)
        running = demos.lengths - 1 > t
        frames = demos.offsets[:-1][running] + t
        actions[running] = demos.signals["actions"][frames]
        world.step(actions)
        assert world.reward[running] == pytest.approx(expected[frames], abs=1e-6)


def test_the_condition_is_the_last_component_if_asked_for() -> None:
    venv = SlotVecEnv("agent", 8, condition_flag=True)
    venv.seed(3)
    observations = venv.reset()
    assert observations.shape == (24, len(venv.world.observation_components) + 1)
    assert np.array_equal(observations[:, -1], np.repeat(venv.world.condition, 3))
    flipped = SlotVecEnv("agent", 8, condition_flag=True, cue="flipped")
    flipped.seed(3)
    assert np.array_equal(flipped.reset()[:, -1], 1 - observations[:, -1])


def test_one_focal_individual_learns_while_the_others_replay() -> None:
    venv = SlotVecEnv("agent", 5, focal="prey")
    venv.seed(0)
    venv.reset()
    assert venv.num_envs == 5
    recorded = [venv.scenario.demos.episode(int(d)).positions for d in venv.world.demo]
    venv.step(np.full(5, 12))
    for b, path in enumerate(recorded):
        assert venv.world.position[b, :2] == pytest.approx(path[1, :2])


def test_demonstrations_of_another_species_are_refused() -> None:
    """A species of one's own fits any of the package's."""
    agents = load_packaged("agent")
    refuses(
        "of agent, not of fly: give species agent or another", SlotVecEnv, "fly", 1, demos=agents
    )
    for own in ("custom", "wolf"):
        SlotVecEnv("fly", 1, demos=replace(agents, species=own))
    for species in ("agent", "custom", replace(AGENT, name="wolf")):
        SlotVecEnv(species, 1, demos=agents)


# -- penalties and labels that the slots hand out are those of a tracker beside it ----------------


class Tracker(DTWTracker):
    """Keeps what the last step was paid, also where a new episode has begun since."""

    def stepped(self, world: Any) -> None:
        super().stepped(world)
        self.paid = self.penalty.copy()


@pytest.mark.parametrize(
    ("species", "options", "steps"),
    [
        ("agent", {}, 300),
        ("agent", {"dtw": "increment"}, 300),
        ("agent", {"dtw": "cumulative"}, 100),
        ("agent", {"focal": "prey"}, 150),
        ("fly", {"rebound": False}, 150),
        ("silkmoth", {"condition_flag": True}, 610),
    ],
)
def test_penalties_and_labels_are_those_of_a_tracker(
    species: str, options: dict[str, Any], steps: int
) -> None:
    """The label of a step is the demonstrated action at the frame aligned before it."""
    copies = 6
    env = SlotVecEnv(species, copies, **options)
    world, species_, demos = env.world, env.scenario.species, env.scenario.demos
    assert demos is not None
    followed = np.array([env.scenario.names.index(name) for name in env.individuals])
    kind = options.get("dtw", "closeness")
    tracker = Tracker(demos, copies, followed, species_.contact_radius, kind)
    world.trackers.append(tracker)
    env.seed(4)
    env.reset()
    demonstrated = demonstrated_actions(demos, species_.locomotion)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(steps):
        frames = demos.offsets[world.demo][:, None] + tracker.aligned
        labels = demonstrated[frames, followed]
        _, _, dones, _ = env.step(rng.integers(13, size=env.num_envs))
        np.testing.assert_array_equal(env.extras["aligned_action"], labels.ravel())
        np.testing.assert_allclose(env.extras["dtw_penalty"], tracker.paid.ravel(), atol=1e-6)
        ends += int(dones.sum())
    assert ends > 5
