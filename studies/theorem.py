"""Terms of the convergence proofs along the paper's experiment, and where they break.

Saves docs/images/theorem.png and theorem-anchored.png, and prints how often each mark is set.
Usage: python studies/theorem.py
"""

from __future__ import annotations

from pages import IMAGES, save_image

import coop_pin as cp
from coop_pin.figures import theorem_figure
from coop_pin.proof import theorem_monitor

MARKS = ("V_rate_3_is_positive", "V_may_grow", "sliding_is_not_assured", "signs_differ")
STEADY = slice(4.0, 10.0)


def main() -> None:
    """Run the experiment at two alphas and without the sign integral, print the marks, draw the first."""
    for alpha in (0.2, 0.002, 0.0):
        result = cp.run("adept-paper", {"controller.gains.sign_gain": alpha, "events": (), "duration": 10.0})
        monitor = theorem_monitor(result)
        print(f"alpha {alpha}: part of the ticks from 4 to 10 s that is marked")
        steady = monitor.sel(time=STEADY)
        for mark in MARKS:
            print(f"  {mark:<24} {float(steady[mark].mean()):.3f}")
        u = steady["u_prime"].mean("time")
        arms, total = (float((part**2).sum("row").max() ** 0.5) for part in (u, u.sum("arm")))
        print(f"  mean u': {total:.3g} in the sum, {arms:.3g} in one arm")
        print(f"  mean V_rate_3 {float(steady['V_rate_3_sum'].mean()):.3g} W")
        if alpha == 0.2:
            save_image(theorem_figure(result, monitor), IMAGES / "theorem")
    result = cp.run("adept-anchored", {"events": (), "duration": 10.0})
    monitor = theorem_monitor(result)
    for defect, of in (
        ("balance_2", "ftilde"),
        ("rate_defect", "disagreement_rate"),
        ("V_rate_defect", "V_rate"),
    ):
        print(f"anchored: {defect} {float(monitor[defect].max()):.2g} of {float(abs(monitor[of]).max()):.3g}")
    save_image(theorem_figure(result, monitor), IMAGES / "theorem-anchored")


if __name__ == "__main__":
    main()
