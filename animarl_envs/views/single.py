"""One focal individual as a ``gymnasium.Env``; the others replay, follow a policy or a rule."""

import json
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Discrete
from numpy.typing import NDArray

from animarl_envs.drawing.render import RENDER_MODES
from animarl_envs.errors import InputError
from animarl_envs.species import Species
from animarl_envs.views.common import FocalView, Others, check_action, observation_space

KEYS = {
    "w": 0,
    "wa": 30,
    "q": 60,
    "a": 90,
    "z": 120,
    "sa": 150,
    "s": 180,
    "sd": 210,
    "c": 240,
    "d": 270,
    "e": 300,
    "wd": 330,
}
"""Directions by key, counter-clockwise from the focus [deg]."""


class AnimalEnv(FocalView, gym.Env[NDArray[np.float32], np.int64]):  # type: ignore[misc]
    """A recorded animal, in the world of its species or in a task.

    Parameters
    ----------
    species
        A species, or the name or id of one or of a task (:mod:`animarl_envs.tasks`).
    focal
        Name of the individual that acts; by default the first pursuer.
    others
        ``"replay"`` (their demonstration; they coast when it ends), ``"scripted"``, ``"packaged"``
        (the network that comes with the package: :mod:`animarl_algos.runs.opponents`), ``"coast"``,
        a function from observations ``(B, n)`` to actions ``(B,)``, or a mapping from names to
        these.
        By default they replay where episodes start from demonstrations, and follow their script
        otherwise; in a task they always follow their script.
    render_mode
        ``"rgb_array"``, ``"human"`` or ``None``.
    options
        Of :func:`animarl_envs.scenario.make_scenario`: ``demos``, ``split``, ``condition``,
        ``start``, ``num_pursuers``, ``arena``, ``contact_radius``, ``locomotion``, ...

    Notes
    -----
    ``info`` holds ``demo`` (index of the paired demonstration in the chosen split, -1 without),
    ``condition``, ``step``, ``warmup`` (the step was replayed from the demonstration, so the action
    had no effect), after a step ``executed`` (the action that had: the demonstrated one in a
    warm-up), each reward component under its own name, ``outcome`` (k above 0: contact by
    individual k - 1; 0: time limit, and as long as the episode goes on; -1: the target left the
    arena; -2: a pursuer left it), and at reset ``scenario``. ``reset(options={"demo": 3})`` starts
    from demonstration 3.

    Raises
    ------
    InputError
        If an option or an action is not valid, in one sentence.

    Examples
    --------
    >>> import gymnasium as gym, animarl_envs
    >>> env = gym.make("AnimaRL/Agent-v0", focal="predator_1")
    >>> observation, info = env.reset(seed=0)
    >>> observation.shape
    (44,)
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 10}
    feedback: tuple[str, ...] = ("executed", "warmup", "condition")
    """What learners may read in ``info``, beside the reward."""

    def __init__(
        self,
        species: Species | str,
        *,
        focal: str | None = None,
        others: Others = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self._build_focal(species, 1, focal, others, render_mode, options)
        self.observation_space = observation_space(self.world)  # type: ignore[assignment]
        self.action_space = Discrete(self.world.num_actions)
        self._running = False

    def get_keys_to_action(self) -> dict[str, int]:
        """Return the keys for :func:`gymnasium.utils.play.play`.

        They are w towards the focus, a left, s away, d right, others and pairs in between; space
        coasts (give it as ``noop`` too).
        """
        own = self.scenario.species.locomotion[self.focal_index]
        angles = {key: np.deg2rad(degrees) for key, degrees in KEYS.items()}
        pushes = {
            key: int(np.argmax(own.action_vectors @ [np.cos(angle), np.sin(angle)]))
            for key, angle in angles.items()
        }
        return pushes | {" ": own.idle_action}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start a new episode; ``options={"demo": i}`` chooses the demonstration."""
        super().reset(seed=seed)
        self._restart(seed, lambda: self.np_random.integers(2**63, size=1), options)
        self._running = True
        return self._observation(), {**self._info(), "scenario": json.loads(self._description)}

    def step(
        self, action: np.int64 | int
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """One decision step of the focal individual."""
        if not self._running:
            raise InputError("step was called before reset or after the end: call reset first")
        action = check_action(action, self.world.num_actions)
        world, i = self.world, self.focal_index
        warming = world.warming.item()
        self._actions[0, i] = action
        self._drive_others()
        done = self.world.executed(self._actions).item(0, i) if warming else action
        world.step(self._actions)
        terminated, truncated = world.terminated.item(), world.truncated.item()
        self._running = not (terminated or truncated)
        self._pictures.follow([False])
        info = self._info(warming)
        info["executed"] = done
        return self._observation(), world.reward.item(i), terminated, truncated, info

    def _observation(self) -> NDArray[np.float32]:
        row: NDArray[np.float32] = self.world.observation[0, self.focal_index].copy()
        return row

    def _info(self, warming: bool = False) -> dict[str, Any]:
        info, world = self._shared_info(warming), self.world
        parts = world.components[0, self.focal_index].tolist()
        info.update(zip(world.reward_components, parts, strict=True))
        return info
