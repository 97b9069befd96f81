"""The packaged flies and newts: synthetic, as published where it is said, obeying their world."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from typer.testing import CliRunner

import animarl_envs
from animarl_algos.cli.main import app
from animarl_envs.demos.demonstrations import TIME_OUT, Demonstrations
from animarl_envs.demos.packaged import FOLDER, load_packaged
from animarl_envs.errors import InputError
from animarl_envs.fitting import demonstrated_actions, fit_locomotion
from animarl_envs.focus import distances_to_target
from animarl_envs.scenario import make_scenario
from animarl_envs.species import get_species
from animarl_envs.worlds.chase.world import ChaseWorld
from tools.packaged_data import courtship
from tools.packaged_data.courtship_behaviour import simulate
from tools.packaged_data.courtship_episodes import durations, outcomes
from tools.packaged_data.courtship_published import BEHAVIOURS, PUBLISHED, SHAPES
from tools.packaged_data.courtship_shapes import LEVELS, fit, is_moving, measure, quantile
from tools.packaged_data.courtship_statistics import BINS, speed_histogram, table

NAMES = sorted(PUBLISHED)
DOCS = Path(__file__).parents[1] / "docs"


# -- the packaged files ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_packaged_courtship_is_small_and_says_that_it_is_synthetic(name):
    demos = load_packaged(name)
    assert (FOLDER / f"{name}.npz").stat().st_size < 2_000_000
    assert demos.synthetic and "synthetic" in demos.provenance["source"]
    assert f"courtship make {name} --seed" in demos.provenance["source"]
    assert all("synthetic" in r for r in demos.recording)
    shown = CliRunner().invoke(app, ["data", "show", name])
    assert shown.exit_code == 0 and "synthetic" in shown.output
    assert "not recorded from animals" in " ".join(shown.output.replace("│", " ").split())


@pytest.mark.parametrize("name", NAMES)
def test_statistics_are_those_published(name):
    demos, published = load_packaged(name), PUBLISHED[name]
    duration = (demos.lengths - 1) * demos.dt
    assert demos.num_episodes == published.episodes
    assert duration.min() == pytest.approx(published.shortest)
    assert duration.max() == pytest.approx(published.longest)
    assert duration.sum() == pytest.approx(published.total, rel=0.01)
    for male, rate in enumerate(published.touch_rates):
        assert (demos.outcome == male + 1).mean() == pytest.approx(rate, abs=0.002)
    counts = tuple(int((demos.split == split).sum()) for split in ("train", "val", "test"))
    assert counts == published.splits
    assert len(set(demos.recording)) == demos.num_episodes  # none shares a session with another


@pytest.mark.parametrize("name", NAMES)
def test_near_zero_speed_is_the_most_frequent(name):
    speed = np.linalg.norm(load_packaged(name).velocities(), axis=2)
    for own in speed.T:
        histogram = speed_histogram(own)
        assert histogram.sum() == pytest.approx(1.0) and len(histogram) == BINS
        assert histogram.argmax() == 0 and histogram[0] > 0.25


@pytest.mark.parametrize("name", NAMES)
def test_episodes_start_far_and_end_at_contact_or_the_limit(name):
    demos, species = load_packaged(name), get_species(name)
    for one in demos:
        distance = distances_to_target(one.positions, demos.roles)
        nearest = distance.min(axis=1)
        assert nearest[0] > species.recording.start_farther_than
        assert (nearest[:-1] >= species.contact_radius).all()
        if one.outcome == TIME_OUT:
            assert one.num_steps == species.time_limit
            assert nearest[-1] >= species.contact_radius
        else:
            assert nearest[-1] < species.contact_radius
            assert distance[-1].argmin() + 1 == one.outcome
    assert species.arena.contains(demos.positions).all()


@pytest.mark.parametrize("name", NAMES)
def test_joint_fit_recovers_the_locomotion(name):
    found = fit_locomotion(load_packaged(name), bootstrap=0)
    for fitted, true in zip(found.individuals, get_species(name).locomotion, strict=True):
        assert fitted.damping == pytest.approx(true.damping, rel=0.02)
        assert fitted.thrust == pytest.approx(true.thrust, rel=0.002)
        assert fitted.velocity_rmse < 0.06 * true.thrust * 0.1


@pytest.mark.parametrize("name", NAMES)
def test_inferred_actions_are_those_taken_and_replay_the_positions(name):
    demos = load_packaged(name)
    species = get_species(name)
    inferred = demonstrated_actions(demos, species.locomotion)
    assert (inferred == demos.signals["actions"]).mean() > 0.9999
    world = ChaseWorld(
        make_scenario(species, demos=demos, split=None, warmup=0), demos.num_episodes
    )
    world.reset(demo=np.arange(demos.num_episodes))
    steps, offsets = demos.lengths - 1, demos.offsets
    for t in range(int(steps.max())):
        going = np.flatnonzero(t < steps)
        actions = np.full(world.reward.shape, 12)
        actions[going] = demos.signals["actions"][offsets[going] + t]
        world.step(actions)
        replayed = demos.positions[offsets[going] + t + 1]
        np.testing.assert_allclose(world.position[going], replayed, atol=2e-4)
        ended = going[steps[going] == t + 1]
        np.testing.assert_array_equal(world.outcome[ended], demos.outcome[ended])
        assert (world.terminated[ended] == (demos.outcome[ended] > 0)).all()


@pytest.mark.parametrize("name", NAMES)
def test_environments_start_from_it(name):
    env = gym.make(animarl_envs.environment_id(name))
    _, info = env.reset(seed=0)
    train = load_packaged(name).select(split="train")
    first = env.unwrapped.world.position[0]
    np.testing.assert_array_equal(first, train.episode(info["demo"]).positions[0])


# -- the generator --------------------------------------------------------------------------------


def few(**options):
    return courtship.make("fly", 2, episodes=5, session_steps=3000, **options)


def test_same_seed_same_bytes(tmp_path):
    done: list[float] = []
    files = [few(progress=done.append).save(tmp_path / f"{k}.npz", dtype=np.float32) for k in "ab"]
    assert files[0].read_bytes() == files[1].read_bytes()
    assert done[-1] == 1.0
    demos = Demonstrations.load(files[0])
    assert demos.num_episodes == 5
    assert set(demos.split) == {"train", "val", "test"}


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_documented_command_repeats_the_packaged_file(name, tmp_path):
    out = tmp_path / "again.npz"
    assert courtship.main(["make", name, "--seed", "1", "--out", str(out)]) == 0
    assert out.read_bytes() == (FOLDER / f"{name}.npz").read_bytes()


def test_everybody_pauses_and_moves():
    species, behaviour = get_species("fly"), BEHAVIOURS["fly"]
    sessions = simulate(species, behaviour, 4, 1500, np.random.default_rng(0))
    speed = np.linalg.norm(sessions.velocity, axis=3)
    for b in range(4):
        for i in range(species.num_individuals):
            moving = is_moving(speed[:, b, i], 0.03, species.dt)
            assert 0.1 < moving.mean() < 0.95
    # actions explain the motion exactly: no acceleration while coasting
    steps = np.diff(sessions.velocity[:, :, 0], axis=0)
    coasting = sessions.actions[:, :, 0] == 12
    lost = -species.locomotion[0].damping * sessions.velocity[:-1, :, 0]
    np.testing.assert_allclose(steps[coasting], lost[coasting], atol=1e-6)


def test_males_that_court_come_nearer_than_males_that_do_not():
    species = get_species("newt")
    mean = []
    for error in (0.3, 100.0):  # bearing known, or unknown
        behaviour = replace(BEHAVIOURS["newt"], approach_error=error)
        sessions = simulate(species, behaviour, 12, 1500, np.random.default_rng(1))
        position = sessions.position[700:]
        mean.append(np.linalg.norm(position[:, :, :-1] - position[:, :, -1:], axis=3).mean())
    assert mean[0] < 0.9 * mean[1]


@pytest.mark.parametrize("name", NAMES)
def test_durations_add_up_and_outcomes_are_dealt(name):
    published = PUBLISHED[name]
    steps = durations(published, 0.1)
    assert len(steps) == published.episodes and (np.diff(steps) >= 0).all()
    assert steps.sum() == round(published.total / 0.1)
    assert (steps[0], steps[-1]) == (round(published.shortest * 10), round(published.longest * 10))
    codes = outcomes(published, steps, 500, np.random.default_rng(0))
    assert (steps[codes == TIME_OUT] == 500).all()
    assert (codes == TIME_OUT).sum() == round((1 - sum(published.touch_rates)) * len(steps))


def test_measuring_known_stop_and_go():
    """Two seconds at speed 1, three at rest, over and over, along a line."""
    speed = np.tile(np.repeat([1.0, 0.0], [20, 30]), 20)
    x = np.concatenate([[0.0], np.cumsum(speed) * 0.1])
    track = np.stack([x, np.zeros_like(x)], axis=-1)[:, None]
    found = measure([track], 0.1, "made up")
    assert found.pause == pytest.approx([3.0] * len(LEVELS))
    assert found.move == pytest.approx([2.0] * len(LEVELS))
    assert found.speed == pytest.approx([1.0] * len(LEVELS))
    assert found.top == pytest.approx(1.0) and found.turning == 0.0


def test_short_runs_belong_to_their_neighbours():
    speed = np.array([1, 1, 1, 1, 0, 1, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0], dtype=float)
    np.testing.assert_array_equal(is_moving(speed, 0.5, 0.1), [True] * 8 + [False] * 8)


def test_quantiles_come_back():
    shape = SHAPES["fly"]
    drawn = quantile(shape.move, np.random.default_rng(0).random(20_000))
    np.testing.assert_allclose(np.quantile(drawn, LEVELS), shape.move, rtol=0.08)


# -- the command line -----------------------------------------------------------------------------


def test_bad_input_is_refused_in_one_sentence(tmp_path, capsys):
    assert courtship.main(["make", "fly", "--episodes", "1"]) == 2
    assert "choose 3 to 107" in capsys.readouterr().err
    assert courtship.main(["fit", "fly", "--data", str(tmp_path)]) == 2
    assert str(tmp_path) in capsys.readouterr().err
    with pytest.raises(InputError, match="dodo"):
        courtship.make("dodo", 0)
    with pytest.raises(InputError, match="no pause"):
        measure([np.zeros((50, 1, 2))], 0.1, "a stone")


@pytest.mark.parametrize("name", NAMES)
def test_the_page_shows_what_the_command_prints(name, capsys):
    assert courtship.main(["table", name]) == 0
    printed = capsys.readouterr().out.strip()
    assert printed == table(load_packaged(name), PUBLISHED[name])
    assert printed in (DOCS / "data" / "packaged_courtship.md").read_text()


@pytest.mark.realdata
@pytest.mark.parametrize("name", NAMES)
def test_shipped_shapes_are_those_of_the_recordings(name, data_dir):
    assert fit(name, data_dir) == SHAPES[name]
