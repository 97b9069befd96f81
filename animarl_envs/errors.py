"""The one exception that a user is meant to read."""

from __future__ import annotations


class InputError(ValueError):
    """Input that cannot be used, said in one sentence: what, where in it, and the mend.

    The command line prints the sentence alone and exits with code 2; from Python it is a
    :class:`ValueError`.
    """


class UnknownOptionError(InputError, TypeError):
    """A keyword that an environment does not take.

    It is Python's :class:`TypeError` as well, with its phrase: TorchRL's ``GymEnv`` tries keywords
    of its own and looks for that phrase to leave them out.
    """


class MissingExtraError(ImportError):
    """An optional dependency is absent; the message names the extra that brings it."""

    def __init__(self, feature: str, extra: str) -> None:
        super().__init__(f"{feature} needs the extra {extra!r}: pip install 'animarl[{extra}]'")
