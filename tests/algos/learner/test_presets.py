"""The YAML settings build every learner, hold the paper's numbers, and nothing is misspelt."""

import pydoc
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import toys
import yaml
from refusals import refuses
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from animarl_algos import DQN
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.presets import CONFIGS, PRESETS, learner_preset, section_of
from animarl_algos.learner.settings import LearnerSettings
from animarl_algos.recipes.registry import DQDIL, RECIPES, named_recipe
from animarl_algos.runs.run_settings import pipeline_settings
from animarl_envs import SPECIES, environment_id

AGENT = "AnimaRL/Agent-v0"
PAPERS_WORLD = {"observation": "paper", "rebound": False}
OF_THE_PAPER = [name for name in RECIPES if "soft-bc" not in name]


def presets(algo: str) -> tuple[str, ...]:
    return PRESETS if algo in OF_THE_PAPER else ("default",)


@pytest.mark.parametrize(("algo", "preset"), [(a, p) for a in RECIPES for p in presets(a)])
def test_every_recipe_can_be_made_from_its_settings(algo: str, preset: str) -> None:
    found = learner_preset(algo, AGENT, preset, {"buffer_size": 2000})
    env = SlotVecEnv("agent", 2, condition_flag=None, **found.env_kwargs)
    model = named_recipe(algo).algorithm(env=env, seed=0, settings=found.settings)
    assert (model.settings.offline_epochs > 0) == named_recipe(algo).pretrained
    assert (model.policy_kwargs.get("n_quantiles") == 20) == algo.startswith("qr-")


@pytest.mark.parametrize(
    ("algo", "preset"), [(a, p) for a in RECIPES if a.startswith("qr-") for p in presets(a)]
)
def test_a_quantile_twin_differs_in_its_quantiles_alone(algo: str, preset: str) -> None:
    for species in PAPER if preset == "paper" else SPECIES:
        twin = learner_preset(algo, environment_id(species), preset)
        plain = learner_preset(algo.removeprefix("qr-"), environment_id(species), preset)
        quantiles = plain.arguments.get("policy_kwargs", {}) | {"n_quantiles": 20}
        assert twin.arguments.pop("policy_kwargs") == quantiles
        plain.arguments.pop("policy_kwargs", None)
        assert twin == plain


@dataclass(frozen=True)
class Paper:
    """One species."""

    offline_rate: float  # DQDIL, DQCIL offline; all without pretraining online
    online_rate: float  # after pretraining
    epsilon: tuple[float, float]
    epsilon_pretrained: tuple[float, float]
    epsilon_test: float
    offline_alpha: float
    alpha: float
    offline_lambda3: float
    lambda3: float
    offline_lambda2: float | None
    lambda2: float | None


PAPER = {
    "agent": Paper(1e-6, 1e-6, (0.1, 0.1), (0.3, 0.1), 0.1, 10, 1, 50, 10, 10, 1),
    "fly": Paper(1e-4, 1e-5, (0.5, 0.3), (0.5, 0.3), 0.5, 0.5, 0.5, 10, 5, None, None),
    "newt": Paper(1e-4, 1e-5, (0.5, 0.3), (0.5, 0.3), 0.5, 0.5, 1, 10, 0.1, None, None),
    "silkmoth": Paper(1e-5, 1e-7, (0.5, 0.3), (0.5, 0.3), 0.5, 10, 1, 50, 10, 10, 1),
}


@pytest.mark.parametrize("species", PAPER)
@pytest.mark.parametrize("algo", OF_THE_PAPER)
def test_the_paper_preset_holds_the_papers_numbers(algo: str, species: str) -> None:
    numbers, name = PAPER[species], algo.removeprefix("qr-")
    found = learner_preset(algo, environment_id(species), "paper")
    settings = found.arguments
    assert settings["lambda1"] == 1e-5
    if name != "bc":
        pretrained = name in ("dqaas", "dqdil-pt", "dqcil-pt")
        assert found.n_timesteps == 1_005_000
        rate = numbers.online_rate if pretrained else numbers.offline_rate
        assert settings["learning_rate"] == rate
        epsilon = [settings[f"exploration_{at}_eps"] for at in ("initial", "final")]
        expected = numbers.epsilon_pretrained if pretrained else numbers.epsilon
        assert tuple(epsilon) == expected
        assert settings["exploration_steps"] == 50_000
        assert settings["gamma"] == 0.9 and settings["batch_size"] == 32
        assert settings["target_update_interval"] == [2000, "episode"]
        assert settings["max_grad_norm"] == 10 and settings["updates_per_episode"] == 1
        assert settings["replay_buffer_kwargs"] == {"max_episodes": 5000}
        assert settings["buffer_size"] > found.n_timesteps  # so that 5000 episodes are the bound
    if name in ("bc", "dqaas", "dqdil-pt", "dqcil-pt"):
        assert settings["offline_epochs"] == 30 and "offline_patience" not in settings
        supervised = name in ("bc", "dqaas")
        assert settings["offline_learning_rate"] == (1e-3 if supervised else numbers.offline_rate)
        assert settings["offline_batch_size"] == 16 and settings["offline_max_grad_norm"] == 20
        assert name == "bc" or settings["offline_gamma"] == 0.99
    else:
        assert not any(key.startswith("offline") for key in settings)
    if "dil" in name or "cil" in name:
        assert settings["alpha"] == numbers.alpha
        assert found.env_kwargs == PAPERS_WORLD | {"dtw": "cumulative"}
        assert settings.get("offline_alpha") == (numbers.offline_alpha if "-pt" in name else None)
        assert not settings.get("offline_scaled_penalties")  # as in the equation: arena units
    if "cil" in name:
        assert settings.get("lambda2") == numbers.lambda2
        expected = numbers.offline_lambda2 if "-pt" in name else None
        assert settings.get("offline_lambda2") == expected
    if name == "dqaas":
        assert settings["lambda3"] == numbers.lambda3
        assert settings["offline_lambda3"] == numbers.offline_lambda3


def test_the_pipeline_tests_with_the_papers_epsilon() -> None:
    for species, numbers in PAPER.items():
        found = pipeline_settings(environment_id(species), "paper")
        acting = f"epsilon:{numbers.epsilon_test:g}"
        assert found == {"acting": acting, "fit_method": "onset", "thrusts": "1"}


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"learning_rat": 1.0}, "'learning_rat' is unknown: choose among"),
        ({"learning_rate": "fast"}, "learning_rate is 'fast': give a number"),
        ({"learning_rate": "lin_fast"}, "write lin_ and a number"),
        ({"batch_size": 1.5}, "give a whole number"),
        ({"batch_size": [1]}, "give a whole number of at least 1"),
        ({"prioritized": "yes"}, "give a number, not text|give true or false"),
        ({"prioritized": 1}, "give true or false"),
        ({"policy": 3}, "choose GruPolicy or MlpPolicy"),
        ({"policy": "os.path"}, "is 'os.path': choose GruPolicy or MlpPolicy"),
        ({"policy_kwargs": "dict(hidden=open)"}, "is 'dict.hidden=open.': give a table"),
        ({"env_kwargs": [1]}, "give a table"),
        ({"seed": 1}, "'seed' is unknown"),
    ],
)
def test_bad_settings_are_refused_by_name(overrides: dict[str, Any], words: str) -> None:
    refuses(words, learner_preset, "dqn", AGENT, "default", overrides)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("AnimaRL/Agent-v0: {default: {learning_rat: 1}}", "Agent-v0: default: 'learning_rat'"),
        ("AnimaRL/Fly-v0: {default: {alhpa: 1}}", "Fly-v0: default: 'alhpa'"),  # another section
        ("common: {paper: {gama: 1}}", "common: paper: 'gama'"),  # another preset
        ("AnimaRL/Agent-v0: {learning_rate: 1}", "say n_timesteps, policy for .* 'base: dqdil'"),
        ("AnimaRL/Agent-v0: {default: {}, gamma: 0.9}", "'default' is unknown: choose among"),
        ("AnimaRL/Agent-v0: {papers: {}}", "it holds 'papers'"),
        ("AnimaRL/Agent-v0: 3", "it holds 3"),
        ("AnimaRL/Agent-v0: {default: 3}", "default is 3"),
        ("- 1", "no sections"),
        ("a: [", "not valid YAML"),
        ("base: nowhere", "zoo_configs/nowhere.yml: there is no such configuration"),
        ("base: 3", "base is 3"),
        ("common: {default: {n_envs: 1}}", "not say n_timesteps, policy for .* 'base: dqdil'"),
        ("CartPole-v1: {policy: MlpPolicy, normalize: true}", "'normalize' is unknown"),
        ("CartPole-v1: {policy: MlpPolicy, a: 1, b: 2}", "'a', 'b' are unknown: choose among"),
        ("common: {default: {offline_epochs: true}}", "common: default: offline_epochs is True"),
        ("common: {default: {gamma: !!python/name:os.system ''}}", "not valid YAML"),
    ],
)
def test_a_bad_file_is_refused_with_its_place(text: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.yml"
    file.write_text(text)
    said = refuses(words, learner_preset, "dqdil", AGENT, config=file)
    assert "nowhere" in words or str(file) in said


def test_a_file_of_ones_own_builds_on_those_of_the_package(tmp_path: Path) -> None:
    file = tmp_path / "mine.yml"
    file.write_text(f"base: dqdil\n{AGENT}:\n  default: {{alpha: 3, learning_rate: lin_1e-4}}\n")
    mine, plain = learner_preset("dqdil", AGENT, config=file), learner_preset("dqdil", AGENT)
    assert mine.arguments == plain.arguments | {"alpha": 3.0, "learning_rate": "lin_1e-4"}
    rate = mine.settings.sb3_arguments()["learning_rate"]
    assert [rate(left) for left in (1.0, 0.5, 0.0)] == pytest.approx([1e-4, 5e-5, 0.0])


def test_a_section_as_rl_zoo3_writes_it_is_preset_default(tmp_path: Path) -> None:
    file = tmp_path / "mine.yml"
    file.write_text(
        "CartPole-v1:\n  n_timesteps: !!float 5e4\n  policy: 'MlpPolicy'\n  gamma: 0.9\n"
        '  policy_kwargs: "dict(net_arch=[256, 256])"\n'
    )
    preset = learner_preset("dqn", "CartPole-v1", config=file)
    assert (preset.n_timesteps, preset.n_envs) == (50_000, 1)
    table = {"net_arch": [256, 256]}
    assert preset.arguments == {"policy": "MlpPolicy", "gamma": 0.9, "policy_kwargs": table}


def test_a_table_goes_over_the_one_below_key_by_key(tmp_path: Path) -> None:
    file = tmp_path / "mine.yml"
    file.write_text(
        f"base: qr-dqdil\n{AGENT}:\n  paper:\n    env_kwargs: {{contact_radius: 0.15}}\n"
        "    policy_kwargs: {hidden: 16}\n    replay_buffer_kwargs: {alpha: 0.5}\n"
    )
    found = learner_preset("qr-dqdil", AGENT, "paper", config=file)
    assert found.env_kwargs == PAPERS_WORLD | {"dtw": "cumulative", "contact_radius": 0.15}
    assert found.arguments["policy_kwargs"] == {"n_quantiles": 20, "hidden": 16}
    assert found.arguments["replay_buffer_kwargs"] == {"max_episodes": 5000, "alpha": 0.5}


def test_null_takes_a_setting_back_and_numbers_that_yaml_takes_for_text_are_numbers() -> None:
    one, whole = (
        learner_preset("dqdil", AGENT, "paper", {"env_kwargs": table})
        for table in ({"dtw": None}, None)
    )
    assert one.env_kwargs == PAPERS_WORLD | {"dtw": None}
    assert whole.env_kwargs == {}
    found = learner_preset("dqn", AGENT, "default", {"learning_rate": "1e-4", "batch_size": "8"})
    assert found.arguments["learning_rate"] == 1e-4 and found.arguments["batch_size"] == 8


def test_other_environments_have_the_default_preset_only() -> None:
    assert learner_preset("dqn", "MountainCar-v0").n_timesteps == 100_000
    assert learner_preset("dqn", "CartPole-v1").n_timesteps == 50_000
    refuses("'paper' has no numbers for CartPole-v1", learner_preset, "dqn", "CartPole-v1", "paper")
    refuses("preset 'fast' is unknown", learner_preset, "dqn", AGENT, "fast")
    told = "soft-bc is not of the paper: choose preset 'default'"
    refuses(told, learner_preset, "soft-bc", AGENT, "paper")


def test_a_file_that_is_its_own_base_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "dqn.yml").write_text("base: dqdil")
    (tmp_path / "dqdil.yml").write_text("base: dqn")
    monkeypatch.setattr("animarl_algos.learner.presets.CONFIGS", tmp_path)
    refuses("dqn: it is its own base", learner_preset, "dqn", AGENT)


def test_a_tasks_section_holds_for_the_policy_it_names() -> None:
    named, other = DQN(env="CartPole-v1"), DQN("GruPolicy", "CartPole-v1", max_episode_steps=500)
    assert (named.settings.sequence_length, named.gamma) == (1, 0.99)
    assert (other.settings.sequence_length, other.gamma) == (None, 0.9)


FOREIGN = "MountainCar-v0"


@cache
def slots(species: str) -> SlotVecEnv:
    return SlotVecEnv(species, 1, condition_flag=None)


def in_use(model: SequenceQLearning, name: str) -> Any:
    """A setting of a learner, as a file would say it."""
    value = getattr(model.settings, name)
    assert name != "policy" or value == model.policy_class.__name__
    return list(value) if isinstance(value, tuple) else value


def expected(algo: str, env_id: str) -> dict[str, Any]:
    """Of the files."""
    return tables_filled(vars(learner_preset(algo, env_id, "default").settings))


def tables_filled(settings: dict[str, Any]) -> dict[str, Any]:
    """As a file says it: an absent table is an empty one, and a pair a list."""
    plain = {k: list(v) if isinstance(v, tuple) else v for k, v in settings.items()}
    return {k: {} if k.endswith("kwargs") and v is None else v for k, v in plain.items()}


def make(algo: str, env: Any) -> SequenceQLearning:
    """The learner of that name, told nothing but the epochs that its ``-pt`` stands for."""
    if not algo.endswith("-pt"):
        return RECIPES[algo].algorithm(env=env, device="cpu")
    epochs = expected(algo, section_of(env))["offline_epochs"]
    return RECIPES[algo].algorithm(env=env, device="cpu", offline_epochs=epochs)


@pytest.mark.parametrize(
    ("algo", "species"),
    [
        (algo, name) for algo in RECIPES for name in SPECIES
        if SPECIES[name].conditions or not RECIPES[algo].algorithm.recipe.needs_condition
    ],
)  # fmt: skip
def test_a_learner_without_settings_has_the_presets(algo: str, species: str) -> None:
    model = make(algo, slots(species))
    settings = expected(algo, environment_id(species))
    if species == "shoal":  # animals that are alike have one network
        settings["policy_kwargs"] = settings["policy_kwargs"] | {"shared": True}
    assert {name: in_use(model, name) for name in settings} == settings


@pytest.mark.parametrize("algo", ["dqn", "dqdil-pt", "qr-bc"])
def test_a_learner_of_the_paper_takes_nothing_from_the_default(algo: str) -> None:
    moth = environment_id("silkmoth")  # whose defaults are the furthest from the paper's
    paper = learner_preset(algo, moth, "paper").settings
    model = RECIPES[algo].algorithm(env=slots("silkmoth"), device="cpu", settings=paper)
    settings = tables_filled(vars(paper))
    assert {name: in_use(model, name) for name in settings} == settings


def test_every_way_to_name_a_species_is_understood() -> None:
    moth = environment_id("silkmoth")
    environments = [moth, gym.make(moth), slots("silkmoth")]
    environments += [VecMonitor(SlotVecEnv("silkmoth", 1)), DummyVecEnv([lambda: gym.make(moth)])]
    assert {section_of(env) for env in environments} == {moth}
    rate = expected("dqn", moth)["learning_rate"]
    assert rate != expected("dqn", FOREIGN)["learning_rate"]
    for env in environments[1:]:
        assert DQN(env=env, device="cpu").learning_rate == rate
    for algo in ("dqn", "qr-dqn"):
        model, settings = make(algo, FOREIGN), expected(algo, FOREIGN)
        assert {name: in_use(model, name) for name in settings} == settings
    assert section_of(None) == section_of(toys.Pair(2)) == ""


@pytest.mark.parametrize("task", ["CartPole-v1", "Acrobot-v1"])
def test_an_ordinary_task_has_a_section_however_it_is_given(task: str) -> None:
    settings = expected("dqn", task)
    assert settings != expected("dqn", FOREIGN) == expected("dqn", "Another-v0")
    for env in (task, gym.make(task), DummyVecEnv([lambda: gym.make(task)]), make_vec_env(task, 2)):
        assert section_of(env) == task
        model = DQN(env=env, device="cpu")
        assert {name: in_use(model, name) for name in settings} == settings


def test_what_is_given_goes_over_the_preset_and_tables_key_by_key() -> None:
    model = RECIPES["qr-dqn"].algorithm(
        "MlpPolicy", slots("agent"), gamma=0.5, policy_kwargs={"hidden": 8}, device="cpu"
    )
    network = {"hidden": 8, "n_quantiles": 20}
    changed = {"policy": "MlpPolicy", "gamma": 0.5, "policy_kwargs": network}
    for name, value in (expected("qr-dqn", environment_id("agent")) | changed).items():
        assert in_use(model, name) == value
    assert RECIPES["bc"].algorithm(env=slots("agent"), device="cpu").settings.offline_kwargs
    emptied = RECIPES["bc"].algorithm(env=slots("agent"), device="cpu", offline_kwargs=None)
    assert emptied.settings.offline_kwargs == {}
    told = "'learning_rat' is unknown: choose among .*learning_rate"
    refuses(told, DQN, env=slots("agent"), learning_rat=1e-3)


def test_a_presets_gradient_steps_belong_to_its_own_train_freq() -> None:
    make = partial(DQN, "MlpPolicy", "CartPole-v1", device="cpu")
    assert make().gradient_steps > 1
    assert make(train_freq=4).gradient_steps == 1
    assert make(train_freq=4, gradient_steps=3).gradient_steps == 3


def test_the_settings_are_listed_and_explained_once_and_can_be_looked_up() -> None:
    assert set(LearnerSettings.__annotations__) == set(DQDIL.default_settings())
    shown = pydoc.render_doc(DQDIL, renderer=pydoc.plaintext)
    entries = {name for line in shown.splitlines() for name in line.strip(" |").split(", ")}
    assert set(DQDIL.default_settings()) <= entries
    assert "zoo_configs" in shown and "demonstrations" in entries
    plain = DQDIL.default_settings(environment_id("agent"))
    pretrained = DQDIL.default_settings(pretrained=True)
    assert plain["offline_epochs"] == 0 < pretrained["offline_epochs"]
    assert not plain["offline_scaled_penalties"] and pretrained["offline_scaled_penalties"]


def test_every_file_of_a_learner_is_a_recipes() -> None:
    others = {"pipeline", "pretraining", "cloning"}
    files = {f.name.removesuffix(".yml") for f in CONFIGS.iterdir() if f.name.endswith(".yml")}
    assert files - others == set(RECIPES)
    classes = {named.algorithm for named in RECIPES.values()}
    names = {n for c in classes for n in (c.preset, c.pretrained_preset) if n is not None}
    assert names == set(RECIPES)
    for name, named in RECIPES.items():
        content = yaml.safe_load((CONFIGS / f"{name}.yml").read_text())
        assert content and name in (named.algorithm.preset, named.algorithm.pretrained_preset)


def test_files_are_plain_data() -> None:
    """safe_load takes them, and every string in them is a name that is looked up in a table."""
    for file in CONFIGS.iterdir():
        if not file.name.endswith(".yml"):
            continue
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
        assert strings(content) - set(content) <= {*NAMES.split(), *RECIPES}


NAMES = """
    GruPolicy MlpPolicy head encoder recompute stored episode step cumulative closeness onset joint
    chosen auto 1 epsilon:0.1 epsilon:0.5 paper epsilon boltzmann huber recipe hard soft tracking
    lin_1e-3 pretraining cloning
"""


def strings(data: Any) -> set[str]:
    """All string values (not keys) in nested data."""
    if isinstance(data, dict):
        return set().union(*map(strings, data.values())) if data else set()
    if isinstance(data, list):
        return set().union(*map(strings, data)) if data else set()
    return {data} if isinstance(data, str) else set()
