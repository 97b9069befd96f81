"""Demonstrations as minibatches, and the penalty of every action by the fitted dynamics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.data.species_data import SpeciesDemonstrations
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_envs import SPECIES
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT, UNFINISHED
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError
from animarl_envs.fitting.tracking import one_step_misses
from animarl_envs.focus import focus_directions
from animarl_envs.importing.readers import read
from animarl_envs.locomotion import (
    COAST,
    NUM_ACTIONS,
    Locomotion,
    apply_actions,
    infer_actions,
)

ROLES = ("pursuer", "pursuer", "target")
NAMES = ("male_0", "male_1", "female")
LENGTHS = np.array([4, 2, 9, 3, 6, 5, 2])
DT = 0.1


def arrays(seed: int = 0, lengths: NDArray[np.int64] = LENGTHS) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    frames, k = int(lengths.sum()), len(NAMES)
    actions = rng.integers(0, NUM_ACTIONS, (frames, k)).astype(np.int8)
    actions[np.cumsum(lengths) - 1] = -1
    within = np.concatenate([np.arange(n) for n in lengths])
    return {
        "observations": rng.normal(size=(frames, k, 4)),
        "actions": actions,
        "lengths": lengths,
        "num_actions": NUM_ACTIONS,
        "rewards": rng.normal(size=(frames, k)),
        "action_penalties": rng.random((frames, k, NUM_ACTIONS)),
        "terminated": rng.random(len(lengths)) < 0.5,
        "condition": rng.integers(0, 2, len(lengths)),
        "warmup": within < 1,
        "names": NAMES,
    }


@pytest.mark.parametrize(
    ("outcome", "terminates"),
    [(UNFINISHED, False), (TIME_OUT, False), (TARGET_OUT, True), (PURSUER_OUT, True), (1, True)],
)
def test_a_recording_that_merely_ends_bootstraps(outcome: int, terminates: bool) -> None:
    """Nobody knows what followed: only an end of the episode itself has the value 0."""
    demos = load_packaged("agent")
    demos = replace(demos, outcome=np.full_like(demos.outcome, outcome))
    for batch in SpeciesDemonstrations(SPECIES["agent"], demos, demos.individuals).val.batches(16):
        last = np.arange(batch.num_steps)[:, None] == batch.lengths.numpy()[:, None] - 1
        np.testing.assert_array_equal(batch.terminated.numpy(), last * terminates)


def test_whose_demonstrations_they_are() -> None:
    assert OfflineDataset(**arrays()).individuals == NAMES
    unnamed = OfflineDataset(**arrays() | {"names": None})
    assert unnamed.individuals is None and unnamed.names[0] == "individual_0"
    assert SlotVecEnv("agent", 1, focal="prey").offline_data().val.individuals == ("prey",)


def test_every_entry_equals_the_demonstrations() -> None:
    data = arrays()
    dataset = OfflineDataset(**data)
    kept = np.flatnonzero(LENGTHS > 2)  # those of one step end within the warm-up
    assert (dataset.num_episodes, dataset.num_steps) == (len(kept), (LENGTHS[kept] - 1).sum())
    first = np.cumsum(LENGTHS) - LENGTHS
    seen: list[list[int]] = [[] for _ in NAMES]
    for batch in dataset.batches(2, np.random.default_rng(0)):
        assert batch.burn_in == 0 and not batch.starts.any()
        assert batch.num_steps == int(batch.lengths.max())
        assert (batch.weights == 1).all()
        for k in range(3):
            for b in range(batch.batch_size):
                episode = int(batch.indices[k, b])
                seen[k].append(episode)
                steps = int(LENGTHS[episode] - 1)
                rows = slice(first[episode], first[episode] + steps)
                assert batch.lengths[k, b] == steps
                assert batch.condition[k, b] == data["condition"][episode]
                np.testing.assert_array_equal(
                    batch.observations[k, : steps + 1, b],
                    data["observations"][first[episode] : first[episode] + steps + 1, k].astype(
                        np.float32
                    ),
                )
                taken = data["actions"][rows, k].astype(int)
                scored = data["action_penalties"][rows, k].astype(np.float32)
                expected = {
                    "actions": taken,
                    "labels": taken,
                    "previous_actions": np.concatenate([[NUM_ACTIONS], taken])[:-1],
                    "rewards": data["rewards"][rows, k].astype(np.float32),
                    "action_penalties": scored,
                    "penalties": scored[np.arange(steps), taken],
                    "mask": (np.arange(steps) >= 1).astype(float),
                    "terminated": (np.arange(steps) == steps - 1) * data["terminated"][episode],
                }
                for name, value in expected.items():
                    tensor = getattr(batch, name)[k, :, b]
                    np.testing.assert_array_equal(tensor[:steps], value, err_msg=name)
                assert not batch.mask[k, steps:, b].any()
                assert (batch.labels[k, steps:, b] == -1).all()
    assert [sorted(mine) for mine in seen] == [kept.tolist()] * 3


def test_an_individual_alone_sees_what_it_sees_with_others() -> None:
    data = arrays()
    together = OfflineDataset(**data)
    per_individual = ("observations", "actions", "rewards", "action_penalties")
    for k, name in enumerate(NAMES):
        mine = data | {key: data[key][:, k : k + 1] for key in per_individual} | {"names": (name,)}
        alone = OfflineDataset(**mine)
        pairs = zip(
            together.batches(3, np.random.default_rng(5)),
            alone.batches(3, np.random.default_rng(5)),
            strict=True,
        )
        for whole, single in pairs:
            np.testing.assert_array_equal(whole.indices[k], single.indices[0])
            steps = single.num_steps
            np.testing.assert_array_equal(whole.rewards[k, :steps], single.rewards[0])
            assert not whole.mask[k, steps:].any()


def test_the_full_pass_is_the_same_for_all_and_longest_first() -> None:
    dataset = OfflineDataset(**arrays())
    batches = [(b.indices.copy(), b.lengths[0].tolist()) for b in dataset.batches(2)]
    assert len(batches) == 3
    order = np.concatenate([indices for indices, _ in batches], axis=1)
    assert (order == order[0]).all() and len(set(order[0])) == 5
    lengths = [length for _, columns in batches for length in columns]
    assert lengths == sorted(lengths, reverse=True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: {"actions": np.where(d["actions"] == 3, -1, d["actions"])}, "infer the actions"),
        (lambda d: {"actions": d["actions"][:-1]}, "actions have shape"),
        (lambda d: {"lengths": d["lengths"] + 1}, "do not fit 31 observations"),
        (lambda d: {"lengths": np.array([30, 1])}, "at least two frames"),
        (lambda d: {"rewards": d["rewards"] * np.nan}, r"rewards at \(0, 0\) is not a finite"),
        (lambda d: {"warmup": np.ones_like(d["warmup"])}, "shorten the warm-up"),
        (lambda d: {"names": NAMES[:2]}, "do not name 3 individuals"),
        (lambda d: {"observations": d["observations"][..., 0]}, "one vector per frame"),
        (lambda d: {"action_penalties": d["action_penalties"][..., :5]}, "action_penalties have"),
    ],
)
def test_bad_data_is_refused(change: Any, message: str) -> None:
    data = arrays()
    with pytest.raises(InputError, match=f"file.npz: .*{message}"):
        OfflineDataset(**data | change(data), source="file.npz")


# -- penalties by the fitted dynamics -------------------------------------------------------------


def recording(
    noise: float, seed: int = 1
) -> tuple[Demonstrations, NDArray[np.int64], list[Locomotion], NDArray[np.float64]]:
    """Animals that take random actions, by where the others are; read with noise."""
    rng = np.random.default_rng(seed)
    lengths = np.array([30, 20])
    frames = int(lengths.sum())
    fitted = [Locomotion(0.25, 2.4), Locomotion(0.1, 1.0), Locomotion(0.3, 3.0)]
    actions = rng.integers(0, NUM_ACTIONS, (frames, 3))
    positions = np.zeros((frames, 3, 2))
    initial = rng.normal(size=(2, 3, 2)) * 0.2
    for episode, begin in enumerate((0, 30)):
        positions[begin] = rng.uniform(-0.3, 0.3, (3, 2))
        velocity = initial[episode].copy()
        for t in range(begin, begin + lengths[episode] - 1):
            focus = focus_directions(positions[t], ROLES)
            for k, model in enumerate(fitted):
                velocity[k] = apply_actions(velocity[k], actions[t, k], focus[k], model, DT)
            positions[t + 1] = positions[t] + velocity * DT
    actions[[29, 49]] = -1
    demos = Demonstrations(
        species="custom",
        individuals=NAMES,
        roles=ROLES,
        dt=DT,
        arena=Arena("open"),
        positions=positions + rng.normal(size=positions.shape) * noise,
        lengths=lengths,
        initial_velocity=initial,
        condition=np.zeros(2),
        outcome=np.zeros(2),
        split=np.array(["train", "val"]),
        recording=np.array(["a", "b"]),
        provenance={"source": "test", "licence": "none", "synthetic": True},
    )
    return demos, actions, fitted, demos.focus()


def test_the_action_taken_leads_exactly_to_the_next_position() -> None:
    demos, actions, fitted, _ = recording(noise=0.0)
    penalties = one_step_misses(demos, fitted)
    assert penalties.shape == (50, 3, NUM_ACTIONS)
    taken = actions >= 0
    assert (penalties.argmin(axis=2)[taken] == actions[taken]).all()
    assert penalties.min(axis=2).max() < 1e-7
    # Coasting instead of thrust u leaves the animal u dt^2 behind; a known answer.
    thrust = np.array([model.thrust for model in fitted])
    left_behind = np.broadcast_to(thrust * DT**2, taken.shape)
    pushed = taken & (actions != COAST)
    np.testing.assert_allclose(penalties[..., COAST][pushed], left_behind[pushed], rtol=1e-5)
    assert not penalties[[29, 49]].any()


def test_the_inferred_action_has_the_smallest_penalty() -> None:
    demos, _, fitted, focus = recording(noise=0.003)
    velocity = demos.velocities()
    penalties = one_step_misses(demos, fitted)
    steps = np.setdiff1d(np.arange(50), [29, 49])
    for k, model in enumerate(fitted):
        inferred = infer_actions(
            velocity[steps, k], velocity[steps + 1, k], focus[steps, k], model, DT
        )
        np.testing.assert_array_equal(penalties[steps, k].argmin(axis=1), inferred)
        assert penalties[steps, k].min(axis=1).max() > 1e-4  # the noise is felt


@pytest.mark.realdata
def test_recorded_actions_have_the_smallest_penalty(data_dir: Path) -> None:
    demos = read(data_dir / "agents_collab_hunting" / "episodes_c2ae_share_slow2.4.npz")
    demos = demos.select(episodes=np.arange(60))
    fitted = [Locomotion(0.25, u) for u in (2.4, 2.4, 3.0)]
    penalties = one_step_misses(demos, fitted)
    recorded = demos.signals["actions"]
    taken = recorded >= 0
    assert (penalties.argmin(axis=2)[taken] == recorded[taken]).all()


def test_penalties_by_the_locomotion_of_others_are_refused() -> None:
    demos, _, fitted, _ = recording(noise=0.0)
    with pytest.raises(InputError, match="for 3 individuals: give one set each"):
        one_step_misses(demos, fitted[:2])
