"""A recorded run: labelled arrays, the scenario that made them, and judgements."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Self

import numpy as np
import xarray as xr

from coop_pin.description.scenario import Scenario
from coop_pin.errors import FileReadError, ScenarioError
from coop_pin.results import metrics as judgements
from coop_pin.results.atomic_write import write_atomically
from coop_pin.results.dataset import RunSamples, dataset
from coop_pin.results.metrics import (
    InternalForceMetrics,
    LimitTable,
    LimitViolation,
    Window,
    limit_violations,
)


class RunResult:
    """The result of a run.

    Attributes:
        scenario: what was run.
        data: xarray Dataset with dimensions time, arm, joint, axis; units are attributes.
    """

    def __init__(self, scenario: Scenario, data: xr.Dataset) -> None:
        self.scenario, self.data = scenario, data

    @classmethod
    def from_samples(cls, scenario: Scenario, samples: RunSamples, limits: LimitTable) -> Self:
        """Label the samples of a run."""
        return cls(scenario, dataset(scenario, samples, limits))

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
        """From 4 s to the first event: where rms values are taken."""
        return Window(judgements.STEADY_FROM_S, min(self.first_event, self.end))

    # ------------------------------------------------------------ judgements

    def settling_time(self) -> float:
        """Return the time after the start from which position stays within 5 mm and orientation within 5 mrad until the first event.

        inf if they do not, s.
        """
        return judgements.settling_time(self.data, Window(0.0, self.first_event))

    def resettling_time(self) -> float:
        """Return the same counted from the first event; not a number without one, or if the error never left the band."""
        window = Window(self.first_event, self.end)
        inside = judgements.samples_of(self.data, window)
        left_band = bool(np.any(inside & ~judgements.in_band(self.data)))
        return judgements.settling_time(self.data, window) if self.scenario.events and left_band else math.nan

    def event_peak_position_error(self) -> float:
        """Return the largest position error from the first event on, m; not a number without one."""
        if not self.scenario.events:
            return math.nan
        inside = judgements.samples_of(self.data, Window(self.first_event, self.end))
        return float(np.linalg.norm(self.data["pose_error"].values[inside, :3], axis=1).max(initial=0.0))

    def position_rms(self) -> float:
        """Return the rms of the position error over the steady window, m."""
        return self._error_rms(slice(0, 3))

    def orientation_rms(self) -> float:
        """Return the rms of the orientation error over the steady window, rad."""
        return self._error_rms(slice(3, 6))

    def internal_force(self) -> InternalForceMetrics:
        """Return the judgements of the internal wrench over the steady window."""
        return judgements.internal_force(self.data, self.steady_window)

    def closure_error_max(self) -> tuple[float, float]:
        """Return the widest distance (m) and angle (rad) between a tip and its grasp over the whole run."""
        return float(self.data["closure_distance"].max()), float(self.data["closure_angle"].max())

    def energy_balance_max(self) -> float:
        """Return the largest difference between energy and work over the whole run, J."""
        return float(np.abs(judgements.energy_balance(self.data)).max())

    def torque_peak(self) -> float:
        """Return the largest drive torque over the whole run, N m."""
        return float(np.nanmax(np.abs(self.data["torque"].values)))

    def limit_violations(self) -> tuple[LimitViolation, ...]:
        """Return every joint or drive limit that was exceeded: by how much, and when first."""
        return limit_violations(self.data)

    def metrics(self) -> dict[str, float | list[float]]:
        """Return all judgements in one flat table; the names carry the units."""
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
            "window_s": list(self.steady_window),
        }

    def _error_rms(self, axes: slice) -> float:
        inside = judgements.samples_of(self.data, self.steady_window)
        return judgements.rms(np.linalg.norm(self.data["pose_error"].values[inside, axes], axis=1))

    # ------------------------------------------------------------ files

    def save(self, path: str | Path) -> None:
        """Write a netCDF file with the scenario inside; a good file at that path is never destroyed half-way."""
        data = self.data.assign_attrs(coop_pin_scenario=self.scenario.to_toml())
        content = data.to_netcdf(
            engine="h5netcdf"
        )  # in memory first: HDF5 that meets a full disk takes the process down
        write_atomically(Path(path), lambda part: part.write_bytes(content))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a result.

        Raises:
            FileReadError: the file is missing, damaged or not a result of coop_pin.
        """
        path = Path(path)
        if not path.is_file():
            hint = "; it is a folder: name the result.nc in it" if path.is_dir() else ""
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
        try:
            return cls(Scenario.from_toml(text), data)
        except (ScenarioError, FileReadError) as error:
            raise FileReadError(
                f"{path} holds a scenario that this version of coop_pin cannot read: {error}"
            ) from None
