"""A notebook panel: a run under the hand, beside its live view."""

from __future__ import annotations

import functools
import html
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coop_pin.description.controller import NoForcePath, UserController
from coop_pin.description.scenario import Scenario
from coop_pin.errors import CoopPinError, MissingExtraError
from coop_pin.results import RunResult
from coop_pin.viz.live_run import LiveRun
from coop_pin.viz.live_view import open_view
from coop_pin.viz.replay import page_frame

_DECADE = 10.0


class Slider(NamedTuple):
    """A slider for a gain.

    Attributes:
        field: dotted path in the scenario.
        label: for people.
        value: as the scenario has it: a number, or a factor on a gain of several numbers.
        low: the least.
        high: the most.
        gain: the gain that the factor multiplies; None where the slider is the gain itself.
    """

    field: str
    label: str
    value: float
    low: float
    high: float
    gain: Any = None

    def field_value(self, value: float) -> Any:
        """Return what the scenario's field becomes."""
        return value if self.gain is None else _scaled(self.gain, value)


def gain_sliders(scenario: Scenario) -> tuple[Slider, ...]:
    """Return the knobs of a scenario's gains; none for a user's own controller, whose gains nobody here knows."""
    chosen = scenario.controller
    if isinstance(chosen, UserController):
        return ()
    sliders: list[Slider] = []
    for name, gain in chosen.gains:
        if name == "force_gain" and isinstance(chosen.force_path, NoForcePath):
            continue  # the law would not feel it
        field, label = f"controller.gains.{name}", name.replace("_", " ")
        if isinstance(gain, tuple):
            sliders.append(Slider(field, f"{label} \u00d7", 1.0, 1.0 / _DECADE, _DECADE, gain))
        elif name in ("sign_gain", "force_gain"):
            sliders.append(Slider(field, label, gain, 0.0, max(5.0 * gain, 1.0)))
        else:
            sliders.append(Slider(field, label, gain, gain / _DECADE, gain * _DECADE))
    return tuple(sliders)


def _scaled(gain: Any, factor: float) -> Any:
    return tuple(_scaled(entry, factor) for entry in gain) if isinstance(gain, tuple) else factor * gain


_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
_PUSH_N, _LARGEST_PUSH_N, _PUSH_S = 150.0, 500.0, 0.2
_MASS_FACTOR = 4.0
_LARGEST_SQUEEZE_FACTOR = 4.0
_HEIGHT = 600


class Panel:
    """Buttons and sliders for a run, and its live view with strip charts; let a notebook cell return it.

    A slider acts on the running loop at the next tick.

    Attributes:
        run: the run under way.
        view: its live view.
        widget: everything, as one ipywidget.
        sliders: the sliders by the field of the scenario that they change; besides gains "mass", "squeeze"
            and "push".
        buttons: "start", "reset" and "push".
    """

    def __init__(self, scenario: Scenario | str | Path, realtime_rate: float = 1.0) -> None:
        """Stand at the start, paused.

        Args:
            scenario: a Scenario, a name in the catalogue or the path of a TOML file; its duration is how long
                one can play.
            realtime_rate: simulated seconds in one second of wall time.

        Raises:
            MissingExtraError: ipywidgets is not installed.
            ScenarioError: the scenario has mistakes.
            UnreachablePoseError: the start is out of an arm's reach.
        """
        self._kit = _widgets()
        scenario = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
        self.view = open_view(scenario)
        self.run = LiveRun(scenario, self.view, realtime_rate)
        self.run.when_it_ends(self._tell_state)
        self.sliders: dict[str, Any] = {}
        self.buttons = {
            "start": self._button("Start", "play", self._toggle),
            "reset": self._button("Reset", "undo", self._reset),
            "push": self._button("Shove", "hand-pointer-o", self._push),
        }
        self._speed = self._kit.Dropdown(
            options=[(f"\u00d7 {speed:g}", speed) for speed in _SPEEDS], value=1.0, layout={"width": "90px"}
        )
        self._speed.observe(self._change_speed, "value")
        self._status, self._frame = (
            self._kit.HTML(),
            self._kit.HTML(self.view.frame_html(_HEIGHT), layout={"width": "100%"}),
        )
        self.widget = self._kit.VBox([self._frame, self._controls(scenario), self._status])
        self._tell_state()

    def result(self) -> RunResult:
        """Return what was recorded since the last reset; at least one tick must have been done."""
        return self.run.result()

    def close(self) -> None:
        """Stop the run and end its view."""
        self.run.pause()
        self.view.close()

    def _repr_mimebundle_(self, **options: Any) -> Any:
        """Return the widget, and for pages without a kernel behind them a still picture that says so."""
        still = page_frame(
            self.view.still_html("still picture: buttons and sliders need a running notebook"),
            _HEIGHT,
            "coop_pin",
        )
        return self.widget._repr_mimebundle_(**options) | {"text/html": still}

    # ------------------------------------------------------------ layout

    def _controls(self, scenario: Scenario) -> Any:
        for knob in gain_sliders(scenario):
            self._add(knob, functools.partial(self._change_gain, knob))
        mass, squeeze = (
            scenario.cell.payload.mass,
            float(np.linalg.norm(scenario.squeeze_wrenches[:, :3], axis=1).max()),
        )
        self._add(
            Slider("mass", "payload, kg", mass, mass / _MASS_FACTOR, mass * _MASS_FACTOR),
            self.run.change_mass,
        )
        if squeeze > 0.0:
            self._add(
                Slider("squeeze", "squeeze, N", squeeze, 0.0, _LARGEST_SQUEEZE_FACTOR * squeeze),
                self.run.change_squeeze,
            )
        self._add(Slider("push", "push, N", _PUSH_N, 0.0, _LARGEST_PUSH_N), lambda _: None)
        gains = [slider for field, slider in self.sliders.items() if "." in field]
        rest = [slider for field, slider in self.sliders.items() if "." not in field]
        buttons = self._kit.HBox([*self.buttons.values(), self._speed])
        return self._kit.HBox([self._kit.VBox([buttons, *rest]), self._kit.VBox(gains)])

    def _add(self, knob: Slider, act: Callable[[float], None]) -> None:
        common = {
            "description": knob.label,
            "continuous_update": False,
            "style": {"description_width": "110px"},
        }
        if knob.low > 0.0:
            low, high = np.log10(knob.low), np.log10(knob.high)
            slider = self._kit.FloatLogSlider(
                value=knob.value, min=low, max=high, step=(high - low) / 200, readout_format=".3g", **common
            )
        else:
            step = knob.high / 200
            slider = self._kit.FloatSlider(
                value=knob.value, min=knob.low, max=knob.high, step=step, readout_format=".3g", **common
            )
        slider.layout.width = "380px"
        slider.observe(lambda change: self._try(lambda: act(change["new"])), "value")
        self.sliders[knob.field] = slider

    def _button(self, text: str, icon: str, act: Callable[[], None]) -> Any:
        button = self._kit.Button(description=text, icon=icon, layout={"width": "92px"})
        button.on_click(lambda _: self._try(act))
        return button

    # ------------------------------------------------------------ what they do

    def _try(self, act: Callable[[], None]) -> None:
        """Do what was asked for; where it is not allowed, say so below the panel and leave everything as it is."""
        try:
            act()
        except CoopPinError as error:
            self._tell(str(error), "#b42318")
        else:
            self._tell_state()

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
            self.run.step()

    def _push(self) -> None:
        self.run.push((0.0, self.sliders["push"].value, 0.0, 0.0, 0.0, 0.0), _PUSH_S)

    def _change_gain(self, knob: Slider, value: float) -> None:
        self.run.change({knob.field: knob.field_value(value)})

    def _change_speed(self, change: Any) -> None:
        self.run.realtime_rate = change["new"]

    def _tell_state(self) -> None:
        running = self.run.is_running and not self.run.is_finished
        self.buttons["start"].description, self.buttons["start"].icon = (
            ("Pause", "pause") if running else ("Start", "play")
        )
        if self.run.error is not None:
            self._tell(str(self.run.error), "#b42318")
        elif self.run.is_finished:
            self._tell(
                f"the run has ended at t = {self.run.scenario.duration:g} s; reset it to go on", "#52606d"
            )
        else:
            self._tell("running" if running else "paused", "#52606d")

    def _tell(self, text: str, colour: str) -> None:
        self._status.value = f'<span style="color: {colour}">{html.escape(text)}</span>'


def _widgets() -> Any:
    """Return ipywidgets."""
    try:
        import ipywidgets
    except ImportError:
        raise MissingExtraError("ipywidgets", "notebook", "for the panel") from None
    return ipywidgets
