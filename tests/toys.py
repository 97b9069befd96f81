"""Toy worlds, each of which only one feature of a learner can solve.

All are batched SB3 ``VecEnv``s in the slot layout of the project (slot ``s`` is individual ``s %
K`` of copy ``s // K``), with the array attributes that the learners read (``extras``), and with
``get_state`` / ``set_state`` for exact resume.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

FloatArray = NDArray[np.floating[Any]]


class Toy(VecEnv):
    """Hooks of a batched toy: ``begin``, ``advance``, ``observe``; state in ``STATE`` arrays."""

    STATE: tuple[str, ...] = ()
    individuals: tuple[str, ...] = ("agent",)
    feedback: tuple[str, ...] = ()
    num_observations = 1
    num_actions = 2
    time_limit = 10

    def __init__(self, num_copies: int = 8, seed: int = 0) -> None:
        self.num_copies = num_copies
        self.extras: dict[str, NDArray[Any]] = {}
        self.step_count = np.zeros(num_copies, dtype=np.int64)
        self.rng = np.random.default_rng(seed)
        space = spaces.Box(-np.inf, np.inf, (self.num_observations,), np.float32)
        super().__init__(
            num_copies * len(self.individuals), space, spaces.Discrete(self.num_actions)
        )

    @property
    def max_episode_steps(self) -> int:
        return self.time_limit

    # -- hooks ------------------------------------------------------------------------------------

    def begin(self, copies: NDArray[np.intp]) -> None:
        raise NotImplementedError

    def advance(self, actions: NDArray[np.integer[Any]]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Rewards ``(copies, K)`` and which copies terminated, given actions ``(copies, K)``."""
        raise NotImplementedError

    def observe(self) -> FloatArray:
        """Observations ``(copies, K, n)``."""
        raise NotImplementedError

    # -- VecEnv -----------------------------------------------------------------------------------

    def reset(self) -> NDArray[np.float32]:
        self.step_count[:] = 0
        self.begin(np.arange(self.num_copies))
        return self._slots(self.observe())

    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = np.asarray(actions).reshape(self.num_copies, len(self.individuals))

    def step_wait(self) -> Any:
        self.step_count += 1
        self.extras = {}
        reward, terminated = self.advance(self._actions)
        truncated = (self.step_count >= self.time_limit) & ~terminated
        done = terminated | truncated
        observation = self._slots(self.observe())
        slots = np.repeat(done, len(self.individuals))
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for s in np.flatnonzero(slots):
            infos[s]["terminal_observation"] = observation[s].copy()
            infos[s]["TimeLimit.truncated"] = bool(truncated[s // len(self.individuals)])
        if done.any():
            copies = np.flatnonzero(done)
            self.step_count[copies] = 0
            self.begin(copies)
            observation = self._slots(self.observe())
        return observation, reward.reshape(-1).astype(np.float32), slots, infos

    def _slots(self, observation: FloatArray) -> NDArray[np.float32]:
        return observation.reshape(self.num_envs, -1).astype(np.float32)

    def get_state(self) -> dict[str, NDArray[Any]]:
        state = {name: getattr(self, name).copy() for name in ("step_count", *self.STATE)}
        words = self.rng.bit_generator.state["state"]
        state["rng"] = np.array([str(words["state"]), str(words["inc"])])
        return state

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        for name in ("step_count", *self.STATE):
            getattr(self, name)[...] = state[name]
        full = self.rng.bit_generator.state
        full["state"] = {"state": int(state["rng"][0]), "inc": int(state["rng"][1])}
        full["has_uint32"], full["uinteger"] = 0, 0
        self.rng.bit_generator.state = full

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        if seed is not None:
            self.rng = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        value = None if attr_name == "render_mode" else getattr(self, attr_name)
        return [value] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        return [getattr(self, method_name)(*args, **kwargs)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


class Recall(Toy):
    """A T-maze: the side to turn to is shown at the first step only, and asked for at the last.

    Actions: left, right, ahead. Turning before the junction ends the episode unrewarded, so that
    the way the maze was walked carries no memory: without a memory of its own, a policy is right
    half of the time.
    """

    STATE = ("side",)
    num_observations = 2
    num_actions = 3
    LENGTH = 3

    def __init__(self, num_copies: int = 8, seed: int = 0) -> None:
        self.side = np.zeros(num_copies, dtype=np.int64)
        super().__init__(num_copies, seed)

    def begin(self, copies: NDArray[np.intp]) -> None:
        self.side[copies] = self.rng.integers(2, size=len(copies))

    def advance(self, actions: NDArray[np.integer[Any]]) -> tuple[FloatArray, NDArray[np.bool_]]:
        turn = actions[:, 0]
        at_junction = self.step_count > self.LENGTH
        right_turn = at_junction & (turn == self.side)
        return right_turn.astype(float)[:, None], at_junction | (turn != 2)

    def observe(self) -> FloatArray:
        shown = np.where(self.step_count == 0, 2.0 * self.side - 1.0, 0.0)
        junction = (self.step_count == self.LENGTH).astype(float)
        return np.stack([shown, junction], axis=-1)[:, None]


class Lock(Toy):
    """A combination lock of ``LENGTH`` digits, rewarded when open; a wrong digit starts it anew.

    Actions: the three digits. The right one differs from place to place, so that neither a random
    walk nor a constant action opens it: chance has ``3 ** -LENGTH``.
    """

    STATE = ("place",)
    KEY = np.array([2, 0, 1, 1, 2, 1, 0, 0, 2, 1, 2, 0])
    LENGTH = len(KEY)
    feedback = ("dtw_penalty",)
    num_observations = LENGTH
    num_actions = 3
    time_limit = 20

    def __init__(self, num_copies: int = 8, seed: int = 0) -> None:
        self.place = np.zeros(num_copies, dtype=np.int64)
        super().__init__(num_copies, seed)

    def begin(self, copies: NDArray[np.intp]) -> None:
        self.place[copies] = 0

    def advance(self, actions: NDArray[np.integer[Any]]) -> tuple[FloatArray, NDArray[np.bool_]]:
        right = actions[:, 0] == self.KEY[self.place]
        self.extras["dtw_penalty"] = np.zeros(self.num_copies)
        self.place[:] = np.where(right, self.place + 1, 0)
        opened = self.place == self.LENGTH
        self.place[opened] = 0
        return opened.astype(float)[:, None], opened

    def observe(self) -> FloatArray:
        return self.features(self.place)[:, None]

    @classmethod
    def features(cls, place: NDArray[np.integer[Any]]) -> FloatArray:
        """One-hot place; zeros once it is open."""
        return np.asarray(place[:, None] == np.arange(cls.LENGTH), dtype=np.float64)


class GridWalk(Toy):
    """A walker on a grid, rewarded on reaching ``goal``, paired with a demonstrated path.

    Actions: east, north, west, south. ``aligned_action`` and ``dtw_penalty`` come from dynamic time
    warping of the walk so far with the demonstration, row by row, as in the paper's equation; the
    penalty is the increase of the row minimum. ``step_aligned=True`` hands out the demonstration's
    action of the same clock time instead.
    """

    STATE = ("position", "row", "minimum")
    feedback = ("dtw_penalty", "aligned_action")
    num_observations = 3
    num_actions = 4
    time_limit = 20
    MOVES = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])

    def __init__(
        self,
        path: Sequence[tuple[float, float]],
        labels: Sequence[int],
        goal: tuple[int, int],
        *,
        step_aligned: bool = False,
        margin: int = 3,
        num_copies: int = 8,
        seed: int = 0,
    ) -> None:
        self.path = np.asarray(path, dtype=np.float64)
        self.labels = np.asarray(labels)
        self.goal = np.asarray(goal)
        self.step_aligned = step_aligned
        self.margin = margin
        self.position = np.zeros((num_copies, 2), dtype=np.int64)
        self.row = np.zeros((num_copies, len(self.path)))
        self.minimum = np.zeros(num_copies)
        super().__init__(num_copies, seed)

    def begin(self, copies: NDArray[np.intp]) -> None:
        self.position[copies] = 0
        cost = np.linalg.norm(self.path[None] - self.position[copies][:, None], axis=-1)
        self.row[copies] = np.cumsum(cost, axis=1)
        self.minimum[copies] = self.row[copies].min(axis=1)

    def advance(self, actions: NDArray[np.integer[Any]]) -> tuple[FloatArray, NDArray[np.bool_]]:
        aligned = self.row.argmin(axis=1)  # of the state that the action is taken in
        if self.step_aligned:
            aligned = np.minimum(self.step_count - 1, len(self.labels) - 1)
        self.extras["aligned_action"] = self.labels[np.minimum(aligned, len(self.labels) - 1)]
        self.position += self.MOVES[actions[:, 0]]
        cost = np.linalg.norm(self.path[None] - self.position[:, None], axis=-1)
        previous = self.row.copy()
        self.row[:, 0] = previous[:, 0] + cost[:, 0]
        for j in range(1, len(self.path)):
            best = np.minimum(previous[:, j], self.row[:, j - 1])
            self.row[:, j] = cost[:, j] + np.minimum(best, previous[:, j - 1])
        minimum = self.row.min(axis=1)
        self.extras["dtw_penalty"] = minimum - self.minimum
        self.minimum[:] = minimum
        arrived = (self.position == self.goal).all(axis=1)
        self.extras["arrived"] = arrived
        outside = (np.abs(self.position - self.goal / 2) > np.abs(self.goal) / 2 + self.margin).any(
            axis=1
        )
        return arrived.astype(float)[:, None], arrived | outside

    def observe(self) -> FloatArray:
        x, y = self.position[:, 0] / 4.0, self.position[:, 1] / 4.0
        return np.stack([x, y, np.ones(self.num_copies)], axis=-1)[:, None]


class Confounded(Toy):
    """A condition that decides which action is right, and a nuisance that comes along with it.

    The observation is ``(nuisance, noise, flag)``; in training the nuisance always agrees with the
    flag and is the louder of the two. The distance penalty is 1 for the wrong action, so the right
    one is known; which of the two cues a learner relies on is not, until the flag is flipped.
    """

    STATE = ("condition", "noise")
    feedback = ("dtw_penalty", "condition")
    num_observations = 3
    num_actions = 2
    time_limit = 4
    condition_flag = True
    LOUDNESS = 3.0

    def __init__(self, num_copies: int = 8, seed: int = 0) -> None:
        self.condition = np.zeros(num_copies, dtype=np.int64)
        self.noise = np.zeros(num_copies)
        super().__init__(num_copies, seed)

    def begin(self, copies: NDArray[np.intp]) -> None:
        self.condition[copies] = self.rng.integers(2, size=len(copies))
        self.noise[copies] = self.rng.normal(size=len(copies))

    def advance(self, actions: NDArray[np.integer[Any]]) -> tuple[FloatArray, NDArray[np.bool_]]:
        self.extras["dtw_penalty"] = (actions[:, 0] != self.condition).astype(float)
        self.extras["condition"] = self.condition.copy()
        self.noise[:] = self.rng.normal(size=self.num_copies)
        never = np.zeros(self.num_copies, dtype=bool)
        return np.zeros((self.num_copies, 1)), never

    def observe(self) -> FloatArray:
        nuisance = self.LOUDNESS * (2.0 * self.condition - 1.0)
        return np.stack([nuisance, self.noise, self.condition.astype(float)], axis=-1)[:, None]


class Pair(Toy):
    """Two individuals on a ring of eight cells: the first seeks the second, which avoids it.

    Actions: left, right, stay. Both observe both places; they meet, or time runs out.
    """

    STATE = ("place",)
    individuals = ("seeker", "avoider")
    feedback = ("dtw_penalty", "aligned_action")
    num_observations = 4
    num_actions = 3
    time_limit = 12
    CELLS = 8
    MOVES = np.array([-1, 1, 0])

    def __init__(self, num_copies: int = 2, seed: int = 0) -> None:
        self.place = np.zeros((num_copies, 2), dtype=np.int64)
        super().__init__(num_copies, seed)

    def begin(self, copies: NDArray[np.intp]) -> None:
        self.place[copies, 0] = self.rng.integers(self.CELLS, size=len(copies))
        offset = 2 + self.rng.integers(self.CELLS - 3, size=len(copies))
        self.place[copies, 1] = (self.place[copies, 0] + offset) % self.CELLS

    def advance(self, actions: NDArray[np.integer[Any]]) -> tuple[FloatArray, NDArray[np.bool_]]:
        self.place[:] = (self.place + self.MOVES[actions]) % self.CELLS
        met = self.place[:, 0] == self.place[:, 1]
        reward = np.stack([met, ~met], axis=-1).astype(float)
        self.extras["dtw_penalty"] = np.abs(self.place - 4).reshape(-1) / 8.0
        self.extras["aligned_action"] = (self.place % 3).reshape(-1)
        return reward, met

    def observe(self) -> FloatArray:
        angle = 2 * np.pi * self.place / self.CELLS
        own = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.concatenate([own, own[:, ::-1]], axis=-1)


class VelocityMasked(gym.ObservationWrapper[Any, Any, Any]):
    """CartPole without its velocities: balancing it needs a memory."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        assert isinstance(env.observation_space, spaces.Box)
        low, high = env.observation_space.low[::2], env.observation_space.high[::2]
        self.observation_space = spaces.Box(low, high, dtype=np.float32)

    def observation(self, observation: Any) -> Any:
        return observation[::2]
