"""A team of ``benchmarks/baselines.py`` as TorchRL's batched environment, and BenchMARL's task."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from baselines import Team, scaled
from benchmarl.environments.common import TaskClass
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

DONE = ("done", "terminated", "truncated")


class TeamEnv(EnvBase):  # type: ignore[misc]
    """Copies ``B`` of a team of ``P``: entries under ``"team"`` are ``(B, P, ...)``."""

    def __init__(self, task: str, copies: int, seed: int) -> None:
        super().__init__(device="cpu", batch_size=[copies])
        self.task, self.team = task, Team(task, copies, seed)
        world, shape = self.team.world, (copies, len(self.team.pursuers))
        self.group_map = {"team": self.team.names}
        seen, actions = len(world.observation_components), world.num_actions

        def grouped(name: str, spec: Any) -> Any:
            return Composite({"team": Composite({name: spec}, shape=shape)}, shape=(copies,))

        self.observation_spec = grouped("observation", Unbounded((*shape, seen)))
        self.action_spec = grouped("action", Categorical(actions, shape))
        self.reward_spec = grouped("reward", Unbounded((*shape, 1)))
        flag = Categorical(2, (copies, 1), dtype=torch.bool)
        self.done_spec = Composite({name: flag.clone() for name in DONE}, shape=(copies,))

    def _told(self, **done: Any) -> dict[str, Any]:
        shown = torch.as_tensor(scaled(self.task, self.team.seen()))
        flags = {name: torch.as_tensor(value)[:, None] for name, value in done.items()}
        return {"team": TensorDict({"observation": shown}, shown.shape[:2]), **flags}

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        wanted = None if tensordict is None else tensordict.get("_reset", None)
        self.team.reset(None if wanted is None else wanted[:, 0].numpy())
        none = np.zeros(self.batch_size[0], dtype=bool)
        return TensorDict(self._told(**dict.fromkeys(DONE, none)), self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        actions = tensordict["team", "action"].numpy()
        reward, terminated, truncated = self.team.step(actions)
        told = self._told(done=terminated | truncated, terminated=terminated, truncated=truncated)
        told["team"]["reward"] = torch.as_tensor(reward.astype(np.float32))[..., None]
        return TensorDict(told, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.team.world.seed(seed + np.arange(self.batch_size[0]))


class TeamTask(TaskClass):  # type: ignore[misc]
    """A team as BenchMARL's task; its name is ours in capitals."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        return lambda: TeamEnv(self.name.lower(), num_envs, num_envs * (seed or 0))

    def supports_continuous_actions(self) -> bool:
        return False

    def supports_discrete_actions(self) -> bool:
        return True

    def max_steps(self, env: EnvBase) -> int:
        return int(env.team.world.scenario.species.time_limit)

    def has_render(self, env: EnvBase) -> bool:
        return False

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        return dict(env.group_map)

    def observation_spec(self, env: EnvBase) -> Composite:
        return env.full_observation_spec_unbatched.clone()

    def info_spec(self, env: EnvBase) -> None:
        return None

    def state_spec(self, env: EnvBase) -> None:
        return None

    def action_spec(self, env: EnvBase) -> Composite:
        return env.full_action_spec_unbatched

    def action_mask_spec(self, env: EnvBase) -> None:
        return None

    @staticmethod
    def env_name() -> str:
        return "animarl"
