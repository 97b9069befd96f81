"""Fitting all individuals of demonstrations: intervals, the RMSE, and what makes a fit doubtful."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.demos.summary import tracking_noise
from animarl_envs.errors import InputError
from animarl_envs.files import read_json
from animarl_envs.fitting.cells import RecordedCells, cells_of_recordings, with_cells
from animarl_envs.fitting.joint import bootstrap_joint, fast_speed, fit_joint, joint_locomotion
from animarl_envs.fitting.transitions import (
    bootstrap_onset,
    fit_onset,
    onset_data,
    top_speed,
    transitions,
    velocity_rmse,
)
from animarl_envs.locomotion import Locomotion
from animarl_envs.species import SPECIES

Method = Literal["joint", "onset", "species"]
Interval = tuple[float, float]
CONFIDENCE = 0.95  # of intervals
BOOTSTRAP = 1000
MAX_TERMINAL_SPEED = 2.0  # in recorded top speeds, above which a fit is doubtful
MAX_DAMPING_CHANGE = 0.1  # relative, beyond the interval, when tracking jumps are left in
MAX_NOISE = 0.1  # of tracking, in median steps, beyond which the joint fit overestimates u
ROUNDING = 1e-6  # of differences of d
NEAR_ZERO = 1e-3  # an interval of d that begins below it reaches zero
SLOW_SHARE = 0.03  # of the top speed: below it an animal of no known species counts as resting


@dataclass(frozen=True)
class IndividualFit:
    """Fitted locomotion of one individual.

    Intervals are 95 % percentile intervals over resampled episodes; ``None`` with too few episodes
    or with several thrust magnitudes. ``onsets`` is the number of rest-to-motion transitions (onset
    fit only); ``resamples_without_onset`` were left out of the intervals.
    """

    name: str
    damping: float
    thrust: float  # [arena unit / s^2]
    damping_interval: Interval | None
    thrust_interval: Interval | None
    velocity_rmse: float  # on the validation episodes [arena unit / s]
    steps: int  # transitions the parameters come from
    top_speed: float  # median of the recorded speeds above their 99th percentile [arena unit / s]
    terminal_speed: float  # what the largest thrust, held, would lead to [arena unit / s]
    braking_time: float  # until coasting has lost all but 1/e of the speed [s]
    magnitudes: tuple[float, ...] = (1.0,)  # multiples of the thrust, the largest first
    onsets: int | None = None
    resamples_without_onset: int = 0

    @property
    def locomotion(self) -> Locomotion:
        """The parameters for a species spec."""
        return Locomotion(self.damping, self.thrust, self.magnitudes)


@dataclass(frozen=True)
class LocomotionFit:
    """Fitted locomotion of all individuals, in their order."""

    method: Method
    species: str
    dt: float  # [s]
    individuals: tuple[IndividualFit, ...]
    fitted_on: str  # split, or "all"
    validated_on: str
    episodes: int
    validation_episodes: int
    onset_threshold: float | None
    bootstrap: int
    seed: int
    fingerprint: str  # of the demonstrations
    cells: tuple[RecordedCells, ...] = ()  # of each individual, or one of all; none where they push

    @property
    def locomotion(self) -> tuple[Locomotion, ...]:
        """Parameters for a species spec, one per individual."""
        own = tuple(fit.locomotion for fit in self.individuals)
        return with_cells(own, self.cells) if self.cells else own

    def save(self, path: str | Path) -> Path:
        """Write JSON."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        record = asdict(self)
        if not self.cells:  # files of pushes stay as they were
            del record["cells"]
        path.write_text(json.dumps(record, indent=2) + "\n")
        return path

    @classmethod
    def load(cls, path: str | Path) -> LocomotionFit:
        """Read JSON written by :meth:`save`."""
        try:
            record = read_json(Path(path))
            individuals = []
            for fit in record["individuals"]:
                fit.pop("tracking_noise", None)  # of files that an earlier version wrote
                known: Any = {k: tuple(v) if isinstance(v, list) else v for k, v in fit.items()}
                individuals.append(IndividualFit(**known))
            cells = tuple(RecordedCells(**each) for each in record.get("cells", ()))
            return cls(**record | {"individuals": tuple(individuals), "cells": cells})
        except FileNotFoundError:
            raise InputError(f"{path}: there is no such file: check the path") from None
        except (ValueError, TypeError, KeyError, IndexError) as error:
            raise InputError(
                f"{path}: it is not a locomotion fit ({error}): make it with 'animarl fit'"
            ) from None


def fit_locomotion(
    demos: Demonstrations,
    method: Method = "joint",
    *,
    thrusts: int = 1,
    onset_threshold: float | None = None,
    split: str | None = "train",
    bootstrap: int = BOOTSTRAP,
    seed: int = 0,
    known: Sequence[Locomotion] = (),
    cells: int = 0,
) -> LocomotionFit:
    """Fit damping, thrust and its magnitudes of every individual.

    Raises InputError if a split is empty, no individual moves, or the onset rule finds no onset of
    an individual.

    Parameters
    ----------
    demos
        Recorded episodes, with their splits.
    method
        ``"joint"`` (see :mod:`animarl_envs.fitting.joint`), ``"onset"``, the paper's rule, or
        ``"species"``: the parameters of the species, which are not fitted.
    thrusts
        Number of thrust magnitudes (see :mod:`animarl_envs.fitting.joint`).
    onset_threshold
        th_acc of the onset fit [arena unit / s^2]; by default that of the species.
    split
        Episodes the parameters come from; ``None`` takes all. The RMSE is measured on ``"val"``
        (on all of them if ``split`` is ``None`` and there is no validation episode).
    bootstrap
        Resamples of episodes for the intervals; 0 leaves them out.
    seed
        Seed of the resampling.
    known
        Parameters of each individual, for method ``"species"``.
    cells
        So many cells for actions (:mod:`animarl_envs.cells`); 0: pushes.
    """
    if method not in get_args(Method):
        raise InputError(f"method {method!r} is unknown: choose joint, onset or species")
    training = demos if split is None else demos.select(split=split)
    without_validation = split is None and not (demos.split == "val").any()
    validation = demos if without_validation else demos.select(split="val")
    if onset_threshold is not None and not 0 < onset_threshold < math.inf:
        raise InputError(f"onset_threshold is {onset_threshold}: it must be a positive number")
    if method != "onset":
        onset_threshold = None
    elif onset_threshold is None:
        onset_threshold = default_onset_threshold(demos)
    if method != "joint" and thrusts != 1:
        raise InputError(
            f"thrusts is {thrusts!r} but the {method} rule fits one thrust: use method joint"
        )
    weights = resampling_weights(training.num_episodes, bootstrap, seed)
    joint = joint_locomotion(training, thrusts) if method == "joint" else ()
    if method == "species":
        joint = tuple(known)
    fits: list[IndividualFit] = []
    for i, name in enumerate(demos.individuals):
        if fits and demos.is_group:  # animals that are alike have one locomotion
            fits.append(replace(fits[0], name=name))
            continue
        more: dict[str, Any] = {}
        samples: Floats | None = None
        if onset_threshold is None:
            own = joint[i]
            if weights is not None and thrusts == 1 and method == "joint":
                data = transitions(training, i)
                if data.next_velocity.any():
                    samples = bootstrap_joint(data, own, weights, fast_speed(data))
        else:
            own = fit_onset(training, i, onset_threshold)
            starts = onset_data(training, i, onset_threshold)
            more["onsets"] = len(starts.onset_speed)
            if weights is not None:
                every = bootstrap_onset(starts, weights)
                samples = every[np.isfinite(every).all(axis=1)]
                more["resamples_without_onset"] = len(every) - len(samples)
        fits.append(
            IndividualFit(
                name,
                own.damping,
                own.thrust,
                *percentiles(samples),
                velocity_rmse=velocity_rmse(validation, i, own),
                steps=int((training.lengths - 1).sum()),
                top_speed=top_speed(training, i),
                terminal_speed=own.terminal_speed(training.dt),
                braking_time=braking_time(own.damping, training.dt),
                magnitudes=own.magnitudes,
                **more,
            )
        )
    return LocomotionFit(
        method=method,
        species=demos.species,
        dt=demos.dt,
        individuals=tuple(fits),
        fitted_on=split or "all",
        validated_on="all" if without_validation else "val",
        episodes=training.num_episodes,
        validation_episodes=validation.num_episodes,
        onset_threshold=onset_threshold,
        bootstrap=bootstrap,
        seed=seed,
        fingerprint=demos.fingerprint(),
        cells=cells_of_recordings(demos, cells) if cells else (),
    )


def default_onset_threshold(demos: Demonstrations) -> float:
    """Return th_acc [arena unit / s^2] of the species, or for an own species from the tracks.

    The agents' published threshold calls 0.03 unit / s "at rest", about 3 % of their top speed.
    That share of the 99th percentile of all speeds is taken here.
    """
    if demos.species in SPECIES:
        return SPECIES[demos.species].recording.onset_threshold
    demos = learnable(demos)
    top = float(np.quantile(np.linalg.norm(demos.velocities(), axis=2), 0.99))
    if top == 0:
        raise InputError(f"{demos.name}: no individual ever moves: check the tracks")
    return SLOW_SHARE * top / demos.dt


def resampling_weights(episodes: int, resamples: int, seed: int) -> Floats | None:
    """Return how often each resample draws each episode, ``(resamples, episodes)``."""
    if resamples < 0:
        raise InputError(f"bootstrap is {resamples}: it must be 0 or a number of resamples")
    if resamples == 0 or episodes < 2:
        return None
    drawn = np.random.default_rng(seed).integers(episodes, size=(resamples, episodes))
    flat = drawn + episodes * np.arange(resamples)[:, None]
    counts = np.bincount(flat.ravel(), minlength=resamples * episodes)
    return counts.reshape(resamples, episodes).astype(np.float64)


def percentiles(
    samples: Floats | None,
) -> tuple[Interval | None, Interval | None]:
    """Return intervals of damping and thrust from resampled ones ``(resamples, 2)``."""
    if samples is None or not len(samples):
        return None, None
    tail = (1 - CONFIDENCE) / 2
    (d_low, u_low), (d_high, u_high) = np.quantile(samples, [tail, 1 - tail], axis=0).tolist()
    return (d_low, d_high), (u_low, u_high)


def braking_time(damping: float, dt: float) -> float:
    """Return the time in which coasting leaves 1/e of the speed, ``-dt / ln(1 - d)`` [s]."""
    if damping == 0:
        return math.inf
    return 0.0 if damping == 1 else -dt / math.log1p(-damping)


def fits_by_kind(fit: LocomotionFit, demos: Demonstrations) -> list[IndividualFit]:
    """Return the fit of each individual; of a group, whose animals are alike, one for all."""
    return [
        replace(one, name=name) for name, one in zip(demos.kinds, fit.individuals, strict=False)
    ]


def doubts(fit: LocomotionFit, demos: Demonstrations) -> list[str]:
    """Return warnings of what makes a fit to ``demos`` doubtful, in sentences.

    The joint fit of one thrust is made once more without leaving any step out as a tracking jump.
    """
    seen = demos if fit.fitted_on == "all" else demos.select(split=fit.fitted_on)
    still, fast, unknown, jumps, noisy = (list[str]() for _ in range(5))
    for i, one in enumerate(fits_by_kind(fit, demos)):
        if one.top_speed == 0:
            still.append(one.name)
            continue
        if fit.cells:  # nobody moves by the pushes
            continue
        if one.terminal_speed > MAX_TERMINAL_SPEED * one.top_speed:
            fast.append(
                f"{one.name} would reach {one.terminal_speed:.3g} arena units/s, "
                f"{one.terminal_speed / one.top_speed:.1f} times the top speed seen "
                f"({one.top_speed:.3g})"
            )
        if one.damping_interval is not None and one.damping_interval[0] < NEAR_ZERO:
            unknown.append(one.name)
        if fit.method != "joint":
            continue
        own = slice(None) if seen.is_group else slice(i, i + 1)
        steps = np.linalg.norm(seen.velocities()[:, own], axis=-1) * seen.dt
        noise = tracking_noise(each.positions[:, own] for each in seen)
        share = noise / float(np.median(steps[steps > 0]))
        if share > MAX_NOISE and not seen.synthetic:
            noisy.append(f"{one.name}: {share:.0%}")
        if len(one.magnitudes) > 1:
            continue
        data = transitions(seen, i)
        whole = fit_joint(data, one.name, fast_speed(data), far=math.inf)
        low, high = one.damping_interval or (one.damping, one.damping)
        change = abs(whole.damping - one.damping) - ROUNDING
        if not low <= whole.damping <= high and change > MAX_DAMPING_CHANGE * one.damping:
            jumps.append(
                f"{one.name}: d is {one.damping:.3g} and u {one.thrust:.3g} without them, "
                f"{whole.damping:.3g} and {whole.thrust:.3g} with them"
            )
    warnings = []
    if still:
        warnings.append(
            f"{', '.join(still)} never moves in {fit.fitted_on}: nothing is learned of how it "
            "moves, and it is simulated where it stands; check the track"
        )
    if fast:
        warnings.append(
            f"With the thrust held {', '.join(fast)}: a policy that pushes on leaves what was "
            "recorded"
        )
    if unknown:
        warnings.append(
            f"The interval of d reaches 0 for {', '.join(unknown)}, so the recordings do not say "
            "how they slow down: record longer, or more turns and stops"
        )
    if jumps:
        warnings.append(
            f"Steps are left out as tracking jumps that matter ({'; '.join(jumps)}): look at the "
            "jumps ('animarl data check')"
        )
    if noisy:
        warnings.append(
            "Successive accelerations oppose each other, as tracking noise would make them (in "
            f"median steps: {', '.join(noisy)}), with which the joint fit overestimates u: import "
            "with --smoothing HZ, above the fastest movement that matters"
        )
    return warnings
