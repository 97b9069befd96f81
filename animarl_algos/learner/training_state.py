"""What a checkpoint holds of a learner beside its replay, taken out and put back."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.offline import OfflineProgress
from animarl_algos.learner.pace import Pace
from animarl_algos.learner.saving import PACE_NAMES, pace_numbers
from animarl_algos.networks.acting_rule import Acting

COUNTERS = (
    "num_timesteps", "_total_timesteps", "_episode_num", "_n_updates",
    "_current_progress_remaining", "exploration_rate", "root_seed",
)  # fmt: skip


def identity(model: SequenceQLearning) -> dict[str, Any]:
    """What a checkpoint must agree with, JSON-like."""
    return {
        "algorithm": type(model).__name__,
        "policy": model.policy_class.__name__,
        "individuals": list(model.layout.individuals),
        "num_copies": model.layout.num_copies,
        "observation_size": model.observation_size,
        "num_actions": model.policy.num_actions,
        "parameters": model.policy.q_net.num_parameters,
        "buffer_size": model.buffer_size,
    }


def training_state(
    model: SequenceQLearning,
) -> tuple[dict[str, Any], dict[str, NDArray[Any]], dict[str, Any]]:
    """All that is needed to go on exactly, but the replay: JSON-like, arrays, tensors."""
    counters = {name: getattr(model, name) for name in COUNTERS} | pace_numbers(model.pace)
    counters["offline_progress"] = model.offline_progress.as_json()
    counters["policy_random_state"] = model.policy.random_state
    counters["acting"] = model.policy.acting.to_json()
    counters["late_episodes"] = [
        {key: float(value) for key, value in info.items()} for info in model.ep_info_buffer or ()
    ]
    arrays: dict[str, NDArray[Any]] = {}
    if model.env is not None and hasattr(model.env, "get_state") and model._last_obs is not None:
        arrays = {f"env/{key}": value for key, value in model.env.get_state().items()}
        arrays["last_observation"] = np.asarray(model._last_obs)
        arrays["episode_starts"] = np.asarray(model._last_episode_starts)
        arrays["hidden"], arrays["previous_action"] = model.memory
    tensors = {
        "q_net": model.policy.q_net.state_dict(),
        "q_net_target": model.policy.q_net_target.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "best_weights": model.best_weights,
        "average_weights": model.average_weights,
    }
    return counters, arrays, tensors


def restore_training_state(
    model: SequenceQLearning,
    counters: dict[str, Any],
    arrays: dict[str, NDArray[Any]],
    tensors: dict[str, Any],
) -> None:
    """Inverse of :func:`training_state`.

    An environment without ``get_state`` and ``set_state`` starts new episodes instead of
    continuing those that were running.
    """
    for name in COUNTERS:
        setattr(model, name, counters[name])
    model.pace = Pace(**{key: counters[name] for key, name in PACE_NAMES.items()})
    model.offline_progress = OfflineProgress.from_json(counters["offline_progress"])
    model.policy.random_state = counters["policy_random_state"]
    if "acting" in counters:  # older checkpoints act by epsilon, which is among the counters
        model.policy.acting = Acting.from_json(counters["acting"])
    model.ep_info_buffer = deque(counters["late_episodes"], maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)
    model.policy.q_net.load_state_dict(tensors["q_net"])
    model.policy.q_net_target.load_state_dict(tensors["q_net_target"])
    model.policy.optimizer.load_state_dict(tensors["optimizer"])
    model.best_weights = tensors["best_weights"]
    average = tensors.get("average_weights")  # follows the networks, where they are
    model.average_weights = average and {k: v.to(model.device) for k, v in average.items()}
    model._last_obs = None
    if "last_observation" in arrays:
        env_state = {key[4:]: value for key, value in arrays.items() if key[:4] == "env/"}
        model.env.set_state(env_state)  # type: ignore[union-attr]
        model._last_obs = arrays["last_observation"]
        model._last_episode_starts = arrays["episode_starts"]
        model.memory = (arrays["hidden"], arrays["previous_action"])
