"""Soft labels, tracked ones, and minibatches in a mirror."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from test_offline_data import LENGTHS, NAMES, arrays

from animarl_algos.data.dataset import OfflineDataset, mirror_columns
from animarl_algos.data.species_data import SpeciesDemonstrations, soft_labels
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_envs import SPECIES
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import learnable
from animarl_envs.errors import InputError
from animarl_envs.fitting.tracking import track
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.worlds import Mirror, demonstration_observations

A = 13
# -- soft labels ----------------------------------------------------------------------------------


def test_a_known_answer() -> None:
    """Two actions as near as each other, the third one width further."""
    width, step = 0.35, 0.02
    near = soft_labels(np.array([0.0, 0.0, width * step]), step, width)
    expected = np.array([1.0, 1.0, np.exp(-0.5)])
    np.testing.assert_allclose(near, expected / expected.sum(), rtol=1e-6)


def test_wide_labels_know_nothing_and_narrow_ones_name_the_nearest() -> None:
    penalties = np.random.default_rng(0).random((20, 3, A))
    np.testing.assert_allclose(soft_labels(penalties, 1.0, 1e6), 1 / A, rtol=1e-5)
    narrow = soft_labels(penalties, 1.0, 1e-5)
    np.testing.assert_array_equal(narrow.argmax(-1), penalties.argmin(-1))
    assert narrow.max(-1).min() > 0.999


def test_units_are_of_each_individual() -> None:
    """An animal that moves twice as far has the same labels for errors twice as large."""
    penalties = np.random.default_rng(1).random((20, 2, A))
    step = np.array([1.0, 2.0])[None, :, None]
    doubled = soft_labels(penalties * step, step, 0.35)
    np.testing.assert_allclose(doubled, soft_labels(penalties, 1.0, 0.35), rtol=1e-5)


# -- of a species ---------------------------------------------------------------------------------


def test_a_species_soft_labels_prefer_what_inverse_dynamics_infers() -> None:
    demos, species = load_packaged("fly"), SPECIES["fly"]
    plain = SpeciesDemonstrations(species, demos, demos.individuals)
    soft = SpeciesDemonstrations(species, demos, demos.individuals, labels="soft")
    assert next(plain.val.batches(4)).label_shares is None
    batch = next(soft.val.batches(4))
    assert batch.label_shares is not None and batch.action_penalties is not None
    labelled = batch.labels >= 0
    shares, labels = batch.label_shares[labelled], batch.labels[labelled]
    torch.testing.assert_close(shares.sum(-1), torch.ones(len(shares)))
    assert torch.equal(shares.gather(1, labels[:, None])[:, 0], shares.max(-1).values)
    assert torch.equal(batch.actions[labelled], labels)


@dataclass(frozen=True)
class Followed:
    positions: NDArray[np.float64]
    actions: NDArray[np.int64]


def test_tracked_demonstrations_are_seen_from_where_the_simulation_is() -> None:
    demos, species = load_packaged("fly"), SPECIES["fly"]
    shift = 1e-3 * np.sin(np.arange(len(demos.positions)))[:, None, None]
    actions = demonstrated_actions(demos, species.locomotion).astype(np.int64)
    turned = np.where(actions >= 0, (actions + 1) % A, -1)
    followed = Followed(demos.positions + shift, turned)
    given = SpeciesDemonstrations(species, demos, demos.individuals, labels="tracking")
    given.__dict__["tracked"] = followed
    data = given.train
    own = replace(demos, positions=followed.positions).select(split="train")
    within = np.repeat(demos.split == "train", demos.lengths)
    expected = demonstration_observations(species, own)
    np.testing.assert_allclose(data._frames.observations, expected, rtol=1e-6)
    np.testing.assert_array_equal(data._frames.actions, turned[within])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"labels": "vague"}, "'vague': choose hard, soft, tracking"),
        ({"label_width": 0}, "label_width is 0"),
        ({"label_horizon": 0.5}, r"label_horizon is 0\.5: give a number of at least 1"),
    ],
)
def test_bad_labels_are_refused_with_the_environment(options, message: str) -> None:
    with pytest.raises(InputError, match=message):
        SlotVecEnv("fly", 1, **options)


def test_the_horizon_of_tracking_labels_reaches_the_tracking() -> None:
    exact = load_packaged("fly")
    noise = np.random.default_rng(0).normal(0.0, 2e-3, exact.positions.shape)
    demos = learnable(replace(exact, positions=exact.positions + noise))

    def labelled(**options: float) -> NDArray[np.int64]:
        env = SlotVecEnv("fly", 1, demos=demos, labels="tracking", **options)
        return env.offline_data().train._frames.actions

    within = np.repeat(demos.split == "train", demos.lengths)
    species = SlotVecEnv("fly", 1, demos=demos).scenario.species
    for options, horizon in (({}, 1.0), ({"label_horizon": 3.0}, 3.0)):
        followed = track(demos, species.locomotion, species.arena, horizon=horizon)
        np.testing.assert_array_equal(labelled(**options), followed.actions[within])
    assert (labelled() != labelled(label_horizon=3.0)).any()
    with pytest.raises(InputError, match=r"horizon is 0\.0"):
        labelled(label_horizon=0.0)


# -- windows and mirrors --------------------------------------------------------------------------

MIRROR = Mirror(
    order=np.array([0, 2, 1, 3]),
    sign=np.array([1, 1, 1, -1], dtype=np.float32),
    actions=np.array([(12 - a) % 12 for a in range(12)] + [12]),
)


def shares() -> NDArray[np.float64]:
    drawn = np.random.default_rng(4).random((int(LENGTHS.sum()), len(NAMES), A))
    return drawn / drawn.sum(-1, keepdims=True)


@pytest.mark.parametrize(("length", "burn_in"), [(1, 0), (1, 2), (3, 0), (3, 2), (50, 0)])
def test_windows_are_pieces_of_the_demonstrations(length: int, burn_in: int) -> None:
    data = arrays() | {"label_shares": shares()}
    dataset = OfflineDataset(**data)
    first = np.cumsum(LENGTHS) - LENGTHS
    drawn = dataset.windows(6, 20, np.random.default_rng(0), length=length, burn_in=burn_in)
    for batch in drawn:
        assert batch.label_shares is not None and batch.action_penalties is not None
        for k in range(len(NAMES)):
            for b in range(6):
                start, end = int(batch.starts[k, b]), int(batch.lengths[k, b])
                assert 1 <= end - batch.burn_in <= length and batch.burn_in - start <= burn_in
                assert batch.mask[k, :, b].any()
                episode = int(batch.indices[k, b])
                rows = slice(first[episode], first[episode] + LENGTHS[episode])
                seen = data["observations"][rows, k].astype(np.float32)
                mine = batch.observations[k, start : end + 1, b].numpy()
                place = np.flatnonzero((seen == mine[0]).all(-1))
                assert len(place) == 1  # all are different
                begin = int(place[0])
                steps = slice(begin, begin + end - start)
                np.testing.assert_array_equal(seen[begin : begin + len(mine)], mine)
                taken = data["actions"][rows, k].astype(int)
                np.testing.assert_array_equal(batch.actions[k, start:end, b], taken[steps])
                before = taken[begin - 1] if begin else A
                assert batch.previous_actions[k, start, b] == before
                np.testing.assert_allclose(
                    batch.label_shares[k, start:end, b], data["label_shares"][rows, k][steps]
                )
                last = begin + end - start == LENGTHS[episode] - 1
                assert bool(batch.terminated[k, end - 1, b]) == (
                    last and bool(data["terminated"][episode])
                )


@pytest.mark.parametrize("length", [1, 3])
def test_every_step_is_drawn_as_often(length: int) -> None:
    data = arrays() | {"warmup": None}
    data["observations"] = np.broadcast_to(
        np.arange(LENGTHS.sum())[:, None, None], (LENGTHS.sum(), 3, 4)
    ).astype(float)
    counts = np.zeros(LENGTHS.sum())
    for batch in OfflineDataset(**data).windows(500, 40, np.random.default_rng(1), length=length):
        frames = batch.observations[:, :-1, :, 0][batch.mask > 0].long().numpy()
        counts += np.bincount(frames, minlength=len(counts))
    steps = np.ones(len(counts), dtype=bool)
    steps[np.cumsum(LENGTHS) - 1] = False
    assert not counts[~steps].any()
    np.testing.assert_allclose(counts[steps] / counts[steps].mean(), 1.0, atol=0.1)


def test_an_individual_alone_draws_the_windows_it_draws_with_others() -> None:
    data = arrays()
    together = OfflineDataset(**data)
    per_individual = ("observations", "actions", "rewards", "action_penalties")
    for k, name in enumerate(NAMES):
        mine = data | {key: data[key][:, k : k + 1] for key in per_individual} | {"names": (name,)}
        options = {"length": 2, "burn_in": 1}
        pairs = zip(
            together.windows(4, 5, np.random.default_rng(5), **options),
            OfflineDataset(**mine).windows(4, 5, np.random.default_rng(5), **options),
            strict=True,
        )
        for whole, single in pairs:
            np.testing.assert_array_equal(whole.indices[k], single.indices[0])
            trained = single.mask.shape[1] - single.burn_in
            np.testing.assert_array_equal(
                whole.labels[k, whole.burn_in : whole.burn_in + trained],
                single.labels[0, single.burn_in :],
            )


def test_half_of_the_windows_are_in_the_mirror() -> None:
    plain = OfflineDataset(**arrays(), label_shares=shares())
    mirrored = OfflineDataset(**arrays(), label_shares=shares(), mirror=MIRROR)
    one, other = (
        next(data.windows(64, 1, np.random.default_rng(0), length=2)) for data in (plain, mirrored)
    )
    chosen = (one.observations != other.observations).any(-1).any(1)
    assert 0.3 < chosen.float().mean() < 0.7
    back = mirror_columns(other, MIRROR, chosen)  # twice mirrored is as it was
    for name in ("observations", "actions", "previous_actions", "labels", "label_shares"):
        assert torch.equal(getattr(back, name), getattr(one, name)), name


def test_labels_are_mirrored_with_what_is_seen() -> None:
    data = OfflineDataset(**arrays(), label_shares=shares())
    one = next(data.windows(8, 1, np.random.default_rng(0), length=2))
    image = mirror_columns(one, MIRROR, torch.ones(3, 8, dtype=torch.bool))
    assert one.label_shares is not None and image.label_shares is not None
    labelled = one.labels >= 0
    assert torch.equal(image.labels[~labelled], one.labels[~labelled])
    assert torch.equal(
        image.labels[labelled],
        (12 - one.labels[labelled]) % 12 * (one.labels[labelled] < 12)
        + 12 * (one.labels[labelled] == 12),
    )
    own = one.label_shares[labelled].gather(1, one.labels[labelled][:, None])
    there = image.label_shares[labelled].gather(1, image.labels[labelled][:, None])
    assert torch.equal(own, there)
    assert torch.equal(image.observations[..., 1], one.observations[..., 2])
    assert torch.equal(image.observations[..., 3], -one.observations[..., 3])


def test_statistics_are_of_steps_that_enter_a_loss_mirrored_ones_too() -> None:
    data = arrays()
    last = np.cumsum(LENGTHS) - 1
    entering = ~data["warmup"]
    entering[last] = False
    mean, sd = OfflineDataset(**data).input_statistics()
    np.testing.assert_allclose(mean, data["observations"][entering].mean(0), atol=1e-6)
    np.testing.assert_allclose(sd, data["observations"][entering].std(0), atol=1e-6)
    mean, _ = OfflineDataset(**data, mirror=MIRROR).input_statistics()
    np.testing.assert_allclose(mean[:, 3], 0.0, atol=1e-6)
    np.testing.assert_allclose(mean[:, 1], mean[:, 2], atol=1e-6)
