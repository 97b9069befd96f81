"""Acting: routing of slots, memory between calls, the acting rules, saving and loading."""

import operator
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium import spaces
from refusals import refuses
from stable_baselines3.common.utils import ConstantSchedule

from animarl_algos.losses.values import ValueDistribution
from animarl_algos.networks.acting_rule import Acting, boltzmann
from animarl_algos.networks.policies import GruPolicy, MlpPolicy, decide_on_device

NAMES = ("predator_0", "predator_1", "prey")
K, COPIES, T, A = 3, 4, 6, 13
S = K * COPIES
SHAPE = (5, 2)
OBSERVATIONS = spaces.Box(-np.inf, np.inf, SHAPE, np.float32)
ACTIONS = spaces.Discrete(A)

kinds = pytest.mark.parametrize("kind", [GruPolicy, MlpPolicy])


def make(kind: type[GruPolicy] = GruPolicy, **options: object) -> GruPolicy:
    options = {"individuals": NAMES, **options}
    return kind(OBSERVATIONS, ACTIONS, ConstantSchedule(1e-3), **options)


def observe(steps: int = T, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((steps, S, *SHAPE)).astype(np.float32)


@kinds
@pytest.mark.parametrize("options", [{}, {"n_quantiles": 5, "condition_flag": True}])
def test_carried_state_equals_the_whole_sequence(kind: type[GruPolicy], options: dict) -> None:
    policy = make(kind, previous_action=True, **options)
    observations = observe()
    previous = np.full((T, S), A)
    q_values, state = [], None
    for t in range(T):
        q_now, _, _ = policy.advance(observations[t], state, None)
        q_values.append(q_now)
        actions, state = policy.predict(observations[t], state, deterministic=True)
        if t + 1 < T:
            previous[t + 1] = actions

    def stacked(array: np.ndarray) -> torch.Tensor:
        """(T, S, ...) to (K, T, copies, ...), written out slot by slot."""
        rows = [np.stack([array[:, c * K + k] for c in range(COPIES)], axis=1) for k in range(K)]
        return torch.from_numpy(np.stack(rows))

    flat = observations.reshape(T, S, -1)
    whole = policy.q_net(stacked(flat), stacked(previous)).values.mean(-1)
    torch.testing.assert_close(stacked(np.stack(q_values)), whole, rtol=1e-4, atol=1e-6)


shapes = pytest.mark.parametrize(
    "shape",
    [
        {}, {"depth": 1}, {"depth": 3, "hidden": 9}, {"head_layers": 0},
        {"head_layers": 0, "condition_flag": False, "previous_action": False},
        {"skip": True, "dropout": 0.5}, {"skip": True, "depth": 3, "head_layers": 0},
        {"condition_input": "encoder"}, {"condition_input": "encoder", "head_layers": 0},
    ],
    ids=lambda shape: "-".join(map(str, shape)) or "plain",
)  # fmt: skip


@kinds
@shapes
@pytest.mark.parametrize("standardised", [False, True])
def test_compiled_and_tensor_acting_agree(
    kind: type[GruPolicy], shape: dict, standardised: bool
) -> None:
    if kind is MlpPolicy and shape.get("skip"):
        shape = shape | {"skip": False}
    given = {"condition_flag": True, "n_quantiles": 4, "previous_action": True} | shape
    policy = make(kind, **given)
    if standardised:
        generator = torch.Generator().manual_seed(0)
        mean, sd = (torch.rand(K, 10, generator=generator) for _ in range(2))
        policy.q_net.standardise_inputs(mean, 0.1 * sd)  # so that some are clipped
    observations = observe(1)[0].reshape(S, -1)
    observations[::2, -1] = 0.0  # the flag of every second slot
    rng = np.random.default_rng(0)
    hidden = rng.uniform(-1, 1, (S, policy.q_net.units)).astype(np.float32)
    previous = rng.integers(0, A + 1, S)
    want_q, want_hidden = decide_on_device(policy.q_net, observations, previous, hidden)
    got_q = policy._actor.decide(observations, previous, hidden)
    np.testing.assert_allclose(got_q, want_q, rtol=1e-4, atol=5e-6)
    np.testing.assert_allclose(hidden, want_hidden, rtol=1e-4, atol=5e-6)


def test_acting_follows_training_and_moved_parameters() -> None:
    policy = make()
    observations = observe(1)[0]
    before, _, _ = policy.advance(observations, None, None)
    with torch.no_grad():
        policy.q_net.dueling.value.bias.add_(1.0)
    trained, _, _ = policy.advance(observations, None, None)
    np.testing.assert_allclose(trained, before + 1, atol=1e-5)
    for parameter in policy.q_net.parameters():
        parameter.data = parameter.data.clone()
    policy.q_net.dueling.value.bias.data.add_(1.0)
    moved, _, _ = policy.advance(observations, None, None)
    np.testing.assert_allclose(moved, before + 2, atol=1e-5)
    other = make(seed=1)
    policy.q_net.load_state_dict(other.q_net.state_dict(), assign=True)  # other parameters
    np.testing.assert_array_equal(
        policy.advance(observations, None, None)[0], other.advance(observations, None, None)[0]
    )
    assert all(map(operator.is_, policy.q_net.all_parameters, policy.q_net.parameters()))


def test_episode_start_resets_those_slots_only() -> None:
    policy = make()
    observations = observe(2)
    _, state = policy.predict(observations[0], deterministic=True)
    kept = [array.copy() for array in state]
    starts = np.zeros(S, dtype=bool)
    starts[[1, 7]] = True
    some, _, _ = policy.advance(observations[1], state, starts)
    none, _, _ = policy.advance(observations[1], state, None)
    fresh, _, _ = policy.advance(observations[1], None, None)
    np.testing.assert_array_equal(some[starts], fresh[starts])
    np.testing.assert_array_equal(some[~starts], none[~starts])
    assert (some[starts] != none[starts]).any(axis=1).all()
    for before, after in zip(kept, state):
        np.testing.assert_array_equal(before, after)


@kinds
def test_slots_that_are_over_cost_nothing_and_change_no_other(kind: type[GruPolicy]) -> None:
    policy = make(kind, previous_action=True, acting=Acting.boltzmann(1.0))
    observations, over = observe(), np.arange(S) % 5 == 0
    taken = []
    for leaving in (False, True):
        policy.seed(7)
        state, actions = None, []
        for observation in observations:
            told, state = policy.predict(observation, state)
            if leaving:
                state = policy.leave_out(state, over)
            actions.append(told)
        taken.append((np.stack(actions)[:, ~over], state[0][~over], state[1][~over]))
    for whole, others in zip(*taken, strict=True):
        np.testing.assert_array_equal(others, whole)
    values, hidden, _ = policy.advance(observations[0], state, None)
    assert not values[over].any() and values[~over].all()
    np.testing.assert_array_equal(hidden[over], state[0][over])
    values, _, _ = policy.advance(observations[0], state, np.ones(S, dtype=bool))
    assert values.all()  # begun anew


def test_who_only_acts_has_no_optimiser() -> None:
    policy = make()
    policy.predict(observe()[0])
    assert policy._optimizer is None
    made = policy.optimizer
    assert made is policy.optimizer and made.param_groups[0]["lr"] == 1e-3
    held = [p for group in made.param_groups for p in group["params"]]
    assert list(map(id, held)) == list(map(id, policy.q_net.parameters()))
    for online, target in zip(policy.q_net.parameters(), policy.q_net_target.parameters()):
        assert torch.equal(online, target) and not target.requires_grad
    refuses("do not fit", make, optimizer_kwargs={"lrr": 1})


def test_greedy_ties_go_to_the_lowest_index_and_draw_nothing() -> None:
    policy = make(acting=Acting.epsilon_greedy(1.0))
    before = policy.random_state
    q_values = np.zeros((S, A), dtype=np.float32)
    q_values[:, [4, 9]] = 1
    assert (policy.choose(q_values, deterministic=True) == 4).all()
    assert policy.random_state == before


def test_epsilon_greedy_frequencies_and_one_coin_per_slot() -> None:
    policy = make(acting=Acting.epsilon_greedy(0.4))
    slots = K * 40_000
    q_values = np.zeros((slots, A), dtype=np.float32)
    q_values[:, 5] = 1
    counts = np.bincount(policy.choose(q_values, deterministic=False), minlength=A) / slots
    expected = np.full(A, 0.4 / A)
    expected[5] += 0.6
    np.testing.assert_allclose(counts, expected, atol=5 * np.sqrt(0.25 / slots))
    # One coin for all slots at once would make whole rows of draws random or greedy together.
    greedy = (policy.choose(q_values[:S], deterministic=False) == 5).sum()
    assert 0 < greedy < S


def test_boltzmann_stays_in_range_at_extreme_draws() -> None:
    scaled = np.array([[0.0, -1e4, 0.0], [0.0, -1e4, 0.0], [5.0, 5.0, -1e4]])
    draw = np.array([0.0, np.nextafter(1.0, 0.0), np.nextafter(1.0, 0.0)])
    assert boltzmann(scaled, draw).tolist() == [0, 2, 1]


def test_draws_are_seeded_and_one_per_slot() -> None:
    policy, twin = (make(acting=Acting.epsilon_greedy(0.5), seed=3) for _ in range(2))
    observations = observe(1)[0]
    first, _ = policy.predict(observations)
    np.testing.assert_array_equal(first, twin.predict(observations)[0])
    after = np.random.default_rng(3)
    after.random(S)
    assert policy.random_state == after.bit_generator.state
    policy.random_state = np.random.default_rng(3).bit_generator.state
    np.testing.assert_array_equal(policy.predict(observations)[0], first)


def test_a_single_bare_slot() -> None:
    policy = make(individuals=("agent",))
    observations = observe(2)[:, 0]
    action, state = policy.predict(observations[0], deterministic=True)
    assert np.shape(action) == ()
    assert ACTIONS.contains(action)
    batched, _ = policy.predict(observations[:1], deterministic=True)
    assert batched.shape == (1,)
    assert batched[0] == action
    again, _ = policy.predict(
        observations[1], state, episode_start=np.array([True]), deterministic=True
    )
    assert again == policy.predict(observations[1], deterministic=True)[0]


@kinds
def test_save_and_load(kind: type[GruPolicy], tmp_path: Path) -> None:
    policy = make(
        kind, n_quantiles=3, condition_flag=True, treatment_head=True, hidden=8,
        acting=Acting.boltzmann(0.3), head_layers=0, td_loss="huber",
    )  # fmt: skip
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.mul_(1.5)
    policy.save(str(tmp_path / "policy.pt"))
    loaded = kind.load(str(tmp_path / "policy.pt"), device="cpu")
    assert loaded.individuals == NAMES
    assert loaded.acting == policy.acting
    assert loaded.distribution == policy.distribution == ValueDistribution(3, "huber")
    for (name, saved), read in zip(policy.state_dict().items(), loaded.state_dict().values()):
        assert torch.equal(saved, read), name
    observations = observe(1)[0]
    np.testing.assert_array_equal(
        policy.advance(observations, None, None)[0], loaded.advance(observations, None, None)[0]
    )


def told(slots: int = S, previous_action: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A memory of so many slots, in which all did one action before."""
    hidden, previous = make().initial_state(slots)
    return hidden, np.full_like(previous, previous_action)


def act(*shape: int, state: tuple[np.ndarray, np.ndarray] | None = None) -> object:
    return make().predict(np.zeros(shape, dtype=np.float32), state)


@pytest.mark.parametrize(
    ("message", "call"),
    [
        ("not a Box", lambda: GruPolicy(spaces.Discrete(3), ACTIONS, ConstantSchedule(1e-3))),
        ("not Discrete", lambda: GruPolicy(OBSERVATIONS, spaces.Box(-1, 1, (2,)), float)),
        ("starting at 0", lambda: GruPolicy(OBSERVATIONS, spaces.Discrete(3, start=1), float)),
        ("cannot be dealt", lambda: act(4, *SHAPE)),
        ("does not fit", lambda: act(S, 7)),
        ("does not fit", lambda: act(S, *SHAPE, state=told(S + 3))),
        ("previous actions", lambda: act(S, *SHAPE, state=told(previous_action=-1))),
        ("previous", lambda: act(S, *SHAPE, state=told(previous_action=A + 1))),
    ],
)
def test_what_does_not_fit_a_policy_is_refused(message: str, call: Callable[[], object]) -> None:
    refuses(message, call)
