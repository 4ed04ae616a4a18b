"""Answer to who pulls the object apart: estimates, causes, what they leave, and the cell with the errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from coop_pin.base.errors import ArgumentError
from coop_pin.description.scenario import Scenario
from coop_pin.identification.causes import Cause
from coop_pin.identification.closure import ViewClosure
from coop_pin.identification.effects import Effects, friction_parameters
from coop_pin.identification.error_changes import error_changes
from coop_pin.identification.estimate import Fit
from coop_pin.identification.excitation import Excitation
from coop_pin.identification.friction import DriveFriction
from coop_pin.identification.payload import HAND_AXES
from coop_pin.logs.record import Record
from coop_pin.results.finding import Findings

_SUM = 0.5
"""Part of a mass's interval below which that of a sum tells that only the sum is seen."""


@dataclass(frozen=True, eq=False)
class Blame:
    """Answer to who pulls the object apart.

    Attributes:
        scenario: cell and law.
        record: log of the arms.
        findings: defects of the log; after an error there are no estimates.
        closure: views of the payload that were fitted; None after an error.
        kinematics: estimates of tips, bases, joints, links and clocks; None after an error.
        payload: estimates of the payload and of the wrists' zeros; None without wrenches.
        friction: friction of the drives whose torques are logged.
        effects: forces by unit errors; None where no formula covers the law.
        causes: causes by newtons, the largest first.
        views: newtons of all kinematic errors together, which the mismatch of the views shows, with interval.
        read: internal force beyond the wanted one that the wrists read, root mean square, N; NaN without.
        unexplained: force that the wrists read and no cause explains, root mean square, N; NaN without it.
        share: newtons by load shares of the law that are not those of the cell; None without wrenches. It is
            among the causes where the log shows it.
        excitation: errors that the log shows least of, and the motion that would show it; None where no arm
            can move so, or without newtons.
        simulated: why newtons are those of runs with a cause alone; empty where formulas cover the law.
        uncovered: why no newtons are known; empty if they are.
    """

    scenario: Scenario
    record: Record
    findings: Findings
    closure: ViewClosure | None = None
    kinematics: Fit | None = None
    payload: Fit | None = None
    friction: tuple[DriveFriction, ...] = ()
    effects: Effects | None = None
    causes: tuple[Cause, ...] = ()
    views: tuple[float, float, float] = (np.nan,) * 3
    read: float = np.nan
    unexplained: float = np.nan
    share: Cause | None = None
    excitation: Excitation | None = None
    simulated: str = ""
    uncovered: str = ""

    @property
    def fitted(self) -> tuple[ViewClosure, Fit]:
        """Views of the arms with the estimate of their errors.

        Raises:
            ArgumentError: the log has errors, and there is no estimate.
        """
        if self.closure is None or self.kinematics is None:
            raise ArgumentError("there are no estimates: mend the log as its findings say, and ask again")
        return self.closure, self.kinematics

    @property
    def errors(self) -> dict[str, Any]:
        """Changes of the scenario with which a run has the errors of the log, by dotted path.

        What the log does not tell apart has the likeliest values: their sum counts. Load shares are those of
        the law: by them a run has the wrenches of the log, and no internal force of that cause.
        """
        fits = [fit for fit in (self.kinematics, self.payload) if fit is not None]
        values = {
            one: float(x) for fit in fits for one, x in zip(fit.parameters, fit.x, strict=True) if one.arm
        }
        if self.share in self.causes and self.share is not None:
            values |= dict(zip(self.share.members, self.share.sizes, strict=True))
        return error_changes(self.scenario, values) if values else {}

    def with_errors(self) -> Scenario:
        """Return the scenario whose arms have the errors of the log, for ``cp.run``."""
        return self.scenario.override(self.errors)

    def summary(self) -> str:
        """Return the answer as text: findings, causes by newtons, ambiguities, and trust."""
        lines = [f"{'!' if one.severity != 'note' else ' '} {one}" for one in self.findings]
        if self.kinematics is None:
            return "\n".join(["no answer:", *lines])
        lines.append(
            f"views of the arms: chi {self.kinematics.chi:.2f} with tips, bases, joints and clocks fitted"
        )
        if self.payload is not None:
            lines.append(self._masses(self.payload))
        if self.uncovered:
            lines.append(f"newtons are not known: {self.uncovered}")
        else:
            low, high = self.views[1:]
            how = f", by runs with a cause alone ({self.simulated})" if self.simulated else ""
            lines.append(f"internal force by cause, norm, mean over the log (95 %){how}:")
            lines.append(
                f"  {self.views[0]:6.2f} N ({low:.2f} to {high:.2f})  all that the arms see differently"
            )
            lines += [f"  {cause}{self._words(cause)}" for cause in self.causes if cause.counts]
            if self.share is not None and self.share not in self.causes:
                lines.append(f"  below {self.share.high:.2f} N  load shares, which are those of the cell")
            if np.isfinite(self.unexplained):
                read = f"not explained of the {self.read:.2f} N that the wrists read"
                lines.append(f"  {self.unexplained:6.2f} N  {read}")
            if self.excitation is not None:
                lines.append(f"to see more: {self.excitation}")
        return "\n".join(lines)

    def _masses(self, fit: Fit) -> str:
        """Return the masses of payload and hands as text, and their sum where the log shows it alone."""
        mass, sd = fit.x[0] + self.scenario.cell.payload.mass, 1.96 * fit.sd
        hands = [k for k, one in enumerate(fit.parameters) if one.axis == HAND_AXES[0]]
        words = "".join(f"; {fit.parameters[k]} {fit.x[k]:+.3f} kg +- {sd[k]:.3f}" for k in hands)
        both = np.ix_([0, *hands], [0, *hands])
        if hands and (of_sum := 1.96 * float(np.sqrt(fit.covariance[both].sum()))) < _SUM * sd[0]:
            words += f": not told apart, their sum to +- {of_sum:.3f}"
        return f"payload {mass:.3f} kg +- {sd[0]:.3f}{words}; chi {fit.chi:.2f}"

    def _words(self, cause: Cause) -> str:
        """Return the size of a cause and what the log says of it, as text."""
        if not cause.is_seen:
            return (
                f"; the log does not see {'it, its prior does' if cause.is_one else 'them, their priors do'}"
            )
        if cause.is_none:
            return "; not different from zero"
        drives = zip(friction_parameters(self.friction), self.friction, strict=True)
        size = cause.size or " or ".join(str(one) for drive, one in drives if drive in cause.members)
        if cause.is_one:
            return size and f", {size}"
        return f": not told apart, only what they make together{size and f'; alone {size}'}"
