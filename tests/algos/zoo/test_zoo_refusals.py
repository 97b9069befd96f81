"""What the zoo refuses: one sentence, nothing evaluated, no folder left behind."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import yaml
from commands import Done
from gymnasium.envs.classic_control import CartPoleEnv
from zoo_commands import AGENT
from zoo_commands import zoo as zoo

from animarl_algos.recipes.registry import RECIPES
from animarl_algos.zoo.manager import slot_environment

DQN = ["train", "--algo", "dqn", "--env", AGENT]
WITHOUT_WANDB = pytest.mark.skipif(find_spec("wandb") is not None, reason="wandb is installed")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["dance"], "'dance' is unknown: choose train, optimize"),
        (["train", "--algo", "ppo", "--env", AGENT], "invalid choice: 'ppo'"),
        (["train", "--algo", "dqn", "--env", "AnimaRL/Dodo-v0"], "'AnimaRL/Dodo-v0' is not"),
        (["train", "--algo", "dqn", "--env", AGENT, "--preset", "fast"], "invalid choice: 'fast'"),
        (["train", "--algo", "dqn", "--env", AGENT, "-params", "gama:1"], "'gama' is unknown"),
        (["train", "--algo", "dqn", "--env", AGENT, "-params", "gamma"], "write KEY:VALUE"),
        (["train", "--algo", "dqn", "--env", AGENT, "-params", "gamma:["], "not valid YAML"),
        (["train", "--algo", "dqn", "--env", AGENT, "--env-kwargs", "wind:1"], "'wind' is unknown"),
        ([*DQN, "-params", "policy_kwargs:{hiden: 4}"], "policy_kwargs: 'hiden' is unknown"),
        ([*DQN, "-params", "learning_rate:-1"], "learning_rate is -1"),
        ([*DQN, "--env-kwargs", "copies:2"], "give -params n_envs"),
        ([*DQN, "--device", "abacus"], "'abacus' is unknown"),
        pytest.param([*DQN, "--track"], "--track needs Weights & Biases", marks=WITHOUT_WANDB),
        ([*DQN, "-i", "no.zip"], "no.zip: there is no such zip file"),
        ([*DQN, "-f", "/dev/null/logs"], "/dev/null/logs: a file cannot be"),
        (["optimize", *DQN[1:], "--n-trials", "0"], "--n-trials is 0"),
        (["optimize", *DQN[1:], "--n-evaluations", "0"], "--n-evaluations is 0"),
        ([*DQN, "--eval-episodes", "0"], "--eval-episodes is 0"),
        ([*DQN, "--n-eval-envs", "0"], "--n-eval-envs is 0"),
        ([*DQN, "-n", "0"], "--n-timesteps is 0"),
        ([*DQN, "--trial-id", "3"], "--trial-id is not supported"),
        ([*DQN, "-params", "n_timesteps:0"], "n_timesteps is 0"),
        ([*DQN, "-params", "n_envs:0"], "n_envs is 0"),
        (["train", "--algo", "dqn", "--env", "CartPole-v1", "--preset", "paper"], "'paper' has no"),
        (["train", "--algo", "dqn", "--env", "Pendulum-v1"], "does not suit"),
        (["train", "--algo", "dqdil", "--env", "CartPole-v1"], "'dtw_penalty'"),
        (["train", "--algo", "dqcil", "--env", "AnimaRL/Fly-v0"], "condition flag"),
    ],
)
def test_bad_input_is_one_sentence(
    arguments: list[str], word: str, zoo: Callable[..., Done]
) -> None:
    done = zoo(*arguments)
    assert done.returncode == 2
    assert word in done.stderr and "Traceback" not in done.stderr
    assert "invalid choice" in word or len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    "arguments",
    [
        (*DQN, "-params", "tau:3"),
        ("train", "--algo", "dqn", "--env", "Pendulum-v1"),
        ("train", "--algo", "dqcil", "--env", "AnimaRL/Fly-v0"),
        ("train", "--algo", "bc", "--env", "CartPole-v1"),
        ("optimize", "--algo", "dqn", "--env", "AnimaRL/Dodo-v0"),
    ],
)
def test_a_refused_run_leaves_no_folder_behind(
    arguments: tuple[str, ...], zoo: Callable[..., Done], tmp_path: Path
) -> None:
    assert zoo(*arguments).returncode == 2
    assert not (tmp_path / "logs").exists()


def test_a_refused_run_leaves_older_folders_alone(zoo: Callable[..., Done], tmp_path: Path) -> None:
    (tmp_path / "logs" / "dqn").mkdir(parents=True)
    assert zoo(*DQN, "-params", "tau:3").returncode == 2
    assert not list((tmp_path / "logs" / "dqn").iterdir())


def test_nothing_on_the_command_line_or_in_a_file_is_evaluated(
    zoo: Callable[..., Done], tmp_path: Path
) -> None:
    """rl_zoo3 evaluates KEY:VALUE, policy_kwargs and normalize, runs .py files, imports names."""
    evil = f"__import__('pathlib').Path('{tmp_path}/ran').touch()"
    for key in ("policy_kwargs", "replay_buffer_kwargs", "normalize", "env_wrapper", "policy"):
        done = zoo("train", "--algo", "dqn", "--env", AGENT, "-params", f'{key}:"{evil}"')
        assert done.returncode == 2, done.stdout
        file = tmp_path / "mine.yml"
        file.write_text(yaml.safe_dump({"base": "dqn", AGENT: {"default": {key: evil}}}))
        done = zoo("train", "--algo", "dqn", "--env", AGENT, "-conf", str(file))
        assert done.returncode == 2, done.stdout
    script = tmp_path / "mine.py"
    script.write_text(f"{evil}\nhyperparams = {{}}\n")
    assert zoo("train", "--algo", "dqn", "--env", AGENT, "-conf", str(script)).returncode == 2
    assert not (tmp_path / "ran").exists()


def test_a_damaged_or_foreign_zip_is_refused(
    zoo: Callable[..., Done], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    class ThreeActions(CartPoleEnv):
        def __init__(self, **kwargs: Any) -> None:
            super().__init__(**kwargs)
            self.action_space = gym.spaces.Discrete(3)

    three = gym.envs.registration.EnvSpec("Three-v0", entry_point=ThreeActions, max_episode_steps=9)
    monkeypatch.setitem(gym.registry, "Three-v0", three)
    RECIPES["dqn"].algorithm("MlpPolicy", "CartPole-v1").save("pole.zip")
    whole = (tmp_path / "pole.zip").read_bytes()
    for content in (b"", b"text", b"PK\x05\x06" + bytes(18), whole[:300] + whole[500:]):
        (tmp_path / "bad.zip").write_bytes(content)
        done = zoo("train", "-i", "bad.zip", "--algo", "dqn", "--env", AGENT)
        assert done.returncode == 2 and "bad.zip: it is no model of" in done.stderr
    for env, word in ((AGENT, "spaces do not match"), ("Three-v0", "Action spaces do not match")):
        done = zoo("train", "-i", "pole.zip", "--algo", "dqn", "--env", env)
        assert done.returncode == 2 and word in done.stderr
        assert "Traceback" not in done.stderr
    assert not (tmp_path / "logs").exists()


def test_a_model_of_other_animals_is_refused(zoo: Callable[..., Done], tmp_path: Path) -> None:
    """Newts without a compass observe what flies do, in units of their own; others observe more."""
    fly = slot_environment("AnimaRL/Fly-v0", 1)
    newt = slot_environment("AnimaRL/Newt-v0", 1, senses_compass=False)
    assert (fly.individuals, fly.observed[1:]) == (newt.individuals, newt.observed[1:])
    RECIPES["dqn"].algorithm("MlpPolicy", fly, offline_epochs=0, buffer_size=5000).save("fly.zip")
    alike = ("--env-kwargs", "senses_compass:False")
    for command, why in (
        (("train", "-i", "fly.zip"), "Observation spaces do not match"),
        (("train", "-i", "fly.zip", *alike), "Observation spaces do not match"),
    ):
        done = zoo(*command, "--algo=dqn", "--env=AnimaRL/Newt-v0")
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert f"fly.zip: {why}" in done.stderr
    assert not (tmp_path / "logs").exists()


def test_training_that_diverged_leaves_its_settings_to_look_at(
    zoo: Callable[..., Done], tmp_path: Path
) -> None:
    moths = [
        "train",
        "--algo=bc",
        "--env=AnimaRL/Silkmoth-v0",
        "-n",
        "20",
        "-params",
        "offline_epochs:1",
    ]
    done = zoo(
        *moths, "offline_epochs:1", "offline_learning_rate:1e30", "offline_max_grad_norm:null"
    )
    assert done.returncode == 2 and "offline training diverged" in done.stderr
    assert list(tmp_path.glob("logs/bc/*/*/config.yml"))
