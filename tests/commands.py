"""Commands called in this process, and how they ended."""

from dataclasses import dataclass

import pytest
from typer.testing import CliRunner

from animarl_algos.cli.main import app


@dataclass(frozen=True)
class Done:
    """Exit status and what was printed."""

    returncode: int
    stdout: str
    stderr: str


def refused(done: Done, *words: str) -> None:
    """Make sure that a command ended with exit code 2 and one sentence that holds these words."""
    assert done.returncode == 2, done.stdout
    assert len(done.stderr.strip().splitlines()) == 1 and "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr, done.stderr


def succeeded(done: Done) -> str:
    """Make sure that a command ended well, and return what it printed."""
    assert done.returncode == 0, done.stderr
    return done.stdout


def animarl(*words: object, drawn: bool = False) -> str:
    """Return what ``animarl`` printed; what it raises is raised.

    An import draws its picture, which takes seconds, only where it is to be ``drawn``.
    """
    with pytest.MonkeyPatch.context() as patch:
        if words[0] == "import" and not drawn:
            patch.setattr("animarl_algos.cli.describing.find_spec", {"matplotlib": None}.get)
        ran = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    if ran.exception is not None and not isinstance(ran.exception, SystemExit):
        raise ran.exception
    assert ran.exit_code == 0, ran.output
    return ran.output
