"""Exceptions whose message is meant for the user."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

EXTRA_MODULES = frozenset(
    {
        "Box2D",
        "PIL",
        "charset_normalizer",
        "filelock",
        "h5py",
        "imageio",
        "imageio_ffmpeg",
        "jinja2",
        "joblib",
        "loguru",
        "matplotlib",
        "minari",
        "movement",
        "openpyxl",
        "optuna",
        "pandas",
        "pooch",
        "pyarrow",
        "pygame",
        "pynwb",
        "ray",
        "rich",
        "rl_zoo3",
        "safetensors",
        "sb3_contrib",
        "scipy",
        "sleap_io",
        "stable_baselines3",
        "tensorboard",
        "threadpoolctl",
        "torch",
        "tqdm",
        "typer",
        "yaml",
    }
)
"""Modules of the packages in the extras; movement brings loguru."""
_APPENDED_BY_GYMNASIUM = " was raised from the environment creator for "


def printable(text: str) -> str:
    """Return the text with unprintable characters, except line ends, escaped."""
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


MOST_FAULTS = 10  # lines of a message about several faults


class InputError(ValueError):
    """Input that cannot be used; the message says in one sentence what, where and how to fix it.

    The command line prints the message alone and exits with code 2; from Python it is a
    :class:`ValueError`. Names from files may stand in it; unprintable characters are escaped.
    """

    def __init__(self, message: object) -> None:
        # Gymnasium raises a constructor's TypeError again with all keyword arguments appended, and
        # its process vectors raise an error again from the error itself.
        sentence = str(message).partition(_APPENDED_BY_GYMNASIUM)[0]
        super().__init__(printable(sentence).replace("\n", " "))


class SeveralFaultsError(InputError):
    """Several faults of one input, a line each: ten at most, then how many more there are.

    ``more`` are faults beside those of the sentences.
    """

    def __init__(self, sentences: Iterable[object], more: int = 0) -> None:
        self.sentences = list(dict.fromkeys(str(InputError(one)) for one in sentences))
        self.more = more
        left = more + max(0, len(self.sentences) - MOST_FAULTS)
        lines = self.sentences[:MOST_FAULTS] + [f"and {left:,} more"] * bool(left)
        ValueError.__init__(self, "\n".join(lines))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what the message is made of."""
        return type(self), (self.sentences, self.more)


def join_errors(errors: Sequence[InputError]) -> InputError:
    """Return one error that names the faults of all; one alone stays as it is."""
    if len(errors) == 1:
        return errors[0]
    sentences = [one for error in errors for one in sentences_of(error)]
    return SeveralFaultsError(sentences, sum(getattr(error, "more", 0) for error in errors))


def sentences_of(error: InputError) -> list[str]:
    """Return the faults that an error names."""
    return error.sentences if isinstance(error, SeveralFaultsError) else [str(error)]


class FaultCollector:
    """Collects the errors of parts that do not depend on each other, to raise them together."""

    def __init__(self) -> None:
        self._errors: list[InputError] = []

    @contextmanager
    def collect(self) -> Iterator[None]:
        """Keep an :class:`InputError` of the block."""
        try:
            yield
        except InputError as error:
            self._errors.append(error)

    def refuse(self) -> None:
        """Raise what was collected, if anything was."""
        if self._errors:
            raise join_errors(self._errors)


def refuse_rows(rows: Sequence[int], sentence: Callable[[int], str]) -> None:
    """Raise the faults of rows, if there are any; ``sentence`` tells that of one row."""
    faults = [InputError(sentence(row)) for row in rows[:MOST_FAULTS]]
    if faults:
        more = len(rows) - len(faults)
        raise SeveralFaultsError(faults, more) if more or len(faults) > 1 else faults[0]


def require(holds: object, sentence: str) -> None:
    """Raise an :class:`InputError` with ``sentence`` unless something holds."""
    if not holds:
        raise InputError(sentence)


class UnknownOptionError(InputError, TypeError):
    """A keyword that an environment does not take.

    It is Python's :class:`TypeError` as well, with its phrase: TorchRL's ``GymEnv`` tries keywords
    of its own and looks for that phrase to leave them out.

    Attributes
    ----------
    option, place, known
        The keyword, what does not take it, and all that it takes; empty where the error was made
        anew from its sentence, as Gymnasium does.
    """

    option: str = ""
    place: str = ""
    known: frozenset[str] = frozenset()

    @classmethod
    def of(cls, option: str, place: str, known: Iterable[str]) -> UnknownOptionError:
        """Return the error of an ``option`` that ``place`` does not take, with those it takes."""
        names = sorted(known)
        near = get_close_matches(option, names, n=1)
        meant = f", did you mean {near[0]!r}" if near else ""
        error = cls(
            f"option {option!r} is unknown for {place} (unexpected keyword argument {option!r})"
            f"{meant}: choose one of {', '.join(names)}"
        )
        error.option, error.place, error.known = option, place, frozenset(names)
        return error


@contextmanager
def also_list_options_of(
    function: Callable[..., Any], without: Collection[str] = ()
) -> Iterator[None]:
    """List the keywords of ``function`` too where an unknown option is refused.

    Those named in ``without`` are not listed.
    """
    try:
        yield
    except UnknownOptionError as error:
        own = {
            name
            for name, parameter in inspect.signature(function).parameters.items()
            if parameter.kind is parameter.KEYWORD_ONLY
        }
        raise UnknownOptionError.of(
            error.option, error.place, (error.known | own) - set(without)
        ) from None


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


@contextmanager
def require_extra(feature: str, extra: str) -> Iterator[None]:
    """Raise a :class:`MissingExtraError` where a package that ``feature`` needs is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        if not is_of_an_extra(error):
            raise
        raise MissingExtraError(feature, extra) from error


def is_of_an_extra(error: ModuleNotFoundError) -> bool:
    """Return whether the missing module is of a package that an extra brings.

    Another one is missing where an installation is broken, which the error itself explains best.
    """
    return (error.name or "").partition(".")[0] in EXTRA_MODULES
