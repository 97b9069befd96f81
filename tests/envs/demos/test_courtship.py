"""The packaged flies and newts: synthetic, as published where it is said, obeying their world."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refuses
from typer.testing import CliRunner

from animarl_algos.cli.main import app
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.demos.packaged import FOLDER, load_packaged
from animarl_envs.errors import InputError
from animarl_envs.fitting.result import fit_locomotion
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.focus import distances_to_target
from animarl_envs.species import get_species
from tools.packaged_data import courtship
from tools.packaged_data.courtship_behaviour import TURNS, Rollouts, roll_out
from tools.packaged_data.courtship_episodes import draw_starts
from tools.packaged_data.courtship_published import BEHAVIOURS, PUBLISHED, SHAPES, STARTS
from tools.packaged_data.courtship_shapes import LEVELS, fit, is_moving, measure
from tools.packaged_data.courtship_statistics import table

NAMES = sorted(PUBLISHED)
DOCS = Path(__file__).parents[3] / "docs"


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
def test_statistics_are_those_published_from_far_to_contact_or_the_limit(name):
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
    species = get_species(name)
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
def test_joint_fit_recovers_the_locomotion_and_inferred_actions_are_those_taken(name):
    demos = load_packaged(name)
    found = fit_locomotion(demos, bootstrap=0)
    for fitted, true in zip(found.individuals, get_species(name).locomotion, strict=True):
        assert fitted.damping == pytest.approx(true.damping, rel=0.02)
        assert fitted.thrust == pytest.approx(true.thrust, rel=0.002)
        assert fitted.velocity_rmse < 0.06 * true.thrust * 0.1
    inferred = demonstrated_actions(demos, get_species(name).locomotion)
    assert (inferred == demos.signals["actions"]).mean() > 0.9999


def trios(name: str, count: int, seed: int = 0, **changed) -> Rollouts:
    species, rng = get_species(name), np.random.default_rng(seed)
    behaviour = replace(BEHAVIOURS[name], **changed)
    states = draw_starts(species, behaviour, STARTS[name], count, rng)
    return roll_out(species, behaviour, *states, rng)


@pytest.mark.parametrize("name", NAMES)
def test_the_policy_from_the_packaged_starts_lasts_and_touches_as_packaged(name):
    """No episode was chosen by its end, so a simulator can be as good as the demonstrations."""
    demos, species = load_packaged(name).select(split="train"), get_species(name)
    usual = np.char.startswith(demos.recording.astype(str), "synthetic rollout ")
    usual &= ~np.char.endswith(demos.recording.astype(str), "steps")
    assert (~usual).sum() <= 2  # the shortest and the longest
    demos = demos.select(episodes=np.flatnonzero(usual))
    first = demos.offsets[:-1]
    start = (demos.positions[first], demos.initial_velocity)
    again = [
        roll_out(species, BEHAVIOURS[name], *start, np.random.default_rng(seed))
        for seed in range(2)
    ]
    made, steps = np.concatenate([one.steps for one in again]), demos.lengths - 1
    spread = np.sqrt(made.var() / len(made) + steps.var() / len(steps))
    assert abs(made.mean() - steps.mean()) < 3.0 * spread
    for outcome in (1, 2, TIME_OUT):
        share = (np.concatenate([one.outcome for one in again]) == outcome).mean()
        spread = np.sqrt(share * (1.0 - share) / demos.num_episodes)
        assert abs(share - (demos.outcome == outcome).mean()) <= 3.0 * spread


def test_males_that_court_come_to_contact_sooner_and_a_shy_female_puts_it_off():
    unaimed = trios("newt", 60, courting=(1.0,) * TURNS)
    assert (trios("newt", 60).outcome > 0).mean() > (unaimed.outcome > 0).mean() + 0.3
    bold, shy = (trios("fly", 300, alarm=a).steps.mean() for a in (0.01, 0.6))
    assert shy > 1.2 * bold


@pytest.mark.parametrize("name", NAMES)
def test_starts_are_as_asked(name):
    species, asked = get_species(name), STARTS[name]
    rng = np.random.default_rng(0)
    position, velocity = draw_starts(species, BEHAVIOURS[name], asked, 2000, rng)
    gap = np.linalg.norm(position[:, :-1] - position[:, -1:], axis=2)
    assert asked.gap[0] <= gap.min() and gap.max() <= asked.gap[1]
    assert (gap[:, 0] < gap[:, 1]).mean() == pytest.approx(asked.first_nearer, abs=0.04)
    assert (np.linalg.norm(velocity, axis=2) > 0).mean() == pytest.approx(asked.moving, abs=0.03)
    assert species.arena.contains(position).all()


FEW = replace(PUBLISHED["fly"], episodes=60, total=220.0, longest=20.0, splits=(40, 10, 10))


def test_same_seed_same_bytes(tmp_path):
    done: list[float] = []
    files = [
        courtship.make("fly", 2, FEW, done.append).save(tmp_path / f"{k}.npz", dtype=np.float32)
        for k in "ab"
    ]
    assert files[0].read_bytes() == files[1].read_bytes()
    assert done and all(0.0 < share <= 1.0 for share in done)
    demos = Demonstrations.load(files[0])
    steps = demos.lengths - 1
    assert (len(steps), steps.min(), steps.max(), steps.sum()) == (60, 4, 200, 2200)
    assert [(demos.outcome == code).sum() for code in (1, 2, TIME_OUT)] == [43, 17, 0]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_documented_command_repeats_the_packaged_file(name, tmp_path):
    out = tmp_path / "again.npz"
    assert courtship.main(["make", name, "--seed", "1", "--out", str(out)]) == 0
    assert out.read_bytes() == (FOLDER / f"{name}.npz").read_bytes()


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
    # Short runs belong to their neighbours.
    speed = np.array([1, 1, 1, 1, 0, 1, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0], dtype=float)
    np.testing.assert_array_equal(is_moving(speed, 0.5, 0.1), [True] * 8 + [False] * 8)


def test_bad_input_is_refused_in_one_sentence(tmp_path, capsys):
    with pytest.raises(InputError, match="choose another --seed"):
        courtship.make("fly", 0, replace(FEW, total=900.0))  # four times as long as they last
    refuses("choose another --seed", courtship.make, "fly", 0, replace(FEW, touch_rates=(0.0, 1.0)))
    refuses("7 weights", replace, BEHAVIOURS["fly"], female=(1.0, 1.0))
    refuses("peak is 0", replace, BEHAVIOURS["fly"], peak=0.0)
    assert courtship.main(["fit", "fly", "--data", str(tmp_path)]) == 2
    assert str(tmp_path) in capsys.readouterr().err
    refuses("dodo", courtship.make, "dodo", 0)
    refuses("no pause", measure, [np.zeros((50, 1, 2))], 0.1, "a stone")


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
