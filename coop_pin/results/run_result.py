"""Result of a run: its scenario, labelled arrays, metrics, and its netCDF file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Self

import numpy as np
import xarray as xr

from coop_pin.arrays import Array, require_path, require_type
from coop_pin.description.scenario import Scenario
from coop_pin.errors import FileReadError, ScenarioError
from coop_pin.results import metrics
from coop_pin.results.atomic_write import write_atomically
from coop_pin.results.dataset import QUANTITIES
from coop_pin.results.metrics import InternalForceMetrics, LimitViolation, Window


class RunResult:
    """Result of a run, finished or not.

    Attributes:
        scenario: what was run.
        data: xarray Dataset with dimensions time, arm, joint, axis; units are attributes of the variables.
    """

    def __init__(self, scenario: Scenario, data: xr.Dataset) -> None:
        require_type("scenario", scenario, Scenario)
        require_type("data", data, xr.Dataset)
        self.scenario, self.data = scenario, data

    # ------------------------------------------------------------ windows

    @property
    def end(self) -> float:
        """Time of the last sample, s."""
        return float(self.data["time"].values[-1])

    @property
    def first_event(self) -> float:
        """Time of the first event, or the end of the run, s."""
        return min((event.time for event in self.scenario.events), default=self.end)

    @property
    def steady_window(self) -> Window:
        """Window of means and rms values: from 4 s to the first event, or to the end of the run."""
        return Window(metrics.STEADY_FROM_S, min(self.first_event, self.end))

    @property
    def _event_window(self) -> Window:
        return Window(self.first_event, self.end)

    # ------------------------------------------------------------ metrics

    def settling_time(self) -> float:
        """Return the time after which the errors stay within 5 mm and 5 mrad until the first event, s.

        inf if they do not.
        """
        return metrics.settling_time(self.data, Window(0.0, self.first_event))

    def resettling_time(self) -> float:
        """Return the settling time after the first event, s.

        NaN without an event, or if the errors never left the band.
        """
        inside = metrics.samples_of(self.data, self._event_window)
        if not self.scenario.events or not np.any(inside & ~metrics.in_band(self.data)):
            return math.nan
        return metrics.settling_time(self.data, self._event_window)

    def event_peak_position_error(self) -> float:
        """Return the largest position error from the first event on, m; NaN without an event."""
        if not self.scenario.events:
            return math.nan
        return float(self._error_norms(slice(0, 3), self._event_window).max(initial=0.0))

    def position_rms(self) -> float:
        """Return the rms of the position error over the steady window, m."""
        return metrics.rms(self._error_norms(slice(0, 3), self.steady_window))

    def orientation_rms(self) -> float:
        """Return the rms of the orientation error over the steady window, rad."""
        return metrics.rms(self._error_norms(slice(3, 6), self.steady_window))

    def internal_force(self) -> InternalForceMetrics:
        """Return the metrics of the internal wrench over the steady window."""
        return metrics.internal_force(self.data, self.steady_window)

    def closure_error_max(self) -> tuple[float, float]:
        """Return the largest distance (m) and angle (rad) between a tip and its grasp over the whole run."""
        return float(self.data["closure_distance"].max()), float(self.data["closure_angle"].max())

    def energy_balance_max(self) -> float:
        """Return the largest difference between energy and work over the whole run, J."""
        return float(np.abs(metrics.energy_balance(self.data)).max())

    def torque_peak(self) -> float:
        """Return the largest drive torque over the whole run, N m."""
        return float(np.nanmax(np.abs(self.data["torque"].values)))

    def limit_violations(self) -> tuple[LimitViolation, ...]:
        """Return every joint or drive limit that was exceeded, with the worst value and the first time."""
        return metrics.limit_violations(self.data)

    def metrics(self) -> dict[str, float]:
        """Return all metrics by name; the names carry the units.

        ``window_start_s`` and ``window_end_s`` bound the steady window of means and rms values; a run that
        does not reach it has NaN there.
        """
        force, (distance, angle) = self.internal_force(), self.closure_error_max()
        return {
            "settling_time_s": self.settling_time(),
            "resettling_time_s": self.resettling_time(),
            "event_peak_position_error_m": self.event_peak_position_error(),
            "position_rms_m": self.position_rms(),
            "orientation_rms_rad": self.orientation_rms(),
            "internal_axial_mean_N": force.axial_mean,
            "internal_axial_rms_error_N": force.axial_rms_error,
            "internal_shear_rms_N": force.shear_rms,
            "internal_moment_rms_error_Nm": force.moment_rms_error,
            "closure_error_max_m": distance,
            "closure_error_max_rad": angle,
            "energy_balance_max_J": self.energy_balance_max(),
            "torque_peak_Nm": self.torque_peak(),
            "window_start_s": self.steady_window.start,
            "window_end_s": self.steady_window.end,
        }

    def _error_norms(self, axes: slice, window: Window) -> Array:
        """Return the norm of some axes of the pose error at the samples of a window."""
        error = self.data["pose_error"].values[metrics.samples_of(self.data, window), axes]
        return np.linalg.norm(error, axis=1)

    # ------------------------------------------------------------ files

    def save(self, path: str | Path) -> None:
        """Write a netCDF file that holds the scenario too; if writing fails, an older file stays."""
        require_path("path", path)
        data = self.data.assign_attrs(coop_pin_scenario=self.scenario.to_toml())
        # In memory first: HDF5 that meets a full disk takes the process down.
        content = data.to_netcdf(engine="h5netcdf")
        write_atomically(Path(path), lambda part: part.write_bytes(content))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a result.

        Raises:
            FileReadError: the file is missing, damaged or not a result of this version of coop_pin.
        """
        require_path("path", path)
        path = Path(path)
        if not path.is_file():
            hint = "; it is a folder: give the path of the result.nc in it" if path.is_dir() else ""
            raise FileReadError(f"there is no result file at {path}{hint}")
        try:
            data = xr.load_dataset(path, engine="h5netcdf")
        except (OSError, ValueError, KeyError) as error:
            raise FileReadError(
                f"{path} cannot be read as netCDF ({error}); it is damaged, or is not the result.nc of a run"
            ) from None
        text = data.attrs.pop("coop_pin_scenario", None)
        if text is None:
            raise FileReadError(f"{path} holds no coop_pin scenario; it was not written by coop_pin")
        missing = [q.name for q in QUANTITIES if q.stored and q.name not in data]
        if missing:
            raise FileReadError(
                f"{path} lacks {', '.join(missing)}; it was written by another version of coop_pin: "
                "run its scenario again"
            )
        try:
            return cls(Scenario.from_toml(text), data)
        except (ScenarioError, FileReadError) as error:
            raise FileReadError(
                f"{path} holds a scenario that this version of coop_pin cannot read: {error}"
            ) from None
