"""Commands, Python code and sizes of the README, and the pages that hold what is not on it."""

import functools
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import matplotlib
import pytest
from browser import chromium
from matplotlib import pyplot as plt
from page_texts import read_numbers
from PIL import Image
from test_architecture import PACKAGES

import coop_pin
from coop_pin.cli import main
from coop_pin.cli.parsing import COMMANDS

REPOSITORY = Path(__file__).resolve().parents[2]
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
SHELL = (REPOSITORY / "docs" / "howto" / "shell.md").read_text(encoding="utf-8")
PAPER = (REPOSITORY / "docs" / "concepts" / "paper.md").read_text(encoding="utf-8")
PACKAGE_TABLE = (REPOSITORY / "docs" / "packages.md").read_text(encoding="utf-8")
MOST_WORDS, MOST_BYTES = 900, 1.5e6
INSTALLATION = ("git", "python3", "source", "pip")
SHORT = ["--duration", "0.2", "--events", "[]", "--quiet"]
"""A run is cut short here unless the README says how long; nothing else about it is changed."""


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", README + SHELL, re.DOTALL | re.MULTILINE)


@functools.cache
def commands():
    """The words of every command line, comments left out."""
    lines = "\n".join(blocks("sh")).splitlines()
    every = [words for line in lines if (words := shlex.split(line, comments=True))]
    return [words for words in every if words[0] not in INSTALLATION]


def test_table_and_import_line_name_every_package_and_imports_follow_the_line():
    (line,) = re.findall(r"^Imports go in one direction.*?\n\n", PACKAGE_TABLE, re.DOTALL | re.MULTILINE)
    layers = [set(re.findall(r"`(\w+)`", layer)) for layer in line.split("→")]
    layer_of = {package: number for number, layer in enumerate(layers) for package in layer}
    packages = {path.parent.name for path in (REPOSITORY / "coop_pin").glob("*/__init__.py")}
    assert sum(map(len, layers)) == len(layer_of)
    assert set(layer_of) == packages
    for package, number in layer_of.items():
        imported = PACKAGES[package][0] & packages
        assert {name for name in imported if layer_of[name] > number} == set(), package
    rows = re.findall(r"^\| `(\w+)` \|", PACKAGE_TABLE, re.MULTILINE)
    others = [row for row in rows if row not in packages]
    assert sorted(set(rows) - set(others)) == sorted(packages)
    assert [row for row in others if not (REPOSITORY / row).is_dir()] == []


def test_every_command_is_coop_pin_or_a_tool_that_exists_and_is_sound_shell():
    scripts = [words[1] for words in commands() if words[0] == "bash"]
    assert [words for words in commands() if words[0] not in ("coop-pin", "bash")] == []
    assert "tools/run.sh" in scripts
    assert "tools/gate.sh" in scripts  # the gate is what runs this test
    for script in scripts:
        subprocess.run(["bash", "-n", str(REPOSITORY / script)], check=True)


def test_the_front_pages_are_short_and_light():
    assert len(README.split()) <= MOST_WORDS
    for page in (REPOSITORY / "README.md", REPOSITORY / "docs" / "index.md"):
        pictures = re.findall(r'(?:!\[[^\]]*\]\(|<img src=")([^)"]+)[)"]', page.read_text(encoding="utf-8"))
        assert pictures, page
        assert sum((page.parent / picture).stat().st_size for picture in pictures) <= MOST_BYTES, page


def test_every_loop_has_bytes_and_frames():
    loops = sorted((REPOSITORY / "docs" / "_static" / "gallery").glob("*.webp"))
    assert {loop.stem for loop in loops} >= set(coop_pin.scenario_names())
    for loop in loops:
        with Image.open(loop) as drawn:
            assert drawn.n_frames >= 10, loop


@pytest.mark.gate
def test_the_commands_work_one_after_the_other(tmp_path, monkeypatch, capsys):
    """In an empty folder, with a scenario of the reader's own beside them."""
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)  # no browser opens
    coop_pin.Scenario.load("adept-paper").save("mine.toml")
    given = [words for words in commands() if words[0] == "coop-pin" and not draws_images(words)]
    assert len(given) > 5
    for words in given:
        assert_works(words, capsys)


@pytest.mark.gate
def test_the_commands_that_render_images_work_too(tmp_path, monkeypatch, capsys):
    """They need a browser, and are skipped where there is none. Pictures are small here."""
    chromium()
    for name, few in (("save_image", {}), ("save_video", {"frames_per_second": 10.0})):
        small = functools.partial(getattr(coop_pin.viz, name), width=320, height=240, **few)
        monkeypatch.setattr(coop_pin.viz, name, small)
    monkeypatch.chdir(tmp_path)
    given = [words for words in commands() if draws_images(words)]
    assert given
    for words in given:
        folder = words[words.index("view") + 1]
        (made,) = [other for other in commands() if other[:2] == ["coop-pin", "run"] and other[-1] == folder]
        assert_works([*made, "--no-replay", "--no-figures"], capsys)
        assert_works(words, capsys)


def draws_images(words):
    return bool({"--image", "--video"} & set(words))


def assert_works(words, capsys):
    short = [*words[1:], *(SHORT if words[1] == "run" else [])]
    codes = (0, 4) if words[1] == "run" else (0,)  # a start of 0.2 s has not decayed
    assert main(short) in codes, (words, capsys.readouterr().err)


def test_the_help_of_every_command_named_in_the_readme_is_there(capsys):
    for name in {words[1] for words in commands() if words[0] == "coop-pin"}:
        with pytest.raises(SystemExit) as ended:
            main([name, "--help"])
        assert ended.value.code == 0
        assert "usage" in capsys.readouterr().out


LIGHT = {"coop_pin", "tyro", "docstring_parser", "typing_extensions", "typeguard"}
"""What may be loaded to print help; cmeel's .pth file loads its own part whenever Python starts."""

HELP = """
import sys
before = set(sys.modules)
import coop_pin
print("import coop_pin:", *(set(sys.modules) - before))
from coop_pin.cli import main
for words in {words}:
    try:
        main(words)
    except SystemExit as ended:
        assert ended.code == 0
    print("loaded:", *(set(sys.modules) - before))
"""


def loaded(line):
    """Packages from elsewhere among the modules that a line names."""
    names = {name.partition(".")[0] for name in line.partition(":")[2].split()}
    return {name for name in names if name not in sys.stdlib_module_names and not name.startswith("_")}


def test_importing_the_package_and_asking_for_help_load_nothing_heavy():
    """Whatever takes long to load, numpy and Pinocchio first of all, waits until something is done."""
    assert {"run", "list", "check", "sweep"} <= {*COMMANDS}
    asked = [["--version"], ["--help"], *([name, "--help"] for name in COMMANDS)]
    code = HELP.replace("{words}", repr(asked))
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    (imported,) = [line for line in lines if line.startswith("import coop_pin:")]
    assert loaded(imported) == {"coop_pin"}
    after = [line for line in lines if line.startswith("loaded:")]
    assert len(after) == len(asked)
    assert loaded(after[0]) == {"coop_pin"}
    for words, line in zip(asked, after, strict=True):
        assert loaded(line) <= LIGHT, words


def test_python_in_the_readme_runs(tmp_path, monkeypatch):
    """All blocks one after the other, as somebody who pastes them."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pasted.py").write_text("\n".join(blocks("python")), encoding="utf-8")
    with matplotlib.rc_context({"backend": "Agg"}):
        shown = runpy.run_path("pasted.py", run_name="__main__")
    assert shown["mine"].simulation_sound
    plt.close("all")
    assert (tmp_path / "run.nc").is_file()


def rounded(value, shown):
    """A value with as many digits as a number that is shown has."""
    digits = re.match(r"-?0*\.?0*([\d.]+)", shown)[1].replace(".", "")
    return float(f"{value:.{len(digits) - 1}e}")


def numbers_of(result):
    """What the paper's page says of a run, by row: name, window, value, unit."""
    found = result.metrics()
    before, after = ((window, result.internal_force(window=window)) for window in ((4.0, 10.0), (14.2, 20.0)))
    return [
        ("settling time", "from the start", found["settling_time_s"], "s"),
        ("peak position error", "from the push", found["event_peak_position_error_m"] * 1e3, "mm"),
        ("settling time after the push", "from the push", found["resettling_time_s"], "s"),
        ("position error, rms", "4 to 10 s", result.position_rms(window=before[0]) * 1e3, "mm"),
        ("internal force along the bar, mean", "4 to 10 s", before[1].axial_mean, "N"),
        ("its error, rms", "4 to 10 s", before[1].force_rms_error, "N"),
        ("internal force along the bar, mean", "14.2 to 20 s", after[1].axial_mean, "N"),
        ("its error, rms", "14.2 to 20 s", after[1].force_rms_error, "N"),
        ("torque, peak", "whole run", found["torque_peak_Nm"], "N m"),
        ("closure error", "whole run", found["closure_error_max_m"], "m"),
        ("energy minus work", "whole run", found["energy_balance_max_J"], "J"),
    ]


def test_the_numbers_of_the_papers_experiment_are_those_of_runs():
    """On the paper's page and on that of verification, digit by digit."""
    rows = re.findall(
        r"^\| ([^|]+) \| ([^|]+) \| (-?[\d.e-]+) (\w[\w ]*) \| (-?[\d.e-]+) (\w[\w ]*) \|$",
        PAPER,
        re.MULTILINE,
    )
    shipped, stronger = (
        numbers_of(coop_pin.run("adept-paper", {"controller.gains.sign_gain": alpha}, warn=False))
        for alpha in map(float, read_numbers("paper", r"window \| α = ([\d.]+) \| α = ([\d.]+) \|"))
    )
    assert len(rows) == len(shipped)
    for (label, when, *shown), one, other in zip(rows, shipped, stronger, strict=True):
        for text, unit, (start, window, value, unit_there) in zip(
            shown[::2], shown[1::2], (one, other), strict=True
        ):
            assert label.startswith(start)
            assert (when, unit) == (window, unit_there)
            assert rounded(value, text) == float(text), label
    page = (REPOSITORY / "docs" / "verification.md").read_text(encoding="utf-8")
    value = [row[2] for row in shipped]
    for text, number in {
        r"here ([\d.]+) s\)": value[0],
        r"after the event \(([\d.]+) s\)": value[2],
        r"mean −([\d.]+) N,": -value[4],
        r"but ([\d.]+) N rms": value[5],
        r"\(([\d.]+) N m\)": value[8],
        r"([\d.e-]+) J in `adept-paper` over 20 s": value[10],
        r"([\d.e-]+) m in `adept-paper` over 20 s": value[9],
    }.items():
        (shown,) = re.findall(text, page)
        assert rounded(number, shown) == float(shown), text
