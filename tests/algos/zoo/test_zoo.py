"""rl_zoo3 with these learners: train, optimize."""

import importlib
import sqlite3
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import matplotlib
import numpy as np
import optuna
import pytest
import rl_zoo3
import rl_zoo3.exp_manager
import rl_zoo3.utils
import yaml
from commands import Done, refused, succeeded
from gymnasium.envs.classic_control import CartPoleEnv
from refusals import refuses
from slow import slowly
from small_runs import few
from stable_baselines3.common import callbacks
from stable_baselines3.common.monitor import load_results

from animarl_algos.cli.watch import prepare
from animarl_algos.learner.presets import learner_preset
from animarl_algos.learner.settings import LearnerFile
from animarl_algos.recipes.registry import RECIPES
from animarl_algos.zoo import manager
from animarl_algos.zoo.__main__ import main, register
from animarl_algos.zoo.manager import sample_settings, slot_environment, validation_environment
from animarl_envs import SPECIES, environment_id
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.settings import field_types

AGENT = "AnimaRL/Agent-v0"
CARTPOLE = ["--env", "CartPole-v1", "-n", "16", "--eval-episodes", "1"]
TINY = ["--n-timesteps", "200", "--seed", "1", "--eval-freq", "100", "--eval-episodes", "2"]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Demonstrations of a few short episodes of both conditions in each split."""
    return few(train=6, val=3, test=3, skip=5).save(tmp_path_factory.mktemp("demos") / "small.npz")


@pytest.fixture
def zoo(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Callable[..., Done]:
    """The command with these arguments, in a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Done:
        monkeypatch.setattr(sys, "argv", ["zoo", *arguments])
        monkeypatch.setattr(sys, "orig_argv", ["zoo", *arguments])
        capfd.readouterr()
        code = 0
        try:
            main()
        except SystemExit as ended:
            code = int(ended.code or 0)
        said = capfd.readouterr()
        return Done(code, said.out, said.err)

    return call


NAME = "AnimaRL-Agent-v0"


def tiny(small: Path) -> list[str]:
    return ["--env", AGENT, *TINY, "--env-kwargs", f"demos:{small}"]


def test_all_learners_are_in_the_tables_of_rl_zoo3() -> None:
    register()
    assert {name: named.algorithm for name, named in RECIPES.items()} == rl_zoo3.ALGOS
    assert rl_zoo3.exp_manager.ALGOS is rl_zoo3.ALGOS is rl_zoo3.utils.ALGOS


@pytest.mark.parametrize("algo", RECIPES)
def test_optuna_chooses_settings_that_the_learner_knows(algo: str) -> None:
    drawn = sample_settings(optuna.create_study().ask(), algo, {})
    assert drawn and learner_preset(algo, AGENT, "default", drawn)
    weights = {key.removeprefix("offline_") for key in drawn} & {"alpha", "lambda2", "lambda3"}
    wanted = {"dil": {"alpha"}, "cil": {"alpha", "lambda2"}, "aas": {"lambda3"}}
    kind = next((k for k in wanted if k in algo), "")
    assert weights == wanted.get(kind, set())
    assert drawn.keys() <= field_types(LearnerFile).keys()


@pytest.mark.parametrize("species", SPECIES)
def test_all_individuals_learn_and_scores_come_from_the_validation_split(species: str) -> None:
    env_id, demos = environment_id(species), load_packaged(species)
    training, scored = slot_environment(env_id, 2), validation_environment(env_id, 2)
    assert training.num_envs == scored.num_envs == 2 * demos.num_individuals
    paired = {"train": training.scenario.demos, "val": scored.scenario.demos}
    for split, found in paired.items():
        assert found is not None and set(found.split) == {split}


def test_the_score_is_the_task_reward_and_closeness(small: Path) -> None:
    scored = validation_environment(AGENT, 1, demos=str(small))
    scored.seed(3)
    scored.reset()
    task = closeness = 0.0
    while True:
        _, _, done, infos = scored.step(np.full(3, 6))
        task += scored.extras["task_reward"] - scored.extras["dtw_refund"]
        closeness -= scored.extras["dtw_penalty"]
        if done.all():
            break
    returns = [info["episode"]["r"] for info in infos]
    assert returns == pytest.approx(task + closeness, abs=1e-5)
    assert (closeness > 0.1).all()


def test_clients_of_rl_zoo3_go_on_from_a_zip_and_plot(
    zoo: Callable[..., Done], small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Training leaves a model, its settings and scores, for ``-i`` and for ``plot_train``."""
    asked = ["--algo", "dqdil", *tiny(small)]
    succeeded(zoo("train", *asked))
    runs = [tmp_path / "logs" / "dqdil" / f"{NAME}_{k}" for k in (1, 2)]
    for name in (f"{NAME}.zip", "best_model.zip", "evaluations.npz", "progress.csv"):
        assert (runs[0] / name).stat().st_size > 0
    assert list(runs[0].glob("events.out.tfevents.*"))
    config = yaml.safe_load((runs[0] / NAME / "config.yml").read_text())
    assert config["alpha"] == 1.0 and config["env_kwargs"]["demos"] == str(small)
    assert yaml.safe_load((runs[0] / NAME / "args.yml").read_text())["seed"] == 1
    with np.load(runs[0] / "evaluations.npz") as evaluations:
        assert evaluations["results"].shape[1] == 2 * 3  # episodes x individuals
    world, actor = prepare(None, model=runs[0], split="test")
    assert len(world.scenario.demos) < 20  # the small set's
    world.reset()
    assert actor(world, True).shape == (1, 3)
    refuses("it was trained in AnimaRL/Agent-v0, not in", prepare, "newt", model=runs[0])
    succeeded(zoo("train", "-i", str(runs[0] / f"{NAME}.zip"), *asked))
    for run in runs:
        episodes = load_results(str(run))
        assert len(episodes) > 1 and (episodes.l >= 1).all() and (episodes.t.diff()[1:] >= 0).all()
        assert 0 < episodes.l.sum() <= 200 + 148 * 16  # steps of all copies, ended episodes alone
    matplotlib.use("agg")
    plots: Any = importlib.import_module("rl_zoo3.plots.plot_train")
    lines: list[int] = []
    monkeypatch.setattr(plots.plt, "plot", lambda x, *_, **__: lines.append(len(x)))
    words = ["plot_train", "-a", "dqdil", "-e", NAME, "-f", "logs", "-w", "2"]
    monkeypatch.setattr(sys, "argv", words)
    plots.plot_train()
    assert len(lines) == 2 and min(lines) > 0


@pytest.mark.parametrize(
    ("asked", "at"),
    [
        ([], [32 * k for k in range(1, 11)]),
        (["--eval-freq=160"], [160, 320]),
        (["--eval-freq", "-1"], None),
    ],
)
def test_evaluations_are_a_tenth_of_the_run_apart_unless_told(
    asked: list[str], at: list[int] | None, zoo: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    told = [*DQN, "--n-timesteps", "320", "--seed", "1", "--eval-episodes", "1"]
    succeeded(zoo(*told, "--env-kwargs", f"demos:{small}", *asked))
    run = tmp_path / "logs" / "dqn" / f"{NAME}_1"
    if at is None:
        assert not (run / "evaluations.npz").exists()
        return
    with np.load(run / "evaluations.npz") as evaluations:
        assert evaluations["timesteps"].tolist() == at
    frequency = yaml.safe_load((run / NAME / "args.yml").read_text())["eval_freq"]
    assert frequency == (160 if asked else 32)
    assert (run / "best_model.zip").exists()


@pytest.mark.slow
def test_one_individual_in_training(zoo: Callable[..., Done], small: Path) -> None:
    params = ["-params", "offline_epochs:1", "learning_rate:lin_1e-3"]
    done = zoo("train", "--algo", "qr-dqcil-pt", *tiny(small), "focal:prey", "-P", *params)
    assert done.returncode == 0 and "\r" not in done.stderr  # no bar where nobody looks


@pytest.mark.parametrize(
    ("algo", "env", "more"),
    [("bc", AGENT, ["-params", "offline_epochs:2"]), ("dqn", "CartPole-v1", [])],
)
def test_cloning_alone_and_other_environments_train_too(
    algo: str, env: str, more: list[str], zoo: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    where = tiny(small) if env == AGENT else ["--env", env, *TINY]
    succeeded(zoo("train", "--algo", algo, *where, *more))
    name = env.replace("/", "-")
    assert (tmp_path / "logs" / algo / f"{name}_1" / f"{name}.zip").exists()


@pytest.mark.slow
@pytest.mark.parametrize("algo", ["bc", "dqdil"])
def test_optimize_tunes_into_sqlite(
    algo: str, zoo: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    """Two trials, then two more in the same study; the best one's settings train a model."""
    tune = ["optimize", "--algo", algo, "--n-trials", "2", "--pruner", "none", *tiny(small)]
    if algo == "bc":
        tune += ["-params", "offline_epochs:1"]
    for _ in range(2):
        succeeded(zoo(*tune))
    database = tmp_path / "logs" / algo / "optuna.db"
    with sqlite3.connect(database) as connection:
        rows = connection.execute("select state from trials").fetchall()
    assert rows == [("COMPLETE",)] * 4
    assert not list(database.parent.glob(f"{NAME}_*/"))
    if algo == "bc":
        return
    study = optuna.load_study(study_name=f"{algo} {AGENT}", storage=f"sqlite:///{database}")
    assert len({trial.value for trial in study.trials}) > 1


def test_a_trial_has_the_network_that_was_asked_for(
    zoo: Callable[..., Done], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The command line, a file and optuna may each say something of one network."""
    networks: list[dict[str, Any]] = []

    def score(model: Any, *_: Any, **__: Any) -> tuple[float, float]:
        networks.append(model.policy_kwargs)
        return 0.0, 0.0

    monkeypatch.setattr(manager, "evaluate_policy", score)
    monkeypatch.setattr(manager, "QUANTILES", (7,))
    params = ["-params", "gamma:0.5", "learning_rate:0.001", "policy_kwargs:{hidden: 8}"]
    tune = ["optimize", "--algo", "qr-dqn", *CARTPOLE, "--n-trials=1", "--pruner=none", *params]
    succeeded(zoo(*tune))
    assert [(one["hidden"], one["n_quantiles"]) for one in networks] == [(8, 7)]
    place = ["--storage", f"sqlite:///{tmp_path}/logs/qr-dqn/optuna.db", "--study-name",
             "qr-dqn CartPole-v1"]  # fmt: skip
    study = optuna.load_study(study_name=place[3], storage=place[1])
    tuned = {"updates_per_episode", "exploration_final_eps", "n_quantiles"}  # what was not given
    assert study.trials[0].params.keys() == tuned


def test_help_says_what_a_zip_file_is(zoo: Callable[..., Done]) -> None:
    train: Any = zoo("train", "--help")
    assert "--preset {paper,default}" in train.stdout and "pickles" in train.stdout
    assert "python -m animarl_algos.zoo train" in zoo("--help").stdout


@pytest.mark.parametrize("exploration", [*slowly("epsilon"), "boltzmann"])
def test_training_scores_a_policy_that_samples_as_it_acts(
    exploration: str, zoo: Callable[..., Done], small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the best actions otherwise, as rl_zoo3 does; its callback and optuna's alike."""
    greedily: list[tuple[bool, str]] = []

    def score(model: Any, *_: Any, deterministic: bool, **asked: Any) -> Any:
        greedily.append((deterministic, str(model.policy.acting.kind)))
        return ([0.0], [1]) if asked.get("return_episode_rewards") else (0.0, 0.0)

    monkeypatch.setattr(callbacks, "evaluate_policy", score)
    monkeypatch.setattr(manager, "evaluate_policy", score)
    params = ["-params", "offline_epochs:1", f"exploration:{exploration}"]
    told = ["--algo", "dqdil-pt", *tiny(small), *params]
    for command in (["train"], ["optimize", "--n-trials", "1", "--pruner", "none"]):
        succeeded(zoo(*command, *told))
    assert len(greedily) > 2 and set(greedily) == {(exploration == "epsilon", exploration)}


DQN = ["train", "--algo", "dqn", "--env", AGENT]
WITHOUT_WANDB = pytest.mark.skipif(find_spec("wandb") is not None, reason="wandb is installed")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["dance"], "'dance' is unknown: choose train, optimize"),
        (["train", "--algo", "ppo", "--env", AGENT], "invalid choice: 'ppo'"),
        (["train", "--algo", "dqn", "--env", "AnimaRL/Dodo-v0"], "'AnimaRL/Dodo-v0' is not"),
        ([*DQN, "--preset", "fast"], "invalid choice: 'fast'"),
        ([*DQN, "-params", "gama:1"], "'gama' is unknown"),
        ([*DQN, "-params", "gamma"], "write KEY:VALUE"),
        ([*DQN, "-params", "gamma:["], "not valid YAML"),
        ([*DQN, "--env-kwargs", "wind:1"], "'wind' is unknown"),
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
        (["train", "--algo", "dqdil", "--env", "CartPole-v1"], "'dtw_penalty'"),
    ],
)
def test_bad_input_is_one_sentence(
    arguments: list[str], word: str, zoo: Callable[..., Done]
) -> None:
    done = zoo(*arguments)
    if "invalid choice" in word:  # argparse says how it is used before
        assert done.returncode == 2 and word in done.stderr
    else:
        refused(done, word)


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
    (tmp_path / "logs" / "dqn").mkdir(parents=True)  # and older ones alone
    assert zoo(*arguments).returncode == 2
    assert not list((tmp_path / "logs" / "dqn").iterdir())


def test_nothing_on_the_command_line_or_in_a_file_is_evaluated(
    zoo: Callable[..., Done], tmp_path: Path
) -> None:
    """rl_zoo3 evaluates KEY:VALUE, policy_kwargs and normalize, runs .py files, imports names."""
    evil = f"__import__('pathlib').Path('{tmp_path}/ran').touch()"
    for key in ("policy_kwargs", "replay_buffer_kwargs", "normalize", "env_wrapper", "policy"):
        assert zoo(*DQN, "-params", f'{key}:"{evil}"').returncode == 2
        file = tmp_path / "mine.yml"
        file.write_text(yaml.safe_dump({"base": "dqn", AGENT: {"default": {key: evil}}}))
        refused(zoo(*DQN, "-conf", str(file)))
    script = tmp_path / "mine.py"
    script.write_text(f"{evil}\nhyperparams = {{}}\n")
    refused(zoo(*DQN, "-conf", str(script)))
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
        refused(zoo(*DQN, "-i", "bad.zip"), "bad.zip: it is no model of")
    for env, word in ((AGENT, "spaces do not match"), ("Three-v0", "Action spaces do not match")):
        refused(zoo("train", "-i", "pole.zip", "--algo", "dqn", "--env", env), word)
    assert not (tmp_path / "logs").exists()


def test_a_model_of_other_animals_is_refused(zoo: Callable[..., Done], tmp_path: Path) -> None:
    """Newts without a compass observe what flies do, in units of their own; others observe more."""
    fly = slot_environment("AnimaRL/Fly-v0", 1)
    newt = slot_environment("AnimaRL/Newt-v0", 1, senses_compass=False)
    assert (fly.individuals, fly.observed[1:]) == (newt.individuals, newt.observed[1:])
    RECIPES["dqn"].algorithm("MlpPolicy", fly, offline_epochs=0, buffer_size=5000).save("fly.zip")
    command = ("train", "-i", "fly.zip", "--algo=dqn", "--env=AnimaRL/Newt-v0")
    for alike in ((), ("--env-kwargs", "senses_compass:False")):
        refused(zoo(*command, *alike), "fly.zip: Observation spaces do not match")
    assert not (tmp_path / "logs").exists()


def test_training_that_diverged_leaves_its_settings_to_look_at(
    zoo: Callable[..., Done], tmp_path: Path
) -> None:
    moths = ["train", "--algo=bc", "--env=AnimaRL/Silkmoth-v0", "-n", "20", "-params"]
    rates = ["offline_epochs:1", "offline_learning_rate:1e30", "offline_max_grad_norm:null"]
    done = zoo(*moths, *rates)
    assert done.returncode == 2 and "offline training diverged" in done.stderr
    assert list(tmp_path.glob("logs/bc/*/*/config.yml"))


def test_the_same_seed_gives_the_same_scores(
    zoo: Callable[..., Done], small: Path, tmp_path: Path
) -> None:
    scores = []
    for number in (1, 2):
        succeeded(zoo("train", "--algo", "dqn", *tiny(small)))
        file = tmp_path / "logs" / "dqn" / f"{NAME}_{number}" / "evaluations.npz"
        with np.load(file) as evaluations:
            scores.append(evaluations["results"])
    np.testing.assert_array_equal(*scores)
