"""The slot VecEnv: the numbers of the PettingZoo view, what learners ask, the recipe of a clone."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refuses

import animarl_envs
from animarl_algos.data import recipe_choice
from animarl_algos.data.recipe_choice import (
    CLONINGS,
    FEW_EXACT,
    SEEN_SELDOM,
    action_miss,
    choose_recipe,
)
from animarl_algos.data.species_data import demonstration_rewards
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.presets import learner_preset
from animarl_algos.runs import pipeline
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.dtw import DTWTracker
from animarl_envs.errors import InputError
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.scenario import make_scenario
from animarl_envs.settings import describe_fields
from animarl_envs.species import AGENT
from animarl_envs.worlds import make_world


def test_slots_are_the_individuals_of_the_parallel_view() -> None:
    copies, K = 3, 3
    options = {"time_limit": 25, "observation": "full"}
    venv = SlotVecEnv("agent", copies, dtw=None, **options)
    venv.seed(7)
    observations = venv.reset()
    views = [animarl_envs.parallel_env("agent", **options) for _ in range(copies)]
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


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("agent", {}),
        ("agent", {"time_cost": 0.5}),
        ("newt", {"time_cost": 0.5}),
        ("silkmoth", {"time_cost": 0.5}),
        ("shoal", {"shoaling_reward": True}),
    ],
)
def test_demonstrated_rewards_are_those_of_the_world(name: str, options: dict[str, Any]) -> None:
    demos = load_packaged(name).select(split="val")
    replayed = dict.fromkeys(demos.individuals, "replay")
    scenario = make_scenario(name, demos=demos, split=None, drivers=replayed, **options)
    expected = demonstration_rewards(scenario.species, demos)
    world = make_world(scenario, demos.num_episodes)
    world.reset(demo=np.arange(demos.num_episodes))
    finer = name != "agent"  # the end was judged at a finer rate than the world's
    for t in range(int(demos.lengths.max()) - 1):
        world.step(np.full((demos.num_episodes, demos.num_individuals), 12))
        frames = demos.offsets[:-1] + t
        running = demos.lengths - 1 - finer > t
        assert world.reward[running] == pytest.approx(expected[frames[running]], abs=1e-6)


def test_the_condition_is_the_last_component_if_asked_for() -> None:
    venv = SlotVecEnv("agent", 8, condition_flag=True)
    venv.seed(3)
    observations = venv.reset()
    assert observations.shape == (24, len(venv.world.observation_components) + 1)
    assert np.array_equal(observations[:, -1], np.repeat(venv.world.condition, 3))
    flipped = SlotVecEnv("agent", 8, condition_flag=True, cue="flipped")
    flipped.seed(3)
    assert np.array_equal(flipped.reset()[:, -1], 1 - observations[:, -1])


def test_options_choose_the_demonstration_of_one_reset() -> None:
    env = SlotVecEnv("newt", 3)
    env.seed(0)
    env.set_options({"demo": 5})
    env.reset()
    assert env.world.demo.tolist() == [5, 5, 5]
    each: list[dict[str, Any]] = [{"demo": b} if b else {} for b in range(3) for _ in range(3)]
    env.set_options(each)
    env.reset()
    assert env.world.demo.tolist()[1:] == [1, 2]
    env.set_options({"demo": 10**6})
    refuses("demo 1000000 does not exist", env.reset)
    env.set_options({"foo": 1})
    refuses("reset has no option 'foo'", env.reset)
    env.set_options()
    env.reset()


def test_without_a_seed_episodes_differ() -> None:
    first, second = SlotVecEnv("newt", 8), SlotVecEnv("newt", 8)
    first.reset(), second.reset()
    assert first.world.demo.tolist() != second.world.demo.tolist()
    seen = first.world.demo.tolist()
    first.reset()
    assert first.world.demo.tolist() != seen  # the stream goes on


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


class Tracker(DTWTracker):
    """Keeps what the last step was paid, also where a new episode has begun since."""

    def stepped(self, world: Any) -> None:
        super().stepped(world)
        self.paid = self.penalty.copy()


@pytest.mark.parametrize(
    ("species", "options", "steps"),
    [
        ("agent", {}, 300), ("agent", {"dtw": "increment"}, 300),
        ("agent", {"dtw": "cumulative"}, 100), ("agent", {"focal": "prey"}, 150),
        ("fly", {"rebound": False}, 150), ("silkmoth", {"condition_flag": True}, 610),
    ],
)  # fmt: skip
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


PACKAGED = {
    "agent": "exact", "fly": "nearly-exact", "newt": "nearly-exact", "silkmoth": "search",
    "solo": "recorded-few", "shoal": "recorded-few",
}  # fmt: skip


def strangers(demos: Demonstrations, episodes: int = 500, **changes: Any) -> Demonstrations:
    """The first episodes of every split, as somebody's own."""
    chosen = np.concatenate(
        [np.flatnonzero(demos.split == s)[:episodes] for s in np.unique(demos.split)]
    )
    return replace(demos.select(episodes=np.sort(chosen)), species="custom", **changes)


def shaken(demos: Demonstrations, by: float) -> Demonstrations:
    """With tracking noise, of this standard deviation."""
    noise = np.random.default_rng(0).normal(0.0, by, demos.positions.shape)
    return replace(demos, positions=(demos.positions + noise).clip(-1.4, 1.4))


@pytest.mark.parametrize("species", PACKAGED)
def test_the_recipe_that_is_chosen_for_packaged_demonstrations(species: str) -> None:
    name = choose_recipe(load_packaged(species)).name
    assert name == PACKAGED[species]
    if name != "recorded-few":  # without demonstrations it is the same
        chosen = learner_preset("soft-bc", environment_id(species), cloning=name)
        assert chosen == learner_preset("soft-bc", environment_id(species))


def test_a_strangers_agents_get_the_recipe_that_is_chosen_for_agents() -> None:
    agents = strangers(load_packaged("agent"))
    assert choose_recipe(agents).name == "exact"
    digits = replace(agents, positions=agents.positions.round(4))
    assert choose_recipe(digits).name in ("exact", "nearly-exact")
    few = strangers(agents, 100)
    found = choose_recipe(few)
    assert found.name == "exact-few" and action_miss(few)[1] < FEW_EXACT
    assert f"few (below {FEW_EXACT})" in found.reason
    noisy = shaken(few, 0.02)
    assert choose_recipe(noisy).name == "recorded-few"  # synthetic ones need no memory
    found = choose_recipe(replace(noisy, provenance={**noisy.provenance, "synthetic": False}))
    assert found.name == "recurrent" and "animals go by what they just did" in found.reason


def test_steps_of_recorded_animals_decide_on_dropout_and_epochs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    some = shaken(strangers(load_packaged("agent"), 40), 0.02)
    steps = action_miss(some)[1]
    monkeypatch.setattr(recipe_choice, "FEW_STEPS", steps)
    monkeypatch.setattr(recipe_choice, "SEEN_SELDOM", steps + 1)
    assert recipe_choice.choose_recipe.__wrapped__(some).name == "recorded"
    monkeypatch.setattr(recipe_choice, "SEEN_SELDOM", steps)
    found = recipe_choice.choose_recipe.__wrapped__(some)
    assert found.name == "recorded-many" and f"many (from {steps})" in found.reason
    monkeypatch.undo()
    few, plain, many = (
        learner_preset("soft-bc", "AnimaRL/Custom-v0", cloning=name)
        for name in ("recorded-few", "recorded", "recorded-many")
    )
    assert few.env_kwargs == plain.env_kwargs == many.env_kwargs
    told = [one.arguments["policy_kwargs"] for one in (few, plain, many)]
    assert [one.pop("dropout") for one in told] == [0.3, 0.1, 0.0]
    assert few.arguments == plain.arguments
    assert many.arguments == plain.arguments | {"offline_epochs": 60}
    # of many steps each is seen fewer than six times by the plain recipe
    drawn = plain.arguments["offline_kwargs"]["updates_per_epoch"]
    drawn *= plain.arguments["offline_epochs"] * plain.arguments["offline_batch_size"]
    assert drawn < 6 * SEEN_SELDOM


def test_what_was_chosen_stands_in_the_run(tmp_path: Path) -> None:
    few = strangers(load_packaged("agent"), 40)

    def opened(folder: str, **asked: Any) -> dict[str, Any]:
        settings = RunSettings(file="few", species="custom", steps=1, copies=1, **asked)
        record = pipeline.open_run(settings, tmp_path / folder, "test", few).record
        assert record == json.loads((tmp_path / folder / "settings.json").read_text())
        return record

    record = opened("chosen")
    assert record["settings"]["cloning"] == "exact-few"
    assert record["reasons"]["cloning"].startswith("actions miss by ")
    assert record["environment"]["labels"] == "hard"
    assert record["learner"]["policy_kwargs"]["dropout"] == 0.3
    assert opened("chosen") == record  # found again
    told = opened("told", overrides={"env_kwargs": {"labels": "soft"}})
    assert told["environment"]["labels"] == "soft"  # what is asked for goes over what is chosen
    assert told["learner"] == record["learner"]
    asked = opened("asked", cloning="recorded")
    assert asked["reasons"] == {} and asked["environment"]["labels"] == "tracking"
    assert opened("dqn", algo="dqn")["settings"]["cloning"] == "chosen"  # takes nothing of it


def test_a_recipe_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="cloning is 'exactly': choose among chosen, exact, exac"):
        RunSettings(species="fly", steps=1, cloning="exactly")
    listed = describe_fields(RunSettings)["cloning"]
    assert len(set(CLONINGS)) == 10 and all(f" {name}," in listed for name in CLONINGS)
