"""Jupyter panel: live view of a run with buttons, and sliders for gains, payload mass, squeeze and push."""

from __future__ import annotations

import contextlib
import functools
import html
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import CoopPinError, needs_extra
from coop_pin.description.scenario import Scenario
from coop_pin.results.finding import Findings
from coop_pin.results.run_result import RunResult
from coop_pin.running.check import run_findings
from coop_pin.viz.live.live_run import LiveRun, squeeze_force
from coop_pin.viz.live.live_view import open_view

_DECADE = 10.0
_RATES = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
_PUSH_N_PER_KG, _LARGEST_PUSH_N_PER_KG, _PUSH_S = 13.5, 45.0, 0.2
"""Of the payload: arms that carry little are pushed little."""
_MASS_FACTOR = 4.0
_LARGEST_SQUEEZE_FACTOR = 4.0
_SLIDER_STEPS = 200
_HEIGHT = 520
_GREY, _RED = "#52606d", "#b42318"


class Slider(NamedTuple):
    """Slider of the panel.

    Attributes:
        field: dotted path of a gain in the scenario; or "mass", "squeeze" or "push".
        label: description beside the slider.
        value: initial value: a number, or the factor 1 for a gain of several numbers.
        low: smallest value; above zero the slider is logarithmic.
        high: largest value.
        gain: gain of several numbers that the value multiplies; None for a single number.
    """

    field: str
    label: str
    value: float
    low: float
    high: float
    gain: Any = None

    def field_value(self, value: float) -> Any:
        """Return the value of the scenario's field for a value of the slider."""
        return value if self.gain is None else _scaled(self.gain, value)

    @property
    def ends(self) -> tuple[float, float]:
        """Ends of the scale: of a logarithmic slider the exponents of ten."""
        if self.low > 0.0:
            return math.log10(self.low), math.log10(self.high)
        return self.low, self.high


def _doubts(scenario: Scenario) -> Findings | tuple[()]:
    """Return the errors and warnings known before a run; none of a cell of which the run itself will tell."""
    with contextlib.suppress(CoopPinError):
        return run_findings(scenario).of("error", "warning")
    return ()


def gain_sliders(scenario: Scenario) -> tuple[Slider, ...]:
    """Return the sliders of a scenario's gains; none for a user's own controller."""
    sliders = list[Slider]()
    for name, gain in scenario.controller.active_gains.items():
        field, label = f"controller.gains.{name}", name.replace("_", " ")
        if isinstance(gain, tuple):
            sliders.append(Slider(field, f"{label} \u00d7", 1.0, 1.0 / _DECADE, _DECADE, gain))
        elif name in ("sign_gain", "force_gain") or gain == 0.0:
            sliders.append(Slider(field, label, gain, 0.0, max(5.0 * gain, 1.0)))
        else:
            largest = scenario.clock.rate_hz if name == "leak" else math.inf
            sliders.append(Slider(field, label, gain, gain / _DECADE, min(gain * _DECADE, largest)))
    return tuple(sliders)


def _scaled(gain: Any, factor: float) -> Any:
    return tuple(_scaled(entry, factor) for entry in gain) if isinstance(gain, tuple) else factor * gain


class Panel:
    """Jupyter panel of a run: live view with strip charts, buttons and sliders.

    A notebook displays it as the result of a cell. A slider acts at the next tick, and follows changes that
    code makes in ``run``.

    Attributes:
        run: the interactive run.
        view: live view of the run.
        widget: the whole panel, an ipywidget.
        sliders: widgets by dotted path of the gain in the scenario, and "mass", "squeeze" and "push".
        buttons: widgets "start", "reset" and "push".
    """

    def __init__(self, scenario: Scenario | str | Path, *, realtime_rate: float = 1.0) -> None:
        """Build the panel of a run, paused at the start.

        Args:
            scenario: a Scenario, a name in the catalogue or the path of a TOML file; its duration limits the
                run.
            realtime_rate: simulated seconds per second of wall time.

        Raises:
            MissingExtraError: anywidget or ipywidgets is not installed.
            ScenarioError: the scenario has mistakes.
            UnreachablePoseError: an arm does not reach its grasp at the start.
        """
        with needs_extra("ipywidgets", "notebook", "for the panel"):
            import ipywidgets
        self._kit: Any = ipywidgets
        scenario = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
        self.view = open_view(scenario)
        self.run = LiveRun(scenario, view=self.view, realtime_rate=realtime_rate)
        self.run.on_end, self.run.on_change = self._show_state, self._follow
        self.sliders: dict[str, Any] = {}
        self._shown: dict[str, Slider] = {}
        self._is_following = False
        self.buttons = {
            "start": self._button("Start", "play", self._toggle),
            "reset": self._button("Reset", "undo", self._reset),
            "push": self._button("Push", "hand-pointer-o", self._push),
        }
        self._push_n, self._most_push_n = (
            float(f"{per_kg * scenario.cell.payload.mass:.2g}")
            for per_kg in (_PUSH_N_PER_KG, _LARGEST_PUSH_N_PER_KG)
        )
        self._live = self.view.in_notebook(height=_HEIGHT, most_push=self._most_push_n)
        self._live.on_push = self._push_at
        self._status = self._kit.HTML()
        known = "".join(f"<p>{html.escape(str(finding))}</p>" for finding in _doubts(scenario))
        doubts = self._kit.HTML(f'<div style="color: {_RED}">{known}</div>')
        self.widget = self._kit.VBox([self._live, doubts, self._controls(scenario), self._status])
        self._show_state()

    def result(self) -> RunResult:
        """Return the recording since the last reset; at least one tick must have been done."""
        return self.run.result()

    def close(self) -> None:
        """Pause the run and close its view."""
        self.run.pause()
        self.view.close()

    def _repr_mimebundle_(self, **options: Any) -> Any:
        """Return the widget, and a still image with the reason for pages without a kernel."""
        reason = "still image: buttons and sliders need a running notebook"
        still = self.view.still_html(reason, height=_HEIGHT)
        return self.widget._repr_mimebundle_(**options) | {"text/html": still}

    # ------------------------------------------------------------ layout

    def _controls(self, scenario: Scenario) -> Any:
        """Return the buttons and sliders."""
        rate = self._kit.Dropdown(
            options=[(f"\u00d7 {rate:g}", rate) for rate in _RATES], value=1.0, layout={"width": "90px"}
        )
        rate.observe(lambda change: setattr(self.run, "realtime_rate", change["new"]), "value")
        gains = [self._add(slider, self._change_gain(slider.field)) for slider in gain_sliders(scenario)]
        push = Slider("push", "push, N", self._push_n, 0.0, self._most_push_n)
        acts = {"mass": self.run.change_mass, "squeeze": self.run.change_squeeze}
        rest = [self._add(slider, acts[slider.field]) for slider in self._load_sliders()]
        rest.append(self._add(push, lambda _: None))
        half = max(len(rest) + 1, (len(gains) + 1) // 2)
        buttons = self._kit.HBox([*self.buttons.values(), rate])
        columns = [self._kit.VBox(part) for part in ([buttons, *rest], gains[:half], gains[half:])]
        return self._kit.HBox(columns, layout={"flex_flow": "row wrap"})

    def _load_sliders(self) -> list[Slider]:
        """Return the sliders of the payload's mass and of the squeeze, if there is one, as they are now."""
        mass, squeeze = self.run.scenario.cell.payload.mass, squeeze_force(self.run.scenario)
        sliders = [Slider("mass", "payload, kg", mass, mass / _MASS_FACTOR, mass * _MASS_FACTOR)]
        if squeeze > 0.0:
            largest = _LARGEST_SQUEEZE_FACTOR * squeeze
            sliders.append(Slider("squeeze", "squeeze, N", self.run.squeeze, 0.0, largest))
        return sliders

    def _add(self, slider: Slider, act: Callable[[float], None]) -> Any:
        """Return the widget of a slider, and list it in ``sliders``."""
        self._shown[slider.field] = slider
        kind = self._kit.FloatLogSlider if slider.low > 0.0 else self._kit.FloatSlider
        low, high = slider.ends
        widget = self.sliders[slider.field] = kind(
            value=slider.value,
            min=low,
            max=high,
            step=(high - low) / _SLIDER_STEPS,
            readout_format=".3g",
            description=slider.label,
            continuous_update=False,
            style={"description_width": "110px"},
            layout={"width": "350px"},
        )
        widget.observe(lambda change: self._act(functools.partial(act, change["new"])), "value")
        return widget

    def _button(self, text: str, icon: str, act: Callable[[], None]) -> Any:
        button = self._kit.Button(description=text, icon=icon, layout={"width": "92px"})
        button.on_click(lambda _: self._try(act))
        return button

    # ------------------------------------------------------------ actions

    def _act(self, act: Callable[[], None]) -> None:
        if not self._is_following:
            self._try(act)

    def _follow(self) -> None:
        """Show in the sliders and on the clock what has changed in the run, without acting on it again."""
        self._live.changes = [change._asdict() for change in self.run.changes]
        self._is_following = True
        for slider in (*gain_sliders(self.run.scenario), *self._load_sliders()):
            widget, was = self.sliders.get(slider.field), self._shown.get(slider.field)
            if (
                widget is None  # of a law that the panel was not made for
                or was is None
                or slider.field_value(slider.value) == was.field_value(widget.value)
            ):
                continue
            self._shown[slider.field] = slider
            with widget.hold_trait_notifications():
                if not was.low <= slider.value <= was.high:
                    widget.min, widget.max = slider.ends
                widget.value = slider.value
        self._is_following = False

    def _try(self, act: Callable[[], None]) -> None:
        """Do an action; show its error below the panel if it is refused."""
        try:
            act()
        except CoopPinError as error:
            self._show(str(error), _RED)
        else:
            self._show_state()

    def _toggle(self) -> None:
        if self.run.is_running:
            self.run.pause()
        else:
            self.run.start()

    def _reset(self) -> None:
        was_running = self.run.is_running
        self.run.reset()
        if was_running:
            self.run.start()
        else:
            self.run.step()  # shows the initial state

    def _push(self) -> None:
        self.run.push((0.0, self.sliders["push"].value, 0.0, 0.0, 0.0, 0.0), _PUSH_S)

    def _push_at(self, point: Array, force: Array) -> None:
        """Push the payload at a point, m, by a force, N; only in the rows that the cell controls."""
        rows = self.run.scenario.cell.task_rows
        moment = np.cross(point - self.view.payload_position, force)
        wrench = rows.expand(rows.select(np.concatenate((force, moment))))
        self._try(lambda: self.run.push(tuple(wrench.tolist()), _PUSH_S))

    def _change_gain(self, field: str) -> Callable[[float], None]:
        return lambda value: self.run.change({field: self._shown[field].field_value(value)})

    def _show_state(self) -> None:
        """Show below the panel whether the run is running, paused, finished or failed."""
        running = self.run.is_running and not self.run.is_finished
        start = self.buttons["start"]
        start.description, start.icon = ("Pause", "pause") if running else ("Start", "play")
        if self.run.error is not None:
            self._show(str(self.run.error), _RED)
        elif self.run.is_finished:
            self._show(f"the run finished at t = {self.run.scenario.duration:g} s; reset to run again", _GREY)
        else:
            self._show("running" if running else "paused", _GREY)

    def _show(self, text: str, colour: str) -> None:
        self._status.value = f'<span style="color: {colour}">{html.escape(text)}</span>'
