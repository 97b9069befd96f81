"""The demonstrations that come with the package. Each file names the command that made it."""

from functools import cache
from pathlib import Path

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.species import species_name

FOLDER = Path(__file__).parent / "data"


@cache
def load_packaged(name: str) -> Demonstrations:
    """Return the packaged demonstrations of a species, by its name or id.

    Raises
    ------
    InputError
        If none are packaged for it.
    """
    if species_name(name) not in packaged_names():
        raise InputError(
            f"no demonstrations are packaged for {name!r}: there are {', '.join(packaged_names())}"
        )
    return Demonstrations.load_trusted(FOLDER / f"{species_name(name)}.npz")


@cache
def packaged_names() -> tuple[str, ...]:
    """Return the species that come with demonstrations."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.npz")))


def packaged_team(name: str) -> Path:
    """Return the weights of the networks that made the packaged chases of a condition."""
    return FOLDER / "teams" / f"{name}.npz"
