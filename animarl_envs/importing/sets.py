"""Published recordings by name: fetched, checked, imported once, and then used by their name.

``sets.toml`` says of each set where it comes from, its licence and citation, the SHA-256 of its
files and the recipe of its import. A set without an address is given by a folder.
"""

import hashlib
import json
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError, require, require_extra
from animarl_envs.importing.readers import default_recipe, follow, get_reader, read

REGISTRY = Path(__file__).with_name("sets.toml")
FOLDER = "ANIMARL_DATA"  # the environment variable that names a folder of recordings


@dataclass(frozen=True, kw_only=True)
class PublishedSet:
    """Recordings that others published.

    Parameters
    ----------
    name, title
        How commands call it, and what it holds.
    folder
        Where its files lie below ``$ANIMARL_DATA``.
    licence, citation, origin
        Of the recordings; ``origin`` is the page where they were published.
    address
        Beginning of the address of each file; ``None`` where it is not known.
    bytes
        Of all files.
    sha256
        Of each file.
    read
        Files that the reader is given, where it finds the others by itself; default: all.
    recipe
        Entries of the :class:`~animarl_envs.importing.import_recipe.ImportRecipe`.
    """

    name: str
    title: str
    folder: str
    licence: str
    citation: str
    origin: str
    bytes: int
    sha256: Mapping[str, str]
    recipe: Mapping[str, Any]
    address: str | None = None
    read: tuple[str, ...] = ()

    @property
    def imported(self) -> Path:
        """The file of its demonstrations, another one where the registry says another thing."""
        entry = json.dumps(vars(self), sort_keys=True).encode()
        return cache_folder() / f"{self.name}-{hashlib.sha256(entry).hexdigest()[:8]}.npz"

    def fetch(self, folder: str | Path | None = None) -> list[Path]:
        """Return the files that its reader is given, from a folder or else from its address.

        ``folder`` holds the files, or the folder of the set; by default it is ``$ANIMARL_DATA``.

        Raises
        ------
        InputError
            If files are not there, cannot be fetched, or are others than the registry knows.
        """
        folder = folder or os.environ.get(FOLDER)
        places = [Path(folder), Path(folder) / self.folder] if folder else []
        own = next((one for one in places if (one / next(iter(self.sha256))).is_file()), None)
        if own is None:
            require(
                self.address,
                f"{self.name}: no address of its files is known: get them from {self.origin}, and "
                f"give their folder by --folder or by {FOLDER}"
                + (f" (they are not in {folder})" if folder else ""),
            )
            own = cache_folder() / self.name
            for file in self.sha256:
                self._download(file, own)
        for file, known in self.sha256.items():
            path = own / file
            require(path.is_file(), f"{path}: there is no such file: it is a part of {self.name}")
            require(
                hashlib.sha256(path.read_bytes()).hexdigest() == known,
                f"{path}: it is not the file that {self.name} was made of (another SHA-256): get "
                "it again, or use 'animarl import'",
            )
        return [own / file for file in self.read or self.sha256]

    def _download(self, file: str, folder: Path) -> None:
        with require_extra("fetching published sets", "data"):
            import pooch
        try:
            pooch.retrieve(
                f"{self.address}{quote(file)}", f"sha256:{self.sha256[file]}", file, folder
            )
        except (OSError, ValueError) as error:
            raise InputError(
                f"{self.name}: {file} cannot be fetched from {self.address} ({error}): try again, "
                f"or get it from {self.origin} and give its folder by --folder"
            ) from None

    def build(self, folder: str | Path | None = None) -> Demonstrations:
        """Fetch and import the recordings, and keep the demonstrations for :func:`load_set`."""
        reader = get_reader(self.recipe["source"])
        plan = default_recipe(reader, **{**self.recipe, "licence": self.licence})
        demos = follow(plan, self.fetch(folder))
        origin = {"source": self.origin, "citation": self.citation, "set": self.name}
        demos = replace(demos, name=self.name, provenance={**demos.provenance, **origin})
        demos.save(self.imported)
        return demos


def cache_folder() -> Path:
    """Return the folder of fetched and imported sets (``$XDG_CACHE_HOME/animarl``)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "animarl"


@cache
def published_sets() -> dict[str, PublishedSet]:
    """Return all sets of the registry, by name."""
    entries = tomllib.loads(REGISTRY.read_text())
    return {name: PublishedSet(name=name, **entry) for name, entry in entries.items()}


def named_set(name: str) -> PublishedSet:
    """Return a set by its name; refuse an unknown one with a list of the names."""
    known = published_sets()
    require(
        name in known,
        f"{name}: there is no published set and no file of that name: sets are {', '.join(known)}",
    )
    return known[name]


def load_set(name: str) -> Demonstrations:
    """Return the demonstrations of a set that was fetched.

    Raises
    ------
    InputError
        If it is unknown, or was not fetched.
    """
    one = named_set(name)
    require(
        one.imported.exists(),
        f"{name}: this published set is not on this computer: fetch it by 'animarl data get "
        f"{name}'",
    )
    return replace(Demonstrations.load(one.imported), name=name)


def read_named(file: str | Path, source: str | None = None) -> Demonstrations:
    """Return the demonstrations of a file, or of the published set of that name."""
    if not Path(file).exists() and str(file).isidentifier():
        return load_set(str(file))
    return read(file, source)
