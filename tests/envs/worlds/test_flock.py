"""One pursuer and several targets: a dog and its flock, from tracks to a run."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from commands import animarl
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from recordings import CHASER, SYNTHETIC, begun, flock, write_tracks
from refusals import refuses

import animarl_envs
from animarl_algos.data.species_data import demonstration_rewards
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT
from animarl_envs.demos.summary import ending_in_words, outcome_name
from animarl_envs.focus import focus_directions
from animarl_envs.locomotion import NUM_ACTIONS
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT
from animarl_envs.species.options import with_options
from animarl_envs.worlds import make_world
from animarl_envs.worlds.base import World
from tools.packaged_data import demonstrations_of

ID = "AnimaRL/Custom-v0"
COAST = NUM_ACTIONS - 1


def stepped(place: Any) -> World:
    """An agents' world of one predator, put there, after a step in which nobody moves."""
    world = make_world(make_scenario("agent", demos=None, num_targets=len(place) - 1))
    world.reset()
    state = world.get_state()
    state["position"][0] = place
    world.set_state(state)
    world.step(np.full((1, len(place)), COAST))
    return world


def test_roles_and_names_come_from_the_number_of_targets() -> None:
    species = with_options(AGENT, num_targets=3)
    assert species.individuals == ("prey_0", "prey_1", "prey_2", "predator_0")
    assert species.roles == ("target", "target", "target", "pursuer")
    assert species.locomotion == (AGENT.locomotion[-1],) * 3 + (AGENT.locomotion[0],)
    assert with_options(species, num_targets=2).individuals == ("prey_0", "prey_1", "predator_0")
    assert with_options(AGENT, num_targets=1) == AGENT
    named = with_options(AGENT, individuals=("ewe", "lamb", "dog"), lone_pursuer=True)
    assert dict(zip(named.individuals, named.roles, strict=True))["dog"] == "pursuer"


@pytest.mark.parametrize("count", [1, 3, 6])
def test_bodies_and_senses_are_those_of_pursuers_and_a_target(count: int) -> None:
    """Who pursues changes rewards and nothing else: bit for bit the same paths and views."""
    worlds = []
    for option in ("num_pursuers", "num_targets"):
        species = with_options(AGENT, **{option: count}, lone_pursuer=option == "num_targets")
        scenario = make_scenario(species, demos=None, locomotion=CHASER, time_limit=60)
        worlds.append(make_world(scenario, 20))
        worlds[-1].seed(np.arange(20))
        worlds[-1].reset()
    rng = np.random.default_rng(0)
    for _ in range(40):
        actions = rng.integers(NUM_ACTIONS, size=(20, count + 1))
        for world in worlds:
            world.step(actions)
        one, two = worlds
        assert np.array_equal(one.position, two.position)
        assert np.array_equal(one.observation, two.observation)
        assert np.array_equal(one.outcome > TIME_OUT, two.outcome > TIME_OUT)


def test_the_pursuer_faces_its_nearest_target_and_targets_face_it() -> None:
    world = stepped([[0.5, 0.0], [0.0, -0.3], [0.0, 0.0]])
    np.testing.assert_allclose(world.towards[0], [[-1, 0], [0, 1], [0, -1]], atol=1e-12)
    roles = world.scenario.species.roles
    np.testing.assert_allclose(focus_directions(world.position, roles), world.towards)


def test_a_dog_that_follows_its_script_comes_nearer_than_one_that_stands_still() -> None:
    least = {}
    for rule in ("scripted", "coast"):
        drivers = {"prey_0": "coast", "prey_1": "coast", "predator_0": rule}
        world = begun(make_scenario("agent", demos=None, num_targets=2, drivers=drivers), 30)
        for _ in range(20):
            world.step(np.zeros((30, 3), dtype=int))
            world.reset(world.terminated & False)
        apart = np.linalg.norm(world.position[:, :2] - world.position[:, 2:], axis=2)
        least[rule] = apart.min(axis=1)
    assert (least["scripted"] < least["coast"]).mean() > 0.9


@pytest.mark.filterwarnings("ignore:reset has no option .options.:UserWarning")  # PettingZoo's
def test_a_flock_works_in_every_view() -> None:
    demos = flock(3)
    env = gym.make(ID, demos=demos)
    check_env(env.unwrapped, skip_render_check=True)
    assert env.unwrapped.scenario.names[env.unwrapped.focal_index] == "dog"
    everyone = animarl_envs.parallel_env("custom", demos=demos)
    assert everyone.possible_agents == ["sheep_0", "sheep_1", "sheep_2", "dog"]
    parallel_api_test(everyone, num_cycles=80)
    vector = gym.make_vec(ID, num_envs=2, demos=demos)
    rows, _ = vector.reset(seed=5)
    assert np.array_equal(everyone.reset(seed=5)[0]["dog"], rows[0])
    drawn = gym.make(ID, demos=demos, render_mode="rgb_array")
    drawn.reset(seed=0)
    assert drawn.render().ndim == 3
    less = gym.make(ID, demos=demos, num_targets=1).unwrapped.scenario
    assert less.names == ("sheep_0", "dog")
    assert less.species.roles == ("target", "pursuer")
    more = gym.make(ID, demos=demos, num_targets=5, start="uniform").unwrapped.scenario
    assert more.species.roles == ("target",) * 5 + ("pursuer",)


def ended(outcome: int, last: list[list[float]]) -> Demonstrations:
    """A flock of two and a dog that stand for three frames, the last as given."""
    first = [[0.5, 0.0], [0.0, 0.5], [-0.5, -0.5]]
    species = with_options(AGENT, num_targets=2)
    path = np.array([first, first, last], dtype=float)
    return demonstrations_of(
        species, [path], {}, condition=np.zeros(1), outcome=np.array([outcome]),
        split=np.array(["train"]), recording=np.array(["r"]), provenance=SYNTHETIC,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("outcome", "last", "reward"),
    [
        (2, [[0.5, 0.0], [-0.45, -0.5], [-0.5, -0.5]], [0.1, 0.0, 1.0]),
        (1, [[-0.42, -0.5], [-0.5, -0.41], [-0.5, -0.5]], [0.0, 0.0, 1.0]),  # paid once
        (TARGET_OUT, [[1.15, 0.0], [0.0, 0.5], [-0.5, -0.5]], [-10.0, 0.1, 0.0]),
        (TARGET_OUT, [[1.15, 0.0], [0.0, 0.5], [-1.15, -0.5]], [-10.0, 0.1, -10.0]),  # named first
        (PURSUER_OUT, [[0.5, 0.0], [0.0, 0.5], [-1.15, -0.5]], [0.1, 0.1, -10.0]),
        (TIME_OUT, [[0.5, 0.0], [0.0, 0.5], [-0.5, -0.5]], [0.1, 0.1, 0.0]),
    ],
)
def test_demonstrated_rewards_are_those_of_the_world(
    outcome: int, last: list[list[float]], reward: list[float]
) -> None:
    demos = ended(outcome, last)
    found = demonstration_rewards(with_options(AGENT, num_targets=2), demos)
    np.testing.assert_allclose(found, [[0.1, 0.1, 0.0], reward, [0.0, 0.0, 0.0]], atol=1e-7)
    world = stepped(last)
    assert world.outcome[0] == outcome and world.terminated[0] == (outcome != TIME_OUT)
    np.testing.assert_allclose(world.reward[0], reward)


def test_endings_are_told_in_words() -> None:
    demos = flock(2)
    told = [
        ending_in_words(code, demos.individuals, demos.roles)
        for code in (2, TARGET_OUT, PURSUER_OUT, TIME_OUT)
    ]
    assert told == [
        "dog reached sheep_1", "a target left the arena", "a pursuer left the arena", "",
    ]  # fmt: skip
    assert outcome_name(2, demos) == "contact with sheep_1"
    assert outcome_name(TARGET_OUT, demos) == "a target left"


def written(folder: Path, demos: Demonstrations, names: dict[str, str]) -> list[Path]:
    """A table of every episode, as a tracker would write it, under other names."""
    given = [names[name] for name in demos.individuals]
    files = [folder / f"field_{one.index}.csv" for one in demos]
    return [write_tracks(file, one.positions, given) for file, one in zip(files, demos)]


@pytest.mark.slow
def test_tables_of_a_sheepdog_become_a_run_with_a_report(tmp_path: Path) -> None:
    names = {"dog": "bella", "sheep_0": "ewe", "sheep_1": "lamb"}
    files = written(tmp_path, flock(2), names)
    imported = tmp_path / "flock.npz"
    shown = animarl("import", *files, "--fps", 10, "--pursuer", "bella", "--arena", "disc",
                 "--arena-width", 4, "--centre", "0,0", "--contact", 0.2,
                 "--out", imported)  # fmt: skip
    assert "bella" in shown
    demos = Demonstrations.load(imported)
    assert demos.individuals == ("ewe", "lamb", "bella")
    assert demos.roles == ("target", "target", "pursuer")
    run = tmp_path / "run"
    animarl("run", imported, "--out", run, "--steps", 60, "--copies", 2, "--repetitions", 2,
         "--set", "offline_epochs=1")  # fmt: skip
    assert (run / "report.html").exists()


def test_a_table_of_roles_names_the_dog_of_every_field(tmp_path: Path) -> None:
    demos = flock(2)
    files = written(tmp_path, demos, {"dog": "bella", "sheep_0": "ewe", "sheep_1": "lamb"})
    rows = ["recording,individual,role"]
    for i in range(len(files)):
        rows += [f"field_{i},{name},target" for name in ("ewe", "lamb")]
        rows.append(f"field_{i},bella,pursuer")
    table = tmp_path / "sessions.csv"
    table.write_text("\n".join([*rows, ""]))
    animarl("import", *files, "--fps", 10, "--metadata", table, "--out", tmp_path / "a.npz")
    assert Demonstrations.load(tmp_path / "a.npz").roles == ("target", "target", "pursuer")
    lone = [row for row in rows if row != "field_0,lamb,target"]
    words = ("import", *files, "--fps", 10, "--metadata", table, "--out", tmp_path / "b.npz")
    for told, why in (
        ([*rows, "field_0,rex,pursuer"], "several pursuers and several targets"),
        ([*rows, "field_0,rex,target"], "there is no individual 'rex'"),
        (lone, "some recordings have one target and others several"),
        ([row for row in rows if "bella" not in row], "several targets but no pursuer in field_0"),
    ):
        table.write_text("\n".join([*told, ""]))
        refuses(why, animarl, *words)
