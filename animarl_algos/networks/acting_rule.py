"""How a policy chooses among its action values: greedily, by sampling, or with random actions.

The rule is data: it is saved with a model, printed, and put on the command line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_envs.array_types import Floats, Ints
from animarl_envs.errors import InputError
from animarl_envs.locomotion import NUM_DIRECTIONS
from animarl_envs.settings import Positive, Probability, check_fields, check_value


class Kind(StrEnum):
    """The rules."""

    GREEDY = "greedy"  # the action of the highest value
    BOLTZMANN = "boltzmann"  # sampled from softmax(Q / temperature)
    EPSILON = "epsilon"  # greedy, but uniformly random with probability epsilon (the paper)


@dataclass(frozen=True)
class Acting:
    """An acting rule for K individuals.

    Parameters
    ----------
    kind
        ``"greedy"``, ``"boltzmann"`` or ``"epsilon"``.
    temperature
        Of Boltzmann sampling, one number or one per individual; the scale of the action values.
    thrust, direction
        Of Boltzmann sampling of thrusts (see :mod:`animarl_envs.locomotion`): shares of the
        temperature at which first the magnitude of the thrust is drawn and then its direction; see
        :func:`two_stage_logits`. One temperature cannot do both: lowered until the directions are
        nearly certain, it also favours the magnitude without a direction, no thrust.
    epsilon
        Share of uniformly random actions.

    Raises
    ------
    InputError
        If the kind is unknown or a number is out of its range.
    """

    kind: Kind = Kind.GREEDY
    temperature: tuple[float, ...] = (1.0,)
    epsilon: Probability = 0.0
    thrust: Positive = 1.0
    direction: Positive = 1.0

    def __post_init__(self) -> None:
        if self.kind not in list(Kind):
            raise InputError(f"acting is {self.kind!r}: choose {', '.join(Kind)}")
        object.__setattr__(self, "kind", Kind(self.kind))
        check_fields(self)
        each = np.atleast_1d(np.asarray(self.temperature, dtype=object)).ravel()
        if not len(each):
            raise InputError("temperature holds no number: give one, or one per individual")
        checked = tuple(check_value("temperature", value, Positive) for value in each)
        object.__setattr__(self, "temperature", checked)

    @classmethod
    def boltzmann(
        cls, temperature: ArrayLike, *, thrust: float = 1.0, direction: float = 1.0
    ) -> Acting:
        """Return the rule that samples at a temperature, or at one per individual."""
        return cls(Kind.BOLTZMANN, temperature, thrust=thrust, direction=direction)  # type: ignore[arg-type]

    @classmethod
    def epsilon_greedy(cls, epsilon: float) -> Acting:
        """Greedy but for a share ``epsilon`` of uniformly random actions."""
        return cls(Kind.EPSILON, epsilon=epsilon)

    @classmethod
    def parse(cls, text: str) -> Acting:
        """``greedy``, ``boltzmann:0.7``, ``boltzmann:0.7,0.4,1.1`` or ``epsilon:0.1``.

        ``boltzmann:0.7/0.5/0.3`` gives ``thrust`` and ``direction`` too.

        Raises
        ------
        InputError
            If it is none of these.
        """
        name, _, given = text.partition(":")
        given, *more = given.split("/")
        try:
            numbers = [float(part) for part in given.split(",") if given]
            shares = [float(part) for part in more]
        except ValueError:
            numbers, shares = [], []
        match name, len(numbers), len(shares):
            case Kind.GREEDY, 0, 0 if text == name:
                return cls()
            case Kind.BOLTZMANN, count, 0 if count:
                return cls.boltzmann(numbers)
            case Kind.BOLTZMANN, count, 2 if count:
                return cls.boltzmann(numbers, thrust=shares[0], direction=shares[1])
            case Kind.EPSILON, 1, 0:
                return cls.epsilon_greedy(numbers[0])
        raise InputError(
            f"acting is {text!r}: write greedy, boltzmann:TEMPERATURE (or one per individual, with "
            "commas; /THRUST/DIRECTION after it) or epsilon:SHARE"
        )

    def __str__(self) -> str:
        """Return the text that :meth:`parse` reads."""
        if self.kind is Kind.BOLTZMANN:
            shares = f"/{self.thrust:g}/{self.direction:g}" if self.two_stage else ""
            return f"{self.kind}:" + ",".join(f"{t:g}" for t in self.temperature) + shares
        return f"{self.kind}:{self.epsilon:g}" if self.kind is Kind.EPSILON else str(self.kind)

    def to_json(self) -> dict[str, Any]:
        """Return the rule as plain data."""
        return asdict(self) | {"kind": str(self.kind), "temperature": list(self.temperature)}

    @classmethod
    def from_json(cls, row: Mapping[str, Any]) -> Acting:
        """Return the rule that :meth:`to_json` wrote."""
        if set(row) != {each.name for each in fields(cls)}:
            raise InputError(
                "an acting rule has kind, temperature, epsilon, thrust and direction, not "
                f"{sorted(row)}: write it anew with to_json"
            )
        return cls(**row)

    @property
    def two_stage(self) -> bool:
        """Whether magnitude and direction are drawn each at its own temperature."""
        return (self.thrust, self.direction) != (1.0, 1.0)

    def checked(self, individuals: int, actions: int) -> Acting:
        """Return the rule itself if so many individuals with so many actions can act by it."""
        if len(self.temperature) not in (1, individuals):
            raise InputError(
                f"temperature has {len(self.temperature)} numbers for {individuals} individuals: "
                "give one, or one for each"
            )
        if self.two_stage and (actions < 2 or (actions - 1) % NUM_DIRECTIONS):
            raise InputError(
                f"acting {self} needs thrusts in {NUM_DIRECTIONS} directions and none, not "
                f"{actions} actions: leave thrust and direction out"
            )
        return self

    def choose(self, q_values: NDArray[np.floating], draw: Floats, individuals: int) -> Ints:
        """Choose an action (S,) for every slot; of equal values the lowest is the greedy one.

        Slot s of ``q_values`` (S, actions) is individual ``s % individuals``; ``draw`` (S,) are
        uniform numbers in [0, 1), one for each slot.
        """
        if self.kind is Kind.BOLTZMANN:
            temperature = np.broadcast_to(np.asarray(self.temperature), individuals)
            slots = np.tile(temperature, len(q_values) // individuals)
            scaled = q_values / slots[:, None]
            if self.two_stage:
                scaled = two_stage_logits(scaled, self.thrust, self.direction)
            return boltzmann(scaled, draw)
        greedy: Ints = q_values.argmax(1)
        if self.kind is Kind.GREEDY or self.epsilon <= 0:
            return greedy
        # A draw below epsilon is uniform there, so that it also says which random action.
        actions = q_values.shape[1]
        random = np.minimum(draw / self.epsilon * actions, actions - 1)
        return np.where(draw < self.epsilon, random.astype(np.int64), greedy)


def two_stage_logits(scaled: NDArray[Any], thrust: float, direction: float) -> Floats:
    """Return log-probabilities of actions if a thrust's magnitude is drawn before its direction.

    There are M + 1 magnitudes: each of M with the probability of all its directions together, and
    no thrust. With p from softmax(scaled), an action has

        p(magnitude)^(1 / thrust) / Z * p(direction | magnitude)^(1 / direction) / Z'

    ``scaled`` are (S, 12 M + 1) logits; both temperatures 1 give softmax(scaled).
    """
    whole = scaled.astype(np.float64)
    way = whole[:, :-1].reshape(len(whole), -1, NUM_DIRECTIONS)
    hard = np.concatenate([_log_sum_exp(way)[..., 0], whole[:, -1:]], axis=1) / thrust
    hard -= _log_sum_exp(hard)
    way = way / direction
    way -= _log_sum_exp(way)
    pushed = (hard[:, :-1, None] + way).reshape(len(whole), -1)
    return np.concatenate([pushed, hard[:, -1:]], axis=1)


def _log_sum_exp(values: Floats) -> Floats:
    """Over the last axis, which stays with length 1."""
    most = values.max(-1, keepdims=True)
    summed: Floats = most + np.log(np.exp(values - most).sum(-1, keepdims=True))
    return summed


def boltzmann(scaled: NDArray[Any], draw: Floats) -> Ints:
    """Sample from softmax(scaled) (S, actions) with one uniform draw (S,) in [0, 1) per row."""
    weight = np.exp(scaled - scaled.max(1, keepdims=True)).astype(np.float64)
    cumulative = weight.cumsum(1)
    chosen: Ints = (cumulative <= draw[:, None] * cumulative[:, -1:]).sum(1)
    return chosen
