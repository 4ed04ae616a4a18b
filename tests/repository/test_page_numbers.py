"""Numbers in the text of the pages on the paper and on messages, held by their runs."""

import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.comparison.controllers import stored_gains
from coop_pin.control import anchor_gain_bound
from coop_pin.control.force_paths.averaged_wrench import ConsensusForcePath, averaged_loop_radius

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = {
    name: (REPOSITORY / "docs" / folder / f"{name}.md").read_text(encoding="utf-8")
    for folder, names in (("concepts", ("messages", "paper")), ("studies", ("alpha", "paper-claims")))
    for name in names
}
TIP = "cell.arms.left.calibration_error.tip.xyz"
FILTERED = {"sensors.wrist": {}, "controller.force_path": {"kind": "low-pass", "pole": 0.9}}


def holds(value, shown):
    """Whether a number rounds to the digits that a page shows."""
    return float(f"{value:.{len(shown.partition('.')[2])}f}") == float(shown)


def worst_force(data):
    """Largest internal-force error of any arm over time, axial and shear together, N."""
    return np.hypot(data.internal_axial_error, data.internal_shear_error).max("arm")


def test_tuned_gains_of_the_printed_law_are_those_of_the_table():
    gains = stored_gains("adept-anchored")["printed"]
    alpha, gamma, other = re.search(
        r"α for this cell is ([\d.e-]+) in .*, with \$\\gamma\$ = ([\d.]+) .*, and ([\d.]+) in",
        PAGES["alpha"],
    ).groups()
    front = pd.read_csv(REPOSITORY / "studies" / "front" / "adept-gains.csv").set_index(["law", "field"])
    assert holds(front.loc[("printed, tuned", "controller.gains.sign_gain"), "value"], other)
    assert float(f"{gains['gains.sign_gain']:.1e}") == float(alpha)
    assert holds(gains["gains.pose_gain"], gamma)


def test_the_start_settles_to_a_millimetre_by_the_pose_gain():
    """Claim 1: at gamma 2.5 start and event are within 1 mm and 1 mrad soon enough, where 2 is not."""
    told = r"at ([\d.]+) the start takes ([\d.]+) s, the event ([\d.]+) s"
    gamma, shown, again = re.search(told, PAGES["paper-claims"]).groups()
    times = []
    for gain, changes in ((2.0, {"events": [], "duration": 4.0}), (float(gamma), {})):
        changes = changes | {"controller.gains.pose_gain": gain}
        data = cp.run("adept-paper", changes, warn=False, engine="compiled").data
        x, y, *_, turn = np.moveaxis(data.pose_error.values, -1, 0)
        is_off = np.maximum(np.hypot(x, y), np.abs(turn)) > 1e-3
        is_early = data.time.values < 10.0
        times.append(float(data.time[np.flatnonzero(is_off & is_early)[-1] + 1]))
        last_far = float(data.time[np.flatnonzero((np.hypot(x, y) > 1e-3) & is_early)[-1]])
        assert last_far < 2.5  # so that claim 1 is missed by the angle alone
    assert cp.Scenario.load("adept-paper").controller.gains.sign_gain == float(
        re.search(r"At α = ([\d.]+) claim 1 misses .* by the angle alone", PAGES["paper-claims"])[1]
    )
    assert holds(times[1], shown)
    settled_again = float(data.time[np.flatnonzero(is_off)[-1] + 1]) - 10.0
    assert holds(settled_again, again)
    assert settled_again < 2.5
    assert times[1] < 2.5 < times[0]


@pytest.mark.slow
def test_forces_under_a_bias_are_those_of_the_papers_table():
    """After 20 s at 1 mm: what the last column of the laws says, the mean of the last second."""
    laws = {
        "printed, alpha = 0.002, K_f = 9": ("adept-paper", FILTERED | {"controller.gains.force_gain": 9.0}),
        "printed, alpha = 0": ("adept-paper", {"controller.gains.sign_gain": 0.0}),
        "payload-space, no sensor": ("adept-anchored", {"controller.force_path": {"kind": "none"}}),
        "payload-space, anchored": ("adept-anchored", {}),
    }
    for law, (scenario, changes) in laws.items():
        (row,) = re.findall(rf"^\| {law} \|.*$", PAGES["paper"], re.MULTILINE)
        ((shown, end, metres),) = re.findall(r"([\d.]+) N (?:after (\d+) s )?at (\d) mm", row)
        bias = {"events": [], "duration": float(end or 20.0), TIP: [1e-3 * float(metres), 0.0, 0.0]}
        force = worst_force(cp.run(scenario, changes | bias, warn=False, engine="compiled").data).sel(
            time=slice(19.0, None)
        )
        assert holds(float(np.sqrt((force**2).mean())), shown), law


@pytest.mark.slow
def test_the_picture_of_two_laws_under_a_bias_has_the_numbers_of_its_caption():
    """Errors of the first arm at the end."""
    caption = (
        r"bias of (\d) mm: .*? to ([\d.]+) N in (\d+) s at alpha ([\d.]+) and to ([\d.]+) N at ([\d.]+), "
        r"the anchored law keeps ([\d.]+) N"
    )
    bias, strong, end, large, weak, small, anchored = re.search(caption, PAGES["paper"]).groups()
    again = re.search(r"off by (\d) mm \(.*The picture is one run, (\d+) N", PAGES["paper"]).groups()
    assert again == (bias, strong)
    runs = {strong: ("adept-paper", large), weak: ("adept-paper", small), anchored: ("adept-anchored", None)}
    for text, (scenario, alpha) in runs.items():
        changes = {"events": [], TIP: [1e-3 * float(bias), 0.0, 0.0], "duration": float(end)}
        changes |= {} if alpha is None else {"controller.gains.sign_gain": float(alpha)}
        data = cp.run(scenario, changes, warn=False, engine="compiled").data.isel(arm=0, time=-1)
        assert holds(float(np.hypot(data.internal_axial_error, data.internal_shear_error)), text)


@pytest.mark.slow
def test_what_the_fit_does_not_show_is_what_its_run_does():
    """Shear at the start, settling, swing and K_f of the gains that come nearest to the paper's axes."""
    result = cp.run("adept-paper-fit", warn=False, engine="compiled")
    data, page = result.data, " ".join(PAGES["paper"].split())
    assert result.task.kept
    assert f"$K_f$ is {result.scenario.controller.gains.force_gain:g}," in page
    (shear,) = re.findall(r"shears it by (\d+) N at first", page)
    error = np.abs(data.internal_shear_error.values[:, 0])
    assert holds(error.max(), shear)
    assert error.argmax() <= 1
    (swing,) = re.findall(r"ranges over (\d+) degrees", page)
    assert holds(np.degrees(np.ptp(data.pose_error.values[:, 5])), swing)
    (settled,) = re.findall(r"the position is within 5 mm after ([\d.]+) s", PAGES["paper-claims"])
    far = np.linalg.norm(data.pose_error.values[:, :3], axis=1) > 5e-3
    last = np.flatnonzero(far & (data.time.values < 10.0))[-1]
    assert holds(data.time.values[last + 1], settled)


def test_a_force_gain_divides_the_error_once_its_low_pass_has_settled():
    told = r"from (\d) s on the gain divides .*, to (\d+) %"
    first, percent = map(float, re.search(told, PAGES["paper-claims"]).groups())
    scaled = []
    for gain in (0.0, 9.0, 15.0):
        gains = {"controller.gains.sign_gain": 0.0, "controller.gains.force_gain": gain}
        data = cp.run(
            "adept-paper", {"events": [], "duration": 10.0} | FILTERED | gains, warn=False, engine="compiled"
        ).data
        error = np.hypot(data.internal_axial_error.values, data.internal_shear_error.values).max(axis=-1)
        parts = np.split((1.0 + gain) * error[1:], 20)
        scaled.append(np.sqrt(np.mean(np.square(parts), axis=1)))
    off = np.abs(np.divide(scaled[1:], scaled[0]) - 1.0).max(axis=0)
    half_seconds = 0.5 * np.arange(20)
    assert (off[half_seconds >= first] < percent / 100.0).all()
    assert off[half_seconds < first].max() > percent / 100.0


def test_forces_that_the_pages_of_claims_quote_are_those_of_the_front():
    judged = pd.read_csv(REPOSITORY / "studies" / "front" / "panda-judged.csv").set_index(["law", "trial"])
    told = r"[Pp]rinted, tuned, it is ([\d.]+) or (\d+) N on two Pandas"
    ((less, more),) = re.findall(told, PAGES["paper-claims"])
    assert holds(judged.loc[("printed, tuned", "nominal"), "force_N"], more)
    table = pd.read_csv(REPOSITORY / "studies" / "benchmark.csv")
    row = table.set_index(["scenario", "controller", "trial"]).loc[("two-pandas-box", "printed", "nominal")]
    assert holds(float(np.hypot(row["axial_rms_N"], row["shear_rms_N"])), less)


@pytest.mark.slow
def test_forces_under_a_bias_and_under_friction_are_those_of_the_exercise(monkeypatch):
    """Mean pose, the anchored law, and neither; of friction also on the page that helps to choose."""
    monkeypatch.syspath_prepend(REPOSITORY / "examples" / "exercises")
    import friction

    biased, rough = (friction.compared("adept-anchored", trial) for trial in friction.TRIALS.values())
    page = (REPOSITORY / "docs" / "exercises.md").read_text(encoding="utf-8")
    text = r"leave ([\d.]+) N, the anchored law ([\d.]+) N, and the same law without either ([\d.]+) N"
    for law, shown in zip(
        ("mean pose", "anchored", "payload-pi"), re.search(text, page).groups(), strict=True
    ):
        assert holds(biased[law][1], shown)
    told = re.search(r"poses leave ([\d.]+) N, the wrenches ([\d.]+) N", page).groups()
    choose = (REPOSITORY / "docs" / "concepts" / "choose.md").read_text(encoding="utf-8")
    text = r"(\d) N m of Coulomb .* (\d) N m of stiction .* PI has ([\d.]+) N, the anchored law ([\d.]+) N"
    coulomb, stiction, *again = re.search(text, choose).groups()
    assert told == tuple(again)
    assert (float(coulomb), float(stiction)) == (friction.FRICTION["coulomb"], friction.FRICTION["stiction"])
    for law, shown in zip(("mean pose", "anchored"), told, strict=True):
        assert holds(rough[law][1], shown)


# ---------------------------------------------------------------- messages


@pytest.fixture(scope="module")
def studies():
    """The folder of the studies, from which they import each other."""
    sys.path.insert(0, str(REPOSITORY / "studies"))
    yield REPOSITORY / "studies"
    sys.path.remove(str(REPOSITORY / "studies"))


@pytest.fixture(scope="module")
def messages(request):
    """studies/messages.py."""
    request.getfixturevalue("studies")
    import messages

    return messages


@pytest.mark.slow
@pytest.mark.usefixtures("studies")
def test_what_the_symmetric_law_leaves_over_rho_is_on_its_page():
    import symmetric

    text = (REPOSITORY / "docs" / "studies" / "measurements.md").read_text(encoding="utf-8")
    section = text.partition("## Absolute and relative pose")[2].partition("\n## ")[0]
    shown = {float(rho): x for rho, x in re.findall(r"^\| ([\d.]+) \| ([\d.]+) \|$", section, re.M)}
    assert shown == {rho: f"{symmetric.internal_force(symmetric.one_box(rho)):.3f}" for rho in symmetric.HELD}
    moved = symmetric.internal_force(symmetric.one_box(0.0, compensated=False, moves=True))
    assert f"has {moved:.2f} N at the end" in section
    rows = re.findall(r"^\| (?:s|the same).*? \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$", section, re.M)
    assert len(rows) == 5
    stiff, soft = (cp.suggest(symmetric.two_things(rho)).scenario for rho in (1.0, symmetric.APART[-1]))
    runs = [symmetric.as_pd(soft, rho, 10.0) for rho in symmetric.APART]
    runs += [symmetric.as_pd(stiff, 1.0, 10.0), stiff]
    for (rho, *numbers), scenario in zip(rows, runs, strict=True):
        assert float(rho) == scenario.controller.relative_gain
        for number, error in zip(numbers, symmetric.errors(scenario), strict=True):
            assert abs(error - float(number)) <= 0.51 * 10.0 ** -len(number.partition(".")[2])


@pytest.mark.slow
def test_forces_of_what_is_sent_are_those_of_their_table(messages):
    """Medians of thirty seeds, exact and with 5 % of messages lost."""
    rows = re.findall(
        r"^\| ([^|]+) \| ([^|]+) \| [^|]+ \| ([\d.]+) N[^/|]*/ ([\d.]+) N", PAGES["messages"], re.M
    )
    shown = {sent: pair for sent, _, *pair in rows}
    laws = messages.laws()
    last = laws["mean pose, last views"]["controller"]
    by_row = {
        "views, only those of this tick": laws["mean pose, this tick's views"],
        "views, the last ones": laws["mean pose, last views"],
        "the last views, and integrals": {
            "controller": last | {"leak_to": "mean", "gains": last["gains"] | {"leak": 2.0}}
        },
        "corrected views, to neighbours": laws["mean pose by consensus"],
        "corrected views and integrals, to neighbours": laws["consensus, integrals agree"],
        "wrist wrenches": laws["anchored, wrenches told"],
    }
    assert set(by_row) == set(shown)
    for sent, changes in by_row.items():
        for loss, text in zip((0.0, 0.05), shown[sent], strict=True):
            force = float(np.median(messages.forces(changes, {"loss": loss})))
            assert_allclose(force, float(text), rtol=0.06, atol=0.006, err_msg=sent)


@pytest.mark.slow
def test_the_ramp_that_the_example_prints_is_the_one_beside_it(capsys):
    blocks = re.findall(r"^```python\n(.*?)^```", PAGES["messages"], re.DOTALL | re.MULTILINE)
    exec(compile("\n".join(blocks[:2]), "messages.md", "exec"), {"__name__": "__main__"})
    (shown,) = re.findall(r"# ([\d.]+), by the messages lost", blocks[1])
    assert capsys.readouterr().out.splitlines()[-1] == f"{shown} N/s"


def test_bounds_of_the_anchor_over_a_line_are_those_of_the_page():
    """A wrist that is a tick late, and the gains beside the numbers: where the modes begin to grow."""
    text = r"have \$g\$ < ([\d.]+) at \$D\$ = 0 and ([\d.]+) at 2\. .* have ([\d.]+) and ([\d.]+)\."
    *line, one, three = re.search(text, PAGES["messages"]).groups()
    path = ConsensusForcePath(proportional_gain=0.15, integral_gain=0.1)
    for delay, shown in zip((0, 2), line, strict=True):
        low, high = 0.1, 2.0
        for _ in range(40):
            g = (low + high) / 2.0
            radius = averaged_loop_radius(
                np.array([0.0, 1.0, 3.0]), path, delay, anchor_gain=g, wrist_delay=1
            )
            low, high = (g, high) if radius < 1.0 else (low, g)
        assert holds(low, shown)
    for delay, shown in ((1, one), (3, three)):
        assert_allclose(anchor_gain_bound(delay=delay), float(shown), atol=5e-4)


def test_ticks_that_an_anchor_may_be_late_are_those_of_its_bound():
    page = (REPOSITORY / "docs" / "concepts" / "choose.md").read_text(encoding="utf-8")
    shown = re.search(r"(\d+) at \$g = ([\d.]+)\$, (\d+) at ([\d.]+), (\d+) at ([\d.]+)", page).groups()
    for ticks, g in zip(map(int, shown[::2]), map(float, shown[1::2]), strict=True):
        assert anchor_gain_bound(delay=ticks) > g > anchor_gain_bound(delay=ticks + 1)


@pytest.mark.slow
def test_what_a_leak_leaves_of_lost_views_is_that_of_a_run():
    """One planar arm 1 mm off, views of this tick only, 5 % lost, the last of ten minutes."""
    (shown,) = re.findall(r"with `gains.leak = 0.2` ([\d.]+) N", PAGES["messages"])
    gains = cp.Scenario.load("adept-anchored").controller.gains
    law = cp.laws.MeanPose(gains=gains.replace(anchor_gain=0.0))
    leaky = law.gains.replace(pose_gain=7.199, sign_gain=115.5, leak=0.2)
    skips = {"gains": leaky, "switching": {"kind": "saturation", "width": 10.0}, "on_loss": "skip"}
    changes = {"controller": cp.laws.MeanPose(**skips), "network": {"loss": 0.05}, "duration": 600.0}
    changes |= {"events": (), TIP: (1e-3, 0.0, 0.0)}
    force = worst_force(cp.run("adept-anchored", changes, warn=False, engine="auto").data)
    assert holds(float(force.sel(time=slice(540.0, None)).max()), shown)
