"""IQ-Learn: its loss by hand, what ends are worth, and an expert that a clone does not find."""

import math
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
import toys
from numpy.typing import NDArray
from pair_learners import Split, evaluated, make_pair_learner
from refusals import refuses
from torch.nn import functional

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.losses.terms import InverseSoftQ, MinibatchValues, Phase, next_values
from animarl_algos.losses.values import ValueDistribution
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.networks.policies import values_to_logits
from animarl_algos.recipes.registry import IQLearn

LOG2, LOG3 = math.log(2.0), math.log(3.0)


@dataclass(frozen=True)
class Given:
    """Action values that no network said."""

    q_values: torch.Tensor


def steps_of(
    q: list[list[float]],
    actions: list[int],
    *,
    rewards: list[float] | None = None,
    terminated: list[float] | None = None,
    shares: list[list[float]] | None = None,
    gamma: float = 0.5,
) -> MinibatchValues:
    """One individual's episode of T steps, given its T + 1 states' action values."""
    like = torch.zeros((1, len(actions), 1))

    def column(values: list[Any] | None) -> torch.Tensor:
        return like if values is None else torch.tensor(values)[None, :, None]

    batch = SimpleNamespace(
        num_steps=len(actions), actions=torch.tensor(actions)[None, :, None],
        rewards=column(rewards), terminated=column(terminated),
        label_shares=None if shares is None else torch.tensor(shares)[None, :, None],
    )  # fmt: skip
    return MinibatchValues(
        batch=batch,  # type: ignore[arg-type]
        phase=Phase("online", gamma, 0.0, 0.0, 0.0, 0.0, None),
        distribution=ValueDistribution(),
        valid=torch.ones_like(like, dtype=torch.bool),
        online=Given(torch.tensor(q)[None, :, None]),
        target=None, treatment_logits=None, parameters=[],
    )  # fmt: skip


def beside(own: MinibatchValues, shown: MinibatchValues) -> MinibatchValues:
    own.demonstrated = shown
    return own


def test_the_loss_by_hand() -> None:
    """V is log 3 and then log 2 on either side; the demonstrated action has log 2, the own 0."""
    shown = steps_of([[LOG2, 0.0], [0.0, 0.0]], [0])
    own = steps_of([[LOG2, 0.0], [0.0, 0.0]], [1])
    loss = InverseSoftQ()(beside(own, shown))
    rewards = (LOG2 - 0.5 * LOG2, 0.0 - 0.5 * LOG2)
    worth = LOG3 - 0.5 * LOG2
    squares = 0.5 * (rewards[0] ** 2 + rewards[1] ** 2) / 2
    assert loss.tolist() == pytest.approx([-rewards[0] + worth + squares])


def test_a_soft_label_counts_for_each_action_by_its_share() -> None:
    q = [[LOG2, 0.0], [0.0, 0.0]]
    hard = [InverseSoftQ()(beside(steps_of(q, [0]), steps_of(q, [a]))).item() for a in (0, 1)]
    soft = InverseSoftQ()(beside(steps_of(q, [0]), steps_of(q, [0], shares=[[0.25, 0.75]])))
    assert soft.item() == pytest.approx(0.25 * hard[0] + 0.75 * hard[1])


def test_what_an_end_is_worth() -> None:
    """Punished: nothing. Not punished: the end value. Cut by the clock: what the network says."""
    q = [[0.0, 0.0], [LOG2, 0.0], [0.0, 0.0], [LOG2, 0.0]]
    found = [
        next_values(steps_of(q, [0, 0, 0], rewards=rewards, terminated=terminated), torch.ones(1))
        for rewards, terminated in (
            ([0.0, 0.0, -10.0], [0.0, 0.0, 1.0]),
            ([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]),
            ([0.0, -10.0, 0.0], [0.0, 0.0, 0.0]),
        )
    ]
    for values, last in zip(found, (0.0, 1.0, LOG3), strict=True):
        assert values.flatten().tolist() == pytest.approx([LOG3, LOG2, last])


def test_an_end_that_costs_no_more_than_its_time_is_not_punished() -> None:
    """A pursuer that did not touch at a capture, and one that left."""
    env = SlotVecEnv("agent", 1, time_cost=0.5)
    phase = IQLearn("MlpPolicy", env, offline_epochs=1, seed=0).phase("online")
    cost, found = env.scenario.species.step_cost, []
    for reward in (-cost, -10.0 - cost):
        end = steps_of([[0.0, 0.0], [0.0, 0.0]], [0], rewards=[reward], terminated=[1.0])
        found.append(next_values(replace(end, phase=phase), torch.ones(1)).item())
    assert found == [1.0, 0.0]


def test_the_end_value_is_the_demonstrated_states_mean_and_has_no_gradient() -> None:
    q = [[LOG2, 0.0], [0.0, 0.0], [5.0, 5.0]]
    shown, own = steps_of(q, [0, 0]), steps_of(q[1:], [0], rewards=[1.0], terminated=[1.0])
    ended = InverseSoftQ()(beside(own, shown)).item()
    mean = (LOG3 + LOG2) / 2
    # the same step, going on into a state of that value
    same = [[0.0, 0.0], [mean - LOG2, mean - LOG2]]
    assert ended == pytest.approx(InverseSoftQ()(beside(steps_of(same, [0]), shown)).item())
    free = torch.tensor(q[1:])[None, :, None].requires_grad_()
    own.online = Given(free)  # type: ignore[assignment]
    InverseSoftQ()(beside(own, shown)).sum().backward()
    assert free.grad is not None
    assert (free.grad[0, 0] != 0.0).all() and (free.grad[0, 1] == 0.0).all()


def test_individuals_are_their_own() -> None:
    learner = make_pair_learner("iq-learn", "MlpPolicy")
    assert learner.demonstrations is not None
    shown, own = (
        evaluated(learner, next(iter(split.batches(8))), needs_target=False)
        for split in (learner.demonstrations.train, learner.demonstrations.val)
    )
    together = InverseSoftQ()(beside(own, shown))
    with torch.no_grad():
        for parameter in learner.policy.q_net.parameters():
            parameter[1] += 0.1
    shown, own = (evaluated(learner, part.batch, needs_target=False) for part in (shown, own))
    after = InverseSoftQ()(beside(own, shown))
    assert after[0] == together[0] and after[1] != together[1]


def test_values_become_logits_at_the_fitted_temperatures() -> None:
    policy = make_pair_learner("soft-bc").policy
    policy.acting = Acting.boltzmann([0.5, 2.0])
    observations = torch.randn((2, 3, 6, 4), generator=torch.Generator().manual_seed(0))
    previous = torch.zeros((2, 3, 6), dtype=torch.int64)
    before = policy.q_net(observations, previous).q_values
    values_to_logits(policy)
    after = policy.q_net(observations, previous).q_values
    torch.testing.assert_close(after, before / torch.tensor([0.5, 2.0]).view(2, 1, 1, 1))
    assert policy.acting == Acting.boltzmann(1.0)


@pytest.mark.parametrize("offline_epochs", [0, 2])
def test_it_acts_at_temperature_one(offline_epochs: int) -> None:
    """After a clone, whose logits are then scaled, and from scratch."""
    learner = make_pair_learner("iq-learn", offline_epochs=offline_epochs).learn(24)
    assert learner.policy.acting == Acting.boltzmann(1.0) and learner._n_updates > 0


def test_it_samples_and_needs_demonstrations() -> None:
    told = r"'epsilon' and recipe iq-learn .* set it to 'boltzmann'"
    refuses(told, make_pair_learner, "iq-learn", exploration="epsilon")
    told = "iq-learn learns from demonstrations and neither it nor"
    refuses(told, make_pair_learner, "iq-learn", offline_epochs=0, demonstrations=None)


class Valley(toys.Toy):
    """A walk along a row of cells; actions: left, stay, right. It starts anywhere."""

    CELLS = 9
    STATE = ("place",)
    num_observations = CELLS
    num_actions = 3
    time_limit = 12
    MOVES = np.array([-1, 0, 1])

    def __init__(self, num_copies: int = 8, seed: int = 0) -> None:
        self.place = np.zeros(num_copies, dtype=np.int64)
        super().__init__(num_copies, seed)

    def begin(self, copies: NDArray[np.intp]) -> None:
        self.place[copies] = self.rng.integers(self.CELLS, size=len(copies))

    def advance(self, actions: NDArray[np.integer[Any]]) -> tuple[Any, NDArray[np.bool_]]:
        self.place[:] = self.after(self.place, actions[:, 0])
        return np.zeros((self.num_copies, 1)), np.zeros(self.num_copies, dtype=bool)

    @classmethod
    def after(cls, place: Any, action: Any) -> Any:
        return np.clip(place + cls.MOVES[action], 0, cls.CELLS - 1)

    def observe(self) -> NDArray[np.float64]:
        return np.eye(self.CELLS)[self.place][:, None]


@cache
def expert() -> NDArray[np.float64]:
    """Probabilities (cells, actions): soft-optimal for 2 a step in the middle cell, gamma 0.9."""
    cells = np.arange(Valley.CELLS)
    after = Valley.after(cells[:, None], np.arange(3))
    q = np.zeros(after.shape)
    for _ in range(300):
        q = 2.0 * (after == Valley.CELLS // 2) + 0.9 * np.log(np.exp(q).sum(1))[after]
    return np.asarray(np.exp(q - np.log(np.exp(q).sum(1, keepdims=True))))


def shown_by_the_expert(episodes: int, seed: int) -> OfflineDataset:
    """Episodes of 30 steps that begin beside the middle."""
    rng = np.random.default_rng(seed)
    places, actions = [], []
    for _ in range(episodes):
        place = Valley.CELLS // 2 + 1
        for _ in range(30):
            action = rng.choice(3, p=expert()[place])
            places.append(place)
            actions.append(action)
            place = Valley.after(place, action)
        places.append(place)
        actions.append(-1)
    return OfflineDataset(
        np.eye(Valley.CELLS)[places][:, None], np.array(actions)[:, None],
        np.full(episodes, 31), 3, names=Valley.individuals,
    )  # fmt: skip


def distance_to_the_expert(model: IQLearn) -> float:
    """Total variation, mean over the cells."""
    q_values, _, _ = model.policy.advance(np.eye(Valley.CELLS, dtype=np.float32), None, None)
    policy = functional.softmax(torch.from_numpy(q_values), -1).numpy()
    return float(0.5 * np.abs(policy - expert()).sum(1).mean())


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_three_demonstrations_show_more_than_their_clone(seed: int) -> None:
    """Cells that nobody showed: a clone guesses, IQ-Learn finds the way back from them."""
    data = Split(shown_by_the_expert(3, seed), shown_by_the_expert(3, seed + 100))
    model = IQLearn(
        "MlpPolicy", Valley(16), demonstrations=data, seed=seed, device="cpu", gamma=0.9,
        train_freq=(24, "step"), gradient_steps=40, buffer_size=3000, learning_rate=3e-3,
        batch_size=256, offline_kwargs={"updates_per_epoch": 20}, offline_batch_size=64,
        policy_kwargs={"hidden": 32, "dropout": 0.0},
    )  # fmt: skip
    model.pretrain()
    cloned = distance_to_the_expert(model)
    model.learn(16 * 24 * 20)
    assert distance_to_the_expert(model) < 0.65 * cloned
