"""Commands called in this process, and how they ended."""

from dataclasses import dataclass

from typer.testing import CliRunner

from animarl_algos.cli.main import app


@dataclass(frozen=True)
class Done:
    """Exit status and what was printed."""

    returncode: int
    stdout: str
    stderr: str


def animarl(*words: object) -> str:
    """What ``animarl`` printed; what it raises is raised."""
    ran = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    if ran.exception is not None and not isinstance(ran.exception, SystemExit):
        raise ran.exception
    assert ran.exit_code == 0, ran.output
    return ran.output
