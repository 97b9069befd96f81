"""Demonstrations as a learner sees them: observations, labels, rewards, scored actions."""

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Annotated

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.replay.sequence_buffer import GIB, available_memory
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT, UNFINISHED
from animarl_envs.errors import InputError
from animarl_envs.fitting.tracking import Tracking, one_step_misses, track
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.focus import lone_pursuer
from animarl_envs.settings import Positive, check_value
from animarl_envs.species import Species
from animarl_envs.worlds import (
    Mirror,
    demonstration_observations,
    mirror,
    observation_components,
)

Horizon = Annotated[float, Ge(1)]  # [steps]
PER_ACTION, PER_COMPONENT = 44, 12
"""Bytes of a frame and individual while labels and observations are made."""
LABEL_OPTIONS = ("labels", "label_width", "label_horizon")
"""Options of an environment that say how its demonstrations are labelled."""


class Labels(StrEnum):
    """The choices."""

    HARD = "hard"  # the action nearest to the recorded acceleration, at recorded states
    SOFT = "soft"  # a probability for each action, by how near it would have led
    TRACKING = "tracking"  # actions that follow the recording, at the states they lead to


def check_labels(labels: str, width: float, horizon: float = 1.0) -> None:
    """Refuse unknown settings of labels."""
    if labels not in list(Labels):
        raise InputError(f"labels is {labels!r}: choose {', '.join(Labels)}")
    check_value("label_width", width, Positive)
    check_value("label_horizon", horizon, Horizon)


def soft_labels(
    penalties: NDArray[np.floating], step: float | NDArray[np.floating], width: float
) -> NDArray[np.float32]:
    """Probability of each action, the higher the nearer it would have led.

    ``p(a)`` is proportional to ``exp(-(e_a / (u dt^2))^2 / (2 c^2))``: a normal error of the
    recorded acceleration, with a standard deviation of c times the thrust.

    ``penalties`` (..., actions) are e_a, the distances between where action a would have led by the
    fitted dynamics and where the animal went; ``step`` is ``u dt^2``, how far one thrust moves the
    animal in a step (both in arena units, it broadcasts against them), ``width`` is c. Returns
    (..., actions), each row a distribution.
    """
    exponent = -((penalties.astype(np.float64) / step) ** 2) / (2.0 * width**2)
    share = np.exp(exponent - exponent.max(axis=-1, keepdims=True))
    return np.asarray(share / share.sum(axis=-1, keepdims=True), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class SpeciesDemonstrations:
    """The two splits that training may see, in the terms of a species.

    Its locomotion parameters infer the actions and score them all. Of animals that take left for
    right half of the windows are mirrored.
    """

    species: Species
    demos: Demonstrations  # with their splits
    learners: tuple[str, ...]  # names of the individuals to learn
    condition_flag: bool = False  # the condition is the last observation component
    labels: str = Labels.HARD
    label_width: float = 0.35  # of soft labels, in units of the thrust; see :func:`soft_labels`
    label_horizon: float = 1.0  # of tracking labels [steps]; see ``fitting.tracking.track``

    @cached_property
    def train(self) -> OfflineDataset:
        """Dataset of the training split."""
        return self._dataset("train")

    @cached_property
    def val(self) -> OfflineDataset:
        """Dataset of the validation split."""
        return self._dataset("val")

    @cached_property
    def tracked(self) -> Tracking:
        """The demonstrations as the world's own dynamics follows them."""
        species = self.species
        return track(self.demos, species.locomotion, species.arena, horizon=self.label_horizon)

    def check_memory(self) -> None:
        """Refuse demonstrations whose labels do not fit the memory; it is not taken yet.

        Raises InputError with how much they take.
        """
        demos, species = self.demos, self.species
        components, free = len(observation_components(species)), available_memory()
        for split in ("train", "val"):
            rows = int(demos.lengths[demos.split == split].sum()) * demos.num_individuals
            needed = rows * (PER_ACTION * species.num_actions + PER_COMPONENT * components)
            if needed > free:
                raise InputError(
                    f"{demos.name} ({split}): {demos.num_individuals} animals with "
                    f"{species.num_actions} actions take about {needed / GIB:.3g} GiB of memory, "
                    f"and {free / GIB:.3g} GiB are available: use fewer animals or episodes, a "
                    "lower --decision-rate, or fewer --thrusts"
                )

    def _dataset(self, split: str) -> OfflineDataset:
        self.check_memory()
        demos, species = self.demos, self.species
        within = np.repeat(demos.split == split, demos.lengths)
        if self.labels == Labels.TRACKING:
            demos = replace(demos, positions=self.tracked.positions).select(split=split)
            actions = self.tracked.actions[within]
        else:
            demos = demos.select(split=split)
            actions = demonstrated_actions(demos, species.locomotion)
        chosen = [demos.individuals.index(name) for name in self.learners]
        observations = demonstration_observations(species, demos)
        image = mirror(species) if species.mirror_symmetric else None
        if self.condition_flag:
            flag = np.repeat(demos.condition, demos.lengths).astype(np.float32)
            column = np.broadcast_to(flag[:, None, None], (*observations.shape[:2], 1))
            observations = np.concatenate([observations, column], axis=2)
            if image is not None:
                order = np.append(image.order, len(image.order))
                image = Mirror(order, np.append(image.sign, np.float32(1.0)), image.actions)
        penalties = one_step_misses(demos, species.locomotion)
        shares = None
        if self.labels == Labels.SOFT:
            thrust = np.array([own.thrust for own in species.locomotion])
            step = thrust[None, :, None] * demos.dt**2
            shares = soft_labels(penalties, step, self.label_width)[:, chosen]
        return OfflineDataset(
            observations[:, chosen],
            actions[:, chosen],
            demos.lengths,
            species.num_actions,
            rewards=demonstration_rewards(species, demos)[:, chosen],
            action_penalties=penalties[:, chosen],
            label_shares=shares,
            mirror=image,
            terminated=(demos.outcome != TIME_OUT) & (demos.outcome != UNFINISHED),
            condition=demos.condition,
            warmup=demos.steps() < species.warmup,
            names=self.learners,
            source=f"{demos.name} ({split})",
        )


def demonstration_rewards(species: Species, demos: Demonstrations) -> NDArray[np.float32]:
    """Task rewards of the recorded steps ``(frames, K)``; the step leaves its frame, last ones 0.

    As in the world, but the end is the recorded outcome: recordings are cut at a finer rate than
    they are stepped.
    """
    outcome, met = demos.outcome, demos.outcome > TIME_OUT
    ends = demos.positions[demos.offsets[1:] - 1]
    near = np.linalg.norm(ends - ends[:, -1:], axis=2) < species.contact_radius
    out = ~replace(species.arena, rebound=False).contains(ends)
    touching = np.zeros_like(near)  # who is said to have touched, or been touched
    touching[met, outcome[met] - 1] = True
    rewards = np.zeros(demos.positions.shape[:2], dtype=np.float32)
    final = demos.offsets[1:] - 2  # the frame that the last step leaves
    pursuing = np.array([role != "target" for role in demos.roles])
    if lone_pursuer(demos.roles):  # the last individual pursues all others, each until touched
        rewards[:, :-1] = demos.dt
        paid = rewards[final]
        out &= np.isin(outcome, (TARGET_OUT, PURSUER_OUT))[:, None]
        paid[(near & met[:, None]) | touching | out] = 0.0
        paid[met, -1] = 1.0
    else:
        escaped = outcome == TARGET_OUT
        out &= (outcome == PURSUER_OUT)[:, None] & pursuing
        if not pursuing.all():  # the target is paid for as long as it lasts
            rewards[:, -1] = demos.dt
            out[:, -1] |= escaped
        paid = rewards[final]
        paid[met | escaped, -1] = 0.0
        shared = (demos.condition == 1) & getattr(species, "shared_reward", False)
        rewarded = (near | shared[:, None]) & pursuing & met[:, None]
        rewarded[:, -1] = False
        paid[rewarded | touching] = 1.0
    paid[out] += species.boundary_penalty
    rewards[final] = paid
    if not getattr(species, "free", False):
        rewards[:, pursuing] -= species.step_cost
    elif getattr(species, "shoaling_reward", False):
        for i in range(demos.num_individuals):  # one by one, as distances of all would be large
            apart = np.linalg.norm(demos.positions - demos.positions[:, i : i + 1], axis=2)
            company = (apart < species.contact_radius).sum(axis=1) > 1  # itself is one
            rewards[:-1, i] += demos.dt * company[1:]
    rewards[demos.offsets[1:] - 1] = 0.0
    return rewards
