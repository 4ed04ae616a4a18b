"""Numbers in the text of README and of the pages on laws, held by studies, stored data and short runs.

``python tools/page_numbers.py`` lists which tests read which number.
"""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from page_texts import read_numbers, require_numbers, rounds_to

import coop_pin as cp
from coop_pin.comparison import controller_names
from coop_pin.control import force_gain_bound
from coop_pin.control.force_paths.averaged_wrench import ConsensusForcePath
from coop_pin.simulation.build_controller import build_controller

STUDIES = Path(__file__).resolve().parents[2] / "studies"
TIP = "cell.arms.left.calibration_error.tip.xyz"


@pytest.fixture(scope="module")
def studies():
    """Modules of studies by name, imported as their commands are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(STUDIES)
        import alpha
        import claims_tables
        import claims_window
        import front
        import front_window
        import messages
        import symmetric

        yield {
            each.__name__: each
            for each in (alpha, claims_tables, claims_window, front, front_window, messages, symmetric)
        }


# ---------------------------------------------------------------- README and the paper


def test_the_picture_of_four_laws_has_the_numbers_of_its_text():
    """Internal force after 10 s of a bias of 1 mm; the squeeze that is wanted is 10 N."""
    bias, alpha, pulled, end = read_numbers(
        "README",
        r"off by (\d+) mm, and the motion .* α(?: of|,) ([\d.]+),? it .* apart with (\d+) N after (\d+) s",
    )
    require_numbers("README", {r"one arm's kinematics off by (\d) mm. width": float(bias)})
    *losses, kept = (
        read_numbers("README", text)
        for text in (
            r"of that α: it loses (\d+) of (\d+) N",
            r"ours, loses (\d+) of (\d+) N",
            r"the (\d+) N to ([\d.]+) N",
        )
    )
    changes = {"events": [], "duration": float(end), TIP: [1e-3 * float(bias), 0.0, 0.0]}
    printed, alone, anchored = "adept-paper", {"controller.force_path.kind": "none"}, {}
    runs = [(printed, {"controller.gains.sign_gain": float(alpha) * part}) for part in (1.0, 0.01)]
    runs += [("adept-anchored", fields) for fields in (alone, anchored)]
    data = [cp.run(name, changes | fields, warn=False).data.isel(arm=0, time=-1) for name, fields in runs]
    axial, squeeze = [float(each.internal_axial) for each in data], -float(data[0].desired_internal_axial)
    assert rounds_to(axial[0], pulled)
    for value, (lost, whole) in zip(axial[1:3], losses, strict=True):
        assert float(whole) == squeeze
        assert rounds_to(squeeze + value, lost)
    assert float(kept[0]) == squeeze
    assert rounds_to(abs(squeeze + axial[3]), kept[1])


def test_the_start_settles_as_the_readme_says(studies):
    """In the median over the starts, position and orientation together."""
    table = pd.read_csv(studies["alpha"].DATA)
    times = [
        studies["alpha"].at(table, 80.0, "event", f"settled_{kind}s").loc[0.002, "median"]
        for kind in ("", "narrow_")
    ]
    bands = [1e3 * studies["claims_window"].BAND[0], 1e3 * studies["claims_window"].NARROW_BAND[0]]
    told = r"below (\d+) mm.* after ([\d.]+) s.* below (\d+).* after ([\d.]+) s; the paper"
    require_numbers("README", {told: [bands[0], times[0], bands[1], times[1]]})


def test_the_papers_experiment_is_as_its_page_says(studies):
    scenario = cp.Scenario.load("adept-paper")
    change, push = scenario.events
    gains, clock = scenario.controller.gains, scenario.clock
    assert change.mass == 0.5 * scenario.cell.payload.mass
    assert change.time == push.time
    assert [scenario.cell.arms[name].posture[1] < 0.0 for name in ("left", "right")] == [True, False]
    require_numbers(
        "paper",
        {
            r"carry a bar at (\d+) Hz for (\d+) s; at t = (\d+) s its mass halves": [
                clock.rate_hz,
                scenario.duration,
                push.time,
            ],
            r"pushed with \((\d+), (\d+)\) N and (\d+) N m for ([\d.]+) s": [
                *push.wrench[:2],
                push.wrench[5],
                push.duration,
            ],
            r"settles at (−\d+) N": -10.0,
            r"`adept-paper` has α = ([\d.]+)": gains.sign_gain,
            r"and \$K_f\$ is (\d+), which the paper allows. Gains": gains.force_gain,
            r"K_d = diag\((\d+), (\d+), (\d+)\) keeps": list(gains.damping_gain),
            r"zero-order hold at (\d+) Hz. gamma = (\d+) leaves": [clock.rate_hz, gains.pose_gain],
            r"Elbows: left (-\d), right \+(\d)": [-1, 1],
            r"one tick late, .* K_f must stay below (\d)": force_gain_bound(0.0),
        },
    )
    soft = cp.Scenario.load("adept-compliant").cell.grasps["left"]
    stiffness = r"by a contact stiffness of (\d+) kN/m"
    require_numbers("paper", {stiffness: 1e-3 * soft.stiffness[0]})
    told = {
        r"Two Adept arms, (\d+) Hz; at (\d+) s the mass": [clock.rate_hz, push.time],
        r"axial force (−\d+) N": -10.0,
    }
    require_numbers("paper-claims", told)
    window = studies["claims_window"]
    told = r"both rms from (\d) to (\d+) s / the latter over the last second of (\d+) s"
    require_numbers("paper-claims", {told: [window.FROM, window.EVENT, scenario.duration]})
    require_numbers(
        "paper-claims",
        {
            r"at α = ([\d.]+) the internal force settles at (−\d+) N": [gains.sign_gain, -10.0],
            r"because our γ is (\d)": gains.pose_gain,
            r"Where not stated, \$K_f\$ is (\d), which": gains.force_gain,
            r"low-pass with pole ([\d.]+); the bound is \$K_f < (\d+)\$": [0.9, force_gain_bound(0.9)],
        },
    )


def test_loads_and_biases_on_the_page_of_the_paper_are_those_of_the_curve(studies):
    """Of the curve over alpha: times to take a load up, ramps under a bias, and where sgn adds force."""
    alpha = studies["alpha"]
    table = pd.read_csv(alpha.DATA)
    taken = alpha.at(table, 80.0, "load", "settled_again_narrow_s")["median"]
    strong, load, fast, weak, slow = read_numbers(
        "paper",
        r"At ([\d.]+) the law takes up .* load of (\d+) N within (\d+) s, at ([\d.]+) within (\d+) minutes",
    )
    assert float(load) == alpha.LOAD
    assert float(fast) - 1.0 < taken[float(strong)] <= float(fast)
    assert 60.0 * (float(slow) - 1.0) < taken[float(weak)] <= 60.0 * float(slow)
    window, ramp = studies["claims_window"], alpha.ramp(table, 80.0, "bias 1 mm")
    assert (ramp[ramp.index > 0.0] > 0.0).all()
    growth = alpha.ramp(table, 80.0, "bias 0.1 mm")
    grows_from = growth.index[growth > 0.0].min()
    assert (growth[grows_from:] > 0.0).all()
    force = alpha.at(table, 80.0, "quiet", "force_N")["median"]
    first = force.index[(force > 1.5 * force[0.0]) & (force.index > 0.0)].min()
    require_numbers(
        "paper",
        {
            r"at ([\d.]+) a bias of 1 mm grows (\d+) times as fast": [
                float(strong),
                ramp[float(strong)] / ramp[float(weak)],
            ],
            r"takes a load up within (\d+) s": float(fast),
            r"In our runs at (\d+) Hz the integral": 80,
            r"the sign adds, from (\d) to (\d+) s, \[an error that grows": [window.FROM, window.EVENT],
            r"bias of ([\d.]+) mm, .*? force grows, in runs of (\d+) s, from alpha = ([\de-]+) on": [
                0.1,
                cp.Scenario.load("adept-paper").duration,
                grows_from,
            ],
            r"with alpha\]\(../studies/alpha.md\) from ([\d.]+) on": first,
            r"median over six starts, (\d+) N": alpha.at(table, 80.0, "bias 1 mm", "end_force_N").loc[
                0.2, "median"
            ],
        },
    )
    assert (force[force.index < first] < 1.5 * force[0.0]).all()
    misses = alpha.at(table, 80.0, "event", "settled_narrow_s").loc[0.002, "median"]
    in_band = [
        alpha.at(table, 80.0, f"K_f {gain:g}", "force_in_band_s").loc[0.002, "median"]
        for gain in alpha.FORCE_GAINS
    ]
    prompt = studies["claims_tables"].PROMPT_S
    require_numbers(
        "paper-claims",
        {
            r"median of six starts, at each of (\d+), from (\d), which the paper excludes, to (\d)": [
                len(alpha.ALPHAS),
                *alpha.ALPHAS[:: len(alpha.ALPHAS) - 1],
            ],
            r"misses (\d) mm and (\d) mrad by ([\d.]+) s": [
                *(1e3 * edge for edge in studies["claims_window"].NARROW_BAND),
                misses - prompt,
            ],
            r"is within ([\d.]+) N in ([\d.]+) s at \$K_f\$ = (\d), in ([\d.]+) s at (\d)": [
                studies["claims_tables"].SMALL_N,
                in_band[0],
                alpha.FORCE_GAINS[0],
                in_band[1],
                alpha.FORCE_GAINS[1],
            ],
            r"the paper's simulation has (\d+) kN/m, which is not judged": 1e-3
            * cp.Scenario.load("adept-compliant").cell.grasps["left"].stiffness[0],
            r"The load is ours, (\d+) N": alpha.LOAD,
        },
    )


# ---------------------------------------------------------------- the printed law over alpha


def test_the_page_over_alpha_says_what_its_study_runs(studies):
    alpha = studies["alpha"]
    rates, lines = list(alpha.STEPS), studies["claims_tables"].SHOWN
    starts = [alpha.STARTS[rate] for rate in rates]
    poses = [
        np.array([changes["start.xyz"][:2], [changes["start.rpy"][2], 0.0]])
        for changes in alpha.starts(starts[0]).values()
        if changes
    ]
    start = cp.Scenario.load("adept-paper").start
    off = np.abs(np.array(poses) - [start.xyz[:2], [start.rpy[2], 0.0]]).max(axis=0)
    assert 2.5e-3 < off[0].max() < 3e-3
    assert 2.0e-3 < off[1].max() < 3e-3
    (load,) = alpha.trials(80.0)["load"]["events"]
    assert load["wrench"] == [0.0, alpha.LOAD, 0.0, 0.0, 0.0, 0.0]
    require_numbers(
        "alpha",
        {
            r"Here \$\\alpha\$ is (\d), which the paper excludes, and ([\de-]+) to (\d)\.": [
                *alpha.ALPHAS[:2],
                alpha.ALPHAS[-1],
            ],
            r"medians over (\w+) starts, up to (\d) mm and (\d) mrad from the paper's, at (\d+) Hz": [
                starts[0],
                3,
                3,
                rates[0],
            ],
            r"A load of (\d+) N along .* comes at (\d+) s\. .* last "
            r"(\d+) s at (\d+) Hz, (\d+) s at (\d+) and (\d+) s at (\d+)": [
                alpha.LOAD,
                load["time"],
                *(number for rate in rates for number in (alpha.LOAD_END[rate], rate)),
            ],
            r"time to take (\d+) N up end with their runs, (\d+), (\d+) and (\d+) s after the load": [
                alpha.LOAD,
                *(alpha.LOAD_END[rate] - load["time"] for rate in rates),
            ],
            r"time to take up (\d+) N and internal force .* alpha, at (\d+), (\d+) and (\d+) Hz": [
                alpha.LOAD,
                *rates,
            ],
            r"over starts: (\w+) at (\d+) Hz, (\w+) at (\d+), (\w+) at (\d+)\.": [
                number for pair in zip(starts, rates, strict=True) for number in pair
            ],
            r"Upright lines stand at ([\d.]+) and ([\d.]+)\.": list(lines),
            r"\$K_f\$ is (\d), which the paper allows. Loads": cp.Scenario.load(
                "adept-paper"
            ).controller.gains.force_gain,
        },
    )


def test_what_the_page_over_alpha_concludes_is_in_its_table(studies):
    alpha = studies["alpha"]
    table = pd.read_csv(alpha.DATA)
    position, force, end = (
        alpha.at(table, 80.0, "quiet", name)["median"] for name in ("position_mm", "force_N", "end_force_N")
    )
    best, within, other = read_numbers(
        "alpha", r"served best by ([\d.]+)\*\*.* track within ([\d.]+) mm it has .* a bias, ([\d.]+) has less"
    )
    assert force[position < float(within)].idxmin() == float(best)
    biased = alpha.at(table, 80.0, "bias 1 mm", "end_force_N")["median"]
    assert end[float(other)] < end[float(best)]
    assert biased[float(other)] < biased[float(best)]
    taken = alpha.at(table, 80.0, "load", "settled_again_narrow_s")["median"]
    fastest, load = read_numbers("alpha", r"At ([\d.]+) a load of (\d+) N is taken up fastest")
    assert (taken.idxmin(), alpha.LOAD) == (float(fastest), float(load))
    largest, slowest = map(float, read_numbers("alpha", r"At α = (\d) and (\d+) Hz the bar is not back"))
    assert taken[largest] > alpha.LOAD_END[slowest] - 10.5
    rate, large = map(float, read_numbers("alpha", r"closer; at (\d+) Hz, from ([\d.]+) on, with more"))
    slow, fast = (alpha.at(table, each, "quiet", "force_N")["median"] for each in (80.0, rate))
    assert (fast[large:] > slow[large:]).all()
    assert (fast[:0.05] < slow[:0.05]).any()
    ramps = [alpha.ramp(table, 80.0, f"bias {bias} mm")[0.002] for bias in ("0.1", "1")]
    assert read_numbers("alpha", r"At ([\d.]+) it grows .*?as fast under ([\d.]+) mm") == ["0.002", "0.1"]
    assert_allclose(*ramps, rtol=0.02)
    window = studies["claims_window"]
    product = (alpha.ramp(table, 80.0, "bias 1 mm") * taken)[0.001:0.02]
    require_numbers(
        "alpha",
        {
            r"internal force from (\d) to (\d+) s; later": [window.FROM, window.EVENT],
            r"doubles the internal force from (\d) to (\d+) s": [window.FROM, window.EVENT],
            r"after ([\d.]+) s. At ([\d.]+) that takes (\d+) s": [taken[0.2], 0.002, taken[0.002]],
            r"After (\d+) s with one arm's .* off by (\d) mm the internal force is off by ([\d.]+) N": [
                20,
                1,
                biased[0.002],
            ],
            r"N at ([\d.]+), and by (\d+) N at ([\d.]+)\. It grows": [0.002, biased[0.2], 0.2],
            r"at ([\d.]+) chatter shows it, and ([\d.]+) mm leaves (\d+) N": [
                0.2,
                0.1,
                alpha.at(table, 80.0, "bias 0.1 mm", "end_force_N").loc[0.2, "median"],
            ],
            r"none of the (\d+) is fast under a load": len(alpha.ALPHAS),
            r"take (\d+) N up, .* force under (\d) mm, is (\d+) to (\d+) N from α = ([\d.]+) to ([\d.]+),": [
                alpha.LOAD,
                1,
                product.min(),
                product.max(),
                *product.index[[0, -1]],
            ],
        },
    )
    first, end_of_curve = read_numbers("alpha", r"From ([\d.]+) on the integral .*, \d+ N at (\d)\.")
    small, large = force[force.index < float(first)], force[force.index >= float(first)]
    assert small.max() < 1.5 * force[0.0] < 2.0 * force[0.0] < large.min()
    assert force.index[-1] == float(end_of_curve)


# ---------------------------------------------------------------- the front, and what helps to choose


def test_the_page_of_the_front_says_what_its_study_runs(studies):
    front, windows = studies["front"], studies["front_window"].WINDOWS
    adept, panda = front.CELLS["adept"], front.CELLS["panda"]
    trials = {name: front.trials(cell, Path("heavy.urdf")) for name, cell in front.CELLS.items()}
    moderate = trials["adept"][front.TUNED_ON].changes
    (load,) = moderate["events"]
    offset = trials["adept"]["wrist offset 1 N, drift"].changes["arm_sensors.left"]["wrist"]
    tuned = [len(law.tuned) for law in front.LAWS.values()]
    judged = pd.concat(pd.read_csv(front.DATA / f"{cell}-judged.csv") for cell in front.CELLS)
    zone = front.ZONE["integral_dead_zone"]
    printed = sum(law.printed for law in front.LAWS.values())
    require_numbers(
        "front",
        {
            r"runs (\d+) s, judged from (\d+) to (\d+) s": [adept.changes["duration"], *windows[adept.base]],
            r"its motion in (\d+) s, judged from (\d+) to (\d+) s": [
                panda.changes["motion.duration"],
                *windows[panda.base],
            ],
            r"dead zone is ([\d.]+) mm and ([\d.]+) mrad": [1e3 * zone[0], 1e3 * zone[1]],
            r"for the largest bias, (\d+) mm": 1e3 * trials["adept"]["bias 1 mm"].changes[TIP][0],
            r"gains, (\w+) to (\w+) for each law, .* seed and (\d+) runs": [
                min(tuned),
                max(tuned),
                front.SIZE * (front.GENERATIONS + 1),
            ],
            r"of sgn from ([\de-]+) to (\d) in logarithms": list(front.ALPHA[1:]),
            r"It has a bias of ([\d.]+) mm": 1e3 * moderate[TIP][0],
            r"In (\d+) s that carries no load": adept.changes["duration"],
            r"an offset of (\d) N in one wrist, drifting": offset["offset"]["force"],
            r"\$\\gamma\$ from (\d) to (\d), ": list(front.GAMMA[1:]),
            r"the median over (\w+) other seeds": judged["runs"].max(),
            r"Load: (\d+) N on the Adept arms, (\d+) N on the Pandas": [
                cell.faults["load"] for cell in (adept, panda)
            ],
            r"(\w+) laws\. (\w+) are the paper's law \(23\): .* excludes\. (\w+) act on the payload": [
                len(front.LAWS),
                printed,
                len(front.LAWS) - printed,
            ],
        },
    )
    assert load["wrench"][1] == adept.faults["load"] / 5.0
    told = r"\$K_d\$ = diag\(([^)]*)\) and diag\(([^)]*)\), \$K\$ = diag\(([^)]*)\) and diag\(([^)]*)\)"
    shown = [list(map(float, text.split(", "))) for text in read_numbers("front", told)]
    assert shown == [next(iter(cell.gains[law].values())) for law in (0, 1) for cell in (adept, panda)]


@pytest.mark.parametrize("cell", ["adept", "panda"])
def test_damping_of_the_front_is_within_the_ends_that_its_page_tells(studies, cell):
    """T lambda_max at the start, of the printed law and of the payload-space law."""
    front = studies["front"]
    low, high, bound = map(
        float, read_numbers("front", r"between ([\d.]+) and ([\d.]+) at the start \(bound (\d)\)")
    )
    base = front.CELLS[cell]
    for law in ("printed, tuned", "payload, sgn"):
        changes = base.changes | {"controller": front.LAWS[law].controller(base)}
        stability = cp.stability.sampled_stability(cp.Scenario.load(base.base, changes))
        assert low <= stability.value <= high
        assert stability.limit == bound


@pytest.fixture(scope="module")
def judged(studies):
    """Errors by cell, law and trial, and the tuned gains, of studies/front."""
    folder = studies["front"].DATA
    errors = {cell: pd.read_csv(folder / f"{cell}-judged.csv") for cell in ("adept", "panda")}
    gains = {cell: pd.read_csv(folder / f"{cell}-gains.csv").set_index(["law", "field"]) for cell in errors}
    return {cell: table.set_index(["law", "trial"]) for cell, table in errors.items()}, gains


PRINTED, FILTERED, SGN = "printed, tuned", "printed, tuned, K_f", "payload, sgn"
TURNED, ROUGH, MILLIMETRE = "base turned by 1 mrad", "friction, stiction", "bias 1 mm"
DIGITS = ("panda", FILTERED, "nominal")
"""Cell, law and trial whose force depends on the last digits of alpha."""
QUOTED = {
    r"leaky law has ([\d.]+) mm and ([\d.]+) N on the Adept arms, ([\d.]+) mm and ([\d.]+) N": [
        (cell, "zeroed leaky", "nominal", measure)
        for cell in ("adept", "panda")
        for measure in ("position_mm", "force_N")
    ],
    r"turned by 1 mrad leaves ([\d.]+) N \(Pandas ([\d.]+) N\), friction ([\d.]+) N \(([\d.]+) N\)": [
        (cell, "zeroed leaky", trial, "force_N") for trial in (TURNED, ROUGH) for cell in ("adept", "panda")
    ],
    r"under a turned base, ([\d.]+) N \(Pandas ([\d.]+) N\)": [
        (cell, "dead zone", TURNED, "force_N") for cell in ("adept", "panda")
    ],
    r"N\); at 1 mm it has ([\d.]+) N. It costs ([\d.]+) mm of position \(Pandas ([\d.]+)\)": [
        ("adept", "dead zone", MILLIMETRE, "force_N"),
        ("adept", "dead zone", "nominal", "position_mm"),
        ("panda", "dead zone", "nominal", "position_mm"),
    ],
    r"tracks the Adept arms to ([\d.]+) mm with ([\d.]+) N, and has ([\d.]+) N at 1 mm": [
        ("adept", PRINTED, "nominal", "position_mm"),
        ("adept", PRINTED, "nominal", "force_N"),
        ("adept", PRINTED, MILLIMETRE, "force_N"),
    ],
    r"carries no load: (\d+) mm under 100 N, ([\d.]+) mm under stiction": [
        ("adept", PRINTED, "unknown load", "position_mm"),
        ("adept", PRINTED, ROUGH, "position_mm"),
    ],
    r"On the Pandas, .*, it has (\d+) N with nothing wrong": [("panda", PRINTED, "nominal", "force_N")],
    r"in one wrist, drifting, becomes ([\d.]+) N": [
        ("adept", "anchored", "wrist offset 1 N, drift", "force_N")
    ],
    r"no ramp: ([\d.]+) N with nothing wrong, ([\d.]+) N at 1 mm; \[about (\d)\]\([^)]*\) and (\d+) N": [
        (cell, FILTERED, trial, "force_N") for cell in ("adept", "panda") for trial in ("nominal", MILLIMETRE)
    ],
    r"the force under friction, to ([\d.]+) N \(Pandas ([\d.]+) N\)": [
        (cell, "own wrench", ROUGH, "force_N") for cell in ("adept", "panda")
    ],
    r": ([\d.]+) N on the Adept arms, ([\d.]+) N on the Pandas, and (\d+) and ([\d.]+) mm under a load": [
        *((cell, SGN, "nominal", "force_N") for cell in ("adept", "panda")),
        *((cell, SGN, "unknown load", "position_mm") for cell in ("adept", "panda")),
    ],
}
"""Cell, law, trial and measure of what the page of the front quotes."""


def test_what_the_page_of_the_front_quotes_is_in_its_tables(studies, judged):
    tables, gains = judged
    require_numbers(
        "front",
        {
            text: [tables[cell].loc[(law, trial), measure] for cell, law, trial, measure in rows]
            for text, rows in QUOTED.items()
        },
    )
    alpha = "controller.gains.sign_gain"
    anchored = [table.loc["anchored"] for table in tables.values()]
    whole = [each[~each.index.str.contains("wrist|loses its torque")] for each in anchored]
    most = [each[measure].max() for each in whole for measure in ("position_mm", "force_N")]
    require_numbers(
        "front",
        {
            r"are at most ([\d.]+) mm and ([\d.]+) N on the Adept arms, ([\d.]+) mm and ([\d.]+) N": most,
            r"an \$\\alpha\$ of ([\d.]+)\. In": gains["adept"].loc[(PRINTED, alpha), "value"],
            r"\$\\alpha\$ of ([\de.-]+) and ([\d.]+): ": [
                gains[cell].loc[(SGN, alpha), "value"] for cell in gains
            ],
        },
    )
    require_numbers("front", {r"on the Pandas, at (\d) and at (\d) mm alike": [0, 1]})
    for table in tables.values():
        same = table.loc[
            [("zeroed leaky", trial) for trial in ("nominal", MILLIMETRE)], ["position_mm", "force_N"]
        ]
        assert_allclose(*same.astype(float).values, rtol=0.01)
        halved = table.loc[("own wrench", ROUGH), "force_N"] / table.loc[("zeroed leaky", ROUGH), "force_N"]
        assert 0.4 < halved < 0.6
        lost = table.xs("an arm loses its torque", level="trial")
        assert (lost["force_N"] > 2.0).all(), lost
    loaded = (
        tables["adept"].loc[("dead zone", "bias 0.1 mm and load"), ["position_mm", "force_N"]].astype(float)
    )
    assert loaded.prod() < 0.25 * 0.1 * 100.0 / 5.0  # far below the product
    blind = [name for name, law in studies["front"].LAWS.items() if not law.senses]
    for table in tables.values():
        assert table.xs(TURNED, level="trial").loc[blind, "force_N"].astype(float).idxmin() == "dead zone"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell", "law", "trial"), sorted({row[:3] for rows in QUOTED.values() for row in rows} - {DIGITS})
)
def test_a_row_that_the_page_of_the_front_quotes_is_what_its_command_finds(
    studies, judged, tmp_path, cell, law, trial
):
    front, (tables, gains) = studies["front"], judged
    base = front.CELLS[cell]
    changes = front.trials(base, tmp_path)[trial]
    assert not changes.random
    row = front.medians(
        base, front.LAWS[law], gains[cell].loc[law, "value"].to_dict(), changes, 1, tmp_path / "sweep"
    )
    for measure in front.MEASURES:
        assert_allclose(row[measure], tables[cell].loc[(law, trial), measure], rtol=5e-3)


@pytest.mark.slow
def test_a_force_that_depends_on_the_last_digits_of_alpha_is_told(studies, judged):
    front, window = studies["front"], studies["front_window"]
    (_, gains), (cell, law, _) = judged, DIGITS
    base, tuned = front.CELLS[cell], gains[cell].loc[law, "value"].to_dict()
    scenario = cp.Scenario.load(base.base, base.changes | {"controller": front.LAWS[law].controller(base)})
    alpha, forces = "controller.gains.sign_gain", []
    for part in (0.0, 1e-6, 1e-3):
        changes = tuned | {alpha: tuned[alpha] * (1.0 + part)}
        forces.append(window.judged(cp.run(scenario, changes, warn=False))["force_N"])
    told = r"csv` it is ([\d.]+) N, with .* millionth larger ([\d.]+) N, .* thousandth larger ([\d.]+) N"
    require_numbers("front", {told: forces})


def test_what_helps_to_choose_has_numbers_of_its_tables(studies):
    """Of costs, of one millimetre, of late anchors; and how many laws the comparisons have."""
    costs = pd.read_csv(STUDIES / "costs.csv").set_index("controller")
    is_modelled = costs["needs"].str.contains("model|regressor")
    ratios = [costs.loc[is_modelled, "ratio"], costs.loc["anchored", "ratio"]]
    with_model, anchored = ([part.min(), part.max()] for part in ratios)
    require_numbers(
        "choose",
        {
            r"model take ([\d.]+) to ([\d.]+) times .* law ([\d.]+) to ([\d.]+) times": [
                *with_model,
                *anchored,
            ],
            r"has (\w+) laws with one budget, \[the benchmark\]\(../studies/benchmark.md\) (\w+) with": [
                len(studies["front"].LAWS),
                len(controller_names()),
            ],
        },
    )
    forces = [
        float(row.split("|")[5])
        for row in ONE_MILLIMETRE.splitlines()
        if row.startswith("| ") and ".csv" in row
    ]
    curve = pd.read_csv(studies["alpha"].DATA)
    printed = studies["alpha"].at(curve, 80.0, "bias 1 mm", "end_force_N").loc[0.2, "median"]
    (most,) = read_numbers("choose", r"leaves from nothing to more than (\d+) N")
    assert min(forces) < 0.01
    assert float(most) < printed < float(most) + 50.0


def measured(heading):
    """A section of the page of measurements."""
    page = STUDIES.parent / "docs" / "studies" / "measurements.md"
    return page.read_text(encoding="utf-8").split(f"## {heading}\n")[1].split("\n## ")[0]


ONE_MILLIMETRE = measured("One millimetre")


def test_numbers_of_the_symmetric_law_are_those_of_its_measurements(studies):
    """Runs hold the page of measurements, in a test of their own; the way is that of the scenario."""
    symmetric, section = studies["symmetric"], measured("Absolute and relative pose")
    forces = {float(rho): float(force) for rho, force in re.findall(r"\n\| ([\d.]+) \| ([\d.]+) \|", section)}
    (moved,) = re.findall(
        r"the box has ([\d.]+) N at the end of its line, at \$\\rho\$ = 1 and at 0", section
    )
    line = symmetric.one_box(1.0, moves=True).motion
    way = np.linalg.norm(np.subtract(line.goal.xyz, line.start.xyz))
    require_numbers(
        "choose",
        {
            r"(\d) mm leaves two Pandas \[([\d.]+), ([\d.]+) and ([\d.]+) N at (\d), ([\d.]+) and (\d)\]": [
                1e3 * symmetric.BIAS,
                *(forces[rho] for rho in symmetric.HELD),
                *symmetric.HELD,
            ],
            r"own weight: it leaves ([\d.]+) N at every \$\\rho\$, on a way of (\d+) cm": [
                float(moved),
                1e2 * way,
            ],
        },
    )


# ---------------------------------------------------------------- messages


def test_numbers_of_a_message_are_those_that_cross(studies):
    """Per row of the table: what an arm says to a neighbour at each tick, with k_0 = 3."""
    (nothing,) = read_numbers("messages", r"\| nothing \| [^|]+ \| (\d) \|")
    leaky = cp.Scenario.load("adept-anchored", {"network": {}, "controller.force_path": {"kind": "none"}})
    assert cp.Simulation(leaky, build_controller(leaky)).traffic()[0] == float(nothing)
    (k_0,) = read_numbers("messages", r"force on `adept-anchored` \(\$k_0 = (\d)\$\)")
    laws = studies["messages"].laws()
    wrist = {"sensors.wrist": {}}
    by_row = {
        r"views, the last ones": laws["mean pose, last views"],
        r"corrected views, to neighbours": laws["mean pose by consensus"],
        r"corrected views and integrals, to neighbours": laws["consensus, integrals agree"],
        r"wrist wrenches": laws["anchored, wrenches told"],
        r"means of wrenches, to neighbours": wrist | {"controller.force_path": {"kind": "consensus"}},
        r"the learned mass, to neighbours": wrist | {"controller.force_path": {"kind": "learned-load"}},
    }
    for row, changes in by_row.items():
        (size,) = read_numbers("messages", rf"\| {row} \| [^|]+ \| ([^|]+?) \|")
        size = size.strip("$").replace("2 k_0", "2 * k_0")
        scenario = cp.Scenario.load("adept-anchored", {"events": [], "network": {}}).override(changes)
        crossing = cp.Simulation(scenario, build_controller(scenario)).traffic()
        assert crossing[0] / crossing[1] == eval(size, {"k_0": int(k_0)}), row


def test_gains_and_times_of_the_table_of_messages_are_those_of_its_study(studies):
    messages = studies["messages"]
    laws = messages.laws()
    path = ConsensusForcePath(proportional_gain=0.15, integral_gain=0.1)
    require_numbers(
        "messages",
        {
            r"\(\$k_0 = 3\$\) with (\d) mm of bias": 1e3 * messages.BIAS,
            r"block above and a leak of (\d) per second": laws["consensus, integrals agree"]["controller"][
                "gains"
            ]["leak"],
            r'averaging = "consensus"`, g = ([\d.]+)': laws["mean pose by consensus"]["controller"][
                "consensus_gain"
            ],
            r"internal-force error, exact / (\d) % lost": 100.0 * messages.LOSS_OF_DELAYS,
            r"against delay, for (\w+) laws, (\w+) seeds each": [len(laws), messages.SEEDS],
            r"Medians over the last (\d+) s of (\d+) s": [messages.DURATION / 3.0, messages.DURATION],
            r"With \$k_P\$ = ([\d.]+), \$k_I\$ = ([\d.]+), \$\\gamma\$ = ([\d.]+) and wrists": [
                path.proportional_gain,
                path.integral_gain,
                path.input_gain,
            ],
        },
    )


@pytest.mark.slow
def test_integrals_that_agree_are_those_of_their_row_when_messages_are_late(studies):
    told = r"integrals, to neighbours .*? / ([\d.]+) N, (\d) ticks late as well"
    force, late = read_numbers("messages", told)
    messages = studies["messages"]
    network = {"delay": int(late), "loss": messages.LOSS_OF_DELAYS}
    forces = messages.forces(messages.laws()["consensus, integrals agree"], network)
    assert rounds_to(np.median(forces), force)


def test_a_clock_that_is_off_is_a_bias_as_told():
    off, speed, bias = map(
        float, read_numbers("messages", r"moves: (\d+) ms at ([\d.]+) m/s act as (\d+) mm")
    )
    assert_allclose(off * speed, bias)


# ---------------------------------------------------------------- the inventory


@pytest.fixture
def page_numbers(monkeypatch):
    """tools/page_numbers.py."""
    monkeypatch.syspath_prepend(STUDIES.parent / "tools")
    import page_numbers

    return page_numbers


def test_every_number_of_these_pages_is_read_by_a_test_or_stated_with_its_reason(page_numbers):
    """Else add a pattern to the test that derives it, or a line to tools/stated_numbers.tsv."""
    reasons, inventory = page_numbers.stated(), page_numbers.inventory()
    assert len(inventory) > 380
    assert all(reasons.values())
    orphans = [
        f"{one.page}:{one.line} {one.text}: {one.context}"
        for one in inventory
        if not one.tests and (one.page, one.text) not in reasons
    ]
    assert orphans == []
    texts = {(one.page, one.text) for one in inventory if not one.tests}
    assert set(reasons) <= texts  # none that a test reads, or that is gone


def test_a_number_that_no_test_reads_is_seen(page_numbers, monkeypatch, tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Head\n\nIt has 3.25 N at $\\alpha = 2$, $2 k_0$, `7 N` of Theorem 3; 41 mm.\n")
    monkeypatch.setattr(page_numbers, "PAGES", {"page": str(page)})
    pattern = page_numbers.Pattern(r"It has ([\d.]+) N", "file::test", frozenset({"page"}))
    found = {one.text: one.tests for one in page_numbers.numbers("page", [pattern])}
    assert found == {"3.25 N": ("file::test",), "2": (), "41 mm": ()}
