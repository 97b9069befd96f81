"""Commands whose options are made from a model or a table instead of being written out."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from typing import Annotated, Any

import typer

Command = Callable[..., None]
CONTEXT = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)


def option(name: str, kind: Any, default: Any, info: Any) -> inspect.Parameter:
    """Return a parameter as typer reads it; ``info`` is typer's Option or Argument."""
    default = inspect.Parameter.empty if default is ... else default
    annotation = Annotated[kind, info]
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, keyword, default=default, annotation=annotation)


def asks_for(parameters: Iterable[inspect.Parameter]) -> Callable[[Command], Command]:
    """Decorator: let typer see these parameters of a command that takes ``**given``."""
    listed = list(parameters)

    def decorate(command: Command) -> Command:
        command.__signature__ = inspect.Signature(listed)  # type: ignore[attr-defined]
        command.__annotations__ = {one.name: one.annotation for one in listed}
        return command

    return decorate
