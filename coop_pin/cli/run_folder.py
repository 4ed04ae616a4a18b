"""Folder of a run: scenario, result, metrics, timing and figures; files are written atomically."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from coop_pin.base.atomic_write import write_atomically
from coop_pin.results.run_result import RunResult


class Timing(NamedTuple):
    """Computing time of a run; kept apart from its metrics, which are the same on every machine.

    Attributes:
        wall_s: s.
        cpu_s: s.
        real_time_factor: simulated seconds in one second of wall time.
    """

    wall_s: float
    cpu_s: float
    real_time_factor: float

    @classmethod
    def since(cls, start: tuple[float, float], result: RunResult) -> Timing:
        """Return the time that a result has taken since the wall and processor times of its start, s."""
        wall = time.perf_counter() - start[0]
        return cls(wall, time.process_time() - start[1], result.end / wall)


class RunFolder:
    """A folder that holds one run.

    Attributes:
        path: the folder.
    """

    SCENARIO, RESULT, METRICS, TIMING = "scenario.toml", "result.nc", "metrics.json", "timing.json"
    REPLAY, REPORT = "replay.html", "report.html"
    FIGURES = ("figure2", "figure3", "errors")

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    def write(
        self,
        result: RunResult,
        timing: Timing,
        *,
        replay: bool = True,
        figures: Sequence[Literal["png", "svg"]] = ("png",),
    ) -> None:
        """Write a run, finished or not; what an earlier run left in the folder is replaced or removed.

        metrics.json starts with the verdicts, their reasons and, if an error ended the run, the error's
        class. A run that did not reach the window of a metric has null there.
        """
        text = result.scenario.to_toml()
        write_atomically(self.path / self.SCENARIO, lambda part: part.write_text(text, encoding="utf-8"))
        result.save(self.path / self.RESULT)
        self._write_json(self.TIMING, timing._asdict())
        self._write_json(self.METRICS, _metrics(result))
        pictures = (f"{name}.{kind}" for name in self.FIGURES for kind in ("png", "svg"))
        for name in (self.REPLAY, self.REPORT, *pictures):
            (self.path / name).unlink(missing_ok=True)
        if replay:
            self.write_replay(result)
        if figures:
            self._write_figures(result, figures)

    def write_replay(self, result: RunResult) -> Path:
        """Write the 3-D replay and return its file."""
        from coop_pin.viz import save_replay  # a run without pictures does not wait for the viewers to load

        path = self.path / self.REPLAY
        save_replay(result, path)
        return path

    def replay(self) -> Path:
        """Return the file of the 3-D replay; it is written from the result if it is missing.

        Raises:
            FileReadError: there is no result either, or it is damaged.
        """
        path = self.path / self.REPLAY
        return path if path.is_file() else self.write_replay(RunResult.load(self.path / self.RESULT))

    def _write_json(self, name: str, table: Mapping[str, Any]) -> None:
        text = json.dumps(table, indent=2, allow_nan=False) + "\n"
        write_atomically(self.path / name, lambda part: part.write_text(text, encoding="utf-8"))

    def _write_figures(self, result: RunResult, formats: Sequence[Literal["png", "svg"]]) -> None:
        from coop_pin import figures

        makers = (figures.tracking_figure, figures.torque_figure, figures.error_figure)
        for name, make in zip(self.FIGURES, makers, strict=True):
            figures.save_figure(make(result), self.path / name, formats=formats)


def _metrics(result: RunResult) -> dict[str, Any]:
    """Return verdicts, reasons and metrics for JSON, which has no infinity and no not-a-number: null."""
    task = result.task
    reasons = [str(breach) for breach in (*result.breaches(), *task.deviations)]
    verdict: dict[str, Any] = {"simulation_sound": result.simulation_sound, "task": task.state}
    verdict["reasons"] = reasons
    if result.ENDED_BY in result.data.attrs:
        verdict[result.ENDED_BY] = result.data.attrs[result.ENDED_BY]
    numbers = {name: value if math.isfinite(value) else None for name, value in result.metrics().items()}
    return verdict | {name: value for name, value in numbers.items() if name not in verdict}
