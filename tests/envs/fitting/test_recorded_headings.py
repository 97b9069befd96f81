"""Recorded headings of several: their turning, their species, and the files they stand in."""

import json
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from pages import run_programs
from recordings import dogs
from refusals import refuses
from small_runs import made
from turned_bodies import SIDEWAYS, SLOW, recorded, species, turned, wanderers

from animarl_algos import load_run
from animarl_algos.whatif.live_page import page_model
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.joining import first_of_role, join
from animarl_envs.errors import InputError
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.fitting.turning import along_travel, fit_turning, heading_misses
from animarl_envs.species import ChaseSpecies
from animarl_envs.species.options import with_options
from animarl_envs.views.common import plain

DOCS = Path(__file__).parents[3] / "docs"


@pytest.mark.parametrize(("noise", "within"), [(0.0, 1e-3), (0.05, 0.05)])
def test_planted_turnings_of_each_are_found_again(noise: float, within: float) -> None:
    demos = turned(wanderers(), SIDEWAYS, SLOW, noise=noise)
    for i, rule in enumerate((SIDEWAYS, SLOW)):
        found = fit_turning(demos, i)
        assert found is not None
        numbers = [found.persistence, found.gain, found.slip]
        assert numbers == pytest.approx([rule.persistence, rule.gain, rule.slip], abs=within)
        assert found.speed == pytest.approx(rule.speed)
        own = np.median(heading_misses(demos, found, i), axis=1)
        travel = np.median(heading_misses(demos, along_travel(demos, i), i), axis=1)
        assert (own < [0.5, 1.0] * travel).all()


def test_a_species_of_recorded_headings_turns_and_sees_them() -> None:
    demos = recorded()
    spec = species_of(demos)
    assert isinstance(spec, ChaseSpecies)
    training = demos.select(split="train")
    assert spec.turning == tuple(fit_turning(training, i) for i in range(3))
    assert spec.turning[1] is None and spec.senses_heading
    straight = species_of(turned(dogs(2), None, None, None))
    assert isinstance(straight, ChaseSpecies)
    assert straight.turning == () and not straight.senses_heading
    assert straight == species_of(dogs(2))
    one_column = replace(dogs(2), signals={"heading": np.zeros(len(dogs(2).positions))})
    assert species_of(one_column) == species_of(dogs(2))


def test_some_of_many_steps_and_episodes_shorter_than_the_horizon_are_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    demos = turned(wanderers(), SIDEWAYS, SLOW)
    with monkeypatch.context() as patched:
        patched.setattr("animarl_envs.fitting.turning.MOST_STARTS", 150)
        found = fit_turning(demos)
    assert found is not None and found.slip == pytest.approx(SIDEWAYS.slip, abs=1e-3)
    cut = np.concatenate([np.arange(start, start + 12) for start in demos.offsets[:-1]])
    short = replace(
        demos, positions=demos.positions[cut], lengths=np.full(12, 12),
        signals={"heading": demos.signals["heading"][cut]},
    )  # fmt: skip
    found = fit_turning(short)
    assert found is not None and found.slip == pytest.approx(SIDEWAYS.slip, abs=0.05)


def test_turning_goes_through_json_options_and_other_numbers_of_individuals() -> None:
    spec = species()
    again = with_options(species_of(dogs(2)), **{
        "turning": json.loads(json.dumps(plain(spec.turning))), "senses_heading": True,
    })  # fmt: skip
    assert again == spec
    named = with_options(spec, turning={"dog_a": plain(SIDEWAYS), "sheep": SLOW})
    assert named == spec
    more = with_options(spec, num_pursuers=3)
    assert isinstance(more, ChaseSpecies)
    assert more.turning == (SIDEWAYS, None, SIDEWAYS, SLOW)
    herd = with_options(spec, num_targets=2)
    assert isinstance(herd, ChaseSpecies)
    assert herd.turning == (SLOW, SLOW, SIDEWAYS)


def test_headings_stay_with_their_individuals_episodes_and_files(tmp_path: Path) -> None:
    demos = recorded()
    heading = demos.signals["heading"]
    again = Demonstrations.load(demos.save(tmp_path / "d.npz"))
    assert np.array_equal(again.headings(), heading)  # type: ignore[arg-type]
    fewer = first_of_role(demos, "num_pursuers", 1)
    assert np.array_equal(fewer.headings(), heading[:, [0, 2]])  # type: ignore[arg-type]
    assert np.array_equal(
        demos.select(episodes=[1]).headings(),  # type: ignore[arg-type]
        heading[demos.offsets[1] : demos.offsets[2]],
    )
    held_out = replace(demos.select(split="test"), name="more.npz")
    both = join([demos.select(split="train"), held_out])
    assert len(both.headings()) == len(both.positions)  # type: ignore[arg-type]
    other = replace(demos, name="flat", signals={"heading": heading[:, 0]})
    refuses(r"flat and .* in dogs.npz: give both as many columns", join, [demos, other])
    lacking = heading.copy()
    lacking[70, 1] = np.nan
    with pytest.raises(InputError, match="episode 1, frame 9, dog_b: signal 'heading' is not a"):
        replace(demos, signals={"heading": lacking})


def test_an_own_environment_sees_headings_and_goes_through_json(tmp_path: Path) -> None:
    path = str(recorded().save(tmp_path / "demos.npz"))
    env = gym.make("AnimaRL/Custom-v0", demos=path, observation="full")
    assert env.spec is not None
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    first, info = env.reset(seed=3)
    assert np.array_equal(first, again.reset(seed=3)[0])
    described = info["scenario"]
    assert json.loads(json.dumps(described)) == described
    assert described["senses_heading"] and described["turning"][1] is None
    options = {"senses_heading": False, "turning": None, "observation": "full"}
    plainly = gym.make("AnimaRL/Custom-v0", demos=path, **options)
    assert env.observation_space.shape[0] == plainly.observation_space.shape[0] + 6  # type: ignore[index]


def test_a_run_learns_simulates_and_is_loaded_with_its_turning(tmp_path: Path) -> None:
    run = made(tmp_path, "soft-bc", demos=recorded(), species="custom", rolled_out=False)
    loaded = load_run(run.path)
    spec = loaded.scenario.species
    assert isinstance(spec, ChaseSpecies) and spec.senses_heading
    training = recorded().select(split="train")
    assert spec.turning == tuple(fit_turning(training, i) for i in range(3))
    rolled = loaded.simulate(split="test", repetitions=2)
    assert np.isfinite(rolled.positions).all()
    with pytest.raises(InputError, match="senses_heading changes the inputs of the policy"):
        loaded.simulate(senses_heading=False)
    told = refuses("headings of their own", page_model, loaded)
    without = {"senses_heading": False, "turning": None}
    assert "--set 'env_kwargs={senses_heading: false, turning: null}'" in told
    plain_run = made(
        tmp_path / "plain", "soft-bc", demos=recorded(), species="custom", rolled_out=False,
        env_kwargs=without,
    )  # fmt: skip
    assert page_model(load_run(plain_run.path))["individuals"]


def test_the_program_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    run_programs("docs/faithful.md")
    said = capsys.readouterr().out
    assert "(4, 3)" in said and "other 2 heading sine" in said
