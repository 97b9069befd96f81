"""Published sets by name: fetched from a folder or an address, checked, imported, and used."""

import functools
import hashlib
import http.server
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import gymnasium as gym
import pytest
from commands import animarl
from refusals import refuses

from animarl_algos.runs.pipeline import load_demonstrations
from animarl_envs.importing import sets
from animarl_envs.importing.readers import default_recipe, get_reader
from animarl_envs.importing.sets import load_set, named_set, published_sets

ENTRY = """
[{name}]
title = "two walkers"
folder = "walkers"
licence = "CC0-1.0"
citation = "Nobody (2026)"
origin = "https://example.org/walkers"
{address}bytes = {bytes}
sha256 = {{ "walks.csv" = "{sha256}" }}
recipe = {{ source = "long-table", frame_rate = 10.0, name_pattern = '(?P<condition>calm|wild)' }}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with the files of two sets: ``walkers``, and ``walkers_online`` with an address."""
    mirror = tmp_path / "mirror" / "walkers"
    mirror.mkdir(parents=True)
    rows = (
        f"{how}{n},{t / 10},{n + t % 7},{t % 5 + n * t / 40}"
        for how in ("calm", "wild") for n in range(6) for t in range(40)
    )  # fmt: skip
    content = "recording,time_s,x_mm,y_mm\n" + "\n".join(rows) + "\n"
    (mirror / "walks.csv").write_text(content)
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(mirror))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        known = {
            "bytes": len(content), "sha256": hashlib.sha256(content.encode()).hexdigest(),
        }  # fmt: skip
        online = f'address = "http://127.0.0.1:{server.server_port}/"\n'
        registry = ENTRY.format(name="walkers", address="", **known)
        registry += ENTRY.format(name="walkers_online", address=online, **known)
        (tmp_path / "sets.toml").write_text(registry)
        monkeypatch.setattr(sets, "REGISTRY", tmp_path / "sets.toml")
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
        monkeypatch.delenv(sets.FOLDER, raising=False)
        published_sets.cache_clear()
        yield tmp_path / "mirror"
        server.shutdown()
    published_sets.cache_clear()


def test_a_set_is_fetched_from_a_folder_and_then_known_by_its_name(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listed = animarl("data", "get")
    assert "two walkers" in listed and "CC0-1.0" in listed
    shown = animarl("data", "get", "walkers", "--folder", folder)
    assert "calm" in shown and "Nobody (2026)" in shown and "animarl run walkers" in shown
    demos = load_set("walkers")
    assert demos.provenance["licence"] == "CC0-1.0" and len(demos) == 12
    world = gym.make("AnimaRL/Custom-v0", demos="walkers").unwrapped
    assert world.scenario.species.conditions == ("calm", "wild")
    assert load_demonstrations("walkers").fingerprint() == demos.fingerprint()
    monkeypatch.setenv(sets.FOLDER, str(folder))
    named_set("walkers").imported.unlink()
    animarl("data", "get", "walkers")
    assert load_set("walkers").fingerprint() == demos.fingerprint()


def test_a_set_is_fetched_from_its_address(folder: Path) -> None:
    demos = named_set("walkers_online").build()
    assert len(demos) == 12 and (sets.cache_folder() / "walkers_online" / "walks.csv").exists()


def test_what_cannot_be_had_is_said_in_a_sentence(folder: Path, tmp_path: Path) -> None:
    refuses("no published set .* walkers_online", animarl, "data", "get", "crows")
    refuses("walkers: this published set is not on this computer: .*data get", load_set, "walkers")
    with pytest.raises(Exception, match="animarl data get walkers"):
        gym.make("AnimaRL/Custom-v0", demos="walkers")
    refuses("no address of its files is known: get them from", named_set("walkers").build)
    empty = tmp_path / "empty"
    empty.mkdir()
    refuses("they are not in .*empty", named_set("walkers").build, empty)
    (folder / "walkers" / "walks.csv").write_text("recording,time_s,x_mm,y_mm\n")
    refuses(r"walks\.csv: it is not the file", named_set("walkers").build, folder)
    refuses("walks.csv cannot be fetched from", named_set("walkers_online").build)


def test_every_set_of_the_registry_has_an_origin_a_licence_and_a_recipe() -> None:
    for one in published_sets().values():
        plan = default_recipe(get_reader(one.recipe["source"]), **one.recipe)
        assert plan.to_dict() and one.licence and one.citation and one.origin.startswith("https:")
        assert all(len(known) == 64 for known in one.sha256.values())
        assert set(one.read) <= set(one.sha256)


@pytest.mark.realdata
def test_the_recorded_files_are_those_of_the_registry(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    data = os.environ.get(sets.FOLDER, Path(__file__).resolve().parents[4] / "shared" / "data")
    for one in published_sets().values():
        assert one.fetch(data)
    flights = named_set("bats_company").build(data)
    assert flights.individuals == ("bat",)
    assert flights.provenance["conditions"] == ["company", "alone"]
