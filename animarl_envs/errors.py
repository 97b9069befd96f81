"""The one exception that a user is meant to read."""

from __future__ import annotations

_APPENDED_BY_GYMNASIUM = " was raised from the environment creator for "


def printable(text: str) -> str:
    """The text with everything that cannot be printed written out, line ends apart."""
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


class InputError(ValueError):
    """Input that cannot be used, said in one sentence: what, where, and what to do about it.

    The command line prints the sentence alone and exits with code 2; from Python it is a
    :class:`ValueError`. Names from files may stand in it: what cannot be printed is written out.
    """

    def __init__(self, message: str) -> None:
        # Gymnasium raises a TypeError of a constructor anew with all keyword arguments appended,
        # arrays on many lines among them; the sentence is enough.
        sentence = message.partition(_APPENDED_BY_GYMNASIUM)[0]
        super().__init__(printable(sentence).replace("\n", " "))


class UnknownOptionError(InputError, TypeError):
    """A keyword that an environment does not take.

    It is Python's :class:`TypeError` as well, with its phrase: TorchRL's ``GymEnv`` tries keywords
    of its own and looks for that phrase to leave them out.
    """


class MissingExtraError(ImportError):
    """An optional dependency is absent; the message names the extra that brings it.

    ``MissingExtraError(feature, extra)`` makes the sentence; with one argument it is the sentence,
    since libraries (Gymnasium's process vectors, pickle) raise an error anew with its text alone.
    """

    def __init__(self, feature: str, extra: str | None = None) -> None:
        super().__init__(
            feature
            if extra is None
            else f"{feature} needs the extra {extra!r}: pip install 'animarl[{extra}]'"
        )
