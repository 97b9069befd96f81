"""All individuals at once as a PettingZoo ``ParallelEnv``."""

import json
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from animarl_envs.drawing.render import RENDER_MODES
from animarl_envs.errors import InputError, also_list_options_of
from animarl_envs.scenario import make_scenario
from animarl_envs.species import Species
from animarl_envs.views import common

Observations = dict[str, NDArray[np.float32]]
NONE_YET = -1  # in the place of an executed action


class AnimalParallelEnv(common.View, ParallelEnv[str, NDArray[np.float32], int]):
    """Every individual of a species acts; all end together.

    Parameters
    ----------
    species
        A species, or the name or id of one or of a task (:mod:`animarl_envs.tasks`).
    render_mode
        ``"rgb_array"``, ``"human"`` or ``None``.
    max_cycles
        PettingZoo's name for the most steps of an episode, which truncate it; by default the
        species' time limit alone does.
    options
        Of :func:`animarl_envs.scenario.make_scenario`.

    Notes
    -----
    ``infos[agent]`` holds the numbers of :class:`~animarl_envs.views.single.AnimalEnv`, the same
    names at reset (where ``executed`` is -1) and at every step, and ``TimeLimit.truncated``, for
    libraries that do not look at truncations: True where a time limit ended the episode, and at
    the reset that follows, whose infos SuperSuit lays over those of the end. ``scenario_data``
    describes the world. Wrappers may draw from ``np_random``, which ``reset(seed=...)`` seeds;
    the world has streams of its own.
    """

    metadata: dict[str, Any] = {
        "name": "animarl",
        "render_modes": list(RENDER_MODES),
        "is_parallelizable": True,
        "render_fps": 10,
    }

    def __init__(
        self,
        species: Species | str,
        *,
        render_mode: str | None = None,
        max_cycles: int | None = None,
        **options: Any,
    ) -> None:
        with also_list_options_of(AnimalParallelEnv.__init__):
            scenario = make_scenario(species, **options)
        self.max_cycles = common.checked_limit("max_cycles", max_cycles)
        self._build(scenario, 1, render_mode)
        self.metadata["name"] = f"animarl_{scenario.species.name}_v0"
        self.possible_agents = list(scenario.names)
        self.agents: list[str] = []
        self.observation_spaces = {
            a: common.observation_space(self.world) for a in self.possible_agents
        }
        actions = self.world.num_actions
        self.action_spaces = {a: spaces.Discrete(actions) for a in self.possible_agents}
        self.np_random = np.random.default_rng()
        self._cut = False  # whether a time limit ended the last episode
        size = 4 * len(self.possible_agents)
        self.state_space = spaces.Box(-np.inf, np.inf, (size,), dtype=np.float32)

    @property
    def scenario_data(self) -> dict[str, Any]:
        """All numbers of the world and its options, as plain data."""
        data: dict[str, Any] = json.loads(self._description)
        return data

    def observation_space(self, agent: str) -> spaces.Box:
        """Return the space of one individual, the same object each time."""
        return self.observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return the actions of one individual, the same object each time."""
        return self.action_spaces[self._known(agent)]

    def _known(self, agent: str) -> str:
        if agent in self.possible_agents:
            return agent
        raise InputError(
            f"there is no individual {agent!r}: choose one of {', '.join(self.possible_agents)}"
        )

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, dict[str, Any]]]:
        """Start a new episode of all; ``options={"demo": i}`` chooses the demonstration."""
        fresh = partial(np.random.SeedSequence().generate_state, 1, np.uint64)
        self._restart(seed, fresh, options, strict=False)  # PettingZoo's own test gives others
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        self.agents = list(self.possible_agents)
        infos = self._infos([NONE_YET] * len(self.agents), False, self._cut)
        return self._observations(), infos

    def step(
        self, actions: dict[str, int]
    ) -> tuple[
        Observations, dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
    ]:
        """One decision step of all individuals."""
        if not self.agents:
            raise InputError("step was called before reset or after the end: call reset first")
        world, agents = self.world, self.agents
        self._take(actions)
        warming = world.warming.item()
        executed = world.executed(self._actions)[0] if warming else self._actions[0]
        executed = executed.tolist()
        world.step(self._actions)
        common.cut_after(world, self.max_cycles)
        self._pictures.follow([False])
        reward = world.reward[0].tolist()
        terminated, truncated = world.terminated.item(), world.truncated.item()
        observations, infos = self._observations(), self._infos(executed, warming, truncated)
        if terminated or truncated:
            self._cut = truncated
            self.agents = []
        return (
            observations,
            dict(zip(agents, reward)),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            infos,
        )

    def _take(self, actions: dict[str, int]) -> None:
        """Check the actions and write them down in order."""
        count = self.world.num_actions
        if not isinstance(actions, Mapping):
            raise InputError(
                f"actions are {actions!r}: give one to each of {', '.join(self.agents)}"
            )
        if len(actions) > len(self.agents):
            stranger = next(agent for agent in actions if agent not in self.agents)
            raise InputError(
                f"there is an action for {stranger!r}: choose among {', '.join(self.agents)}"
            )
        chosen = []
        for agent in self.possible_agents:
            if agent not in actions:
                raise InputError(
                    f"there is no action for {agent}: give one to each of {', '.join(self.agents)}"
                )
            chosen.append(common.check_action(actions[agent], count, f" of {agent}"))
        self._actions[0] = chosen

    def state(self) -> NDArray[np.float32]:
        """Return positions and velocities of all, flat, arena frame: ``(4 K,)``."""
        both = np.concatenate([self.world.position[0], self.world.velocity[0]], axis=1)
        return both.astype(np.float32).ravel()

    def _observations(self) -> Observations:
        return dict(zip(self.agents, self.world.observation[0].copy()))  # a row each

    def _infos(self, executed: list[int], warming: bool, cut: bool) -> dict[str, dict[str, Any]]:
        shared, names = self._shared_info(warming), self.world.reward_components
        shared["TimeLimit.truncated"] = cut
        infos = {}
        for agent, own, action in zip(self.agents, self.world.components[0].tolist(), executed):
            infos[agent] = info = shared.copy()
            info.update(zip(names, own))
            info["executed"] = action
        return infos
