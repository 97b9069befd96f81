"""Reading settings that have more than one form."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.ranges import COUNT, POSITIVE
from animarl_envs.errors import InputError


def as_frequency(value: Any, name: str) -> TrainFreq:
    """``(n, "step")``, ``(n, "episode")``, or ``n`` for steps.

    Raises
    ------
    InputError
        If it is neither.
    """
    if isinstance(value, TrainFreq):
        return value
    number, unit = value, "step"
    if isinstance(value, tuple | list) and len(value) == 2:
        number, unit = value
    if unit not in ("step", "episode") or not isinstance(number, int | float | np.number):
        raise InputError(
            f'{name} is {value!r}: give (n, "step"), (n, "episode") or a number of steps'
        )
    COUNT.check(name, number)
    return TrainFreq(int(number), TrainFrequencyUnit(unit))


def longest_episode(env: VecEnv | None, given: int | None) -> int | None:
    """The time limit [steps]: as ``given``, or as the environment declares it.

    Looked for are ``max_episode_steps`` or ``time_limit`` of the VecEnv or its environments, and
    the Gymnasium spec.

    Raises
    ------
    InputError
        If it declares none.
    """
    if given is not None or env is None:
        return given
    limit = declared_limit(env)
    if limit is None:
        raise InputError(
            "the environment does not say how long an episode can last: give max_episode_steps"
        )
    return limit


def declared_limit(env: VecEnv) -> int | None:
    """The time limit [steps] that an environment tells of itself, if any."""
    for name in ("max_episode_steps", "time_limit"):
        declared = getattr(env, name, None)
        if declared is None and env.has_attr(name):
            each = env.get_attr(name)
            declared = None if None in each else max(each)
        if declared is not None:
            return int(declared)
    specs = [spec for spec in env.get_attr("spec") if spec is not None]
    if specs and all(spec.max_episode_steps for spec in specs):
        return max(int(spec.max_episode_steps) for spec in specs)
    return None


def checked_value(key: str, value: Any, like: Any, place: str) -> Any:
    """A setting as plain data, of the kind of ``like``, the default of its parameter.

    Numbers may be written ``1e-4``, which YAML itself takes for text. A learning rate may be
    ``lin_1e-4``: linear to zero over the run, as in rl_zoo3.

    Raises
    ------
    InputError
        If the kind is another; the sentence starts with ``place``.
    """
    if isinstance(value, str):
        if key == "learning_rate" and value.startswith(LINEAR):
            linear_start(value, place)
            return value
        try:
            value = value if isinstance(like, str) else float(value)
        except ValueError:
            raise InputError(f"{place} is {value!r}: give a number, not text") from None
    if isinstance(like, bool):
        if not isinstance(value, bool):
            raise InputError(f"{place} is {value!r}: give true or false")
        return value
    if isinstance(like, int | float):
        if isinstance(value, bool) or not isinstance(value, int | float | None):
            raise InputError(f"{place} is {value!r}: give a number")
        if isinstance(like, int) and isinstance(value, float):
            if not value.is_integer():
                raise InputError(f"{place} is {value!r}: give a whole number")
            return int(value)
        if value is not None:
            return int(value) if isinstance(like, int) else float(value)
    if isinstance(like, str) and not isinstance(value, str):
        raise InputError(f"{place} is {value!r}: give a name")
    if key.endswith("kwargs") and not isinstance(value, dict | None):
        raise InputError(f"{place} is {value!r}: give a table")
    return value


LINEAR = "lin_"


def linear_start(value: str, place: str) -> float:
    """The first value of ``lin_<number>``."""
    try:
        start = float(value.removeprefix(LINEAR))
    except ValueError:
        raise InputError(f"{place} is {value!r}: write lin_ and a number") from None
    POSITIVE.check(f"{place}, the number after lin_,", start)
    return start


def constructed(arguments: dict[str, Any]) -> dict[str, Any]:
    """Plain settings as the algorithms take them: lists as tuples, ``lin_`` rates as schedules."""
    ready = {k: tuple(v) if isinstance(v, list) else v for k, v in arguments.items()}
    rate = ready.get("learning_rate")
    if isinstance(rate, str):
        ready["learning_rate"] = LinearSchedule(linear_start(rate, "learning_rate"), 0.0, 1.0)
    return ready
