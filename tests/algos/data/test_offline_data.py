"""Demonstrations as minibatches, and the penalty of every action by the fitted dynamics."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from recordings import episodes_along
from refusals import refuses

from animarl_algos import DQN, SoftBC
from animarl_algos.data import species_data
from animarl_algos.data.dataset import OfflineDataset, mirror_columns
from animarl_algos.data.species_data import SpeciesDemonstrations, soft_labels
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.runs.pipeline import check_run
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs import SPECIES
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT, UNFINISHED
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import learnable
from animarl_envs.errors import InputError
from animarl_envs.fitting.tracking import one_step_misses, track
from animarl_envs.focus import focus_directions
from animarl_envs.locomotion import COAST, NUM_ACTIONS, Locomotion, apply_actions
from animarl_envs.worlds import Mirror, demonstration_observations

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
        "observations": rng.normal(size=(frames, k, 4)), "actions": actions, "lengths": lengths,
        "num_actions": NUM_ACTIONS, "rewards": rng.normal(size=(frames, k)),
        "action_penalties": rng.random((frames, k, NUM_ACTIONS)),
        "terminated": rng.random(len(lengths)) < 0.5, "condition": rng.integers(0, 2, len(lengths)),
        "warmup": within < 1, "names": NAMES,
    }  # fmt: skip


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
        assert batch.weights is None
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
                    "actions": taken, "labels": taken,
                    "previous_actions": np.concatenate([[NUM_ACTIONS], taken])[:-1],
                    "rewards": data["rewards"][rows, k].astype(np.float32),
                    "action_penalties": scored, "penalties": scored[np.arange(steps), taken],
                    "mask": (np.arange(steps) >= 1).astype(float),
                    "terminated": (np.arange(steps) == steps - 1) * data["terminated"][episode],
                }  # fmt: skip
                for name, value in expected.items():
                    tensor = getattr(batch, name)[k, :, b]
                    np.testing.assert_array_equal(tensor[:steps], value, err_msg=name)
                assert not batch.mask[k, steps:, b].any()
                assert (batch.labels[k, steps:, b] == -1).all()
    assert [sorted(mine) for mine in seen] == [kept.tolist()] * 3


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
    refuses(f"file.npz: .*{message}", OfflineDataset, **data | change(data), source="file.npz")


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
    noisy = positions + rng.normal(size=positions.shape) * noise
    demos = episodes_along(
        np.split(noisy, [30]), species="custom", individuals=NAMES, arena=Arena("open"),
        initial_velocity=initial, split=np.array(["train", "val"]),
    )  # fmt: skip
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
    refuses("for 3 individuals: give one set each", one_step_misses, demos, fitted[:2])


A = 13


def test_a_known_answer() -> None:
    """Two actions as near as each other, the third one width further."""
    width, step = 0.35, 0.02
    near = soft_labels(np.array([0.0, 0.0, width * step]), step, width)
    expected = np.array([1.0, 1.0, np.exp(-0.5)])
    np.testing.assert_allclose(near, expected / expected.sum(), rtol=1e-6)


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


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"labels": "vague"}, "'vague': choose hard, soft, tracking"),
        ({"label_width": 0}, "label_width is 0"),
        ({"label_horizon": 0.5}, r"label_horizon is 0\.5: give a number of at least 1"),
    ],
)
def test_bad_labels_are_refused_with_the_environment(options, message: str) -> None:
    refuses(message, SlotVecEnv, "fly", 1, **options)


@pytest.mark.parametrize(("options", "horizon"), [({}, 1.0), ({"label_horizon": 3.0}, 3.0)])
def test_tracking_labels_are_those_of_the_simulation_seen_from_where_it_is(
    options: dict[str, float], horizon: float
) -> None:
    exact = load_packaged("fly")
    noise = np.random.default_rng(0).normal(0.0, 2e-3, exact.positions.shape)
    demos = learnable(replace(exact, positions=exact.positions + noise))
    env = SlotVecEnv("fly", 1, demos=demos, labels="tracking", **options)
    species, frames = env.scenario.species, env.offline_data().train._frames
    followed = track(demos, species.locomotion, species.arena, horizon=horizon)
    within = np.repeat(demos.split == "train", demos.lengths)
    np.testing.assert_array_equal(frames.actions, followed.actions[within])
    simulated = replace(demos, positions=followed.positions).select(split="train")
    expected = demonstration_observations(species, simulated)
    np.testing.assert_allclose(frames.observations, expected, rtol=1e-6, atol=1e-6)


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
        image.labels[labelled], torch.from_numpy(MIRROR.actions)[one.labels[labelled]]
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


def test_memory_is_said_before_it_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand animals do not fit a small machine."""
    monkeypatch.setattr(species_data, "available_memory", lambda: 1e6)
    env = SlotVecEnv("shoal", 1)
    said = r"12 animals with \d+ actions take about \S+ GiB of memory, and \S+ GiB are available"
    with pytest.raises(InputError, match=said):
        _ = env.offline_data().train
    with pytest.raises(InputError, match=said):  # before anything is fitted
        check_run(RunSettings(species="shoal", steps=1), load_packaged("shoal"))
    monkeypatch.undo()
    # Nor is there a replay memory for a learner that never acts.
    memory = SoftBC("MlpPolicy", env, seed=0).replay_buffer
    assert memory is not None and memory.buffer_size == env.max_episode_steps + 1
    assert species_data.available_memory() > 1e8


@pytest.mark.parametrize(("species", "shared"), [("shoal", True), ("agent", False)])
def test_animals_that_are_alike_share_a_network_without_recordings(
    species: str, shared: bool
) -> None:
    env = SlotVecEnv(species, 1, demos=None)
    assert DQN("MlpPolicy", env, seed=0).policy.q_net.shared is shared
