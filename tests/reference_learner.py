"""The learners once more, plainly: one individual, double precision, one sequence at a time.

Below them its network and the losses of its values, by their equations, as plain functions.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scripted_pair import Step
from torch.nn import functional

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.networks.networks import StackedQNetwork

Weights = dict[str, torch.Tensor]
ALPHA, BETA, FLOOR = 0.6, (0.4, 1.0), 1e-6  # of prioritised replay
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8  # of Adam


@dataclass
class Episode:
    """Individual ``k`` of a copy; ``states[t]`` is its memory before ``steps[t]``."""

    copy: int
    k: int
    states: list[torch.Tensor]
    steps: list[Step] = field(default_factory=list)

    def of(self, name: str) -> list[Any]:
        """What each step has for the individual, or for its copy."""
        rows = [getattr(step, name)[self.copy] for step in self.steps]
        return [(row[self.k] if np.ndim(row) else row).tolist() for row in rows]

    def observations(self) -> torch.Tensor:
        """``(T + 1, n)``, the last one included."""
        rows = [*self.of("observations"), self.of("successors")[-1]]
        return torch.tensor(rows, dtype=torch.float64)


class ReferenceLearner:
    """Individual ``k`` of ``model``, before it has learned anything; follows a log of events."""

    def __init__(self, model: SequenceQLearning, k: int, total: int) -> None:
        self.model, self.k, self.total, self.net = model, k, total, model.policy.q_net
        self.online = {n: p[k].detach().double() for n, p in self.net.named_parameters()}
        self.target = dict(self.online)
        self.moments = {n: (torch.zeros_like(p),) * 2 for n, p in self.online.items()}
        self.updates = self.steps = 0
        self.running = [self.new_episode(c) for c in range(model.layout.num_copies)]
        self.sequences: list[tuple[Episode, int, int]] = []
        self.priorities: list[float] = []
        self.largest = 1.0

    def new_episode(self, copy: int) -> Episode:
        return Episode(copy, self.k, [torch.zeros(self.net.units, dtype=torch.float64)])

    def follow(self, log: list[Step | NDArray[np.int64]]) -> None:
        for event in log:
            if isinstance(event, Step):
                self.step(event)
            else:
                self.update(event[self.k].tolist())

    def step(self, step: Step) -> None:
        """Act in every copy, store what ended, move the target."""
        for c, episode in enumerate(self.running):
            observation = torch.tensor(step.observations[c, self.k]).double()
            previous = episode.of("actions")[-1:] or [self.net.num_actions]
            _, states, _ = run_network(
                self.net, self.online, observation[None], previous, episode.states[-1]
            )
            episode.steps.append(step)
            episode.states.append(states[-1])
            if step.done[c]:
                self.store(episode)
                self.running[c] = self.new_episode(c)
        before, self.steps = self.steps, self.steps + len(self.running)
        interval, tau = self.model.target_update.frequency, self.model.tau
        if self.steps // interval > before // interval:
            for name, own in self.target.items():
                self.target[name] = (1 - tau) * own + tau * self.online[name]

    def store(self, episode: Episode) -> None:
        """Trained parts lie end to end; those of warm-up steps alone are left out."""
        length, most = len(episode.steps), self.model.settings.sequence_length
        stride = length if most is None else most - self.model.settings.burn_in
        for begin in range(0, length, stride):
            end = min(begin + stride, length)
            if not all(episode.of("warmup")[begin:end]):
                self.sequences.append((episode, begin, end))
                self.priorities.append(self.largest)

    def update(self, indices: list[int]) -> None:
        """One step of Adam on the sequences drawn."""
        progress = self.steps / self.total
        beta = BETA[0] + progress * (BETA[1] - BETA[0])
        shares = np.array(self.priorities) ** ALPHA
        importance = (len(shares) * shares[indices] / shares.sum()) ** -beta
        gradients = self.gradients(indices, importance / importance.max())
        self.updates += 1
        for name, gradient in gradients.items():
            first, second = self.moments[name]
            first = BETA_1 * first + (1 - BETA_1) * gradient
            second = BETA_2 * second + (1 - BETA_2) * gradient**2
            self.moments[name] = first, second
            mean = first / (1 - BETA_1**self.updates)
            size = (second / (1 - BETA_2**self.updates)).sqrt()
            rate = self.model.lr_schedule(1 - progress)
            self.online[name] = self.online[name] - rate * mean / (size + EPSILON)

    def gradients(self, indices: list[int], importance: NDArray[np.float64]) -> Weights:
        """Of the recipe's loss, clipped; sets the priorities of the sequences."""
        model, recipe = self.model, self.model.recipe.name
        weights = {n: p.clone().requires_grad_() for n, p in self.online.items()}
        td, supervision, treatment = torch.zeros(3, dtype=torch.float64)
        steps = labelled = 0
        for index, weight in zip(indices, importance):
            episode, begin, end = self.sequences[index]
            values, features = self.evaluate(weights, episode, begin, end)
            later, _ = self.evaluate(self.target, episode, begin, end)
            actions, returned, rewards, labels, warmup = map(
                episode.of, ("actions", "returned", "rewards", "labels", "warmup")
            )
            errors = []
            for t in (t for t in range(begin, end) if not warmup[t]):
                now, reward = t - begin, returned[t]
                if recipe in ("dqdil", "dqcil"):
                    reward = rewards[t] - model.settings.alpha * episode.of("penalties")[t]
                best = values[now + 1].mean(-1).argmax()
                gamma = 0.0 if episode.of("terminated")[t] else model.gamma
                target, value = reward + gamma * later[now + 1, best], values[now, actions[t]]
                td = td + weight * td_loss(value, target)
                errors.append(abs((target.mean() - value.mean()).item()))
                steps += 1
                if labels[t] >= 0:
                    log_share = values[now].mean(-1).log_softmax(0)[labels[t]]
                    supervision = supervision - weight * log_share
                    labelled += 1
                if recipe == "dqcil":
                    condition = float(episode.of("condition")[t])
                    loss = treatment_loss(weights, features[now], condition, self.net.reversal)
                    treatment = treatment + weight * loss
            self.priorities[index] = 0.9 * max(errors) + 0.1 * float(np.mean(errors)) + FLOOR
        self.largest = max(self.largest, *(self.priorities[i] for i in indices))
        loss = td / steps + model.settings.lambda1 * sum(p.square().sum() for p in weights.values())
        if recipe == "dqaas":
            loss = loss + model.settings.lambda3 * supervision / max(labelled, 1)
        if recipe == "dqcil":
            loss = loss + model.settings.lambda2 * treatment / steps
        gradients = torch.autograd.grad(loss, list(weights.values()))
        norm = torch.cat([g.flatten() for g in gradients]).norm().item()
        scale = min(1.0, model.max_grad_norm / (norm + 1e-6))
        return {name: scale * g for name, g in zip(weights, gradients)}

    def evaluate(
        self, weights: Weights, episode: Episode, begin: int, end: int
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Values and features at the observations from ``begin`` to ``end``, both included."""
        observations = episode.observations()
        previous = [self.net.num_actions, *episode.of("actions")]
        prefix = max(0, begin - self.model.settings.burn_in)
        state = episode.states[prefix if self.model.settings.state_mode == "stored" else 0]
        if prefix < begin:
            burnt = slice(prefix, begin)
            with torch.no_grad():
                _, states, _ = run_network(
                    self.net, weights, observations[burnt], previous[burnt], state
                )
            state = states[-1]
        trained = slice(begin, end + 1)
        values, _, features = run_network(
            self.net, weights, observations[trained], previous[trained], state
        )
        return values, features


def layer(weights: Weights, name: str, inputs: torch.Tensor) -> torch.Tensor:
    return inputs @ weights[f"{name}.weight"] + weights[f"{name}.bias"][0]


def run_network(
    net: StackedQNetwork,
    weights: Weights,
    observations: torch.Tensor,
    previous: list[int],
    state: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Values ``(T, A, Q)``, memories after each of T observations, features ``(T, H)``."""
    units, actions = net.units, net.num_actions
    inputs = observations[:, : net.sensed]
    if net.previous_action:
        one_hot = torch.eye(actions + 1, dtype=torch.float64)[previous][:, :actions]
        inputs = torch.cat([inputs, one_hot], dim=1)
    encoded = torch.relu(layer(weights, "encoder_1", inputs))
    features = torch.relu(layer(weights, "encoder_2", encoded))
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
    hidden = torch.relu(layer(weights, "dueling.hidden", torch.cat([features, flag], dim=1)))
    value = layer(weights, "dueling.value", hidden[:, :units]).unsqueeze(1)
    advantage = layer(weights, "dueling.advantage", hidden[:, units:])
    advantage = advantage.view(len(hidden), actions, -1)
    return value + advantage - advantage.mean(1, keepdim=True), states, features


def td_loss(value: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Squared error of one number, quantile Huber loss of several."""
    if len(value) == 1:
        return (target - value).square().sum()
    tau = (torch.arange(len(value)) + 0.5) / len(value)
    delta = target[None, :] - value[:, None]
    huber = torch.where(delta.abs() <= 1, 0.5 * delta**2, delta.abs() - 0.5)
    return ((tau[:, None] - (delta < 0).double()).abs() * huber).sum(0).mean()


def treatment_loss(
    weights: Weights, features: torch.Tensor, condition: float, reversal: float
) -> torch.Tensor:
    """Through the reversal: the value of ``features``, minus their gradient."""
    inputs = (1 + reversal) * features.detach() - reversal * features
    logit = layer(weights, "treatment.2", torch.relu(layer(weights, "treatment.0", inputs)))
    return functional.binary_cross_entropy_with_logits(logit, torch.full_like(logit, condition))
