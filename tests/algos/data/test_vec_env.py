"""The slot VecEnv: the same numbers as the PettingZoo view, and what learners ask of it."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from textbook_dtw import closeness, textbook

import animarl_envs
from animarl_algos.data.species_data import demonstration_rewards
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.dtw import WINDOW
from animarl_envs.errors import InputError
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT
from animarl_envs.worlds import make_world


def test_slots_are_the_individuals_of_the_parallel_view() -> None:
    copies, K = 3, 3
    venv = SlotVecEnv("agent", copies, dtw=None)
    venv.seed(7)
    observations = venv.reset()
    views = [
        animarl_envs.parallel_env("agent", recorded=True, observation="full") for _ in range(copies)
    ]
    streams = np.random.SeedSequence(7).generate_state(copies, np.uint64)
    expected = [view.reset(seed=int(streams[b]))[0] for b, view in enumerate(views)]
    rng = np.random.default_rng(0)
    ends = 0
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
            if not view.agents:
                ends += 1
                seen, _ = view.reset()
            expected[b] = seen
    assert ends > 5


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


def test_replaying_the_demonstrated_actions_keeps_the_aligned_action_in_step() -> None:
    demos = load_packaged("agent")
    venv = SlotVecEnv("agent", 1, demos=demos)
    venv.seed(0)
    venv.reset()
    episode = venv.scenario.demos.episode(int(venv.world.demo[0]))
    for t in range(episode.num_steps):
        _, _, dones, _ = venv.step(episode.signals["actions"][t].astype(np.int64))
        assert np.array_equal(venv.extras["aligned_action"], episode.signals["actions"][t])
        assert venv.extras["dtw_penalty"] == pytest.approx(-1.0, abs=1e-3)  # as close as can be
    assert dones.all()


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
    with pytest.raises(InputError, match="of agent, not of fly: give species agent or another"):
        SlotVecEnv("fly", 1, demos=agents)
    for own in ("custom", "wolf"):
        SlotVecEnv("fly", 1, demos=replace(agents, species=own))
    for species in ("agent", "custom", replace(AGENT, name="wolf")):
        SlotVecEnv(species, 1, demos=agents)


def test_the_test_split_is_refused() -> None:
    with pytest.raises(InputError, match="test"):
        SlotVecEnv("agent", 2, split="test")


# -- penalties and labels that the slots hand out, against a textbook DTW of whole rollouts -------


@dataclass
class Rollout:
    """An episode of one copy: positions ``(K, 2)`` of each frame, and what came with each step."""

    demo: int
    positions: list[NDArray[np.float64]]
    penalties: list[NDArray[np.float32]] = field(default_factory=list)
    labels: list[NDArray[np.int64]] = field(default_factory=list)
    elapsed: list[NDArray[np.float64]] = field(default_factory=list)


class Paths:
    """Follows a world as a DTW tracker does, and keeps where everyone went."""

    def __init__(self, num_copies: int) -> None:
        self.running: list[Rollout | None] = [None] * num_copies

    def started(self, world: Any, mask: NDArray[np.bool_]) -> None:
        for b in np.flatnonzero(mask):
            self.running[b] = Rollout(int(world.demo[b]), [world.position[b].copy()])

    def stepped(self, world: Any) -> None:
        for b, rollout in enumerate(self.running):
            assert rollout is not None
            rollout.positions.append(world.position[b].copy())
            if "elapsed" in world.reward_components:
                lasting = world.reward_components.index("elapsed")
                rollout.elapsed.append(world.components[b, :, lasting].copy())


def random_rollouts(env: SlotVecEnv, steps: int) -> list[Rollout]:
    """Episodes that ended while ``steps`` random actions were taken in every slot."""
    paths, ended = Paths(env.num_copies), []
    env.world.trackers.append(paths)
    env.seed(4)
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(steps):
        acting = list(paths.running)
        _, _, dones, _ = env.step(rng.integers(13, size=env.num_envs))
        pair = (env.num_copies, len(env.individuals))
        penalties, labels = (env.extras[n].reshape(pair) for n in ("dtw_penalty", "aligned_action"))
        for b, rollout in enumerate(acting):
            rollout.penalties.append(penalties[b])
            rollout.labels.append(labels[b])
            if dones.reshape(pair)[b, 0]:
                ended.append(rollout)
    return ended


@pytest.mark.parametrize(
    ("species", "options", "steps", "least"),
    [
        ("agent", {}, 300, 30),
        ("agent", {"dtw": "increment"}, 300, 30),
        ("agent", {"dtw": "cumulative"}, 100, 10),
        ("agent", {"focal": "prey"}, 150, 15),
        ("fly", {"rebound": False}, 150, 20),
        ("silkmoth", {"condition_flag": True}, 610, 6),
    ],
)
def test_penalties_and_labels_equal_the_textbook(
    species: str, options: dict[str, Any], steps: int, least: int
) -> None:
    env = SlotVecEnv(species, 6, **options)
    demos = env.scenario.demos
    assert demos is not None
    everyone = env.scenario.names
    actions = demonstrated_actions(demos, env.scenario.species.locomotion)
    rollouts = random_rollouts(env, steps)
    assert len(rollouts) >= least
    for rollout in rollouts:
        frames = slice(*demos.offsets[rollout.demo : rollout.demo + 2])
        for s, name in enumerate(env.individuals):
            k = everyone.index(name)
            path = np.array(rollout.positions)[:, k]
            rows = textbook(path, demos.positions[frames, k])
            minimum = rows.min(axis=1)
            kind = options.get("dtw", "closeness")
            if kind == "closeness":
                scale = env.scenario.species.contact_radius
                expected = -closeness(path, demos.positions[frames, k], WINDOW, scale)
                beyond = len(demos.positions[frames]) - 1
                if rollout.elapsed:
                    expected[beyond:] = np.array(rollout.elapsed)[beyond:, k]
            else:
                expected = minimum[1:] if kind == "cumulative" else np.diff(minimum)
            np.testing.assert_allclose(
                np.array(rollout.penalties)[:, s],
                expected,
                atol=1e-4 if kind == "cumulative" else 1e-5,
            )
            aligned = actions[frames, k][rows[:-1].argmin(axis=1)]
            np.testing.assert_array_equal(np.array(rollout.labels)[:, s], aligned)
