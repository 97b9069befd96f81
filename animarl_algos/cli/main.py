"""The command line, ``animarl``. Bad input is one sentence and exit code 2, never a traceback."""

from __future__ import annotations

import signal
import sys
import warnings
from typing import Any

from animarl_envs.checks import printable
from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.files import unreadable_or_unwritable

try:
    import typer

    from animarl_algos.cli.lazy import SETTINGS, LazyCommands
except ModuleNotFoundError as error:
    if (error.name or "").startswith("animarl"):
        raise
    print(f"animarl: {MissingExtraError('the command line', 'cli')}", file=sys.stderr)
    sys.exit(2)

TERMINATED = 128 + signal.SIGTERM  # as a shell gives it
INTERRUPTED = (130, TERMINATED)  # Ctrl-C, which typer gives without a word, and SIGTERM

app = typer.Typer(
    name="animarl",
    cls=LazyCommands,
    epilog="First steps: animarl run packaged --steps 20000 --out runs/first, then "
    "animarl watch AnimaRL/Agent-v0 --model runs/first. COMMAND --help gives examples.",
    no_args_is_help=True,
    **SETTINGS | {"add_completion": True},
)


@app.callback()
def animarl() -> None:
    """Recorded animals become a simulator: fit, train, evaluate, report."""


def say_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """A warning as one line, without the place in the source that Python would add."""
    sentence = printable(" ".join(str(message).split()))
    print(f"Warning: {sentence}", file=sys.stderr)


def main() -> None:
    """Entry point of the ``animarl`` script."""
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    try:
        with warnings.catch_warnings():
            warnings.showwarning = say_warning
            app()
    except (InputError, MissingExtraError) as error:
        print(f"animarl: {printable(str(error))}", file=sys.stderr)
        sys.exit(2)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("animarl"):
            raise
        print(f"animarl: {MissingExtraError('this command', 'algos')}", file=sys.stderr)
        sys.exit(2)
    except OSError as error:
        what = printable(unreadable_or_unwritable(error))
        print(f"animarl: {what}; finished stages and checkpoints are kept", file=sys.stderr)
        sys.exit(2)
    except SystemExit as ended:
        if ended.code in INTERRUPTED:
            print(
                "\nanimarl: interrupted; given again, the same command takes up a run where its "
                "last checkpoint or finished stage left it",
                file=sys.stderr,
            )
        raise
    finally:
        signal.signal(signal.SIGTERM, before)


if __name__ == "__main__":
    main()
