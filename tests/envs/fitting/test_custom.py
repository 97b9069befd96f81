"""``AnimaRL/Custom-v0``: any demonstrations become an environment at once."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from recordings import CHASER, PREY, dogs, search

import animarl_envs
import benchmarks.paper_readers  # noqa: F401  (registers the readers of published sets)
from animarl_algos.cli.describing import automatic_decisions
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import learnable
from animarl_envs.fitting import joint
from animarl_envs.fitting.custom_species import (
    STATED,
    contact_radius_of,
    species_of,
    stated_options,
    takes_sides,
)
from animarl_envs.importing.readers import read
from animarl_envs.locomotion import Locomotion
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SILKMOTH, ChaseSpecies, SearchSpecies
from animarl_envs.species.traits import Traits
from animarl_envs.views import AnimalVectorEnv
from animarl_envs.worlds import observation_components
from animarl_envs.worlds.chase.world import ChaseWorld

pytestmark = [
    pytest.mark.filterwarnings("error"),
    pytest.mark.filterwarnings("ignore:reset has no option .options.:UserWarning"),  # PettingZoo's
    pytest.mark.usefixtures("_garbage_collected"),
]

ID = "AnimaRL/Custom-v0"
EPISODES, STEPS = 8, 60


@pytest.mark.parametrize("pursuers", [1, 5])
def test_registry_custom_works_with_any_number_of_pursuers(pursuers: int, tmp_path: Path) -> None:
    path = str(dogs(pursuers).save(tmp_path / "demos.npz"))
    env = gym.make(ID, demos=path)
    check_env(env.unwrapped, skip_render_check=True)
    everyone = animarl_envs.parallel_env("custom", demos=path)
    assert everyone.possible_agents == list(dogs(pursuers).individuals)
    parallel_api_test(everyone, num_cycles=80)
    assert np.array_equal(everyone.reset(seed=5)[0]["dog_a"], env.reset(seed=5)[0])


def test_tracks_that_stand_for_recordings_state_what_was_measured_of_them() -> None:
    solo, bodies = load_packaged("solo"), [Locomotion(1.0, 1.0)]
    recorded = replace(solo, species="custom", provenance={**solo.provenance, "synthetic": False})
    traits = Traits(np.ones((2, 1, 2)), np.array([[np.inf, 0.5]]), np.zeros((9, 1, 2)))
    species = replace(species_of(recorded, bodies), traits=traits)
    assert isinstance(species, ChaseSpecies)
    stated = json.loads(json.dumps(stated_options(species)))
    few = replace(recorded.select([0]), provenance={**solo.provenance, STATED: stated})
    again = species_of(few, bodies)
    stated_apart = {name: getattr(again, name) for name in ("recording", "source", "title")}
    assert again == replace(species, **stated_apart)


def test_registry_custom_search_has_the_moths_senses() -> None:
    env = gym.make(ID, demos=search())
    check_env(env.unwrapped, skip_render_check=True)
    spec = env.unwrapped.scenario.species  # type: ignore[attr-defined]
    assert isinstance(spec, SearchSpecies)
    assert (spec.individuals, spec.dt, spec.arena.size) == (("beetle",), 0.4, 0.4)
    assert (spec.conditions, spec.warmup) == (SILKMOTH.conditions, 0)
    seen = gym.make_vec(ID, num_envs=2, demos=search()).reset(seed=0)[0]
    assert seen.shape == (2, len(observation_components(spec)))
    seen = gym.make_vec(ID, num_envs=2, demos=search(), observation="paper").reset(seed=0)[0]
    assert seen.shape == (2, 10)


@pytest.mark.parametrize("pursuers", [1, 3])
def test_locomotion_is_fitted_from_the_file(pursuers: int) -> None:
    species = species_of(dogs(pursuers))
    for found, truth in zip(species.locomotion, (CHASER,) * pursuers + (PREY,), strict=True):
        assert found.damping == pytest.approx(truth.damping, abs=1e-6)
        assert found.thrust == pytest.approx(truth.thrust, rel=1e-6)


def test_the_fit_is_made_once_per_content(monkeypatch: pytest.MonkeyPatch) -> None:
    demos = dogs(1)
    changed = replace(demos, condition=np.ones(EPISODES))
    species_of(demos)

    def refuse(*_: Any) -> Any:
        raise AssertionError("fitted again")

    monkeypatch.setattr(joint, "fit_joint", refuse)
    assert species_of(replace(demos, name="a copy")).locomotion == species_of(demos).locomotion
    with pytest.raises(AssertionError, match="again"):
        species_of(changed)
    given = (Locomotion(0.5, 1.0),) * 2
    assert species_of(changed, fit=given).locomotion == given


def test_numbers_are_those_of_the_file() -> None:
    demos = dogs(1)  # nobody leaves, so walls rebound
    species = species_of(demos)
    assert isinstance(species, ChaseSpecies)
    assert species.individuals == demos.individuals
    assert species.arena == replace(demos.arena, rebound=True)
    assert (species.dt, species.warmup) == (demos.dt, 0)
    assert species.time_limit == STEPS  # the longest episode
    assert species.recording.frame_rate == pytest.approx(10.0)
    assert species.conditions == ()
    assert "synthetic" in species.source
    kept = {"recipe": {"cutting": {"longest": "inf", "keep_last": 9.0}}}
    assert species_of(_told(demos, **kept)).time_limit == 90


@pytest.mark.parametrize(("every", "walled"), [(20, False), (80, True)])
def test_a_wall_stands_where_nobody_was_recorded_beyond_it(every: int, walled: bool) -> None:
    """Tracking errors put one frame in eighty there, not one in twenty."""
    demos = dogs(1)
    beyond = demos.positions.copy()
    beyond[::every, 0] = (1.05 * demos.arena.size, 0.0)
    seen = replace(demos, positions=beyond)
    assert species_of(seen, fit=(CHASER, PREY)).arena.rebound is walled
    assert ("no wall stands there" in " ".join(automatic_decisions(seen))) is not walled


def test_several_thrusts_see_their_past_and_time_is_seen_where_episodes_began_apart() -> None:
    demos = dogs(1)
    one, three = Locomotion(0.5, 1.0), Locomotion(0.5, 1.0, magnitudes=(2.0, 1.0, 0.5))
    for own, base, past in ((one, None, False), (three, None, True), (three, "fly", False)):
        species = species_of(demos, fit=(own, own), base=base)
        assert isinstance(species, ChaseSpecies)
        assert species.senses_past is past

    def senses_time(**cutting: Any) -> bool:
        species = species_of(_told(dogs(1), recipe={"cutting": cutting}))
        assert isinstance(species, ChaseSpecies)
        return species.senses_time

    assert senses_time(mode="approach", start="separation", keep_last="inf")
    assert not senses_time(mode="approach", start="separation", keep_last=9.0)
    assert not senses_time(mode="approach", start="approach")
    assert not senses_time(mode="whole", start="separation")


def test_a_named_species_gives_its_numbers() -> None:
    demos = replace(dogs(2), species="newt")
    species = species_of(demos)
    assert (species.name, species.contact_radius, species.warmup) == ("newt", 0.15, 10)
    assert species.arena == replace(demos.arena, rebound=True)  # as newts have it
    assert species.individuals == demos.individuals
    assert species_of(dogs(2), base="agent").arena == demos.arena
    assert species.time_limit == 500
    assert species_of(dogs(2), base="fly").contact_radius == 0.2


def test_the_contact_radius_is_as_stated_or_as_seen() -> None:
    demos = replace(dogs(2), split=np.repeat(["train", "val"], EPISODES)[:EPISODES])
    distance = np.linalg.norm(demos.positions[:, :-1] - demos.positions[:, -1:], axis=2)
    assert contact_radius_of(demos) == 0.001 * demos.arena.size  # none ended by contact
    approach = {"mode": "approach", "farther_than": 1.0, "closer_than": 0.25}
    assert contact_radius_of(_told(demos, recipe={"cutting": approach})) == 0.25
    whole = {"mode": "whole", "contact": 0.3}
    assert contact_radius_of(_told(demos, recipe={"cutting": whole})) == 0.3
    assert contact_radius_of(_told(demos, contact_radius=0.4)) == 0.4
    touched = replace(demos, outcome=np.where(np.arange(EPISODES) < 6, 1, UNFINISHED))
    ends = distance[demos.offsets[1:7] - 1, 0]
    assert contact_radius_of(touched) == pytest.approx(np.quantile(ends, 0.9))


def test_without_stated_contact_no_recording_is_cut_short() -> None:
    demos = learnable(dogs(2))
    episodes = demos.num_episodes
    drivers = dict.fromkeys(demos.individuals, "replay")
    world = ChaseWorld(make_scenario("custom", demos=demos, split=None, drivers=drivers), episodes)
    world.reset(demo=np.arange(episodes))
    for t in range(1, STEPS + 1):
        world.step(np.zeros((episodes, 3), dtype=int))
        running = demos.lengths - 1 >= t
        left = np.linalg.norm(world.position[:, -1], axis=-1) > demos.arena.boundary
        assert not world.terminated[running & ~left].any()


def test_conditions_are_labels_that_change_no_reward() -> None:
    demos = replace(dogs(2), condition=np.arange(EPISODES) % 2)
    species = species_of(demos)
    assert species.conditions == ("condition 0", "condition 1")
    named = species_of(_told(demos, conditions=["light", "dark"]))
    assert named.conditions == ("light", "dark")
    start = [[0.0, 0.0], [1.0, 0.0], [0.02, 0.0]]
    paid = []
    for condition in (0, 1):
        env = AnimalVectorEnv("custom", 1, demos=demos, condition=condition, start=start,
                              focal="dog_b", contact_radius=0.1, time_cost=0.0)  # fmt: skip
        env.reset(seed=0)
        _, reward, terminated, *_ = env.step(np.array([12]))
        assert terminated[0]
        paid.append(reward[0])
    assert paid == [0.0, 0.0]


def _told(demos: Demonstrations, **more: Any) -> Demonstrations:
    return replace(demos, provenance={**demos.provenance, **more})


@pytest.mark.realdata
def test_recorded_moths_at_once(data_dir: Path) -> None:
    runs = read(data_dir / "silkmoth_mothvr" / "raw" / "case11.csv")
    env = gym.make(ID, demos=runs, split=None)
    _, info = env.reset(seed=0)
    assert info["scenario"]["species"] == "silkmoth"
    assert info["scenario"]["time_limit"] == 600
    env.step(0)


def test_mirror_images_are_chosen_by_whether_recordings_take_sides() -> None:
    demos = load_packaged("agent")
    assert takes_sides(demos)  # the programs learned one of two equally good ways
    still = (Locomotion(0.2, 2.0),) * 3
    assert not species_of(demos, still, base="custom").mirror_symmetric
    sign = np.repeat((-1.0) ** np.arange(demos.num_episodes), demos.lengths)
    image = np.stack([np.ones_like(sign), sign], axis=1)[:, None]
    velocity = demos.initial_velocity * image[demos.offsets[:-1]]
    fair = replace(demos, positions=demos.positions * image, initial_velocity=velocity)
    assert not takes_sides(fair)
    assert species_of(fair, still, base="custom").mirror_symmetric
    few = demos.select(episodes=np.arange(7))
    assert not takes_sides(few)  # seven recordings cannot say so
