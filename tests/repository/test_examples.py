"""Every example runs as a user runs it, in a folder of its own, and shows what it promises."""

import ast
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest
from built_once import built_once
from test_docs import missing_names

FOLDER = Path(__file__).parents[2] / "examples"
EXAMPLES = sorted(FOLDER.glob("*.py"))
LONG = {"blame_a_log", "compare_laws", "four_bar", "motions", "sweep_force_gain"}
"""Examples of many or long runs: two thirds of the time of all. What they call runs in tests of its own."""
QUICK = {"internal_force_split"}
"""Examples that run in the default tier, too."""
PAPER = (FOLDER.parent / "docs" / "concepts" / "paper.md").read_text(encoding="utf-8")


ALL = """
import os, runpy, signal, sys
from pathlib import Path
import coop_pin as cp
import matplotlib.font_manager  # builds its list of fonts, and says so on stderr where that takes long

[getattr(cp, name) for name in cp.__all__]
out, examples = Path(sys.argv[1]), sys.argv[2:]
for example in examples:
    folder = out / Path(example).stem
    folder.mkdir()
    child = os.fork()
    if child == 0:
        signal.alarm(120)
        os.chdir(folder)
        for name, stream in (("stdout", 1), ("stderr", 2)):
            os.dup2(os.open(out / f"{folder.name}.{name}", os.O_WRONLY | os.O_CREAT), stream)
        sys.argv, sys.path[0] = [example], str(Path(example).parent)
        runpy.run_path(example, run_name="__main__")
        sys.exit()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    (out / f"{folder.name}.code").write_text(str(code))
"""
"""Runs each example in a process and a folder of its own, all forked from one that has imported coop_pin."""


def run_all(folder, examples):
    subprocess.run([sys.executable, "-c", ALL, str(folder), *map(str, examples)], check=True)


def tier(path):
    """What marks an example, which is also the folder of those that run one after the other."""
    return "slow" if path.stem in LONG else "quick" if path.stem in QUICK else "gate"


MARKS = {"slow": [pytest.mark.slow], "gate": [pytest.mark.gate], "quick": []}


@pytest.mark.parametrize(
    "path", [pytest.param(path, marks=MARKS[tier(path)], id=path.stem) for path in EXAMPLES]
)
def test_an_example_runs_and_shows_what_it_promises(path, tmp_path_factory):
    build = functools.partial(run_all, examples=[other for other in EXAMPLES if tier(other) == tier(path)])
    folder = built_once(tmp_path_factory, f"{tier(path)} examples", build)
    code, out, err = ((folder / f"{path.stem}.{kind}").read_text() for kind in ("code", "stdout", "stderr"))
    assert code == "0", err
    assert err == ""
    assert out
    PROMISES[path.stem](out, folder / path.stem)


def metrics_and_files(out, folder):
    assert "settling_time_s" in out
    assert sorted(path.name for path in (folder / "out" / "run_paper").iterdir()) == [
        "replay.html",
        "result.nc",
    ]


def static_factor_and_bound(out, _folder):
    *stable, last = (line.split() for line in out.splitlines()[1:])
    for gain, _, promised, found in stable:
        assert float(promised) == pytest.approx(1.0 / (1.0 + float(gain)), abs=1e-3)
        assert float(found) == pytest.approx(float(promised), rel=0.05)
    assert last[0] == "1.10"
    assert "diverged" in last


def tracking_and_squeeze(out, _folder):
    _, law, spring = out.splitlines()
    assert law.startswith("printed law")
    position, force = (float(spring.split(before)[1].split()[0]) for before in ("position", "force"))
    assert 0.0 < position < 0.5
    assert 0.0 < force < 0.5


def wrist_and_base_of_the_log(out, _folder):
    """The log was made with a wrist zero of 1.5 N on left and a base of right that is 2 mm off along x."""
    *_, first, base = out.splitlines()
    assert first.startswith("first: left wrist y")
    assert 0.5 < float(first.split()[4]) < 1.0
    assert abs(float(base.strip("()").split(",")[0])) == pytest.approx(1e-3, rel=0.1)  # a half on each arm


def laws_side_by_side(out, _folder):
    """The table of the paper's page is what the example prints, digit by digit."""
    found = {line[:32].strip(): [float(word) for word in line[32:].split()] for line in out.splitlines()[1:]}
    rows = re.findall(
        r"^\| ((?:printed|payload-space), [^|]+) \| ([\d.]+) \| ([\d.]+) \|", PAPER, re.MULTILINE
    )
    assert [name for name, *_ in rows] == list(found)
    window = re.search(r"compare_laws.py`, (\d) to (\d+) s, no event", PAPER).groups()
    assert f"window=({window[0]}.0, {window[1]}.0)" in (FOLDER / "compare_laws.py").read_text()
    for name, *shown in rows:
        for text, value in zip(shown, found[name], strict=False):
            assert float(f"{value:.{len(text.partition('.')[2])}f}") == float(text), name


def squeezed_without_motion(out, _folder):
    before, after = ([float(word) for word in re.findall(r"-?\d+\.\d*", line)] for line in out.splitlines())
    assert after[:3] + after[6:] == pytest.approx(before[:3] + before[6:], abs=2e-6)
    assert [a - b for a, b in zip(after[3:6], before[3:6], strict=True)] == pytest.approx(
        [-10.0, 0.0, 0.0], abs=2e-6
    )


def eight_branches(out, _folder):
    closure_errors = [float(line.split("gap")[1]) for line in out.splitlines()]
    assert len(closure_errors) == 8
    assert max(closure_errors) < 1e-8


def followed_and_pressed(out, _folder):
    first, *rest = out.splitlines()
    assert float(first.split()[2]) < 0.5
    for line in rest:
        found, desired = (float(word) for word in re.findall(r"(\d+\.\d+)(?: N)", line))
        assert found == pytest.approx(desired, abs=1.5)


def every_motion_and_payload_source(out, _folder):
    rows = [line.split() for line in out.splitlines()[1:]]
    assert [row[0] for row in rows] == ["circle", "turn", "swing", "waypoints", "csv"]
    assert [row[1] for row in rows] == ["bar", "box", "cylinder", "mesh", "urdf"]
    assert max(float(row[3]) for row in rows) < 1.0
    for row in rows:
        assert float(row[4]) == pytest.approx(20.0, abs=3.0)


def all_the_same(out, folder):
    assert [line.split()[-1] for line in out.splitlines()] == ["True"] * 3
    assert sorted(path.name for path in (folder / "out" / "save_and_load").iterdir()) == [
        "report.html",
        "result.nc",
        "scenario.toml",
    ]


def bound_of_a_late_force_path(out, folder):
    boundary = out.split("last_stable")[1].splitlines()[2:]
    assert [line.split() for line in boundary] == [["80", "0.75", "1.00"], ["160", "1.00", "1.25"]]
    assert (folder / "out" / "stability" / "table.csv").is_file()


def close_to_the_closed_form(out, _folder):
    chains = [
        re.fullmatch(r"(\d) loops, .* tip within (\S+) m of the closed form, energy within (\S+) J", line)
        for line in out.splitlines()
    ]
    assert [chain[1] for chain in chains] == ["1", "2", "2", "5"]
    assert max(float(chain[2]) for chain in chains) < 1e-6
    assert max(float(chain[3]) for chain in chains) < 1e-6


def definitions_as_on_their_page(out, _folder):
    """The page quotes the output; the split by equal shares, the symmetric and the nonsqueezing one agree."""
    page = FOLDER.parent / "docs" / "concepts" / "internal-force-definitions.md"
    (quoted,) = re.findall(r"^```text\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    found, shown = ([line.split() for line in text.splitlines()] for text in (out, quoted))
    assert [words[0] for words in found] == [words[0] for words in shown]
    rows = [words for words in found if len(words) == 4]
    assert len(rows) == 14
    for words, there in zip(rows, (words for words in shown if len(words) == 4), strict=True):
        assert [float(word) for word in words[1:]] == pytest.approx(
            [float(word) for word in there[1:]], abs=0.011
        )
    equal = {name: rest for name, *rest in rows}
    assert equal["load_shares"] == equal["nonsqueezing"] == equal["symmetric"] != equal["virtual_linkage"]


def held_and_regulated(out, _folder):
    torques = [float(number) for number in re.findall(r"\|tau\| = ([\d.]+)", out)]
    held, regulated = (float(number) for number in re.findall(r"largest \|z\| = ([\d.]+)", out))
    assert torques[0] < torques[1]
    assert "forces on the arms [[-20.0, 0.0, -14.7], [20.0, -0.0, -14.7]] N" in out
    assert regulated < 1.0 < held


def both_arms_of_one_robot(out, folder):  # noqa: ARG001
    assert "left: left_gripper, 10 joints" in out
    assert "simulation sound; internal force -10.0" in out


def platforms_that_follow(out, folder):  # noqa: ARG001
    moved = [float(way) for way in re.findall(r"\d\.\d\d", out.partition("moved")[2])]
    assert out.startswith("task kept")
    assert len(moved) == 3
    assert all(abs(way - 0.3) < 0.1 for way in moved)


def forces_that_cancel(out, folder):  # noqa: ARG001
    assert out.startswith("task kept")
    assert float(out.split()[-2]) < 1e-9


PROMISES = {
    "blame_a_log": wrist_and_base_of_the_log,
    "two_armed_robot": both_arms_of_one_robot,
    "mobile_bases": platforms_that_follow,
    "four_arms": forces_that_cancel,
    "internal_force_definitions": definitions_as_on_their_page,
    "run_paper": metrics_and_files,
    "sweep_force_gain": static_factor_and_bound,
    "own_controller": tracking_and_squeeze,
    "compare_laws": laws_side_by_side,
    "internal_force_split": squeezed_without_motion,
    "ik_branches": eight_branches,
    "motions": every_motion_and_payload_source,
    "own_reference": followed_and_pressed,
    "save_and_load": all_the_same,
    "stability_map": bound_of_a_late_force_path,
    "four_bar": close_to_the_closed_form,
    "linear_model": held_and_regulated,
}


def test_each_example_has_a_title_and_a_promise_and_uses_what_exists():
    assert set(PROMISES) == {path.stem for path in EXAMPLES}
    titles = [ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))).split("\n") for path in EXAMPLES]
    assert [title for title, *rest in titles if len(title) < 20 or "".join(rest[:1])] == []
    assert {path.stem: [*missing_names(path.read_text(encoding="utf-8"))] for path in EXAMPLES} == {
        path.stem: [] for path in EXAMPLES
    }
