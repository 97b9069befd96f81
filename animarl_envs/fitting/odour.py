"""The odour as recorded animals got it: how probable hits are, by place, heading and last hits.

A network of 24 units gives P(no hit, left, right, both) in the next step. It knows where the body
is, where it points, which antennae were hit in the step before and how long ago the last hit was.
It is fitted by maximum likelihood to the training episodes and their mirror images.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import HEADING
from animarl_envs.worlds.plume.fitted import INPUTS, FittedOdour, mirrored, softmax, write_inputs

UNITS, UPDATES, BATCH, RATE, DECAY = 24, 1_500, 512, 5e-3, 3e-2
HIT_SHARE = 0.5  # a recorded odour signal of at least this is a hit
Floats = NDArray[np.float64]


def odour_steps(demos: Demonstrations) -> tuple[Floats, NDArray[np.int64]]:
    """Inputs ``(n, INPUTS)`` and hits ``(n,)`` (0 none, 1 left, 2 right, 3 both) of all steps."""
    signals = [np.squeeze(demos.signals[f"odour_{side}"]) for side in ("left", "right")]
    hits = np.stack(signals, axis=-1).astype(np.float64) >= HIT_SHARE
    heading = np.squeeze(demos.signals[HEADING]).astype(np.float64)
    rows, labels = [], []
    for first, end in zip(demos.offsets[:-1], demos.offsets[1:], strict=True):
        last_hit = -np.inf
        for frame in range(first + 1, end):
            if hits[frame - 1].any():
                last_hit = frame - 1
            since = (frame - 1 - last_hit) * demos.dt
            row = np.empty(INPUTS)
            x, y = demos.positions[frame, 0]
            cosine, sine = np.cos(heading[frame]), np.sin(heading[frame])
            write_inputs(x, y, cosine, sine, hits[frame - 1, 0], hits[frame - 1, 1], since, row)
            rows.append(row)
            labels.append(hits[frame, 0] + 2 * hits[frame, 1])
    return np.array(rows), np.array(labels, dtype=np.int64)


def fit_odour(demos: Demonstrations, seed: int = 0) -> FittedOdour:
    """Fit the network to all episodes of ``demos``, which need headings and odour signals."""
    inputs, hits = odour_steps(demos)
    inputs = np.concatenate([inputs, mirrored(inputs)])
    hits = np.concatenate([hits, np.array([0, 2, 1, 3])[hits]])
    draw = np.random.default_rng(seed)
    weights = [
        draw.normal(0.0, INPUTS**-0.5, (INPUTS, UNITS)), np.zeros(UNITS),
        draw.normal(0.0, UNITS**-0.5, (UNITS, 4)), np.zeros(4),
    ]  # fmt: skip
    mean, square = [[np.zeros_like(w) for w in weights] for _ in range(2)]
    for update in range(1, UPDATES + 1):
        rows = draw.integers(len(hits), size=BATCH)
        seen = inputs[rows]
        units = np.tanh(seen @ weights[0] + weights[1])
        error = softmax(units @ weights[2] + weights[3])
        error[np.arange(BATCH), hits[rows]] -= 1.0
        error /= BATCH
        back = (error @ weights[2].T) * (1.0 - units**2)
        slopes = [seen.T @ back, back.sum(0), units.T @ error, error.sum(0)]
        rate = RATE * (1.0 - (update - 1) / UPDATES)
        for i, slope in enumerate(slopes):  # Adam (Kingma & Ba 2015), decoupled weight decay
            mean[i] = 0.9 * mean[i] + 0.1 * slope
            square[i] = 0.999 * square[i] + 0.001 * slope**2
            step = mean[i] / (1 - 0.9**update) / (np.sqrt(square[i] / (1 - 0.999**update)) + 1e-8)
            weights[i] -= rate * (step + DECAY * weights[i])
    first, bias, last, offset = weights
    return FittedOdour(first, bias, last, offset)


def likelihood(odour: FittedOdour, demos: Demonstrations) -> float:
    """Mean negative log likelihood of recorded hits [nats a step]."""
    inputs, hits = odour_steps(demos)
    return float(-np.log(odour.chances(inputs)[np.arange(len(hits)), hits]).mean())
