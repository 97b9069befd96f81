"""Episodes: outcome codes, a single episode, and a container of many.

Recorded episodes (:class:`animarl_envs.demos.demonstrations.Demonstrations`) and simulated ones
(``animarl_algos.evaluation.rollouts.Rollouts``) are checked, selected, joined and stored alike, as
plain arrays and one JSON text, never as a pickle.

Recorded positions were stored on a grid: pixels, rounded decimals, fixed-point numbers. At rest,
and in headings, a grid shows; so simulations are put on the recordings' :class:`Resolution` before
the two are compared.
"""

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from animarl_envs import wall
from animarl_envs.array_types import Floats, Ints
from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.files import allowed_bytes, read_npz, refuse_special, write_then_rename
from animarl_envs.focus import is_free
from animarl_envs.settings import plain

SPLITS = ("train", "val", "test")

FILLED = "filled"
"""Signal ``(frames, individuals)``: the position was not tracked but filled in."""

HEADING = "heading"
"""Signal ``(frames, individuals)``: where the bodies point, counter-clockwise from x in the arena
frame [rad]; of a lone individual ``(frames,)`` as well."""

INTERVAL = "interval"
"""Signal ``(frames,)``: the time that led to a frame [s], where a last step may be shorter."""

# Outcome codes, one per episode. k > 0: contact by individual k - 1 (of several targets: with it).
TIME_OUT = 0
TARGET_OUT = -1  # the target, or one of them, left the boundary
PURSUER_OUT = -2  # a pursuer left the boundary
UNFINISHED = -3  # the recording was cut for another reason

FORMAT_VERSION = 1


@dataclass(frozen=True)
class Episode:
    """One recorded episode; arrays are read-only views into the container.

    ``positions`` is ``(frames, individuals, 2)`` in the arena frame [arena unit], ``velocities``
    the same in arena unit / s with the velocity belonging to the position it led to, ``signals``
    the per-frame channels by name.
    """

    index: int
    positions: Floats
    velocities: Floats
    signals: Mapping[str, NDArray[Any]]
    condition: int
    outcome: int
    split: str
    recording: str
    dt: float

    @property
    def num_steps(self) -> int:
        """Decision steps: one less than the frames."""
        return len(self.positions) - 1

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.num_steps * self.dt


@dataclass(frozen=True, eq=False, kw_only=True)
class Episodes(ABC):
    """Episodes of the same individuals, laid end to end; arrays are read-only.

    Parameters
    ----------
    individuals, roles
        Names, and for each ``"pursuer"``, ``"target"`` or ``"searcher"``.
    dt
        Time between frames [s].
    positions
        ``(frames, individuals, 2)``, all episodes end to end, arena frame [arena unit].
    lengths
        ``(episodes,)``, frames per episode; an episode of T steps has T + 1 frames.
    outcome, condition
        ``(episodes,)`` int8: outcome codes, see above; 0 or 1.
    """

    FORMAT: ClassVar[str]
    MADE_BY: ClassVar[str]  # how to come by a file, for messages
    FEWEST_FRAMES: ClassVar[int] = 1
    EACH: ClassVar[dict[str, Any]]  # arrays with an entry per episode, and their kinds
    TUPLES: ClassVar[tuple[str, ...]] = ("individuals", "roles")
    META: ClassVar[tuple[str, ...]]  # fields that are stored in the JSON text
    STORED_AS: ClassVar[dict[str, Any]] = {}  # kinds on disk, where they are others

    individuals: tuple[str, ...]
    roles: tuple[str, ...]
    dt: float
    positions: Floats
    lengths: Ints
    outcome: NDArray[np.int8]
    condition: NDArray[np.int8]

    def __post_init__(self) -> None:
        for key, dtype in {"positions": np.float64, **self.EACH}.items():
            try:
                object.__setattr__(self, key, read_only(getattr(self, key), dtype))
            except InputError as error:
                self._refuse(f"{key}: {error}")
        for key in self.TUPLES:
            object.__setattr__(self, key, tuple(getattr(self, key)))
        num, count = self.num_individuals, len(self.lengths)
        if self.positions.ndim != 3 or self.positions.shape[1:] != (num, 2):
            self._refuse(
                f"positions have shape {self.positions.shape}, not (frames, {num}, 2): "
                f"give x and y of {num} individuals per frame"
            )
        if self.lengths.ndim != 1 or count == 0:
            self._refuse("it holds no episode: check the cut, the split or the selection")
        for i in np.flatnonzero(self.lengths < self.FEWEST_FRAMES)[:1].tolist():
            length = int(self.lengths[i])
            self._refuse(
                f"episode {i} has {length} frame{'s' * (length != 1)}: leave it out, an episode "
                f"needs at least {self.FEWEST_FRAMES}"
            )
        for i in np.flatnonzero(self.lengths > len(self.positions))[:1].tolist():
            self._refuse(
                f"episode {i} has {self.lengths[i]} frames but there are {len(self.positions)} "
                "positions: cut the episodes again"
            )
        if self.lengths.sum() != len(self.positions):
            self._refuse(
                f"episode lengths add up to {self.lengths.sum()} frames but there are "
                f"{len(self.positions)} positions: cut the episodes again"
            )
        for key, dtype in self.EACH.items():
            array = getattr(self, key)
            if array.shape[:1] != (count,) or (array.ndim > 1 and dtype is not np.float64):
                self._refuse(
                    f"{key} has {array.size} entries for {count} episodes: give one for each"
                )

    @property
    @abstractmethod
    def label(self) -> str:
        """Return the name of these episodes in messages."""

    def _refuse(self, what: str) -> NoReturn:
        raise InputError(f"{self.label}: {what}")

    # -- shape ------------------------------------------------------------------------------------

    @property
    def num_individuals(self) -> int:
        """Number of individuals, K."""
        return len(self.individuals)

    @property
    def has_goal(self) -> bool:
        """Whether a target is pursued or a source searched; else one animal, or a group."""
        return not is_free(self.roles)

    @property
    def is_group(self) -> bool:
        """Whether three or more animals are alike: what is measured is a mean over them.

        The animals of a pair keep their names, such as male and female.
        """
        return self.num_individuals > 2 and not self.has_goal

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of the individuals that are described separately; a group has one for all."""
        return (f"each of {self.num_individuals}",) if self.is_group else self.individuals

    @property
    def offsets(self) -> Ints:
        """First frame of each episode, and one past the last: ``(episodes + 1,)``."""
        return np.concatenate([[0], np.cumsum(self.lengths)])

    def __len__(self) -> int:
        return len(self.lengths)

    def path(self, index: int) -> Floats:
        """Return the positions of one episode, ``(frames, individuals, 2)``."""
        start = int(self.offsets[index])
        return self.positions[start : start + int(self.lengths[index])]

    # -- selection --------------------------------------------------------------------------------

    def select(self, episodes: Any) -> Self:
        """Return the episodes of a boolean mask or of indices, in that order."""
        chosen = np.asarray(episodes)
        if chosen.size == 0 or (chosen.dtype == bool and not chosen.any()):
            self._refuse("the selection is empty: widen it")
        index = np.arange(len(self))[chosen]
        first, lengths = self.offsets[:-1][index], self.lengths[index]
        frames = np.arange(lengths.sum()) + np.repeat(first + lengths - lengths.cumsum(), lengths)
        each = {key: getattr(self, key)[index] for key in self.EACH}
        return replace(self, **self._frames(frames), **each)

    def _frames(self, frames: Ints) -> dict[str, Any]:
        """Return everything that has an entry per frame, at these frames."""
        return {"positions": self.positions[frames]}

    @classmethod
    def joined_arrays(cls, parts: Sequence[Self]) -> dict[str, Any]:
        """Return positions and all arrays per episode, concatenated over the parts."""
        return {
            key: np.concatenate([getattr(part, key) for part in parts])
            for key in ("positions", *cls.EACH)
        }

    # -- storage ----------------------------------------------------------------------------------

    def save(self, path: str | Path, *, dtype: type[np.floating] = np.float64) -> Path:
        """Write an ``.npz`` without pickle: to a temporary file first, then renamed.

        ``dtype=np.float32`` halves the size; positions are then rounded to about 6e-8.
        """
        path = Path(path)
        meta = {"format": self.FORMAT, "version": FORMAT_VERSION}
        meta |= {name: getattr(self, name) for name in self.META}
        arrays = {key: getattr(self, key) for key in ("positions", *self.EACH)}
        arrays = {
            key: value.astype(
                self.STORED_AS.get(key, dtype if value.dtype == np.float64 else value.dtype)
            )
            for key, value in arrays.items()
        }
        arrays |= {"meta": np.array(json.dumps(meta, default=plain)), **self._more_arrays()}
        with write_then_rename(path) as part, part.open("wb") as file:
            np.savez_compressed(file, **arrays)
        return path

    def _more_arrays(self) -> dict[str, NDArray[Any]]:
        return {}

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file written by :meth:`save`.

        It is decompressed in a process of its own (:mod:`animarl_envs.wall`). Raises InputError if
        the file is missing, truncated, of another format, or holds a pickle.
        """
        path = Path(path)
        refuse_special(path)
        memory = wall.MEMORY + 2 * allowed_bytes(path.stat().st_size)
        return cls._from_arrays(path, wall.call(read_npz, path, what=str(path), memory=memory))

    @classmethod
    def load_trusted(cls, path: Path) -> Self:
        """Read a file of this package as :meth:`load` does, in this process."""
        return cls._from_arrays(path, read_npz(path))

    @classmethod
    def _from_arrays(cls, path: Path, arrays: dict[str, Any]) -> Self:
        with refusing_damage(path, cls.MADE_BY):
            meta = json.loads(str(arrays.pop("meta", "{}")))
            if meta.pop("format", None) != cls.FORMAT:
                what = cls.FORMAT.removeprefix("animarl-")
                raise InputError(f"{path}: it holds no {what} of this project: {cls.MADE_BY}")
            if meta.pop("version") > FORMAT_VERSION:
                raise InputError(f"{path}: it was written by a newer animarl: upgrade this one")
            stored = cls.from_stored(path, meta, arrays)
            try:
                return cls(**stored)
            except InputError as error:
                place = "" if str(path) in str(error) else f"{path}: "
                raise InputError(f"{place}{error}") from None

    @classmethod
    def from_stored(
        cls, path: Path, meta: dict[str, Any], arrays: dict[str, NDArray[Any]]
    ) -> dict[str, Any]:
        """Return the constructor's arguments from a file's metadata and arrays."""
        return meta | arrays


def read_only(value: Any, dtype: Any) -> NDArray[Any]:
    """Return a copy of ``value`` as a read-only array of plain numbers or strings.

    Raises InputError if an entry is not a number of this kind, such as 17.7 or 257 for int8.
    """
    array = np.array(value, dtype=dtype if dtype is np.str_ else None)
    if dtype not in (None, np.str_):
        array = _as_numbers(array, dtype)
    if array.dtype == object:
        raise InputError("an array holds Python objects: give plain numbers or strings")
    array.setflags(write=False)
    return array


def _as_numbers(array: NDArray[Any], dtype: Any) -> NDArray[Any]:
    """Return numbers as ``dtype``.

    Raises InputError if they are none, or an integer ``dtype`` cannot hold one of them.
    """
    if array.size and array.dtype.kind not in "biuf":
        raise InputError(f"it is of kind {array.dtype}: give numbers")
    with np.errstate(invalid="ignore"):
        cast = array.astype(dtype)
    if np.issubdtype(dtype, np.integer):
        for value in array[cast != array][:1].tolist():
            limits = np.iinfo(dtype)
            raise InputError(f"{value} is no whole number from {limits.min} to {limits.max}")
    return cast


@contextmanager
def refusing_damage(
    path: str | Path, fix: str = "make it again with 'animarl import'"
) -> Iterator[None]:
    """Turn what the content of a damaged file raises into one sentence."""
    try:
        yield
    except (InputError, MissingExtraError, MemoryError):
        raise
    except Exception as e:
        raise InputError(f"{path}: its content is damaged ({type(e).__name__}: {e}): {fix}") from e


MIN_GRID_COORDINATES = 20  # distinct coordinates; fewer lie on a grid by chance
FINEST = 2.0**-24  # of their range: in single precision, finer steps are rounding
FINEST_DOUBLE = 2.0**-34  # of their range: in double precision, finer steps are rounding
FINEST_SINGLE = 2.0**-20  # where coordinates are themselves rounded to single precision
SINGLE = 2.0**-23  # of the largest coordinate: two such roundings, of a coordinate and the lowest
OFF = 1e-3  # steps that a coordinate may lie beside the grid


@dataclass(frozen=True)
class Resolution:
    """How positions were stored: on a grid, or as numbers of single precision.

    The grid's points are whole multiples of ``step`` from ``origin``, its point next to zero; each
    ``(x, y)``, arena frame [arena unit]. A step of zero stands for single precision.
    """

    step: tuple[float, float]
    origin: tuple[float, float]

    @property
    def single(self) -> bool:
        """Whether positions were numbers of single precision, on no coarser grid."""
        return self.step == (0.0, 0.0)

    @property
    def reach(self) -> float:
        """How far rounding moves a position within the arena at most [arena unit]."""
        return math.hypot(*self.step) / 2 + SINGLE


SINGLE_PRECISION = Resolution((0.0, 0.0), (0.0, 0.0))


def rounded(positions: Floats, resolution: Resolution | None) -> Floats:
    """Return positions ``(..., 2)`` on the grid of a resolution; unchanged without one."""
    if resolution is None:
        return positions
    if resolution.single:
        return positions.astype(np.float32).astype(np.float64)
    step, origin = np.array(resolution.step), np.array(resolution.origin)
    return np.asarray(origin + np.round((positions - origin) / step) * step)


def find_resolution(positions: Floats) -> Resolution | None:
    """Return the coarsest grid on which all positions ``(..., 2)`` lie, if both axes have one.

    Else single precision, if all are such numbers, or None.
    """
    axes = [_axis(positions[..., axis]) for axis in range(2)]
    if axes[0] is None or axes[1] is None:
        moved = len(np.unique(positions)) >= MIN_GRID_COORDINATES
        single = moved and np.array_equal(positions, positions.astype(np.float32))
        return SINGLE_PRECISION if single else None
    (x_step, x_origin), (y_step, y_origin) = axes[0], axes[1]
    return Resolution((x_step, y_step), (x_origin, y_origin))


def joint_resolution(positions: Floats, recording: NDArray[Any]) -> Resolution | None:
    """Return the grid of all positions ``(frames, K, 2)``; ``recording`` ``(frames,)`` names each.

    Where half of the recordings or more have grids of their own, such as after ``--scale-each``,
    it is one of their median step.
    """
    grid, names = find_resolution(positions), np.unique(recording)
    if grid is not None or len(names) == 1:
        return grid
    each = [find_resolution(positions[recording == one]) for one in names]
    steps = [one.step for one in each if one is not None and not one.single]
    if 2 * len(steps) < len(each):
        return None
    across, along = np.median(steps, axis=0).tolist()
    return Resolution((across, along), (0.0, 0.0))


def _axis(coordinates: Floats) -> tuple[float, float] | None:
    """Return step and origin on one axis, of coordinates in double or else single precision."""
    distinct = np.unique(coordinates)
    if len(distinct) < MIN_GRID_COORDINATES:
        return None
    lowest, largest = float(distinct[0]), float(np.abs(distinct).max())
    double = FINEST if np.array_equal(distinct, distinct.astype(np.float32)) else FINEST_DOUBLE
    for finest, rounding in ((double, 0.0), (FINEST_SINGLE, SINGLE * largest)):
        step = _common_step(distinct, finest * float(distinct[-1] - lowest), rounding)
        if step is not None:
            return step, lowest - round(lowest / step) * step
    return None


def _common_step(distinct: Floats, finest: float, rounding: float) -> float | None:
    """Return the largest step that fits all distances, by Euclid's algorithm.

    A step that does not fit leaves remainders, of which the least is the next trial.
    """
    distance, gaps = distinct[1:] - distinct[0], np.diff(distinct)
    step = float(np.min(gaps, where=gaps > finest, initial=np.inf))  # less is rounding

    def remainders(trial: float) -> Floats:
        beside = np.abs(distance - np.round(distance / trial) * trial)
        return np.asarray(beside[beside > OFF * trial + rounding])

    while finest < step < np.inf:
        for trial in (_averaged(distinct, step), step):
            left = remainders(trial)
            if not len(left):
                return trial
        step = float(left.min())
    return None


def _averaged(distinct: Floats, step: float) -> float:
    """Return the step, estimated from ever longer distances, where rounding matters less."""
    gaps = np.sort(np.diff(distinct))
    gaps, number = gaps[gaps > step / 2], 1
    while number < len(gaps):
        step = float(gaps[:number].sum() / np.round(gaps[:number] / step).sum())
        number *= 2
    lag = 1
    while lag < len(distinct):
        apart = distinct[lag:] - distinct[:-lag]
        step = float(apart.sum() / np.round(apart / step).sum())
        lag *= 2
    return step
