"""Methods of others: anything with SB3's ``predict``, or a callable, made by ``module:factory``."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_world import training_options
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.species import Species

TERMINATED = 143  # a worker ends with it where it was told to end


@dataclass(frozen=True, eq=False, kw_only=True)
class MethodSetting:
    """What the factory of a method is handed: everything to train on, and no test episode.

    Parameters
    ----------
    demos
        The demonstrations of the splits train and val.
    species
        The world's numbers, with the fitted locomotion.
    seed
        Of the training.
    copies, options
        Of :meth:`environment`.
    """

    demos: Demonstrations
    species: Species
    seed: int
    copies: int
    options: Mapping[str, Any]

    @classmethod
    def of(cls, world: Run, seed: int) -> MethodSetting:
        """That of a fitted world."""
        demos = world.learnable_demos
        return cls(
            demos=demos,
            species=world.species,
            seed=seed,
            copies=world.settings.copies,
            options=training_options(world.environment_options),
        )

    def environment(self) -> SlotVecEnv:
        """A vectorised environment to train in, one slot per copy and individual.

        Its observations are those that the method is asked about afterwards: where recordings of
        both conditions are there, the last component is the condition.
        """
        return SlotVecEnv(
            self.species, self.copies, demos=self.demos, condition_flag=None, **self.options
        )


class Checked:
    """A method that is asked for actions, every answer checked.

    Parameters
    ----------
    name
        Of the method, for messages.
    policy
        With ``predict`` as SB3 has it, or a callable from observations ``(slots, n)`` to actions
        ``(slots,)``; slot = copy * individuals + individual.
    num_actions
        Actions go from 0 to one below it.
    """

    def __init__(self, name: str, policy: Any, num_actions: int) -> None:
        if not callable(policy) and not hasattr(policy, "predict"):
            raise InputError(
                f"method {name}: its factory made {type(policy).__name__}, which has no predict "
                "and is no callable: return what acts"
            )
        self._name, self._policy, self._num_actions = name, policy, num_actions

    def predict(
        self,
        observation: NDArray[np.floating],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.int64], Any]:
        """Return one action per slot.

        Raises
        ------
        InputError
            If the method raises, or answers anything but one action per slot.
        """
        slots, most = len(observation), self._num_actions - 1
        with foreign(f"method {self._name}: its predict raised", "fix it"):
            if hasattr(self._policy, "predict"):
                actions, state = self._policy.predict(
                    observation, state=state, episode_start=episode_start,
                    deterministic=deterministic,
                )  # fmt: skip
            else:
                actions = self._policy(observation)
            found = np.asarray(actions)
        wrong = f"{found.dtype} of shape {found.shape}"
        if found.shape == (slots,) and found.dtype.kind in "iuf":
            bad = found[~((found == np.floor(found)) & (found >= 0) & (found <= most))]
            wrong = f"action {bad[0]:g}" if len(bad) else ""
        if wrong:
            raise InputError(
                f"method {self._name}: its predict gave {wrong}: give {slots} whole numbers from 0 "
                f"to {most}"
            )
        return found.astype(np.int64), state


def one_line(text: object) -> str:
    """Return what somebody else's code said without line ends: they would end a table or a list."""
    return " ".join(str(text).split())


@contextmanager
def foreign(said: str, fix: str) -> Iterator[None]:
    """Whatever somebody else's code raises, or ends the process with, becomes one sentence.

    Ctrl-C and a signal to end go through.

    Raises
    ------
    InputError
        ``said``, what was raised, and the ``fix``.
    """
    try:
        yield
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and error.code == TERMINATED:
            raise
        raised = f"{type(error).__name__} ({one_line(error)})"
        raise InputError(f"{said} {raised}: {fix}") from error


def parameters_of(policy: Any) -> int | None:
    """Parameters of a policy of PyTorch, or of a model of SB3 around one; None of anything else.

    Those of a target network, where the policy has one, are among them.
    """
    network = getattr(policy, "policy", policy)
    if not isinstance(network, torch.nn.Module):
        return None
    return sum(parameter.numel() for parameter in network.parameters())


def parse_method(given: str) -> tuple[str, str]:
    """``NAME=module:factory`` as name and ``module:factory``, which is looked up now.

    Raises
    ------
    InputError
        If it is not of that form, or there is no such factory.
    """
    name, equals, place = given.partition("=")
    if not equals or not name.replace("-", "").replace("_", "").isalnum():
        raise InputError(
            f"--method {given}: write NAME=module:factory, the name of letters, digits, - and _"
        )
    load_factory(place)
    return name, place


def load_factory(place: str) -> Callable[[MethodSetting], Any]:
    """What ``module:factory`` names; modules in the working directory are found too.

    Raises
    ------
    InputError
        If it cannot be imported or is no callable.
    """
    module, colon, name = place.partition(":")
    if not (module and colon and name):
        raise InputError(f"method {place!r}: write module:factory")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)
    with foreign(f"method {place!r}: it cannot be imported:", "see to its module"):
        found = getattr(importlib.import_module(module), name)
    if not callable(found):
        raise InputError(f"method {place!r}: it is no callable: name a factory")
    made: Callable[[MethodSetting], Any] = found
    return made


def source_of(place: str) -> str:
    """The factory with a hash of its module's file, so that another source is another method."""
    spec = importlib.util.find_spec(place.partition(":")[0])
    if spec is None or spec.origin is None or not Path(spec.origin).is_file():
        return place
    return f"{place}#{hashlib.sha256(Path(spec.origin).read_bytes()).hexdigest()[:16]}"
