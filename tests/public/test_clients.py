"""The examples run, in every library that the documentation names."""

import math
import os
import re
import subprocess
from pathlib import Path

import pytest
from pages import load_script
from slow import slowly

ROOT = Path(__file__).parents[2]


VALUES = ROOT / "examples" / "inspect_episode.py"  # of no other library
EXAMPLES = sorted(set((ROOT / "examples").glob("*.py")) - {VALUES})
PAGE = load_script(ROOT / "docs" / "make_clients_page.py")
CLIENTS = PAGE.CLIENTS
OWN = {client.name: client for client in CLIENTS if client.own}
OPTIONAL = {"torchrl_env": "torchrl", "tianshou_env": "tianshou"}
LATER = ROOT / "examples" / "tianshou_env.py"
HERE = [path for path in EXAMPLES if path.stem not in (*OWN, "more_libraries") and path != LATER]


@pytest.mark.parametrize("path", [*HERE, *slowly(LATER)], ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore")
def test_example_runs_and_gives_a_number(path, capsys):
    if path.stem in OPTIONAL:
        pytest.importorskip(OPTIONAL[path.stem])
    result = load_script(path).main(["--steps", "400", "--seed", "1"])
    numbers = result if isinstance(result, tuple) else (result,)
    assert all(math.isfinite(number) for number in numbers)
    assert "400 steps" in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore")
def test_frames_are_skipped_by_supersuit():
    said = load_script(ROOT / "examples" / "more_libraries.py").main(
        ["supersuit", "--steps", "400"]
    )
    episodes = int(said.split()[0])
    assert episodes > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", OWN)
def test_clients_of_other_versions_run_in_environments_of_their_own(name, tmp_path):
    client = OWN[name]
    if client.checkout and client.checkout not in os.environ:
        pytest.skip(f"{name} is no package: name a checkout in ${client.checkout}")
    try:
        python = PAGE.interpreter(client, tmp_path)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"{', '.join(client.own)} cannot be installed here: {error}")
    assert "400 steps" in PAGE.run(client, python, 400)
    assert re.search(rf"{client.libraries[0]} \d+\.\d+", PAGE.versions(client, python))


@pytest.mark.filterwarnings("ignore")
def test_time_outs_are_stored_as_time_outs():
    example = load_script(ROOT / "examples" / "pettingzoo_supersuit_sb3.py")
    time_outs, ends = example.main(["--steps", "1500", "--copies", "1", "--seed", "0"])
    assert time_outs > 0
    assert time_outs < ends  # others end by contact or at the boundary
    assert time_outs % 3 == 0  # all three individuals of a copy at once
    assert (time_outs, ends) == example.main(["--steps", "1500", "--copies", "1", "--seed", "0"])


def test_the_page_names_every_example_and_a_version_of_every_library():
    page = (ROOT / "docs" / "clients.md").read_text()
    assert {client.example for client in CLIENTS} == {path.stem for path in EXAMPLES}
    for client in CLIENTS:
        place = f"`{client.example}.py {client.argument}".rstrip()
        row = next(line for line in page.splitlines() if f"{place}`" in line)
        assert client.summary in row
        for library in client.libraries:
            assert re.search(rf"{library} \d+\.\d+", row)


def test_action_values_of_an_episode_are_drawn(tmp_path):
    out = tmp_path / "values.png"
    load_script(VALUES).main(["fly", "--episode", "1", "--individual", "female", "--out", str(out)])
    assert out.read_bytes().startswith(b"\x89PNG")
