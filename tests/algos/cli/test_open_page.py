"""The list of runs: what it shows and starts, and what it refuses to strangers."""

import http.client
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from threading import Thread
from urllib.parse import quote, urlencode

import pytest
from browser import serious_findings, unreachable_controls
from report_inputs import report_page

from animarl_algos.cli import opening
from animarl_envs.errors import InputError

VERDICT = '{"headline": "Mice <b>alike</b>", "colour": "green"}'


@pytest.fixture(scope="module")
def report() -> str:
    return report_page()


@pytest.fixture
def server(tmp_path: Path, report: str) -> Iterator[opening.RunsServer]:
    """A folder with a run that has a page, one that has none, and a secret beside it."""
    folder = tmp_path / "runs"
    for name in ("mice one", "deep/late"):
        (folder / name).mkdir(parents=True)
        (folder / name / "settings.json").write_text("{}")
    (folder / "mice one" / "report.html").write_text(report, encoding="utf-8")
    (folder / "mice one" / "evaluation").mkdir()
    (folder / "mice one" / "evaluation" / "verdict.json").write_text(VERDICT)
    (tmp_path / "settings.json").write_text("secret")
    (tmp_path / "report.html").write_text("secret")
    with opening.RunsServer(folder) as made:
        thread = Thread(target=made.serve_forever, daemon=True)
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def ask(
    server: opening.RunsServer, path: str, form: dict[str, str] | None = None, **headers: str
) -> tuple[int, str, dict[str, str]]:
    """Status, body and headers of a request."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=20)
    kind = {"Content-Type": "application/x-www-form-urlencoded"} if form else {}
    body = urlencode(form) if form else None
    connection.request("POST" if form else "GET", path, body, kind | headers)
    answer = connection.getresponse()
    content = answer.read().decode()
    connection.close()
    return answer.status, content, dict(answer.getheaders())


def test_the_open_page_lists_runs_with_headline_date_and_picture(
    server: opening.RunsServer, report: str
) -> None:
    status, page, headers = ask(server, "/")
    assert status == 200 and "script" not in headers["Content-Security-Policy"]
    assert "Mice &lt;b&gt;alike&lt;/b&gt;" in page and "not evaluated yet" in page
    assert re.search(r"Begun \d{4}-\d\d-\d\d", page) and "deep/late" in page
    status, content, headers = ask(server, f"/page?run={quote('mice one')}")
    assert status == 200 and content == report
    assert (
        headers["Content-Security-Policy"].startswith("sandbox")
        and "same-origin" not in (headers["Content-Security-Policy"])
    )
    status, content, headers = ask(server, "/thumbnail?run=mice%20one")
    assert content.startswith("<svg") and headers["Content-Type"] == "image/svg+xml"


@pytest.mark.parametrize(
    "path",
    ["/page?run=..", "/page?run=../runs/mice%20one", "/../settings.json", "/page?run=deep/late",
     "/mice%20one/settings.json", "/picture?recording=../x.npz", "/start"],
)  # fmt: skip
def test_the_open_page_serves_nothing_else(server: opening.RunsServer, path: str) -> None:
    status, content, _ = ask(server, path)
    assert status == 404 and "secret" not in content


def test_the_open_page_answers_its_own_host_and_forms_alone(server: opening.RunsServer) -> None:
    form = {"command": "run", "file": "packaged", "name": "new", "token": server.token}
    assert ask(server, "/", Host="evil.example")[0] == 403
    assert ask(server, "/start", form, Host="evil.example")[0] == 403
    assert ask(server, "/start", form, Origin="http://evil.example")[0] == 403
    assert ask(server, "/start", form | {"token": "guess"})[0] == 403
    assert ask(server, "/start", form | {"file": "x" * 100_000})[0] == 400
    assert ask(server, "/start", form | {"name": "../out"})[0] == 400
    assert server.jobs.empty()
    assert ask(server, "/start", form)[0] == 303
    assert server.jobs.get_nowait().words == [
        "run", f"--out={server.folder / 'new'}", "--", "packaged"
    ]  # fmt: skip
    status, content, _ = ask(server, "/start", form)
    assert status == 400 and "another command goes on" in content


def test_a_form_of_the_open_page_starts_the_command_line(server: opening.RunsServer) -> None:
    form = {"command": "import", "files": "no-such.csv\n", "name": "mine", "fps": "30",
            "token": server.token}  # fmt: skip
    assert ask(server, "/start", form)[0] == 303
    job = next(server.answers())
    assert "refresh" in ask(server, "/")[1]
    job.run()
    assert job.status == 2 and "no-such.csv" in job.tail
    page = ask(server, "/")[1]
    assert "Refused: animarl import" in page and "no-such.csv" in page and "refresh" not in page


def test_forms_of_the_open_page_become_commands(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    (folder / "a").mkdir(parents=True)
    (folder / "a" / "settings.json").write_text("{}")
    asked = {"command": "whatif", "run": "a", "change": "speed=+20%\n\narena=x2", "name": "w"}
    assert opening.command_of_form(asked, folder) == [
        "whatif", "--change=speed=+20%", "--change=arena=x2", f"--out={folder / 'w'}", "--",
        str(folder / "a"),
    ]  # fmt: skip
    (folder / "mine.npz").touch()
    for wrong, word in (
        ({"run": "../a"}, "choose one of the list"), ({"change": " "}, "change is empty"),
        ({"name": ".hidden"}, "name is"), ({"command": "train"}, "choose import"),
        ({"command": "import", "files": "x", "name": "mine"}, "another name"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=word):
            opening.command_of_form(asked | wrong, folder)


def test_the_open_page_in_a_browser(server: opening.RunsServer, browser: object) -> None:
    page = browser.new_page()  # type: ignore[attr-defined]
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text))
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto(server.url)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        assert serious_findings(page) == []
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    assert unreachable_controls(page) == []
    page.get_by_label("Files of a tracker").fill("tracks.csv")
    page.get_by_label("Name of the result").fill("mine")
    page.get_by_role("button", name="Import").press("Enter")
    page.get_by_role("heading", name="Running: animarl import").wait_for()
    assert server.jobs.get_nowait().words[0] == "import"
    page.get_by_role("link", name="mice one").click()
    page.get_by_role("heading", name="Verdict").wait_for()
    page.locator("#theme").wait_for()
    assert errors == []
    shutil.rmtree(server.folder / "deep")
    page.goto(server.url)
    assert page.get_by_text("deep/late").count() == 0
