"""Reading settings that have more than one form."""

from __future__ import annotations

from typing import Any

from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit
from stable_baselines3.common.vec_env import VecEnv

from animarl_envs.errors import InputError


def as_frequency(value: int | tuple[int, str] | list[Any] | TrainFreq, name: str) -> TrainFreq:
    """``(n, "step")``, ``(n, "episode")``, or ``n`` for steps.

    Raises
    ------
    InputError
        If it is neither.
    """
    if isinstance(value, TrainFreq):
        return value
    number, unit = value if isinstance(value, tuple | list) else (value, "step")
    if unit not in ("step", "episode") or isinstance(number, bool) or int(number) != number:
        raise InputError(
            f'{name} is {value!r}: give (n, "step"), (n, "episode") or a number of steps'
        )
    if number < 1:
        raise InputError(f"{name} is {value!r}: it must be at least 1")
    return TrainFreq(int(number), TrainFrequencyUnit(unit))


def longest_episode(env: VecEnv | None, given: int | None) -> int | None:
    """The time limit [steps]: as ``given``, or as the environment declares it.

    Looked for are the VecEnv attribute ``max_episode_steps`` or ``time_limit`` and the Gymnasium
    spec.
    """
    if given is not None or env is None:
        return given
    for name in ("max_episode_steps", "time_limit"):
        declared = getattr(env, name, None)
        if declared is not None:
            return int(declared)
    specs = [spec for spec in env.get_attr("spec") if spec is not None]
    if specs and all(spec.max_episode_steps for spec in specs):
        return max(int(spec.max_episode_steps) for spec in specs)
    raise InputError(
        "the environment does not say how long an episode can last: give max_episode_steps"
    )
