"""Rollouts: how they are collected and kept, and teams that do again what was recorded of them."""

import pickle
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from recordings import episodes_along
from refusals import refuses

import benchmarks.paper_readers  # noqa: F401  (registers the readers of published sets)
from animarl_algos.evaluation import collect
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.prepared import path_lengths
from animarl_algos.evaluation.rollouts import NO_CUE, Rollouts
from animarl_algos.evaluation.teams import PublishedTeam, teams_of
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TARGET_OUT, TIME_OUT
from animarl_envs.demos.joining import join
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.importing.readers import read
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT
from animarl_envs.worlds.chase.world import ChaseWorld

STARTS = [
    [(-0.5, 0.0), (0.5, 0.0), (0.0, 0.5)],
    [(-0.2, 0.0), (0.5, 0.5), (0.0, 0.0)],
    [(-0.5, -0.5), (0.5, -0.5), (0.9, 0.9)],
]


def make_demos() -> Demonstrations:
    drift = np.arange(4)[:, None, None] * 0.01
    paths = [np.array(start) + drift for start in STARTS]
    return episodes_along(paths, condition=[0, 1, 1], outcome=[1, 0, 0])


def world_maker(**options: Any) -> Any:
    scenario = make_scenario("agent", demos=make_demos(), split=None, time_limit=12, **options)
    return partial(ChaseWorld, scenario)


def collected(policy: Any, repetitions: int = 1, seed: int = 0, **more: Any) -> Rollouts:
    return collect_rollouts(
        world_maker(**more), policy, method="x", seed=seed, repetitions=repetitions
    )


class Recorder:
    """Straight at the focus, always; remembers what it was shown."""

    def __init__(self, actions: tuple[int, int, int] = (0, 0, 12)) -> None:
        self.actions = actions
        self.seen: list[NDArray[Any]] = []
        self.states: list[Any] = []
        self.starts: list[NDArray[Any]] = []

    def predict(
        self, observation: Any, state: Any, episode_start: Any, deterministic: bool
    ) -> tuple[Any, Any]:
        self.seen.append(np.array(observation))
        self.states.append(state)
        self.starts.append(np.array(episode_start))
        return np.tile(self.actions, len(observation) // 3), len(self.seen)


def test_every_demonstration_is_started_from_as_often_as_asked() -> None:
    made = collected(RandomPolicy(0), 2, seed=3)
    assert made.demo.tolist() == [0, 0, 1, 1, 2, 2]
    assert made.repetition.tolist() == [0, 1, 0, 1, 0, 1]
    assert (made.seed == 3).all() and (made.cue == NO_CUE).all()
    assert made.condition.tolist() == [0, 0, 1, 1, 1, 1]
    for i, demo in enumerate(made.demo):
        assert made.path(i)[0].tolist() == [list(p) for p in STARTS[demo]]
    assert made.lengths.max() <= 13


def test_paths_end_with_their_own_episode() -> None:
    """Copies end at different steps; each path has the frames up to its own end and no more."""
    made = collected(Recorder())
    assert made.outcome[1] == 1  # predator_0 starts 0.2 away from a prey at rest
    assert made.lengths[1] < made.lengths[0]
    for i in range(3):
        path = made.path(i)
        touching = np.linalg.norm(path[:, :2] - path[:, 2:], axis=-1).min(axis=1) < 0.1
        assert touching.tolist() == [False] * (len(path) - 1) + [bool(made.captured[i])]
    names = made.component_names
    touched = made.components[:, :, names.index("touch")]
    assert touched[1].tolist() == [1.0, 1.0, 0.0]  # shared reward: condition 1
    elapsed = made.components[:, 2, names.index("elapsed")]
    lasted = made.lengths - 1 - made.captured
    assert elapsed == pytest.approx(0.1 * lasted)


def test_leaving_is_told_from_timing_out() -> None:
    fleeing = collected(Recorder((12, 12, 6)))
    assert fleeing.outcome[2] == TARGET_OUT  # starts in a corner and flees outwards
    resting = collected(Recorder((12, 12, 12)))
    assert (resting.outcome == TIME_OUT).all() and (resting.lengths == 13).all()
    assert not resting.captured.any()


def test_policies_see_slots_and_keep_their_state() -> None:
    policy = Recorder((12, 12, 12))
    make_world = world_maker()
    collect_rollouts(make_world, policy, method="x", seed=0, repetitions=2)
    world = make_world(1)
    assert policy.seen[0].shape == (6 * 3, world.observation.shape[-1])
    world.reset(demo=np.array([1]))
    # Rollout 2 is the first from demonstration 1; its slots are 6, 7 and 8.
    assert np.array_equal(policy.seen[0][6:9], world.observation[0])
    assert policy.states == [None, *range(1, 12)]
    assert policy.starts[0].all() and not np.any(policy.starts[1:])


@pytest.mark.parametrize(
    ("cue", "told"), [("actual", [0, 1, 1]), ("flipped", [1, 0, 0]), (0, [0, 0, 0]), (1, [1, 1, 1])]
)
def test_the_cue_is_told_and_leaves_the_world_alone(cue: Any, told: list[int]) -> None:
    policy = Recorder()
    made = collect_rollouts(world_maker(), policy, method="x", seed=0, repetitions=1, cue=cue)
    plain = collected(Recorder())
    assert made.cue.tolist() == told and made.condition.tolist() == [0, 1, 1]
    assert policy.seen[0][:, -1].tolist() == np.repeat(told, 3).tolist()
    assert np.array_equal(made.positions, plain.positions)


def test_same_seeds_same_bytes() -> None:
    made = [collected(RandomPolicy(5), 5, seed=1, observation_noise=0.1) for _ in range(2)]
    assert made[0].positions.tobytes() == made[1].positions.tobytes()
    other = collected(RandomPolicy(6), 5, seed=1)
    assert other.positions.tobytes() != made[0].positions.tobytes()


def test_batches_do_not_change_what_a_policy_does(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = collected(Recorder(), 3)
    monkeypatch.setattr(collect, "MAX_COPIES", 4)
    parts = collected(Recorder(), 3)
    assert np.array_equal(whole.positions, parts.positions)
    assert np.array_equal(whole.demo, parts.demo)


def test_copies_that_have_ended_are_left_out_of_what_is_decided() -> None:
    class Leaving(Recorder):
        def __init__(self) -> None:
            super().__init__()
            self.left: list[NDArray[np.bool_]] = []

        def leave_out(self, state: Any, over: NDArray[np.bool_]) -> Any:
            self.left.append(over.reshape(-1, 3))
            return state

    plain, leaving = Recorder(), Leaving()
    made = [collected(policy, 2) for policy in (plain, leaving)]
    np.testing.assert_array_equal(made[0].positions, made[1].positions)
    steps, left = made[1].lengths - 1, np.stack(leaving.left)
    assert len(np.unique(steps)) > 1
    first = steps.min()  # decided for all until then
    expected = np.arange(first, steps.max())[:, None] >= steps
    assert len(leaving.seen) == steps.max()
    np.testing.assert_array_equal(left, np.repeat(expected[..., None], 3, axis=2))


def test_random_policy_is_uniform() -> None:
    actions, _ = RandomPolicy(0).predict(np.zeros((13_000, 4)))
    counts = np.bincount(actions, minlength=13)
    assert len(counts) == 13 and abs(counts - 1000).max() < 150


@pytest.fixture
def made() -> Rollouts:
    return collected(RandomPolicy(0), 2, seed=3)


def test_save_and_load(made: Rollouts, tmp_path: Path) -> None:
    read = Rollouts.load(made.save(tmp_path / "some" / "rollouts.npz"))
    assert read.method == made.method and read.component_names == made.component_names
    assert read.individuals == made.individuals and read.dt == made.dt
    for key in ("positions", *Rollouts.EACH):
        assert np.array_equal(getattr(read, key), getattr(made, key))
    assert [p.name for p in (tmp_path / "some").iterdir()] == ["rollouts.npz"]


def test_a_foreign_or_damaged_file_is_refused(made: Rollouts, tmp_path: Path) -> None:
    path = tmp_path / "other.npz"
    np.savez(path, positions=np.zeros((3, 1, 2)))
    refuses("no rollouts of this project", Rollouts.load, path)
    whole = made.save(tmp_path / "whole.npz").read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    refuses(r"other\.npz", Rollouts.load, path)
    refuses("no such file", Rollouts.load, tmp_path / "missing.npz")


def test_rollouts_that_cannot_be_collected_or_are_misshapen_are_refused(made: Rollouts) -> None:
    keys = ("positions", "lengths", "outcome", "condition", "cue", "demo", "seed", "repetition")
    good: dict[str, Any] = {key: getattr(made, key) for key in keys}
    good |= {"method": "x", "individuals": made.individuals, "roles": made.roles, "dt": 0.1}
    assert len(Rollouts(**good)) == 6
    refuses("at least one rollout", collected, Recorder(), 0)
    refuses("start from demonstrations", collected, Recorder(), start="uniform")
    told = {"method": "x", "seed": 0, "cue": "other"}
    refuses("cue is 'other'", collect_rollouts, world_maker(), Recorder(), **told)
    for change, message in [
        ({"demo": made.demo[:-1]}, "demo has 5 entries"),
        ({"positions": made.positions[:-1]}, "add up"),
        ({"positions": np.where(made.positions > 0, np.nan, 0.0)}, "not a finite number"),
        ({"lengths": np.zeros(0), **{k: np.zeros(0) for k in keys[2:]}}, "holds no episode"),
    ]:
        refuses(message, Rollouts, **good | change)


def test_selecting_and_joining(made: Rollouts) -> None:
    chosen = made.select(made.demo == 1)
    assert len(chosen) == 2 and np.array_equal(chosen.path(1), made.path(3))
    joined = Rollouts.concatenate([made, chosen], method="both")
    assert len(joined) == 8 and joined.method == "both"
    assert np.array_equal(joined.path(7), made.path(3))
    refuses("selection is empty", made.select, made.demo == 99)


def test_speeds_do_not_jump_from_one_rollout_to_the_next() -> None:
    made = collected(Recorder((12, 12, 12)))
    speeds = made.speeds()
    assert speeds.shape == ((made.lengths - 1).sum(), 3)
    assert (speeds == 0.0).all()  # all coast from rest, though their starts lie far apart


def test_recordings_as_rollouts() -> None:
    demos = make_demos()
    recorded = Rollouts.from_demonstrations(demos)
    assert np.array_equal(recorded.positions, demos.positions)
    assert recorded.demo.tolist() == [0, 1, 2] and recorded.captured.tolist() == [1, 0, 0]
    assert recorded.movers.tolist() == [0, 1]


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
        team.roll_out(team.embody(species), demos, name="team", seed=0, repetitions=5)
        for team in teams
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
        rollouts = team.roll_out(team.embody(AGENT), starts, name="team", seed=0, repetitions=20)
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
