"""Explorer of many runs: the heat map of a sweep or a comparison, served: a cell opens its replay."""

from __future__ import annotations

import functools
import http.server
import secrets
import threading
import urllib.parse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from coop_pin.base.errors import CoopPinError, FieldError, PortTakenError
from coop_pin.comparison.table import Comparison
from coop_pin.results.run_result import RunResult
from coop_pin.sweeps.heat_map import REPLAYS, SERVED, cell_names, replay_file
from coop_pin.sweeps.result import SweepResult
from coop_pin.viz.replay import save_replay

_COMPARISON, _SWEEP = "comparison.csv", "plan.json"
"""Files of the folders of many runs."""
_MOST_CELLS = 4
_Drawn: TypeAlias = Callable[[Sequence[str]], Path]
"""Function that writes the replay of some cells, by what the page calls them."""


def is_folder_of_runs(path: Path) -> bool:
    """Return whether a path is the folder of a comparison or of a sweep."""
    return any((path / name).is_file() for name in (_COMPARISON, _SWEEP))


def comparison_replay(table: Comparison, texts: Sequence[str], folder: Path) -> Path:
    """Write the replay of some cells of a comparison, side by side, and return its file.

    Args:
        table: the comparison.
        texts: cells, "SCENARIO | CONTROLLER | TRIAL", with "| SEED" behind a random trial.
        folder: folder in whose ``replays`` it is written.

    Raises:
        FieldError: a text is not of this form.
        CoopPinError: whatever ``Comparison.open`` raises where nothing was recorded.
    """
    runs, cells = list[RunResult](), list(map(cell_names, texts))
    for cell in cells:
        names, seed = cell[:3], "".join(cell[3:]) or "0"
        if len(names) < 3 or not seed.isdecimal():
            form = "'SCENARIO | CONTROLLER | TRIAL', with '| SEED' behind a random trial"
            raise FieldError(f"is {' | '.join(cell)!r}; it must be {form}", "--replay")
        runs.append(_kept(functools.partial(table.open, *names, seed=int(seed))))
    return _written(folder / REPLAYS / replay_file(cells), runs, texts)


def sweep_replay(result: SweepResult, numbers: Sequence[str], folder: Path) -> Path:
    """Write the replay of some runs of a sweep, side by side, and return its file.

    Args:
        result: the sweep.
        numbers: numbers of runs.
        folder: folder in whose ``replays`` it is written.

    Raises:
        OutOfRangeError: there is no such run.
        CoopPinError: whatever ``SweepResult.open`` raises where nothing was recorded.
    """
    runs = [_kept(functools.partial(result.open, int(number))) for number in numbers]
    names = [f"run {number}" for number in numbers]
    return _written(folder / REPLAYS / f"run-{'--'.join(numbers)}.html", runs, names)


def _kept(run: Callable[[], RunResult]) -> RunResult:
    """Return the result of a run; that of one that failed ends where it failed."""
    try:
        return run()
    except CoopPinError as error:
        if error.result is None:
            raise
        return error.result


def _written(file: Path, runs: Sequence[RunResult], names: Sequence[str]) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    save_replay(runs[0], file, *runs[1:], names=names if len(runs) > 1 else ())
    return file


class Explorer:
    """Server of the heat map of a folder of runs, for browsers of this machine that know its address.

    A replay that the folder does not have is simulated and written when it is asked for, one at a time.

    Attributes:
        url: address with a secret, which other users of the machine do not know.
    """

    def __init__(self, folder: Path, *, port: int = 0) -> None:
        """Start to serve.

        Args:
            folder: folder of a comparison or of a sweep; its page is written there.
            port: port on 127.0.0.1; 0 for any free one.

        Raises:
            FileReadError: the folder is not one of runs.
            PortTakenError: the chosen port is not available.
        """
        page, draw = _page_of(folder)
        secret = secrets.token_urlsafe(16)
        handler = functools.partial(_Handler, page, folder / REPLAYS, draw, f"/{secret}/")
        try:
            self._server = http.server.ThreadingHTTPServer(("127.0.0.1", port), handler)
        except OSError as error:
            raise PortTakenError(port, str(error)) from error
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/{secret}/"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End it."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _page_of(folder: Path) -> tuple[Path, _Drawn]:
    """Return the page of a folder of runs, written anew, and what writes its replays."""
    if (folder / _COMPARISON).is_file():
        table, page = Comparison.load(folder), folder / "comparison.html"
        table.write_html(page)
        return page, lambda cells: comparison_replay(table, cells, folder)
    result, page = SweepResult.load(folder), folder / "map.html"
    result.write_html(page)
    return page, lambda cells: sweep_replay(result, cells, folder)


class _Handler(http.server.BaseHTTPRequestHandler):
    """Answers: the page, and replays."""

    _one_at_a_time = threading.Lock()

    def __init__(self, page: Path, replays: Path, draw: _Drawn, root: str, *connection: Any) -> None:
        self._page, self._replays, self._draw, self._root = page, replays, draw, root
        super().__init__(*connection)

    def do_GET(self) -> None:
        """Answer with a page, or in words why there is none."""
        address = urllib.parse.urlsplit(self.path)
        if address.path == self._root:
            page = self._page.read_text(encoding="utf-8")
            return self._send(200, page.replace(SERVED, SERVED.replace("false", "true"), 1))
        name = urllib.parse.unquote(address.path.removeprefix(f"{self._root}{REPLAYS}/"))
        if not address.path.startswith(self._root) or Path(name).name != name:
            return self._send(404, "There is no such page.")
        file, cells = self._replays / name, urllib.parse.parse_qs(address.query).get("cell", [])
        try:
            with self._one_at_a_time:
                if not file.is_file() and 0 < len(cells) <= _MOST_CELLS:
                    file = self._draw(cells)
        except (CoopPinError, ValueError) as error:
            return self._send(500, f"There is no replay: {error}")
        if not file.is_file():
            return self._send(404, "There is no such replay.")
        return self._send(200, file.read_text(encoding="utf-8"))

    def _send(self, code: int, text: str) -> None:
        content = text.encode()
        self.send_response(code)
        kind = "text/html" if code == 200 else "text/plain"
        for name, value in (
            ("Content-Type", f"{kind}; charset=utf-8"),
            ("Content-Length", str(len(content))),
            ("Cache-Control", "no-store"),
            ("Referrer-Policy", "no-referrer"),
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_words: object) -> None:
        """Write no log."""
