"""The learners once more, plainly: one individual, double precision, one sequence at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from scripted_pair import Step
from torch.nn import functional

from animarl_algos.base import SequenceQLearning
from animarl_algos.recurrent.networks import StackedQNetwork

ALPHA, BETA, FLOOR = 0.6, (0.4, 1.0), 1e-6  # of prioritised replay
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8  # of Adam
Weights = dict[str, torch.Tensor]


@dataclass
class Episode:
    """What one individual lived through; ``states[t]`` is its memory before step t."""

    states: list[torch.Tensor]
    observations: list[torch.Tensor] = field(default_factory=list)
    actions: list[int] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    penalties: list[float] = field(default_factory=list)
    labels: list[int] = field(default_factory=list)
    warmup: list[bool] = field(default_factory=list)
    condition: float = 0.0
    terminated: bool = False


def run_network(
    net: StackedQNetwork,
    weights: Weights,
    observations: torch.Tensor,
    previous: list[int],
    state: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Values ``(T, A, Q)``, memories after each of T observations, features ``(T, H)``."""

    def layer(name: str, inputs: torch.Tensor) -> torch.Tensor:
        return inputs @ weights[f"{name}.weight"] + weights[f"{name}.bias"][0]

    units, actions = net.units, net.num_actions
    inputs = observations[:, : net.sensed]
    if net.previous_action:
        one_hot = torch.eye(actions + 1, dtype=torch.float64)[previous][:, :actions]
        inputs = torch.cat([inputs, one_hot], dim=1)
    features = torch.relu(layer("encoder_2", torch.relu(layer("encoder_1", inputs))))
    states = state.expand(len(features), -1)
    if net.recurrent:
        remembered = []
        for row in features:
            given = row @ weights["gru.weight_input"] + weights["gru.bias_input"][0]
            own = state @ weights["gru.weight_hidden"] + weights["gru.bias_hidden"][0]
            reset, keep = torch.sigmoid(given[: 2 * units] + own[: 2 * units]).chunk(2)
            new = torch.tanh(given[2 * units :] + reset * own[2 * units :])
            state = (1 - keep) * new + keep * state
            remembered.append(state)
        features = states = torch.stack(remembered)
    flag = observations[:, net.sensed :]  # empty without one
    hidden = torch.relu(layer("dueling.hidden", torch.cat([features, flag], dim=1)))
    value = layer("dueling.value", hidden[:, :units]).unsqueeze(1)
    advantage = layer("dueling.advantage", hidden[:, units:]).view(len(hidden), actions, -1)
    return value + advantage - advantage.mean(1, keepdim=True), states, features


def td_loss(value: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Squared error of one number, quantile Huber loss of several."""
    if len(value) == 1:
        return (target - value).square().sum()
    tau = (torch.arange(len(value)) + 0.5) / len(value)
    delta = target[None, :] - value[:, None]
    huber = torch.where(delta.abs() <= 1, 0.5 * delta**2, delta.abs() - 0.5)
    return ((tau[:, None] - (delta < 0).double()).abs() * huber).sum(0).mean()


class ReferenceLearner:
    """Individual ``k`` of ``model``, before it has learned anything; follows a log of events."""

    def __init__(self, model: SequenceQLearning, k: int, total: int) -> None:
        self.model, self.k, self.total = model, k, total
        self.net = model.policy.q_net
        self.rate: Callable[[float], float] = model.lr_schedule
        self.online = {n: p[k].detach().double() for n, p in self.net.named_parameters()}
        self.target = {n: p.clone() for n, p in self.online.items()}
        self.moments = {n: (torch.zeros_like(p),) * 2 for n, p in self.online.items()}
        self.updates = self.steps = 0
        self.running = [self.new_episode() for _ in range(model.layout.num_copies)]
        self.sequences: list[tuple[Episode, int, int]] = []
        self.priorities: list[float] = []
        self.largest = 1.0

    def new_episode(self) -> Episode:
        return Episode(states=[torch.zeros(self.net.units, dtype=torch.float64)])

    def follow(self, log: list[Step | NDArray[np.int64]]) -> None:
        for event in log:
            if isinstance(event, Step):
                self.step(event)
            else:
                self.update(event[self.k].tolist())

    # -- act and store ----------------------------------------------------------------------------

    def step(self, step: Step) -> None:
        k, copies = self.k, len(self.running)
        for c, episode in enumerate(self.running):
            observation = torch.tensor(step.observations[c, k]).double()
            before = episode.actions[-1] if episode.actions else self.net.num_actions
            _, states, _ = run_network(
                self.net, self.online, observation[None], [before], episode.states[-1]
            )
            episode.states.append(states[-1])
            episode.observations.append(observation)
            episode.actions.append(int(step.actions[c, k]))
            episode.rewards.append(float(step.rewards[c, k]))
            episode.penalties.append(float(step.penalties[c, k]))
            episode.labels.append(int(step.labels[c, k]))
            episode.warmup.append(bool(step.warmup[c]))
            if step.done[c]:
                episode.observations.append(torch.tensor(step.successors[c, k]).double())
                episode.condition = float(step.condition[c])
                episode.terminated = bool(step.terminated[c])
                self.store(episode)
                self.running[c] = self.new_episode()
        self.steps += copies
        interval, tau = self.model.target_update.frequency, self.model.tau
        if self.steps // interval > (self.steps - copies) // interval:
            for name, own in self.target.items():
                self.target[name] = (1 - tau) * own + tau * self.online[name]

    def store(self, episode: Episode) -> None:
        """Trained parts lie end to end; those of warm-up steps alone are left out."""
        length, whole = len(episode.actions), self.model.sequence_length is None
        stride = length if whole else self.model.sequence_length - self.model.burn_in
        for begin in range(0, length, stride):
            end = min(begin + stride, length)
            if not all(episode.warmup[begin:end]):
                self.sequences.append((episode, begin, end))
                self.priorities.append(self.largest)

    # -- learn ------------------------------------------------------------------------------------

    def update(self, indices: list[int]) -> None:
        progress = self.steps / self.total
        shares = np.array(self.priorities) ** ALPHA
        beta = BETA[0] + progress * (BETA[1] - BETA[0])
        importance = (len(shares) * shares[indices] / shares.sum()) ** -beta
        weights = {n: p.clone().requires_grad_() for n, p in self.online.items()}
        gradients = self.gradients(weights, indices, importance / importance.max())
        self.updates += 1
        for name, gradient in gradients.items():
            first, second = self.moments[name]
            first = BETA_1 * first + (1 - BETA_1) * gradient
            second = BETA_2 * second + (1 - BETA_2) * gradient**2
            self.moments[name] = first, second
            mean = first / (1 - BETA_1**self.updates)
            size = (second / (1 - BETA_2**self.updates)).sqrt()
            rate = self.rate(1 - progress)
            self.online[name] = self.online[name] - rate * mean / (size + EPSILON)

    def gradients(self, weights: Weights, indices: list[int], importance: NDArray) -> Weights:
        """Of the recipe's loss, clipped; sets the priorities of the sequences."""
        model, recipe = self.model, self.model.recipe.name
        sums = {"td": torch.tensor(0.0), "supervision": torch.tensor(0.0)}
        sums["treatment"] = torch.tensor(0.0)
        steps = labelled = 0
        errors: dict[int, list[float]] = {i: [] for i in indices}
        for index, weight in zip(indices, importance):
            episode, begin, end = self.sequences[index]
            values, features = self.evaluate(weights, episode, begin, end)
            with torch.no_grad():
                later, _ = self.evaluate(self.target, episode, begin, end)
            errors[index] = []
            for t in range(begin, end):
                if episode.warmup[t]:
                    continue
                reward, now, then = episode.rewards[t], t - begin, t + 1 - begin
                if recipe in ("dqdil", "dqcil"):
                    reward -= model.alpha * episode.penalties[t]
                best = int(values[then].mean(-1).argmax())
                last = episode.terminated and t + 1 == len(episode.actions)
                target = reward + (0.0 if last else model.gamma) * later[then, best]
                value = values[now, episode.actions[t]]
                sums["td"] = sums["td"] + weight * td_loss(value, target)
                errors[index].append(abs((target.mean() - value.mean()).item()))
                steps += 1
                if episode.labels[t] >= 0:
                    chosen = values[now].mean(-1).log_softmax(0)[episode.labels[t]]
                    sums["supervision"] = sums["supervision"] - weight * chosen
                    labelled += 1
                if recipe == "dqcil":
                    loss = self.treatment_loss(weights, features[now], episode.condition)
                    sums["treatment"] = sums["treatment"] + weight * loss
        total = sums["td"] / steps + model.lambda1 * sum(p.square().sum() for p in weights.values())
        if recipe == "dqaas":
            total = total + model.lambda3 * sums["supervision"] / max(labelled, 1)
        if recipe == "dqcil":
            total = total + model.lambda2 * sums["treatment"] / steps
        for index, found in errors.items():
            self.priorities[index] = 0.9 * max(found) + 0.1 * float(np.mean(found)) + FLOOR
            self.largest = max(self.largest, self.priorities[index])
        gradients = torch.autograd.grad(total, list(weights.values()))
        norm = torch.cat([g.flatten() for g in gradients]).norm()
        scale = min(1.0, model.max_grad_norm / float(norm + 1e-6))
        return {name: scale * g for name, g in zip(weights, gradients)}

    def evaluate(
        self, weights: Weights, episode: Episode, begin: int, end: int
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Values and features at the observations from ``begin`` to ``end``, both included."""
        previous = [self.net.num_actions, *episode.actions]
        prefix = max(0, begin - self.model.burn_in)
        stored = self.model.state_mode == "stored"
        state = episode.states[prefix if stored else 0]
        observations = torch.stack(episode.observations)
        if prefix < begin:
            with torch.no_grad():
                _, states, _ = run_network(
                    self.net,
                    weights,
                    observations[prefix:begin],
                    previous[prefix:begin],
                    state,
                )
            state = states[-1]
        values, _, features = run_network(
            self.net, weights, observations[begin : end + 1], previous[begin : end + 1], state
        )
        return values, features

    def treatment_loss(
        self, weights: Weights, features: torch.Tensor, condition: float
    ) -> torch.Tensor:
        """Through the reversal: the value of ``features``, minus its gradient."""
        reversal = self.net.reversal
        inputs = (1 + reversal) * features.detach() - reversal * features
        hidden = torch.relu(inputs @ weights["treatment.0.weight"] + weights["treatment.0.bias"][0])
        logit = hidden @ weights["treatment.2.weight"] + weights["treatment.2.bias"][0]
        aim = torch.full_like(logit, condition)
        return functional.binary_cross_entropy_with_logits(logit, aim)
