"""Ten more libraries that take the environments as they are, a function for each.

    python examples/more_libraries.py skrl --steps 2000

A line at the end says what was seen. Each library wants an environment of its own, which
``docs/make_clients_page.py`` makes; CleanRL and EPyMARL are no packages: name the folder of a
checkout in ``$CLEANRL`` or ``$EPYMARL``.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium as gym
import numpy as np

from animarl_envs import newt_v0, parallel_env


def torchrl(steps: int, seed: int) -> str:
    """TorchRL: its multi-agent wrapper with a global state, its checks, and a collector."""
    from torchrl.collectors import Collector
    from torchrl.envs import PettingZooWrapper, check_env_specs

    env = PettingZooWrapper(parallel_env("newt"), return_state=True)
    env.set_seed(seed)
    check_env_specs(env)
    collector = Collector(env, None, frames_per_batch=200, total_frames=steps)
    rewards = [batch["next", "male", "reward"].sum().item() for batch in collector]
    collector.shutdown()
    state = env.observation_spec["state"].shape[-1]
    return f"groups {sorted(env.group_map)}, state of {state} numbers, rewards {sum(rewards):.2f}"


def benchmarl(steps: int, seed: int) -> str:
    """BenchMARL: MAPPO, a network for the males and one for the female."""
    from benchmarl.algorithms import MappoConfig
    from benchmarl.environments.pettingzoo.common import PettingZooClass
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig
    from torchrl.envs import PettingZooWrapper

    class NewtTask(PettingZooClass):  # type: ignore[misc]
        def get_env_fun(
            self, num_envs: int, continuous_actions: bool, seed: Any, device: Any
        ) -> Any:
            return lambda: PettingZooWrapper(
                newt_v0.parallel_env(), return_state=True, seed=seed, device=device
            )

        def supports_discrete_actions(self) -> bool:
            return True

        def has_state(self) -> bool:
            return True

    NewtTask.__qualname__ = "NewtTask"
    globals()["NewtTask"] = NewtTask  # BenchMARL pickles the class by its name
    config = ExperimentConfig.get_from_yaml()
    config.max_n_frames, config.max_n_iters = steps, None
    config.on_policy_collected_frames_per_batch = 200
    config.on_policy_n_envs_per_worker, config.on_policy_n_minibatch_iters = 2, 2
    config.on_policy_minibatch_size = 100
    config.evaluation, config.loggers, config.create_json = False, [], False
    config.save_folder = tempfile.mkdtemp()
    limit = newt_v0.parallel_env().scenario_data["time_limit"]
    experiment = Experiment(
        task=NewtTask("NEWT", {"max_cycles": limit}),
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=seed,
        config=config,
    )
    experiment.run()
    return f"{experiment.total_frames} frames, mean return {experiment.mean_return:.2f}"


def skrl(steps: int, seed: int) -> str:
    """skrl: IPPO, a network for each individual."""
    import torch
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.memories.torch import RandomMemory
    from skrl.models.torch import CategoricalMixin, DeterministicMixin, Model
    from skrl.multi_agents.torch.ippo import IPPO
    from skrl.trainers.torch import SequentialTrainer
    from skrl.utils import set_seed

    def network(mixin: Any, outputs: int, **spaces: Any) -> Any:
        class Network(mixin, Model):  # type: ignore[misc]
            def __init__(self) -> None:
                Model.__init__(self, **spaces)
                mixin.__init__(self)
                self.net = torch.nn.Sequential(
                    torch.nn.Linear(self.num_observations, 64),
                    torch.nn.Tanh(),
                    torch.nn.Linear(64, outputs),
                )

            def compute(self, inputs: Any, role: str = "") -> Any:
                return self.net(inputs["observations"]), {}

        return Network()

    set_seed(seed)
    env = wrap_env(newt_v0.parallel_env(), wrapper="pettingzoo")
    models = {}
    for name in env.possible_agents:
        spaces = {
            "observation_space": env.observation_space(name),
            "action_space": env.action_space(name),
            "device": env.device,
        }
        models[name] = {
            "policy": network(CategoricalMixin, env.action_space(name).n, **spaces),
            "value": network(DeterministicMixin, 1, **spaces),
        }
    first = next(iter(models.values()))["policy"].net[0].weight.detach().clone()
    parts = ["observation_preprocessor", "state_preprocessor", "value_preprocessor"]
    parts.append("learning_rate_scheduler")  # skrl 2.1.1 refuses its own default, an empty table
    agents = IPPO(
        possible_agents=env.possible_agents,
        models=models,
        memories={name: RandomMemory(memory_size=64) for name in env.possible_agents},
        observation_spaces=env.observation_spaces,
        state_spaces=env.state_spaces,
        action_spaces=env.action_spaces,
        device=env.device,
        cfg={
            "rollouts": 64,
            "experiment": {"write_interval": 0, "checkpoint_interval": 0},
            **{f"{part}_kwargs": {name: {} for name in models} for part in parts},
        },
    )
    SequentialTrainer(env=env, agents=agents, cfg={"timesteps": steps, "headless": True}).train()
    moved = (next(iter(models.values()))["policy"].net[0].weight - first).abs().max().item()
    return f"IPPO of {', '.join(env.possible_agents)}, weights moved by {moved:.4f}"


def tianshou(steps: int, seed: int) -> str:
    """Tianshou: DQN for each individual on PettingZoo's turns."""
    from tianshou.algorithm import DQN
    from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
    from tianshou.algorithm.multiagent.marl import MultiAgentOffPolicyAlgorithm
    from tianshou.algorithm.optim import AdamOptimizerFactory
    from tianshou.data import Collector, VectorReplayBuffer
    from tianshou.env import DummyVectorEnv
    from tianshou.env.pettingzoo_env import PettingZooEnv
    from tianshou.utils.net.common import Net

    def make() -> Any:
        return PettingZooEnv(newt_v0.env())

    env, learners = make(), []
    for _ in env.agents:
        net = Net(
            state_shape=env.observation_space.shape, action_shape=env.action_space.n,
            hidden_sizes=[64],
        )  # fmt: skip
        policy = DiscreteQLearningPolicy(
            model=net, action_space=env.action_space, observation_space=env.observation_space,
            eps_training=0.3,
        )  # fmt: skip
        learners.append(DQN(policy=policy, optim=AdamOptimizerFactory(lr=1e-3)))
    everyone = MultiAgentOffPolicyAlgorithm(algorithms=learners, env=env)
    buffer = VectorReplayBuffer(steps, 2)
    collector = Collector(everyone, DummyVectorEnv([make, make]), buffer)
    collector.reset()
    collected = collector.collect(n_step=steps)
    from tianshou.algorithm.algorithm_base import policy_within_training_step
    from tianshou.utils.torch_utils import torch_train_mode

    with policy_within_training_step(everyone.policy), torch_train_mode(everyone):
        loss = everyone.update(buffer=buffer, sample_size=64)
    return f"{collected.n_collected_steps} turns, {len(loss.get_loss_stats_dict())} losses"


def epymarl(steps: int, seed: int) -> str:
    """EPyMARL: its Gymma and PettingZoo wrappers, each episode to its end."""
    package = ModuleType("envs")  # without its front door, which asks for other simulators
    package.__path__ = [str(Path(os.environ["EPYMARL"]) / "src" / "envs")]
    sys.modules |= {"envs": package, "pettingzoo.animarl.newt_v0": newt_v0}  # where it looks
    from envs.gymma import GymmaWrapper

    gym.register(
        "pz-animarl-newt-v0", "envs.pz_wrapper:PettingZooWrapper",
        kwargs={"lib_name": "animarl", "env_name": "newt_v0"},
    )  # fmt: skip
    env = GymmaWrapper(
        "pz-animarl-newt-v0", time_limit=100, pretrained_wrapper=None, seed=seed,
        common_reward=True, reward_scalarisation="sum",
    )  # fmt: skip
    about, draw = env.get_env_info(), np.random.default_rng(seed)
    env.reset(seed=seed)
    episodes, total = 0, 0.0
    for _ in range(steps):
        assert env.get_state().shape == (about["state_shape"],)
        _, reward, done, truncated, _ = env.step(
            draw.integers(about["n_actions"], size=about["n_agents"])
        )
        total += reward
        if done or truncated:
            episodes += 1
            env.reset()
    return f"{about['n_agents']} agents, {episodes} episodes, rewards {total:.2f}"


def d3rlpy(steps: int, seed: int) -> str:
    """d3rlpy: DQN online, and discrete cloning of a dataset that Minari recorded."""
    os.environ["MINARI_DATASETS_PATH"] = tempfile.mkdtemp()
    import d3rlpy as d3
    import minari

    d3.seed(seed)
    env = gym.make("AnimaRL/NewtTask-v0")
    quiet: dict[str, Any] = {
        "logger_adapter": d3.logging.NoopAdapterFactory(),
        "show_progress": False,
    }
    online = d3.algos.DQNConfig().create()
    buffer = d3.dataset.create_fifo_replay_buffer(limit=steps, env=env)
    online.fit_online(env, buffer, n_steps=steps, n_steps_per_epoch=steps, **quiet)
    recorder = minari.DataCollector(env)
    for episode in range(3):
        recorder.reset(seed=seed + episode)
        over = False
        while not over:
            _, _, terminated, truncated, _ = recorder.step(recorder.action_space.sample())
            over = terminated or truncated
    recorder.create_dataset("animarl/newt/random-v0", algorithm_name="random", eval_env=env)
    shown, _ = d3.datasets.get_minari("animarl/newt/random-v0")
    clone = d3.algos.DiscreteBCConfig().create()
    clone.fit(shown, n_steps=100, n_steps_per_epoch=100, **quiet)
    action = clone.predict(env.reset(seed=seed)[0][None])[0]
    return f"{buffer.transition_count} own steps, {shown.transition_count} shown, action {action}"


def cleanrl(steps: int, seed: int) -> str:
    """CleanRL: its ppo.py as it is, with an id of this package."""
    script = Path(os.environ["CLEANRL"]) / "cleanrl" / "ppo.py"
    command = [
        sys.executable, str(script), "--env-id", "animarl_envs:AnimaRL/NewtTask-v0",
        "--num-steps", "64", "--total-timesteps", str(steps), "--seed", str(seed),
    ]  # fmt: skip
    folder = tempfile.mkdtemp()
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr)
    rounds = done.stdout.count("SPS")
    return f"{rounds} rounds of PPO on four copies"


def pufferlib(steps: int, seed: int) -> str:
    """PufferLib: its emulation of a single and of a multi-agent environment."""
    from pufferlib.emulation import GymnasiumPufferEnv, PettingZooPufferEnv

    single = GymnasiumPufferEnv(env_creator=lambda **_: gym.make("AnimaRL/NewtTask-v0"))
    single.reset(seed=seed)
    everyone = PettingZooPufferEnv(env_creator=lambda **_: newt_v0.parallel_env())
    everyone.reset(seed=seed)
    ends = 0
    for _ in range(steps):
        if single.done:
            single.reset()
        if everyone.done:
            everyone.reset()
        single.step(single.action_space.sample())
        seen, _, over, cut, _ = everyone.step(
            {name: everyone.single_action_space.sample() for name in everyone.possible_agents}
        )
        ends += any(over.values()) or any(cut.values())
    return f"{len(seen)} individuals, {ends} episodes"


def make_newt(*_: Any, **__: Any) -> Any:
    """Make the environment, as Sample Factory asks for it."""
    return gym.make("AnimaRL/NewtTask-v0")


def sample_factory(steps: int, seed: int) -> str:
    """Sample Factory: APPO on one process."""
    from sample_factory.cfg.arguments import parse_full_cfg, parse_sf_args
    from sample_factory.envs.env_utils import register_env
    from sample_factory.train import run_rl

    register_env("animarl_newt", make_newt)
    asked = [
        "--env=animarl_newt", "--device=cpu", "--serial_mode=True", "--async_rl=False",
        "--num_workers=1", "--num_envs_per_worker=2", "--rollout=32", "--batch_size=64",
        "--num_batches_per_epoch=1", f"--train_for_env_steps={steps}", f"--seed={seed}",
        f"--train_dir={tempfile.mkdtemp()}", "--experiment=newt", "--use_rnn=False",
    ]  # fmt: skip
    parser, _ = parse_sf_args(asked)
    status = run_rl(parse_full_cfg(parser, asked))
    if status:
        raise SystemExit(f"Sample Factory ended with status {status}")
    return "APPO ended well"


def supersuit(steps: int, seed: int) -> str:
    """SuperSuit: four steps with one action each, all individuals."""
    from supersuit import frame_skip_v0

    env = frame_skip_v0(parallel_env("newt"), 4)
    draw, episodes, longest = np.random.default_rng(seed), 0, 0
    env.reset(seed=seed)
    for _ in range(steps):
        actions = {name: int(draw.integers(env.action_space(name).n)) for name in env.agents}
        infos = env.step(actions)[4]
        longest = max(longest, *(int(info["step"]) for info in infos.values()))
        if not env.agents:
            env.reset()
            episodes += 1
    return f"{episodes} episodes, the longest of {longest} steps of the world"


LIBRARIES: dict[str, Callable[[int, int], str]] = {
    f.__name__: f
    for f in (
        torchrl,
        benchmarl,
        skrl,
        tianshou,
        epymarl,
        d3rlpy,
        cleanrl,
        pufferlib,
        sample_factory,
        supersuit,
    )
}


def main(arguments: Sequence[str] | None = None) -> str:
    """Run one of the libraries; return what was seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("library", choices=LIBRARIES)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    said = LIBRARIES[options.library](options.steps, options.seed)
    print(f"{options.steps} steps, {said}")
    return said


if __name__ == "__main__":
    main()
