"""``enjoy``: run a model that rl_zoo3 saved, in a window, as a clip, or without a picture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from huggingface_sb3 import EnvironmentName
from rl_zoo3.utils import get_model_path
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.cli.watch import play
from animarl_algos.cli.watch_actors import trained_actor
from animarl_algos.data.focal import FocalPolicy
from animarl_algos.data.slots import Feedback
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.networks.acting_rule import Acting, Kind
from animarl_algos.recipes.registry import RECIPES
from animarl_algos.zoo.environments import slot_environment, species_of_id
from animarl_algos.zoo.models import check_fit, load_model
from animarl_envs.drawing.render import CLIP_SUFFIXES, Renderer, write_clip
from animarl_envs.errors import InputError
from animarl_envs.importing.plain_yaml import read_yaml


def enjoy(arguments: list[str]) -> None:
    """Load a model and let it act; prints the return and length of every episode."""
    asked = _parser().parse_args(arguments)
    rule = None if asked.acting is None else Acting.parse(asked.acting)
    if asked.out is not None and asked.out.suffix.lower() not in CLIP_SUFFIXES:
        raise InputError(f"{asked.out}: a clip cannot be written so: use .gif or .mp4")
    species = species_of_id(asked.env)
    if asked.out is not None and species is None:
        raise InputError(f"--out draws AnimaRL environments, not {asked.env}: leave it out")
    path, options = find_model(asked)
    model = load_model(asked.algo, path)
    model.policy.seed(asked.seed)
    if rule is not None:
        model.policy.acting = rule
    print(f"Acting: {model.policy.acting}")
    if species is None:
        mode = None if asked.no_render else "human"
        env: VecEnv = model._wrap_env(gym.make(asked.env, render_mode=mode, **options))
        check_fit(model, env, path)
        run(model, env, asked.n_timesteps, asked.seed)
        return
    slots = slot_environment(asked.env, 1, split="val", **options)
    check_fit(model, slots, path)
    if asked.no_render:
        run(model, slots, asked.n_timesteps, asked.seed)
    else:
        show(model, slots, asked)


def run(model: SequenceQLearning, env: VecEnv, steps: int, seed: int) -> None:
    """Act for so many steps, and say how episodes ended."""
    env.seed(seed)
    feedback = Feedback(env)
    observation = env.reset()
    state, starts = None, np.ones(env.num_envs, dtype=bool)
    returns: list[float] = []
    for _ in range(steps):
        actions, state = model.predict(observation, state, starts)  # type: ignore[arg-type]
        observation, _, starts, infos = env.step(actions)
        feedback.update(infos)
        state = model.remember(state, feedback.executed(actions))
        episode = infos[0].get("episode")
        if episode is not None:
            returns.append(float(episode["r"]))
            print(f"episode {len(returns)}: return {returns[-1]:.3f}, {episode['l']} steps")
    if returns:
        print(f"{len(returns)} episodes, mean return {np.mean(returns):.3f}")
    else:
        print(f"no episode ended within {steps} steps: give more with -n")
    env.close()


def show(model: SequenceQLearning, env: SlotVecEnv, asked: argparse.Namespace) -> None:
    """Draw episodes of the validation split, in a window or into a clip."""
    one = len(env.individuals) < len(env.scenario.names)
    actor = trained_actor(
        FocalPolicy(model, env.scenario.names, env.individuals[0]) if one else model
    )
    env.world.seed(np.array([asked.seed], dtype=np.uint64))
    fps = 1.0 / env.scenario.species.dt
    renderer = Renderer("human" if asked.out is None else "rgb_array", fps=fps)
    endings: list[str] = []
    pictures = play(
        env.world, actor, renderer, episodes=asked.episodes, steps=asked.n_timesteps,
        endings=endings,
    )  # fmt: skip
    try:
        if asked.out is None:
            for _ in pictures:
                pass
        else:
            write_clip(pictures, asked.out, fps)
            print(f"Wrote {asked.out}")
    finally:
        renderer.close()
    for number, ending in enumerate(endings, start=1):
        print(f"episode {number}: {ending}")


def find_model(asked: argparse.Namespace) -> tuple[Path, dict[str, Any]]:
    """The zip file that was asked for, and the options its environment was trained with.

    Raises
    ------
    InputError
        If there is none.
    """
    name = EnvironmentName(asked.env)
    if asked.model is not None:
        path = asked.model
        folder = path.parent
        if not path.is_file():
            raise InputError(f"{path}: there is no such file: name the zip of a trained model")
    else:
        try:
            _, found, log_path = get_model_path(
                asked.exp_id, asked.folder, asked.algo, name, asked.load_best
            )
        except (AssertionError, ValueError) as error:
            raise InputError(f"{error}: train first, or name a zip with --model") from None
        path, folder = Path(found), Path(log_path)
    config = folder / name / "config.yml"
    if not config.is_file():
        return path, {}
    settings = read_yaml(config)
    options = settings.get("env_kwargs") or {} if isinstance(settings, dict) else None
    if not isinstance(options, dict):
        raise InputError(f"{config}: it holds no settings of a training: name another --model")
    if species_of_id(name.gym_id) is not None:
        options = {"observation": "paper"} | options  # all there was before it was written down
    return path, options


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m animarl_algos.zoo enjoy",
        description=(
            "Run a model that 'train' saved: the latest of --algo and --env in --folder, or the "
            "file --model. A zip file of stable-baselines3 holds pickles, which can run any code "
            "when loaded: load only files of your own. AnimaRL episodes start from the validation "
            "split."
        ),
    )
    parser.add_argument("--algo", required=True, choices=list(RECIPES), help="as it was trained")
    parser.add_argument("--env", required=True, help="environment id")
    parser.add_argument("--model", type=Path, help="zip file to load (holds pickles)")
    parser.add_argument("-f", "--folder", default="logs", help="log folder (default: logs)")
    parser.add_argument("--exp-id", type=int, default=0, help="run number (default: the latest)")
    parser.add_argument("--load-best", action="store_true", help="the best by evaluation")
    parser.add_argument("-n", "--n-timesteps", type=int, default=1000, help="most steps")
    parser.add_argument("--episodes", type=int, default=1, help="episodes to show")
    parser.add_argument("--seed", type=int, default=0)
    acting = parser.add_mutually_exclusive_group()
    acting.add_argument(
        "--acting",
        metavar="RULE",
        help="how the model acts: greedy, boltzmann:TEMPERATURE or epsilon:SHARE; by default by "
        "the rule that was saved with it",
    )
    acting.add_argument(
        "--deterministic",
        dest="acting",
        action="store_const",
        const=str(Kind.GREEDY),
        help="take the best actions: --acting greedy",
    )
    acting.add_argument(
        "--stochastic", action="store_true", help="act by the rule that was saved, as by default"
    )
    parser.add_argument(
        "--no-render",
        action="store_true",
        help="no picture: the task return of every episode, a mean over the pursuers that learned",
    )
    parser.add_argument("--out", type=Path, help="clip to write, .gif or .mp4, instead of a window")
    return parser
