"""Collecting rollouts, and the container that holds them."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from moving_pairs import demonstrations_of
from numpy.typing import NDArray
from refusals import refuses

from animarl_algos.evaluation import collect
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.rollouts import NO_CUE, Rollouts
from animarl_envs.demos.demonstrations import TARGET_OUT, TIME_OUT, Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds.chase.world import ChaseWorld

STARTS = [
    [(-0.5, 0.0), (0.5, 0.0), (0.0, 0.5)],
    [(-0.2, 0.0), (0.5, 0.5), (0.0, 0.0)],
    [(-0.5, -0.5), (0.5, -0.5), (0.9, 0.9)],
]


def make_demos() -> Demonstrations:
    drift = np.arange(4)[:, None, None] * 0.01
    paths = [np.array(start) + drift for start in STARTS]
    return demonstrations_of(paths, condition=[0, 1, 1], outcome=[1, 0, 0])


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


def test_refuses_what_cannot_be_collected() -> None:
    refuses("at least one rollout", collected, Recorder(), 0)
    refuses("start from demonstrations", collected, Recorder(), start="uniform")
    with pytest.raises(InputError, match="cue is 'other'"):
        collect_rollouts(world_maker(), Recorder(), method="x", seed=0, cue="other")  # type: ignore[arg-type]


# -- the container ------------------------------------------------------------


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


def test_misshapen_rollouts_are_refused(made: Rollouts) -> None:
    keys = ("positions", "lengths", "outcome", "condition", "cue", "demo", "seed", "repetition")
    good: dict[str, Any] = {key: getattr(made, key) for key in keys}
    good |= {"method": "x", "individuals": made.individuals, "roles": made.roles, "dt": 0.1}
    assert len(Rollouts(**good)) == 6
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
