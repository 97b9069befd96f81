"""Many copies at once as a native Gymnasium ``VectorEnv``, one focal individual each."""

from __future__ import annotations

import json
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium.spaces import Discrete
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Ints
from animarl_envs.errors import InputError
from animarl_envs.species import Species
from animarl_envs.views import common


class AnimalVectorEnv(  # type: ignore[misc]
    common.FocalView, VectorEnv[NDArray[np.float32], Ints, NDArray[Any]]
):
    """``num_envs`` copies of an :class:`~animarl_envs.views.single.AnimalEnv` in one kernel call.

    Copy ``b`` seeded with ``s`` gives the numbers of a single environment seeded with ``s + b``.

    Parameters
    ----------
    num_envs
        Number of copies.
    autoreset_mode
        ``NEXT_STEP`` (Gymnasium's default: the step after an end resets and ignores the action),
        ``SAME_STEP`` (the last observation is in ``infos["final_obs"]``) or ``DISABLED``.
    render_mode
        ``"rgb_array"`` or ``None``.
    max_episode_steps
        Gymnasium's name for the most steps of an episode, which truncate it; by default the
        species' time limit alone does.
    species, focal, others, options
        As in :class:`~animarl_envs.views.single.AnimalEnv`.

    Notes
    -----
    It truncates by itself at the time limit of the scenario. ``reset_by_step`` ``(num_envs,)``
    tells which copies the last ``step`` has reset instead of stepped (``NEXT_STEP``). ``infos``
    hold what those of an :class:`~animarl_envs.views.single.AnimalEnv` do, as arrays
    ``(num_envs,)``, each with its mask ``_key``; ``scenario`` is one dictionary that all share.
    Only those of ``reset`` have ``scenario``, and only those of ``step`` have ``warmup`` and
    ``executed``, which say nothing of a copy that the step has reset.
    """

    metadata: dict[str, Any] = {
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        species: Species | str,
        num_envs: int = 1,
        *,
        focal: str | None = None,
        others: common.Others = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        **options: Any,
    ) -> None:
        if isinstance(num_envs, bool) or not isinstance(num_envs, int) or num_envs < 1:
            raise InputError(f"num_envs is {num_envs!r}: it must be a whole number, at least 1")
        self._most = common.checked_limit("max_episode_steps", max_episode_steps)
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            raise InputError(
                f"autoreset_mode is {autoreset_mode!r}: choose one of "
                f"{', '.join(mode.value for mode in AutoresetMode)}"
            ) from None
        self._build_focal(species, num_envs, focal, others, render_mode, options)
        self.metadata["autoreset_mode"] = self.autoreset_mode
        self.num_envs = num_envs
        self.single_observation_space = common.observation_space(self.world)
        self.single_action_space = Discrete(self.world.num_actions)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.reset_by_step = np.zeros(num_envs, dtype=bool)
        self._ended = np.ones(num_envs, dtype=bool)
        self._all = np.ones(num_envs, dtype=bool)

    close = VectorEnv.close  # type: ignore[assignment]

    @property
    def time_limit(self) -> int:
        """Longest episode [steps], which truncates it."""
        return super().time_limit if self._most is None else min(super().time_limit, self._most)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start new episodes.

        ``options={"reset_mask": mask}`` starts them in those copies only, and ``{"demo": i}`` from
        that demonstration (one number, or one per copy, -1 for any).

        A list of seeds has one per copy; where it is ``None``, and where a mask leaves an episode
        running, the copy's stream goes on.
        """
        given = common.reset_options(options, "demo", "reset_mask")
        mask = np.array(given.get("reset_mask", self._all), dtype=bool)
        if mask.shape != (self.num_envs,):
            raise InputError(f"reset_mask has shape {mask.shape}: give ({self.num_envs},)")
        self._seed(seed, mask)
        demo = common.chosen_demos(given.get("demo"), self.scenario, self.num_envs)
        self.world.reset(mask, demo=demo)
        self._started = True
        self._ended[mask] = False
        self.reset_by_step[:] = False
        self._pictures.follow(mask, stepped=False)
        infos = self._infos()
        described = np.full(self.num_envs, None, dtype=object)
        described[:] = [json.loads(self._description)] * self.num_envs
        return self._observation(), self._masked(infos | {"scenario": described})

    def _seed(self, seed: int | Sequence[int | None] | None, mask: Bools) -> None:
        """Start the random streams: before the first episode, and whenever a seed is given.

        Those of copies that run on, outside of ``mask``, stay.
        """
        listed = list(seed) if isinstance(seed, list | tuple) else None
        if seed is None and self._started:
            return
        if listed is not None and len(listed) != self.num_envs:
            raise InputError(f"seed lists {len(listed)} seeds: give {self.num_envs}, one per copy")
        one = seed if listed is None else next((s for s in listed if s is not None), None)
        super().reset(seed=one)  # type: ignore[arg-type]  # Gymnasium's own generator
        if seed is None or (listed is not None and not self._started):
            self.world.seed(self.np_random.integers(2**63, size=self.num_envs))
        streams, kept = self.world.random_state.copy(), ~mask & self._started
        if isinstance(seed, int | np.integer):
            self.world.seed(
                np.arange(self.num_envs, dtype=np.uint64) + common.stream_seed(int(seed))
            )
        elif listed is not None:
            kept |= np.array([s is None for s in listed])
            self.world.seed(np.array([common.stream_seed(s or 0) for s in listed]))
        self.world.random_state[kept] = streams[kept]

    def step(
        self, actions: Ints
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """One decision step of every copy."""
        if not self._started:
            raise InputError("step was called before reset: call reset first")
        world, i = self.world, self.focal_index
        self._actions[:, i] = common.check_actions(actions, (self.num_envs,), world.num_actions)
        due = self._ended.copy()  # copies to reset instead of stepping them
        resetting = np.count_nonzero(due) > 0
        if resetting:
            if self.autoreset_mode is AutoresetMode.DISABLED:
                raise InputError(
                    f"copy {int(np.argmax(due))} has ended: reset it with "
                    "reset(options={'reset_mask': ...}) before the next step"
                )
            streams = world.random_state[due]
        self._drive_others()
        warming, executed = world.warming.copy(), self.world.executed(self._actions)[:, i].copy()
        world.step(self._actions, observed=not resetting)
        self.reset_by_step = due
        if resetting:
            world.random_state[due] = streams  # as if the step had not been
            world.reset(due)
            warming[due] = False
        common.cut_after(world, self._most)
        self._pictures.follow(due)
        ended = world.terminated | world.truncated
        reward = world.reward[:, i].copy()
        terminated, truncated = world.terminated.copy(), world.truncated.copy()
        infos = self._masked(self._infos() | {"warmup": warming, "executed": executed})
        self._ended = ended
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            if np.count_nonzero(ended):
                self._reset_same_step(ended, infos)
            self._ended = np.zeros_like(ended)
        return self._observation(), reward, terminated, truncated, infos

    def _reset_same_step(self, ended: Bools, infos: dict[str, Any]) -> None:
        """Keep what ended under ``final_obs`` and ``final_info``, and start anew."""
        last = self._observation()
        final = np.full(self.num_envs, None, dtype=object)
        for b in np.flatnonzero(ended):
            final[b] = last[b]
        final_info = {
            key: ended.copy() if key.startswith("_") else value.copy()
            for key, value in infos.items()
        }
        self.world.reset(ended)
        self._pictures.follow(ended, stepped=False)
        infos |= self._infos()
        infos["final_obs"], infos["_final_obs"] = final, ended.copy()
        infos["final_info"], infos["_final_info"] = final_info, ended.copy()

    def render(self) -> tuple[NDArray[np.uint8], ...]:
        """Return the present scene of each copy, ``(height, width, 3)`` uint8.

        Only the first :data:`~animarl_envs.drawing.render.MOST_DRAWN` are drawn, others are blank.
        """
        return tuple(self._pictures.draw())

    def _masked(self, infos: dict[str, Any]) -> dict[str, Any]:
        """With a mask for each entry, one array for all: every copy has it."""
        mask = self._all.copy()
        return infos | {f"_{key}": mask for key in infos}

    def _observation(self) -> NDArray[np.float32]:
        return self.world.observations_of(self.focal_index)

    def _infos(self) -> dict[str, Any]:
        world, i = self.world, self.focal_index
        infos: dict[str, Any] = {
            "demo": world.demo.copy(),
            "condition": world.condition.astype(np.int64),
            "step": world.step_count.copy(),
            "outcome": world.outcome.astype(np.int64),
        }
        paid = world.components[:, i].T.copy()
        return infos | dict(zip(world.reward_components, paid, strict=True))

    def __deepcopy__(self, memo: dict[int, Any]) -> AnimalVectorEnv:
        twin = object.__new__(type(self))
        memo[id(self)] = twin
        for key, value in vars(self).items():
            setattr(twin, key, deepcopy(value, memo))
        return twin
