"""Foreign data are handled in a process of its own: what it does there becomes one sentence."""

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pages import python
from refusals import refuses

from animarl_envs import wall
from animarl_envs.demos.splits import Splitting, split_recordings
from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.importing.sessions import conditions_of, sessions_by_name

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")


def many(count: int) -> dict[str, Any]:
    return {"a": [np.arange(count), "b", (1, None)], "c": {"d": np.array(["x", "yz"])}}


def spin() -> None:
    while True:
        pass


def refuse(error: str) -> None:
    raise InputError(error)


def lack() -> None:
    raise MissingExtraError("flying", "wings")


def surprise() -> None:
    {}["a"]


def count_up(progress: Callable[[float], None]) -> int:
    for i in range(4):
        progress(i / 4)
    return os.getpid()


def test_values_and_arrays_come_back_as_they_are() -> None:
    found = wall.call(many, 5, what="x")
    assert found["a"][0].tolist() == [0, 1, 2, 3, 4] and found["a"][1:] == ["b", [1, None]]
    assert found["c"]["d"].tolist() == ["x", "yz"]
    assert len(wall.call(many, 10**6, what="x")["a"][0]) == 10**6
    named_so = {"a": [{wall.ARRAY: 7}, {wall.ARRAY: [0]}]}  # by a file
    assert wall.call(dict, named_so, what="x") == named_so


def test_what_goes_wrong_is_one_sentence_and_the_next_call_works() -> None:
    for function, arguments, message in (
        (os.abort, (), r"f: a library crashes over it \(SIGABRT\)"),
        (os._exit, (3,), r"f: a library crashes over it \(exit code 3\)"),
        (np.zeros, (10**10,), "f: it needs more memory"),
        (refuse, ("g: no",), "g: no"),
        (surprise, (), "KeyError: 'a'"),
    ):
        refuses(message, wall.call, function, *arguments, what="f")
    with pytest.raises(MissingExtraError, match="pip install"):
        wall.call(lack, what="f")
    with pytest.raises(InputError, match="more than 1 s of processor time: cut it"):
        wall.call(spin, what="f", seconds=1, remedy="cut it")
    shares: list[float] = []
    assert wall.call(count_up, what="f", progress=shares.append) != os.getpid()
    assert shares == [0.0, 0.25, 0.5, 0.75]


ENDLESS = "(a+)+$"


def test_a_regular_expression_that_never_ends_is_refused() -> None:
    names = np.array(["a" * 60 + "b"] * 3)
    began = time.process_time()
    with pytest.raises(InputError, match="more than 2 s of processor time: simplify it"):
        sessions_by_name(f"(?P<condition>{ENDLESS})", names.tolist())
    with pytest.raises(InputError, match="more than 2 s of processor time: simplify it"):
        split_recordings(names, Splitting(by="group", pattern=ENDLESS))
    assert time.process_time() - began < 1.0


CLOSED = """
import os, resource, sys
import numpy as np
from animarl_envs import wall
for number in (0, 1, 2):
    if str(number) in sys.argv[1]:
        os.close(number)
found = wall.call(np.arange, 10**5, what="f")
os.write(1, b"printed")
assert wall.call(len, found, what="f") == len(found) == 10**5
os._exit(7)
"""
LIMITED = """
import resource
from animarl_envs import wall
resource.setrlimit(resource.RLIMIT_CPU, (40, 40))
assert wall.call(len, "abc", what="f") == 3
print(wall.call(resource.getrlimit, resource.RLIMIT_CPU, what="f"))
"""


@pytest.mark.parametrize("closed", ["0", "1", "2", "012"])
def test_standard_descriptors_may_be_closed(closed: str) -> None:
    assert python(CLOSED, closed, check=False).returncode == 7


def test_a_lower_limit_of_the_caller_is_kept() -> None:
    assert python(LIMITED).stdout.strip() == "[39, 40]"


def test_conditions_are_names() -> None:
    for name in ("=A1", "a\nb", "../a", "x" * 300):
        refuses(r"m\.csv: a condition ", conditions_of, [name, "b"], "m.csv")


def test_a_forked_process_has_a_server_of_its_own() -> None:
    wall.call(many, 1, what="x")
    theirs = wall._worker
    pid = os.fork()
    if pid == 0:
        try:
            wall.call(many, 2, what="x")
            os._exit(0 if wall._worker is not theirs else 1)
        finally:
            os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    assert wall._worker is theirs and len(wall.call(many, 3, what="x")["a"][0]) == 3
