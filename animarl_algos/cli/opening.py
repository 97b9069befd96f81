"""``animarl open``: the runs of a folder in the browser, with forms that start commands.

The server listens on the loopback address alone. It answers requests that name this address as
their host, serves files of the runs that it lists and no others, and starts a command only for a
form that holds its token. Pages of runs are shown without access to the list and its forms.
"""

import io
import queue
import re
import secrets
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from functools import cached_property
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any, TextIO
from urllib.parse import parse_qs, urlsplit

from typer import Argument, Option

from animarl_algos.cli.shared import PlainConsole, with_help
from animarl_envs.errors import InputError, require
from animarl_envs.files import read_json

LOOPBACK = "127.0.0.1"
LARGEST_FORM = 64_000  # bytes
MOST_OUTPUT = 6000  # last characters
NAME = re.compile(r"[A-Za-z0-9][\w.-]{0,60}")
PLACES = ("settings.json", "*/settings.json", "*/*/settings.json")  # of runs in a folder
PICTURE = re.compile(r'<section id="trajectories">.*?(<svg .*?</svg>)', re.DOTALL)
LIST_POLICY = (
    "default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; form-action 'self'; "
    "base-uri 'none'; frame-ancestors 'none'"
)
PAGE_POLICY = "sandbox allow-scripts allow-downloads"
HTML, SVG, PNG = "text/html; charset=utf-8", "image/svg+xml", "image/png"


@dataclass(frozen=True)
class ListedRun:
    """A run as the list shows it."""

    name: str
    path: Path

    @property
    def page(self) -> Path:
        """Where its page is, or will be."""
        return self.path / "report.html"

    @property
    def date(self) -> str:
        """When it was begun."""
        begun = (self.path / "settings.json").stat().st_mtime
        return time.strftime("%Y-%m-%d %H:%M", time.localtime(begun))

    @cached_property
    def verdict(self) -> dict[str, str]:
        """The headline of its verdict and the colour of that; what is missing, in place of it."""
        file = self.path / "evaluation" / "verdict.json"
        if not file.exists():
            return {"colour": "grey", "headline": "It is not evaluated yet."}
        try:
            content = read_json(file)
            return {key: str(content[key]) for key in ("colour", "headline")}
        except (InputError, ValueError, KeyError) as error:
            return {"colour": "grey", "headline": f"Its verdict cannot be read: {error}"}

    @cached_property
    def thumbnail(self) -> str:
        """The first picture of paths on its page, as SVG; empty if there is none."""
        if not self.page.is_file():
            return ""
        match = PICTURE.search(self.page.read_text(encoding="utf-8"))
        return "" if match is None else match[1]


def list_runs(folder: Path) -> dict[str, ListedRun]:
    """Return the runs of a folder by name, the newest first."""
    files = [file for place in PLACES for file in folder.glob(place)]
    files.sort(key=lambda file: file.stat().st_mtime, reverse=True)
    names = [file.parent.relative_to(folder).as_posix() for file in files]
    return {name: ListedRun(name, file.parent) for name, file in zip(names, files)}


@dataclass
class Job:
    """A command that a form started; ``status`` is its exit status, None while it goes on."""

    words: list[str]
    output: io.StringIO = field(default_factory=io.StringIO)
    status: int | None = None

    @property
    def tail(self) -> str:
        """What it printed last."""
        return self.output.getvalue()[-MOST_OUTPUT:]

    def run(self) -> None:
        """Run it as the command line does."""
        from animarl_algos.cli.main import main

        before, sys.argv = sys.argv, ["animarl", *self.words]
        try:
            out, errors = _Tee(self.output, sys.stdout), _Tee(self.output, sys.stderr)
            with redirect_stdout(out), redirect_stderr(errors):
                main()
            self.status = 0
        except SystemExit as ended:
            self.status = ended.code if isinstance(ended.code, int) else int(bool(ended.code))
        finally:
            sys.argv = before
            if self.status is None:
                self.status = 1


class _Tee(io.TextIOBase):
    """Writes to the page of a job and to the terminal."""

    def __init__(self, page: TextIO, terminal: TextIO) -> None:
        self.page, self.terminal = page, terminal

    def write(self, text: str) -> int:
        self.page.write(text)
        return self.terminal.write(text)

    def flush(self) -> None:
        self.terminal.flush()


def command_of_form(form: Mapping[str, str], folder: Path) -> list[str]:
    """Return the words of the command that a form asks for.

    Results are put into ``folder``. Raises InputError if an entry is missing or does not fit.
    """

    def entry(name: str) -> str:
        value = form.get(name, "").strip()
        require(value, f"{name} is empty: fill it in")
        return value

    kind, name = form.get("command", ""), entry("name")
    require(
        NAME.fullmatch(name),
        f"name is {name!r}: give letters, digits, points, dashes and underscores",
    )
    if kind == "import":
        out = folder / f"{name.removesuffix('.npz')}.npz"
        require(not out.exists(), f"{out}: there is such a file: choose another name")
        options = [f"--{one}={form[one].strip()}" for one in ("fps", "target") if form.get(one)]
        files = [line.strip() for line in entry("files").splitlines() if line.strip()]
        return ["import", *options, f"--out={out}", "--", *files]
    if kind == "run":
        return ["run", f"--out={folder / name}", "--", entry("file")]
    runs = list_runs(folder)
    require(kind == "whatif", f"command is {kind!r}: choose import, run or whatif")
    require(form.get("run") in runs, f"run is {form.get('run')!r}: choose one of the list")
    changes = [f"--change={line.strip()}" for line in entry("change").splitlines() if line.strip()]
    return ["whatif", *changes, f"--out={folder / name}", "--", str(runs[form["run"]].path)]


class RunsServer(ThreadingHTTPServer):
    """Serves the runs of a folder; commands of its forms are put into ``jobs``."""

    daemon_threads = True

    def __init__(self, folder: Path, port: int = 0) -> None:
        super().__init__((LOOPBACK, port), _Handler)
        self.folder, self.token = folder, secrets.token_urlsafe(32)
        self.jobs: queue.Queue[Job] = queue.Queue()
        self.job: Job | None = None

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print what went wrong, unless the reader left before the answer."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    @property
    def url(self) -> str:
        """Where the list is."""
        return f"http://{LOOPBACK}:{self.server_port}/"

    @property
    def hosts(self) -> set[str]:
        """Names under which it answers; another host's page cannot pass for this one."""
        return {f"{name}:{self.server_port}" for name in (LOOPBACK, "localhost")}

    def start(self, job: Job) -> None:
        """Queue a command; raises InputError while another goes on."""
        busy = self.job is not None and self.job.status is None
        require(not busy, "another command goes on: wait until it has ended")
        self.job = job
        self.jobs.put(job)

    def answers(self) -> Iterator[Job]:
        """Yield commands as they come, for the main thread to run."""
        while True:
            yield self.jobs.get()


class _Handler(BaseHTTPRequestHandler):
    server: RunsServer

    def do_GET(self) -> None:
        if not self._of_this_host():
            self._send(HTTPStatus.FORBIDDEN, "This server answers on this computer alone.")
            return
        place, query = self._place()
        runs = list_runs(self.server.folder)
        one = runs.get(query.get("run", ""))
        recordings = {file.name: file for file in sorted(self.server.folder.glob("*.npz"))}
        recording = recordings.get(query.get("recording", ""))
        if place == "/":
            self._send(HTTPStatus.OK, self._list(runs, list(recordings.values())), LIST_POLICY)
        elif place == "/page" and one is not None and one.page.is_file():
            self._send(HTTPStatus.OK, one.page.read_bytes(), PAGE_POLICY)
        elif place == "/thumbnail" and one is not None and one.thumbnail:
            self._send(HTTPStatus.OK, one.thumbnail, PAGE_POLICY, SVG)
        elif place == "/picture" and recording and (file := recording.with_suffix(".png")).exists():
            self._send(HTTPStatus.OK, file.read_bytes(), PAGE_POLICY, PNG)
        else:
            self._send(HTTPStatus.NOT_FOUND, "There is no such page.")

    def do_POST(self) -> None:
        place, _ = self._place()
        length = self.headers.get("Content-Length", "")
        origin = self.headers.get("Origin")
        own = origin is None or urlsplit(origin).netloc in self.server.hosts
        if not self._of_this_host() or not own:
            self._send(HTTPStatus.FORBIDDEN, "This server answers on this computer alone.")
            return
        if place != "/start" or not length.isdigit() or int(length) > LARGEST_FORM:
            self._send(HTTPStatus.BAD_REQUEST, "This is no form of the list.")
            return
        form = _last_of_each(self.rfile.read(int(length)).decode(errors="replace"))
        if not secrets.compare_digest(form.get("token", "").encode(), self.server.token.encode()):
            self._send(HTTPStatus.FORBIDDEN, "The form is of another session: reload the list.")
            return
        try:
            self.server.start(Job(command_of_form(form, self.server.folder)))
        except InputError as error:
            self._send(HTTPStatus.BAD_REQUEST, str(error))
            return
        self.send_response(HTTPStatus.SEE_OTHER)
        self.send_header("Location", "/")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _place(self) -> tuple[str, dict[str, str]]:
        parts = urlsplit(self.path)
        return parts.path, _last_of_each(parts.query)

    def _of_this_host(self) -> bool:
        return self.headers.get("Host") in self.server.hosts

    def _list(self, runs: Mapping[str, ListedRun], recordings: list[Path]) -> str:
        from animarl_algos.report.page import render

        return render(
            "runs.html.j2",
            folder=str(self.server.folder),
            runs=list(runs.values()),
            recordings=recordings,
            job=self.server.job,
            token=self.server.token,
        )

    def _send(
        self, status: HTTPStatus, content: str | bytes, policy: str = LIST_POLICY, kind: str = ""
    ) -> None:
        body = content if isinstance(content, bytes) else content.encode()
        self.send_response(status)
        plain = "text/plain; charset=utf-8"
        self.send_header("Content-Type", kind or (HTML if status == HTTPStatus.OK else plain))
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Content-Security-Policy", policy)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "same-origin")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: Any) -> None:
        """Print no line for each request."""


def _last_of_each(query: str) -> dict[str, str]:
    return {name: values[-1] for name, values in parse_qs(query, max_num_fields=50).items()}


@with_help(
    folder=Argument(help="Folder of runs."),
    port=Option(min=0, max=65535, help="Port; 0: one that is free."),
    browser=Option("--browser/--no-browser", help="Open the list in the browser."),
)
def open_command(folder: Path = Path("runs"), port: int = 0, browser: bool = True) -> None:
    """List the runs of a folder in the browser, with their pages, and forms to start commands.

    The forms import tracks, build a simulator and ask what if, in this process and into this
    folder. The list is served on this computer alone, until Ctrl-C.

    Example:

      animarl open

      animarl open results --no-browser --port 8000
    """
    require(folder.is_dir() or not folder.exists(), f"{folder}: it is a file: name a folder")
    from animarl_algos.report import page  # noqa: F401  before a reader waits for it

    with RunsServer(folder, port) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        PlainConsole().print(f"Open {server.url} (Ctrl-C ends it)")
        if browser:
            import webbrowser

            webbrowser.open(server.url)
        try:
            for job in server.answers():
                job.run()
        finally:
            server.shutdown()
