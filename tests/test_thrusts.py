"""Several thrust magnitudes: 12 M + 1 actions everywhere, fitted, and followed in closed loop."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

import animarl_envs
from animarl_algos.cli.main import app
from animarl_algos.cli.thrusts import parse_thrusts
from animarl_algos.data.slots import refuse_other_actions
from animarl_algos.data.species_data import SpeciesDemonstrations
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.decisions import decide_along
from animarl_algos.evaluation.thrust_choice import GAIN, choose_thrusts, tracking_floor
from animarl_algos.recipes.dqn import DQN
from animarl_algos.report.interpretation import action_labels
from animarl_envs.arena import Arena
from animarl_envs.demos import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import assign_splits
from animarl_envs.errors import InputError
from animarl_envs.fitting import (
    LocomotionFit,
    demonstrated_actions,
    fit_joint,
    fit_locomotion,
    joint_locomotion,
    one_step_misses,
    track,
    transitions,
)
from animarl_envs.fitting.magnitudes import fast_speed
from animarl_envs.fitting.tracking import speed_distances, tracking_errors
from animarl_envs.focus import focus_directions
from animarl_envs.importing.readers import read
from animarl_envs.locomotion import (
    ACTION_VECTORS,
    COAST,
    MOST_THRUSTS,
    NUM_ACTIONS,
    Locomotion,
    action_directions,
    apply_actions,
    infer_actions,
)
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT, FLY, SILKMOTH, Species
from animarl_envs.views.scenario_data import scenario_as_data
from animarl_envs.worlds import make_world
from animarl_envs.worlds.rules import LOOKAHEAD, decide
from animarl_envs.worlds.search.programmed_moth import ProgrammedMoth

MULTIPLES = (1.75, 1.0, 0.5)
DT = 0.1
ROLES = ("pursuer", "pursuer", "target")


def three(species: Species) -> Species:
    """The species with three magnitudes."""
    return replace(
        species, locomotion=tuple(replace(m, magnitudes=MULTIPLES) for m in species.locomotion)
    )


def walk(
    truth: tuple[Locomotion, ...],
    seed: int,
    *,
    episodes: int = 40,
    steps: int = 50,
    noise: float = 0.0,
) -> tuple[Demonstrations, NDArray[np.int64]]:
    """Sticky random actions of three individuals in the open, and the actions."""  # fmt: skip
    rng = np.random.default_rng(seed)
    count = truth[0].num_actions
    position = rng.uniform(-0.5, 0.5, (episodes, 3, 2))
    velocity = np.zeros((episodes, 3, 2))
    action = rng.integers(count, size=(episodes, 3))
    path, taken = [position], []
    for _ in range(steps):
        action = np.where(
            rng.random(action.shape) < 0.3, rng.integers(count, size=action.shape), action
        )
        focus = focus_directions(position, ROLES)
        velocity = np.stack(
            [
                apply_actions(velocity[:, i], action[:, i], focus[:, i], m, DT)
                for i, m in enumerate(truth)
            ],
            axis=1,
        )
        position = position + velocity * DT
        path.append(position)
        taken.append(action)
    frames = np.stack(path, axis=1).reshape(-1, 3, 2)
    actions = np.stack([*taken, np.full((episodes, 3), -1)], axis=1).reshape(-1, 3)
    recording = np.array([f"r{i:03d}" for i in range(episodes)])
    demos = Demonstrations(
        species="custom", individuals=("a", "b", "c"), roles=ROLES, dt=DT, arena=Arena("open"),
        positions=frames + noise * rng.standard_normal(frames.shape),
        lengths=np.full(episodes, steps + 1), initial_velocity=np.zeros((episodes, 3, 2)),
        condition=np.zeros(episodes, np.int8), outcome=np.zeros(episodes, np.int8),
        split=assign_splits(recording, 0), recording=recording,
        provenance={"source": "test", "licence": "none", "synthetic": True},
    )  # fmt: skip
    return demos, actions


TRUTH = tuple(Locomotion(d, u, (1.6, 0.9, 0.4)) for d, u in ((0.2, 2.0), (0.25, 2.4), (0.3, 3.0)))


# -- the actions ----------------------------------------------------------------------------------


def test_one_magnitude_is_the_papers_thirteen_actions_to_the_bit() -> None:
    one = Locomotion(0.25, 3.0)
    assert one.magnitudes == (1.0,) and one.thrusts == 1 and one.num_actions == NUM_ACTIONS == 13
    assert one.action_vectors.tobytes() == ACTION_VECTORS.tobytes()
    assert AGENT.num_actions == 13 and AGENT.thrusts == 1


def test_an_action_is_a_magnitude_and_a_direction_and_the_last_coasts() -> None:
    vectors = Locomotion(0.25, 3.0, MULTIPLES).action_vectors
    assert vectors.shape == (37, 2) and not vectors.flags.writeable
    for action in range(36):
        expected = MULTIPLES[action // 12] * ACTION_VECTORS[action % 12]
        np.testing.assert_array_equal(vectors[action], expected)
    assert not vectors[36].any()


def test_directions_forget_the_magnitude() -> None:
    focus = np.array([0.6, 0.8])
    for action in range(36):
        np.testing.assert_array_equal(
            action_directions(np.array(action), focus, 37),
            action_directions(np.array(action % 12), focus),
        )
    assert not action_directions(np.array(36), focus, 37).any()


@pytest.mark.parametrize("given", [(), (0.5, 1.0), (1.0, 1.0), (1.0, 0.0), (1.0, -1.0), "1",
                                   (np.inf,), (float("nan"),), 2.0, (True,),
                                   tuple(range(MOST_THRUSTS + 1, 0, -1))])  # fmt: skip
def test_magnitudes_fall_and_are_positive(given: Any) -> None:
    with pytest.raises(InputError, match="magnitudes"):
        Locomotion(0.1, 1.0, given)


def test_individuals_with_other_numbers_of_magnitudes_are_refused() -> None:
    mixed = (Locomotion(0.25, 3.0, MULTIPLES), *AGENT.locomotion[1:])
    with pytest.raises(InputError, match="predator_0 3, predator_1 1"):
        replace(AGENT, locomotion=mixed)


def test_magnitudes_are_an_option_by_name() -> None:
    every = {name: {"magnitudes": MULTIPLES} for name in FLY.individuals}
    scenario = make_scenario("fly", locomotion=every)
    assert scenario.species == three(FLY)
    stated = scenario_as_data(scenario)["locomotion"]
    assert [one["magnitudes"] for one in stated] == [list(MULTIPLES)] * 3


def test_the_terminal_speed_is_that_of_the_largest_thrust() -> None:
    assert Locomotion(0.2, 2.0, MULTIPLES).terminal_speed(DT) == pytest.approx(1.75)
    assert Locomotion(0.0, 2.0, MULTIPLES).top_speed(DT, 10, 0.5) == pytest.approx(4.0)


def test_inverse_dynamics_returns_magnitude_and_direction() -> None:
    demos, actions = walk(TRUTH, 1)
    np.testing.assert_array_equal(demonstrated_actions(demos, TRUTH), actions)


# -- one transition -------------------------------------------------------------------------------


def test_worlds_and_numpy_move_alike() -> None:
    species = three(AGENT)
    world = make_world(make_scenario(species, demos=None), 50)
    world.seed(np.arange(50))
    world.reset()
    rng = np.random.default_rng(0)
    for _ in range(10):
        actions = rng.integers(37, size=(50, 3))
        towards = focus_directions(world.position, ROLES)
        expected = np.stack(
            [apply_actions(world.velocity[:, i], actions[:, i], towards[:, i], m, species.dt)
             for i, m in enumerate(species.locomotion)], axis=1,
        )  # fmt: skip
        world.step(actions)
        np.testing.assert_allclose(world.velocity, expected, rtol=1e-12, atol=1e-12)


def test_the_searcher_and_numpy_move_alike() -> None:
    species = three(SILKMOTH)
    world = make_world(make_scenario(species, demos=None), 37)
    world.reset()
    upwind = np.tile([-1.0, 0.0], (37, 1))
    for _ in range(3):
        actions = np.arange(37)
        expected = apply_actions(
            world.velocity[:, 0], actions, upwind, species.locomotion[0], species.dt
        )
        world.step(actions[:, None])
        np.testing.assert_allclose(world.velocity[:, 0], expected, rtol=1e-12, atol=1e-15)


def test_the_scripted_target_looks_ahead_with_the_same_transition() -> None:
    rng = np.random.default_rng(3)
    own = Locomotion(0.2, 3.0, MULTIPLES)
    copies, target = 40, 2
    position = rng.uniform(-0.9, 0.9, (3, 2, copies))
    velocity = rng.normal(0, 0.5, (3, 2, copies))
    towards = focus_directions(position.transpose(2, 0, 1), ROLES)
    actions = np.zeros((3, copies), dtype=np.uint64)
    pushes = np.stack([np.ascontiguousarray(own.action_vectors.T)] * 3)
    decide(
        target, position, velocity, np.ascontiguousarray(towards.transpose(1, 2, 0)), own.damping,
        own.thrust, pushes, DT, 2, 1.0, actions,
    )  # fmt: skip
    # In the open (shape 2) only the distance from pursuers counts; see animarl_envs.worlds.rules.
    costs = np.empty((37, copies))
    for k in range(37):
        place, speed = position[target].T, velocity[target].T
        for _ in range(LOOKAHEAD):
            speed = apply_actions(speed, np.full(copies, k), towards[:, target], own, DT)
            place = place + speed * DT
        gaps = [
            np.linalg.norm(position[j].T + velocity[j].T * LOOKAHEAD * DT * 0.5 - place, axis=1)
            for j in range(2)
        ]
        costs[k] = sum(1.0 / (gap + 0.05) for gap in gaps)
    chosen = costs[actions[target].astype(int), np.arange(copies)]
    np.testing.assert_allclose(chosen, costs.min(axis=0), rtol=1e-12)
    assert len(set(actions[target].tolist())) > 5 and (actions[target] < 12).all()


def test_the_fit_rebuilds_velocities_with_the_same_transition() -> None:
    """The loss of the joint fit is the squared miss of the inferred actions."""
    from animarl_envs.fitting.joint import _scratch
    from animarl_envs.fitting.nearest_actions import assign

    demos, _ = walk(TRUTH, 2, noise=0.01)
    own = Locomotion(0.3, 1.5, MULTIPLES)
    data = transitions(demos, 0)
    error, action, level = _scratch(len(data))
    impulses = own.thrust * np.array(MULTIPLES) * DT
    assign(
        data.velocity, data.next_velocity, data.focus, own.damping, impulses, error, action, level
    )
    inferred = infer_actions(data.velocity, data.next_velocity, data.focus, own, DT)
    rebuilt = apply_actions(data.velocity, inferred, data.focus, own, DT)
    missed = np.sum((rebuilt - data.next_velocity) ** 2, axis=1)
    np.testing.assert_allclose(error, missed, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(level, np.where(inferred == 36, -1, inferred // 12))


# -- every view -----------------------------------------------------------------------------------


def test_all_views_offer_the_same_actions() -> None:
    options: dict[str, Any] = {"locomotion": three(FLY).locomotion}
    env = gym.make("AnimaRL/Fly-v0", **options)
    envs = gym.make_vec("AnimaRL/Fly-v0", num_envs=2, **options)
    everybody = animarl_envs.parallel_env("fly", **options)
    slots = SlotVecEnv("fly", 2, **options)
    assert env.action_space == everybody.action_space("female") == slots.action_space
    assert env.action_space == gym.spaces.Discrete(37) == envs.unwrapped.single_action_space  # type: ignore[attr-defined]
    env.reset(seed=0)
    env.step(36)
    with pytest.raises(InputError, match="0 to 36"):
        env.unwrapped.step(37)


def test_whoever_nobody_drives_coasts() -> None:
    drivers = dict.fromkeys(AGENT.individuals, "coast")
    world = make_world(make_scenario(three(AGENT), demos=None, drivers=drivers), 3)
    world.reset()
    world.velocity[:] = 0.4
    world.step(np.zeros((3, 3), dtype=np.int64))
    np.testing.assert_allclose(world.velocity, 0.3, rtol=1e-12)


def test_a_replay_that_has_ended_coasts() -> None:
    demos = load_packaged("silkmoth").select(split="train")
    shortest = demos.select(episodes=[int(np.argmin(demos.lengths))])
    scenario = make_scenario(three(SILKMOTH), demos=shortest, drivers={"moth": "replay"})
    world = make_world(scenario, 1)
    world.reset()
    for _ in range(int(shortest.lengths[0]) - 1):
        world.step(np.zeros((1, 1), dtype=np.int64))
    before = world.velocity.copy()
    world.step(np.zeros((1, 1), dtype=np.int64))
    np.testing.assert_allclose(world.velocity, (1 - 0.208) * before, rtol=1e-12)


def test_the_programmed_moth_uses_what_it_has() -> None:
    species = three(SILKMOTH)
    moth = ProgrammedMoth(200, np.random.default_rng(0), species)
    world = make_world(make_scenario(species, demos=None), 200)
    world.reset()
    taken = np.concatenate([(moth.act(world.observation)) for _ in range(3)])
    assert taken.min() >= 0 and taken.max() == 36
    rest = moth._nearest_action(np.zeros((1, 2)), np.zeros((1, 2)))
    assert rest.tolist() == [36]


# -- learners -------------------------------------------------------------------------------------


def test_data_and_decisions_have_a_value_per_action() -> None:
    demos = load_packaged("agent")
    few = demos.select(
        episodes=np.concatenate([np.flatnonzero(demos.split == s)[:3] for s in ("train", "val")])
    )
    species = three(AGENT)
    train = SpeciesDemonstrations(species, few, species.individuals).train
    batch = next(iter(train.batches(2, np.random.default_rng(0))))
    assert batch.action_penalties.shape[-1] == 37 and batch.actions.max() > COAST
    penalties = one_step_misses(few, species.locomotion)
    assert penalties.shape == (len(few.positions), 3, 37)
    acted = demonstrated_actions(few, species.locomotion)
    np.testing.assert_array_equal(penalties[acted >= 0].argmin(axis=1), acted[acted >= 0])

    class Flat:
        def advance(self, observation: Any, state: Any, episode_start: Any) -> Any:
            return np.zeros((len(observation), 37)), np.zeros((len(observation), 1)), False

    decisions = decide_along(Flat(), species, few)
    assert decisions.q.shape[1] == decisions.map_q.shape[2] == 37
    labels = action_labels(37)
    assert labels[0] == "1: towards focus" and labels[15] == "2: right" and labels[36] == "coast"
    assert action_labels(13)[0] == "towards focus" and action_labels(13)[COAST] == "coast"


def test_a_model_of_other_magnitudes_is_refused() -> None:
    model = DQN(
        env=SlotVecEnv("agent", 2), offline_epochs=0, seed=0, device="cpu", buffer_size=1000
    )
    richer = SlotVecEnv(three(AGENT), 2)
    with pytest.raises(InputError, match=r"13 actions learned and 37 here: .*thrust magnitudes"):
        model.set_env(richer)
    scenario = make_scenario(three(AGENT), split="val")
    with pytest.raises(InputError, match="thrust magnitudes"):
        collect_rollouts(
            lambda copies: make_world(scenario, copies), model, method="dqn", seed=0, repetitions=1
        )
    refuse_other_actions(37, 37)


def test_random_policies_use_all_actions() -> None:
    actions, _ = RandomPolicy(0, 37).predict(np.zeros((5000, 4)))
    assert set(actions.tolist()) == set(range(37))


# -- fits -----------------------------------------------------------------------------------------


def test_several_magnitudes_of_exact_tracks_are_found() -> None:
    demos, _ = walk(TRUTH, 4, episodes=60)
    for found, truth in zip(joint_locomotion(demos, 3), TRUTH, strict=True):
        assert found.damping == pytest.approx(truth.damping, abs=1e-6)
        np.testing.assert_allclose(
            found.thrust * np.array(found.magnitudes),
            truth.thrust * np.array(truth.magnitudes),
            rtol=1e-5,
        )


def test_noise_moves_the_magnitudes_little() -> None:
    demos, _ = walk(TRUTH, 5, episodes=100, noise=5e-4)
    for found, truth in zip(joint_locomotion(demos, 3), TRUTH, strict=True):
        assert found.damping == pytest.approx(truth.damping, abs=0.02)
        np.testing.assert_allclose(
            found.thrust * np.array(found.magnitudes),
            truth.thrust * np.array(truth.magnitudes),
            rtol=0.05,
        )


def test_exact_tracks_of_one_magnitude_stay_what_they_are() -> None:
    truth = tuple(Locomotion(0.25, u) for u in (2.4, 2.4, 3.0))
    demos, _ = walk(truth, 6)
    for found, own in zip(joint_locomotion(demos, 1), truth, strict=True):
        assert found.damping == pytest.approx(0.25, abs=1e-6)
        assert found.thrust == pytest.approx(own.thrust, abs=1e-6)
        assert found.magnitudes == (1.0,)
    assert choose_thrusts(demos) == 1


def test_as_many_magnitudes_are_chosen_as_there_are() -> None:
    demos, _ = walk(TRUTH, 7)
    assert choose_thrusts(demos) == 3


def test_the_floor_needs_two_episodes_to_tell_apart() -> None:
    demos, _ = walk(TRUTH, 7)
    assert tracking_floor(demos, TRUTH).estimate < 0.6
    poorer = joint_locomotion(demos, 1)
    assert tracking_floor(demos, poorer).estimate > 0.8
    assert np.isnan(tracking_floor(demos.select(episodes=[0]), TRUTH).estimate)


def test_the_terminal_speed_reaches_the_fast_steps() -> None:
    """Noise biases d upwards (docs/data/fitting.md) until the animal could not go so fast."""
    truth = (Locomotion(0.05, 1.0),) * 3
    demos, _ = walk(truth, 8, noise=0.02)
    data = transitions(demos, 0)
    free, fast = fit_joint(data), fast_speed(data)
    assert free.terminal_speed(DT) < 0.9 * fast
    held = fit_joint(data, least_speed=fast)
    assert held.terminal_speed(DT) == pytest.approx(fast, rel=1e-9)

    # The best of all fits with that terminal speed.
    def miss(thrust: float) -> float:
        own = Locomotion(thrust * DT / fast, thrust)
        actions = infer_actions(data.velocity, data.next_velocity, data.focus, own, DT)
        rebuilt = apply_actions(data.velocity, actions, data.focus, own, DT)
        return float(np.sum((rebuilt - data.next_velocity) ** 2))

    assert miss(held.thrust) <= min(miss(0.98 * held.thrust), miss(1.02 * held.thrust))
    for thrusts in (1, 2, 3):
        for own in joint_locomotion(demos, thrusts):
            assert own.terminal_speed(DT) >= fast_speed(data) * 0.9
    fit = fit_locomotion(demos, bootstrap=50)
    for one in fit.individuals:
        low, high = one.damping_interval or (np.nan, np.nan)
        assert low < one.damping < high


def test_a_fit_with_magnitudes_passes_through_json(tmp_path: Path) -> None:
    demos, _ = walk(TRUTH, 9)
    fit = fit_locomotion(demos, thrusts=2, bootstrap=0)
    assert {own.thrusts for own in fit.locomotion} == {2}
    assert LocomotionFit.load(fit.save(tmp_path / "fit.json")) == fit


def test_a_file_from_before_magnitudes_has_one() -> None:
    demos, _ = walk(TRUTH, 9)
    fit = fit_locomotion(demos, bootstrap=0)
    record = fit.to_dict()
    for one in record["individuals"]:
        del one["magnitudes"]
    assert LocomotionFit.from_dict(record) == fit


@pytest.mark.parametrize("thrusts", [0, MOST_THRUSTS + 1, 1.5, "2"])
def test_impossible_numbers_of_magnitudes_are_refused(thrusts: Any) -> None:
    demos, _ = walk(TRUTH, 9, episodes=10)
    with pytest.raises(InputError, match="thrusts is"):
        fit_locomotion(demos, thrusts=thrusts)


def test_the_onset_rule_has_one_thrust() -> None:
    demos, _ = walk(TRUTH, 9, episodes=10)
    with pytest.raises(InputError, match="onset rule fits one thrust"):
        fit_locomotion(demos, "onset", thrusts=2, bootstrap=0)


# -- tracking -------------------------------------------------------------------------------------


def test_exact_tracks_are_followed_exactly() -> None:
    demos, actions = walk(TRUTH, 10)
    tracking = track(demos, TRUTH)
    np.testing.assert_array_equal(tracking.actions, actions)
    np.testing.assert_allclose(tracking.positions, demos.positions, atol=1e-12)
    np.testing.assert_allclose(tracking.velocities, demos.velocities(), atol=1e-11)
    assert speed_distances(demos, tracking).max() < 1e-10


def test_each_step_is_the_best_from_where_the_simulation_is() -> None:
    """Against all actions of one step in NumPy, focus from the simulated positions."""
    demos, _ = walk(TRUTH, 11, episodes=5, noise=0.01)
    poorer = tuple(Locomotion(m.damping, m.thrust, (1.2, 0.5)) for m in TRUTH)
    tracking, velocity = track(demos, poorer), demos.velocities()
    focus = focus_directions(tracking.positions, ROLES)
    misses = one_step_misses(demos, poorer, tracking)
    for frame in np.flatnonzero(tracking.actions[:, 0] >= 0):
        for i, own in enumerate(poorer):
            taken = tracking.actions[frame, i]
            v = np.stack([
                apply_actions(tracking.velocities[frame, i], np.array(k), focus[frame, i], own, DT)
                for k in range(25)
            ])  # fmt: skip
            p = tracking.positions[frame, i] + v * DT
            cost = np.sum((p - demos.positions[frame + 1, i]) ** 2, axis=1) / DT**2
            cost += np.sum((v - velocity[frame + 1, i]) ** 2, axis=1)
            assert cost[taken] == pytest.approx(cost.min(), rel=1e-9)
            np.testing.assert_allclose(p[taken], tracking.positions[frame + 1, i], atol=1e-12)
            np.testing.assert_allclose(misses[frame, i], DT * np.sqrt(cost / 2), atol=1e-12)
    last = demos.offsets[1:] - 1
    assert (tracking.actions[last] == -1).all() and not misses[last].any()


def test_misses_from_recorded_states_are_distances() -> None:
    demos, _ = walk(TRUTH, 12, episodes=10, noise=0.01)
    misses, focus, velocity = one_step_misses(demos, TRUTH), demos.focus(), demos.velocities()
    for frame in np.setdiff1d(np.arange(len(misses)), demos.offsets[1:] - 1):
        for i, own in enumerate(TRUTH):
            for action in (0, 7, own.num_actions - 1):
                reached = apply_actions(
                    velocity[frame, i], np.array(action), focus[frame, i], own, DT
                )
                apart = demos.positions[frame, i] + reached * DT - demos.positions[frame + 1, i]
                assert misses[frame, i, action] == pytest.approx(np.hypot(*apart), abs=1e-12)


def test_tracking_stays_within_walls() -> None:
    demos, _ = walk(TRUTH, 13, episodes=10)
    walls = Arena("disc", size=0.5, boundary=0.5, rebound=True)
    assert np.linalg.norm(demos.positions, axis=2).max() > 1.0
    held = track(demos, TRUTH, walls).positions
    started = np.delete(np.arange(len(held)), demos.offsets[:-1])
    assert np.linalg.norm(held[started], axis=2).max() <= 0.5
    free = track(demos, TRUTH, replace(walls, rebound=False)).positions
    assert np.linalg.norm(free, axis=2).max() > 1.0


def test_packaged_flies_are_followed_to_a_thousandth() -> None:
    demos = load_packaged("fly").select(split="val")
    tracking = track(demos, FLY.locomotion)
    assert np.hypot(*(tracking.positions - demos.positions).T).max() < 5e-3
    assert tracking_errors(demos, tracking).max() < 1e-4


def test_tracking_wants_equal_magnitudes() -> None:
    demos, _ = walk(TRUTH, 14, episodes=5)
    with pytest.raises(InputError, match="thrust magnitudes"):
        track(demos, (TRUTH[0], TRUTH[1], Locomotion(0.3, 3.0)))
    with pytest.raises(InputError, match="3 individuals"):
        track(demos, TRUTH[:2])


# -- the command ----------------------------------------------------------------------------------


def test_the_command_compares_numbers_of_magnitudes(tmp_path: Path) -> None:
    demos, _ = walk(TRUTH, 15, episodes=20)
    file, out = demos.save(tmp_path / "walk.npz"), tmp_path / "rows.csv"
    result = CliRunner().invoke(
        app, ["fit", str(file), "--thrusts", "1,3", "--out", str(out)], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["thrusts"] for row in rows] == ["1"] * 3 + ["3"] * 3
    for row, truth in zip(rows[3:], TRUTH, strict=True):
        found = float(row["thrust"]) * np.array(row["magnitudes"].split(), dtype=float)
        np.testing.assert_allclose(found, truth.thrust * np.array(truth.magnitudes), rtol=1e-4)
        assert float(row["tracking_error"]) < 1e-3 < float(rows[0]["tracking_error"])
        assert float(row["floor"]) < float(rows[0]["floor"]) - GAIN
    assert "Chosen on training episodes: 3" in result.output


def test_numbers_of_magnitudes_are_read_from_either_form() -> None:
    assert parse_thrusts(["1,2, 5"]) == parse_thrusts(["5", "2", "1", "1"]) == (1, 2, 5)
    for bad in (["0"], ["1,,2"], ["two"], ["11"], ["-1"]):
        with pytest.raises(InputError, match="--thrusts"):
            parse_thrusts(bad)


# -- recordings -----------------------------------------------------------------------------------


@pytest.mark.realdata
def test_recorded_agents_have_one_magnitude_and_are_followed_exactly(data_dir: Path) -> None:
    demos = read(data_dir / "agents_collab_hunting" / "episodes_c2ae_share_slow2.4.npz")
    fit = joint_locomotion(demos.select(split="train"))
    for found, thrust in zip(fit, (2.4, 2.4, 3.0), strict=True):
        assert found.damping == pytest.approx(0.25, abs=1e-6)
        assert found.thrust == pytest.approx(thrust, abs=1e-6)
    truth = tuple(Locomotion(0.25, u) for u in (2.4, 2.4, 3.0))
    tracking = track(demos, truth)
    np.testing.assert_array_equal(tracking.actions, demonstrated_actions(demos, truth))
    assert np.abs(tracking.positions - demos.positions).max() < 1e-5


@pytest.mark.realdata
def test_recorded_moths_are_followed_more_closely_with_three(data_dir: Path) -> None:
    from animarl_envs.importing.readers import default_recipe, follow, get_reader

    files = sorted((data_dir / "silkmoth_mothvr" / "raw").glob("*.csv"))
    demos = follow(default_recipe(get_reader("mothvr")), files).select(split="train")
    one, many = (track(demos, joint_locomotion(demos, m)) for m in (1, 3))
    assert (tracking_errors(demos, many) < 0.7 * tracking_errors(demos, one)).all()
    assert (speed_distances(demos, many) < 0.5 * speed_distances(demos, one)).all()
