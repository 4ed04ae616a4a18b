"""Coverage of 95 % intervals over draws of several causes at once, and errors of what is seen.

    python tests/blame_coverage.py KIND [SEED [DRAWS]]

prints, for each kind of parameter, how many intervals have the true value, and the root mean square of errors
in sds and in units of the parameter; KIND is one of log_cells.scenario_of.
"""

import sys

import numpy as np
from log_cells import all_logged, force_of, scenario_of, truth

import coop_pin as cp
from coop_pin.identification import Priors

PRIORS = Priors(clock=3e-3, link=0.0, wrist=(2.0, 0.1), forecast=0.0)
FEWEST = 0.86
"""Part of the draws in which the interval of every parameter by itself must have its value."""


class Coverage:
    """Errors by kind of parameter, those of each parameter, and hits of the intervals of newtons."""

    def __init__(self):
        self.z, self.off, self.of_one, self.newtons = {}, {}, {}, {"newtons": [], "views": []}

    def add(self, causes, answer, scenario):
        """The estimates that are called seen, and the newtons of causes that are known and of all views."""
        mass = scenario.cell.payload.mass
        for fit in (answer.kinematics, answer.payload):
            off = fit.x - truth(fit, causes, mass)
            for k, one in enumerate(fit.parameters):
                if fit.seen[k] > 0.5 and np.isfinite(off[k]):
                    z = off[k] / fit.sd[k]
                    self.of_one.setdefault(str(one), []).append(z)
                    self.z.setdefault(one.part, []).append(z)
                    self.off.setdefault(f"{one.part} {one.unit}", []).append(off[k])
        for cause in answer.causes:
            if cause.members[0].part not in ("friction", "load share") and cause.is_known:
                force = force_of(answer, cause.members, causes)
                self.newtons["newtons"].append(cause.low <= force <= cause.high)
        total = force_of(answer, answer.kinematics.parameters, causes)
        self.newtons["views"].append(answer.views[1] <= total <= answer.views[2])

    @property
    def inside(self):
        """Hits of all intervals, by kind."""
        return {part: np.abs(z) < 1.96 for part, z in self.z.items()} | self.newtons

    @property
    def worst(self):
        """The parameter whose interval has its value in the smallest part of the draws, and this part."""
        parts = {one: np.mean(np.abs(z) < 1.96) for one, z in self.of_one.items() if len(z) > 20}
        return min(parts.items(), key=lambda one: one[1])

    def __str__(self):
        lines = [
            f"{part:14s} {np.mean(hits):.3f} of {len(hits):5d}"
            + (f"  rms z {np.sqrt(np.mean(np.square(self.z[part]))):.3f}" if part in self.z else "")
            for part, hits in self.inside.items()
        ]
        lines += [f"rms of {unit}: {np.sqrt(np.mean(np.square(off))):.3g}" for unit, off in self.off.items()]
        return "\n".join([*lines, "worst: {} {:.2f}".format(*self.worst)])


def coverage(kind, seeds):
    """The coverage of all draws."""
    scenario, found = scenario_of(kind), Coverage()
    for causes, record, cell in all_logged(scenario, seeds):
        found.add(causes, cp.blame(record, cell, priors=PRIORS), scenario)
    return found


if __name__ == "__main__":
    first, draws = (int(one) for one in (sys.argv[2:] + ["100", "100"][len(sys.argv) - 2 :])[:2])
    print(sys.argv[1], first, draws)
    print(coverage(sys.argv[1], range(first, first + draws)))
