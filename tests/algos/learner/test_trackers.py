"""Experiment trackers work unchanged: scalars have stable-baselines3's names.

The trackers themselves are not installed. What is tested is the part of their interface that they
use: Weights & Biases and Trackio read the attributes of the model and save it, MLflow is a writer
of key and value.
"""

from pathlib import Path
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger

from animarl_algos import DQN


class MlflowWriter(KVWriter):
    """As in stable-baselines3's guide to MLflow: one call per scalar that is not excluded."""

    def __init__(self) -> None:
        self.scalars: dict[str, list[tuple[int, float]]] = {}

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        for key, value in key_values.items():
            if isinstance(value, float | int) and "mlflow" not in (key_excluded[key] or ()):
                self.scalars.setdefault(key, []).append((step, value))

    def close(self) -> None:
        """Nothing is open."""


class WandbCallback(BaseCallback):
    """What the callbacks of Weights & Biases and Trackio do with a model."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder, self.config, self.steps = folder, dict[str, Any](), 0

    def _init_callback(self) -> None:
        plain = (float, int, str)
        self.config["algo"] = type(self.model).__name__
        for key, value in vars(self.model).items():
            self.config[key] = value if type(value) in plain else str(value)
        assert list(self.model.policy.named_parameters())  # wandb.watch(model.policy)

    def _on_step(self) -> bool:
        self.steps += 1
        return True

    def _on_training_end(self) -> None:
        self.model.save(self.folder / "model")


def test_trackers_get_scalars_and_the_model(tmp_path: Path) -> None:
    model = DQN("MlpPolicy", "CartPole-v1", learning_starts=20, policy_kwargs={"net_arch": [8]})
    writer, callback = MlflowWriter(), WandbCallback(tmp_path)
    model.set_logger(Logger(None, [writer]))
    model.learn(400, callback=callback, log_interval=1)
    assert writer.scalars.keys() >= {
        "rollout/ep_rew_mean", "rollout/ep_len_mean", "rollout/exploration_rate", "time/fps",
        "time/episodes", "time/total_timesteps", "time/time_elapsed", "train/learning_rate",
        "train/n_updates", "train/loss",
    }  # fmt: skip
    steps = [step for step, _ in writer.scalars["rollout/ep_rew_mean"]]
    assert steps == sorted(steps) and steps[-1] <= 400
    assert callback.steps == 400 and callback.config["algo"] == "DQN"
    assert callback.config["gamma"] == model.gamma
    assert (tmp_path / "model.zip").exists()
