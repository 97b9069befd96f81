"""Exploration: its kinds, epsilon's schedule, and a temperature fitted to demonstrated actions.

The draws themselves are the policy's (one per slot); here is how much of them, and when.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from animarl_envs.errors import InputError

LOG_TEMPERATURE_SD = 0.5
"""How far the logarithm of a temperature lies from 0 before any action was looked at."""


class Exploration(StrEnum):
    """How online collection acts."""

    EPSILON = "epsilon"  # greedy but for a share of random actions (the paper)
    BOLTZMANN = "boltzmann"  # sampled at temperatures fitted after the offline phase


@dataclass(frozen=True)
class LinearDecay:
    """Epsilon from ``initial`` to ``final`` within ``steps`` world steps, constant thereafter."""

    initial: float
    final: float
    steps: int

    def __call__(self, num_timesteps: int) -> float:
        passed = min(num_timesteps / self.steps, 1.0) if self.steps else 1.0
        return self.initial + passed * (self.final - self.initial)


def boltzmann_nll(
    values: NDArray[np.floating], actions: NDArray[np.integer], temperature: float
) -> float:
    """Return the mean negative log-likelihood [nat] under ``softmax(values / temperature)``.

    Parameters
    ----------
    values
        ``(N, A)``, action values or logits.
    actions
        ``(N,)``, demonstrated actions.
    """
    scaled = values / temperature
    scaled = scaled - scaled.max(axis=1, keepdims=True)
    log_norm = np.log(np.exp(scaled).sum(axis=1))
    return float(np.mean(log_norm - scaled[np.arange(len(actions)), actions]))


def fit_boltzmann_temperature(values: NDArray[np.floating], actions: NDArray[np.integer]) -> float:
    """Return the likeliest temperature, searched over ten decades around the values' own spread.

    A priori its logarithm is normal around 0, the temperature of a clone's logits, with standard
    deviation ``LOG_TEMPERATURE_SD``. Some hundred actions outweigh that; but of a few that are all
    the same, as of animals at rest, the likelihood alone would have them never move again.

    The likelihood is unimodal in the inverse temperature (the log-likelihood of a one-parameter
    exponential family is concave), so a bounded scalar search finds it.

    Raises
    ------
    InputError
        If there is no demonstrated action to fit to, or the values are all equal.
    """
    if len(actions) == 0:
        raise InputError("no demonstrated action to fit a temperature to: give a larger dataset")
    values = values.astype(np.float64)
    spread = float(np.mean(values.std(axis=1)))
    if not spread > 0:
        raise InputError(
            "the action values are all equal or not finite: train before fitting a temperature"
        )
    result = minimize_scalar(
        lambda log_t: (
            len(actions) * boltzmann_nll(values, actions, spread * np.exp(log_t))
            + ((log_t + np.log(spread)) / LOG_TEMPERATURE_SD) ** 2 / 2
        ),
        bounds=(np.log(1e-5), np.log(1e5)),
        method="bounded",
        options={"xatol": 1e-4},
    )
    return float(spread * np.exp(result.x))
