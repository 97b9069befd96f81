"""What a reader says of a file that it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from animarl_envs.errors import InputError
from animarl_envs.importing.readers import read


def refused(path: Path, source: str | None = None, **options: Any) -> str:
    """The one line of the refusal."""
    with pytest.raises(InputError) as caught:
        read(path, source, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)
