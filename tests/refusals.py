"""Refusals: each is one sentence."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from animarl_envs.errors import InputError, SeveralFaultsError
from animarl_envs.importing.readers import read


def refuses(message: str, call: Callable[..., object], /, *given: Any, **options: Any) -> str:
    """Make sure that a call with these arguments is refused; return the sentence.

    ``message`` is searched for in it, as ``match`` of ``pytest.raises``.
    """
    with pytest.raises(InputError, match=message or None) as caught:
        call(*given, **options)
    assert "\n" not in str(caught.value) or isinstance(caught.value, SeveralFaultsError)
    return str(caught.value)


def refused(path: Path, source: str | None = None, **options: Any) -> str:
    """Return what a reader says of a file that it refuses."""
    return refuses("", read, path, source, **options)
