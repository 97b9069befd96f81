"""The odour in which a searcher was recorded, as a network of one layer fitted to its hits.

The network gives P(no hit, left, right, both) in the next step. It knows where the body is, where
it points, which antennae were hit in the step before and how long ago the last hit was. It is
fitted by penalised maximum likelihood to the training episodes and their mirror images.

Recordings say nothing of places where no searcher was, and there the network would continue what it
learned nearby: odour upwind of its source. So a share of what it is fitted to are such places
(:func:`sample_empty_places`), without hits.
"""

import math

import numpy as np

from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import require_extra
from animarl_envs.worlds.plume.plume import (
    INPUTS,
    LONGEST,
    FittedOdour,
    mirrored,
    softmax,
    write_inputs,
)

UNITS = 24
PENALTY = 1e-3  # of squared weights
ITERATIONS = 80  # more fit the training episodes better and validation episodes worse
MIRRORED_HITS = np.array([0, 2, 1, 3])  # left becomes right
EMPTY_PLACES, EMPTY_SHARE = 5_000, 1 / 9  # their number, and their weight in the likelihood
CELL, MARGIN = 0.02, 0.3  # squares of the map of visited places, and how far it goes beyond [m]


def shows_odour(demos: Demonstrations) -> bool:
    """Return whether a searcher was recorded with its heading and its odour."""
    signals = {HEADING, "odour_left", "odour_right"}
    return not demos.synthetic and "searcher" in demos.roles and signals <= set(demos.signals)


def odour_steps(demos: Demonstrations) -> tuple[Floats, Ints]:
    """Return inputs ``(n, INPUTS)`` and hits ``(n,)`` of all steps.

    A hit is 0 for none, 1 left, 2 right, 3 both. The recordings need headings and odour signals
    (:func:`shows_odour`).
    """
    hits, heading = demos.odour_hits(), demos.headings()
    assert hits is not None and heading is not None
    rows, labels = [], []
    for first, end in zip(demos.offsets[:-1], demos.offsets[1:], strict=True):
        last_hit = -np.inf
        for frame in range(first + 1, end):
            left, right = hits[frame - 1]
            if left or right:
                last_hit = frame - 1
            x, y = demos.positions[frame, 0]
            angle, since = heading[frame, 0], (frame - 1 - last_hit) * demos.dt
            row = np.empty(INPUTS)
            write_inputs(x, y, np.cos(angle), np.sin(angle), left, right, since, row)
            rows.append(row)
            labels.append(hits[frame, 0] + 2 * hits[frame, 1])
    return np.array(rows), np.array(labels, dtype=np.int64)


def sample_empty_places(demos: Demonstrations, rng: np.random.Generator) -> Floats:
    """Return inputs ``(n, INPUTS)`` at places around the recorded ones without a searcher nearby.

    The field is cut into squares of side ``CELL``; empty are those that nobody has been in or next
    to, nor in their mirror images. Heading, hits before and time since a hit are random.
    """
    half = math.ceil((np.abs(demos.positions).max() + MARGIN) / CELL)
    empty = np.ones((2 * half + 2, 2 * half + 2), dtype=bool)
    column, row = (np.floor(demos.positions[:, 0] / CELL).astype(int) + half + 1).T
    for beside in np.ndindex(3, 3):
        empty[column + beside[0] - 1, row + beside[1] - 1] = False
    empty &= empty[:, ::-1]
    chosen = rng.choice(np.argwhere(empty), EMPTY_PLACES)
    places = (chosen - half - 1 + rng.uniform(size=chosen.shape)) * CELL
    rows = np.empty((EMPTY_PLACES, INPUTS))
    for (x, y), out in zip(places, rows, strict=True):
        angle, since = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, LONGEST)
        left, right = rng.random(2) < 0.5
        write_inputs(x, y, np.cos(angle), np.sin(angle), left, right, since, out)
    return rows


def fit_odour(demos: Demonstrations, seed: int = 0) -> FittedOdour:
    """Return the network fitted to all episodes of ``demos``, which need odour signals.

    ``seed`` draws the initial weights and the empty places.
    """
    with require_extra("fitting odour", "data"):
        from scipy.optimize import minimize
    rng = np.random.default_rng(seed)
    inputs, hits = odour_steps(demos)
    recorded, empty = 2 * len(hits), sample_empty_places(demos, rng)
    inputs = np.concatenate([inputs, mirrored(inputs), empty])
    target = np.zeros((len(inputs), 4))
    target[np.arange(recorded), np.concatenate([hits, MIRRORED_HITS[hits]])] = 1.0
    target[recorded:, 0] = 1.0
    importance = np.full((len(inputs), 1), EMPTY_SHARE / len(empty))
    importance[:recorded] = (1 - EMPTY_SHARE) / recorded
    weights = [
        rng.normal(0.0, INPUTS**-0.5, (INPUTS, UNITS)),
        np.zeros(UNITS),
        rng.normal(0.0, UNITS**-0.5, (UNITS, 4)),
        np.zeros(4),
    ]
    ends = np.cumsum([each.size for each in weights])[:-1]

    def unpack(point: Floats) -> list[Floats]:
        parts = np.split(point, ends)
        return [part.reshape(each.shape) for part, each in zip(parts, weights, strict=True)]

    def loss_and_gradient(point: Floats) -> tuple[float, Floats]:
        first, bias, last, offset = unpack(point)
        units = np.tanh(inputs @ first + bias)
        chances = softmax(units @ last + offset)
        error = (chances - target) * importance
        back = (error @ last.T) * (1.0 - units**2)
        slopes = [inputs.T @ back, back.sum(axis=0), units.T @ error, error.sum(axis=0)]
        log_likelihood = np.sum(importance * target * np.log(np.maximum(chances, 1e-300)))
        penalty = 0.5 * PENALTY * (point @ point)
        gradient = np.concatenate([slope.ravel() for slope in slopes]) + PENALTY * point
        return float(penalty - log_likelihood), gradient

    start = np.concatenate([each.ravel() for each in weights])
    fitted = minimize(
        loss_and_gradient, start, jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS}
    )
    first, bias, last, offset = unpack(fitted.x)
    return FittedOdour(first, bias, last, offset)
