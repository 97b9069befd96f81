"""The teams that made demonstrations do again what was recorded of them."""

import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from refusals import refuses

from animarl_algos.evaluation.prepared import path_lengths
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.teams import PublishedTeam, teams_of
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.joining import join
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.importing.readers import read
from animarl_envs.species import AGENT

NAMES = ("indiv", "share")


def recorded(data_dir: Path, condition: int) -> Demonstrations:
    name = f"episodes_c2ae_{NAMES[condition]}_slow2.4.npz"
    return read(data_dir / "agents_collab_hunting" / name, "agents").select(split="test")


@pytest.mark.realdata
@pytest.mark.parametrize("condition", [0, 1])
def test_the_published_teams_repeat_their_recordings(data_dir: Path, condition: int) -> None:
    demos = recorded(data_dir, condition)
    weights = data_dir / "agents_collab_hunting" / "weights"
    teams = teams_of(demos, weights)
    assert teams is not None
    species = species_of(demos, teams[0].locomotion, "agent")
    own, other = (
        team.roll_out(species, demos, name="team", seed=0, repetitions=5) for team in teams
    )
    if condition == 1:
        own, other = other, own
    assert len(own) == demos.num_episodes  # greedy: once from every start
    assert own.lengths.tolist() == demos.lengths.tolist()
    assert own.outcome.tolist() == demos.outcome.tolist()
    assert np.abs(own.positions - demos.positions).max() < 1e-3
    assert np.mean(other.lengths == demos.lengths) < 0.5


@pytest.mark.realdata
def test_both_conditions_joined_know_their_teams(data_dir: Path) -> None:
    parts = [recorded(data_dir, c) for c in (0, 1)]
    both = join(parts)
    assert both.num_episodes == 100 and both.condition.tolist() == [0] * 50 + [1] * 50
    assert np.array_equal(both.episode(60).positions, parts[1].episode(10).positions)
    teams = teams_of(both, data_dir / "agents_collab_hunting" / "weights")
    assert teams is not None and teams[0].locomotion[2].thrust == 3.0
    refuses("differ in dt", join, [parts[0], replace(parts[1], dt=0.2)])


@pytest.mark.realdata
def test_damaged_weights_and_pickles_are_refused(data_dir: Path, tmp_path: Path) -> None:
    original = data_dir / "agents_collab_hunting" / "weights" / "indiv"
    folder = tmp_path / "indiv"
    shutil.copytree(original, folder)
    file = folder / "p1_2.4.pth"
    file.chmod(0o644)
    whole = torch.load(file, weights_only=True)
    for content in (pickle.dumps(print), b"", file.read_bytes()[:-100]):
        file.write_bytes(content)
        refuses(r"p1_2\.4\.pth: it is no network", PublishedTeam.load, folder)
    torch.save(whole | {"fc_state.2.bias": torch.zeros(2)}, file)
    refuses(r"fc_state\.2\.bias has shape", PublishedTeam.load, folder)
    file.unlink()
    refuses("cannot be read", PublishedTeam.load, folder)


def test_the_packaged_teams_differ_as_their_recordings_do() -> None:
    """Not the same chases, as one action in ten is random, but the same distribution."""
    demos = load_packaged("agent").select(split="test")
    teams = teams_of(demos)
    assert teams is not None
    for c, team in enumerate(teams):
        starts = demos.select(condition=c)
        rollouts = team.roll_out(AGENT, starts, name="team", seed=0, repetitions=20)
        assert len(rollouts) == 20 * starts.num_episodes
        own = path_lengths(rollouts)[:, :2].mean()
        recordings = path_lengths(Rollouts.from_demonstrations(starts))[:, :2].mean(axis=1)
        error = recordings.std(ddof=1) / np.sqrt(len(recordings))
        assert abs(own - recordings.mean()) < 4 * error


def test_no_team_is_made_up() -> None:
    demos = load_packaged("agent").select(split="test")
    known = dict(demos.provenance)
    known.pop("trained")
    assert teams_of(replace(demos, provenance=known)) is None
    refuses("does not say by which agents", teams_of, demos, Path("weights"))
