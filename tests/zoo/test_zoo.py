"""Zoo of reproductions: its list, verdicts, the command, and every experiment beside its page."""

import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import FieldError, FileReadError, NameNotFoundError, WrongTypeError
from coop_pin.cli import main
from coop_pin.zoo import Claim, Experiment, Measured, Reproduction, experiment_names, load_experiment

REPOSITORY = Path(__file__).resolve().parents[2]
FOLDER, PAGES = Path(cp.__file__).parent / "zoo", REPOSITORY / "docs" / "zoo"
NAMES = experiment_names()
VERDICTS = ("holds", "holds in part", "does not hold", "cannot be judged")
QUICK = "force-leader"
"""Experiment whose short form takes seconds."""

sys.path.insert(0, str(REPOSITORY / "tools"))
import zoo as tool  # noqa: E402

# ---------------------------------------------------------------- what an experiment states


def kinds():
    """Kinds of the list, and for each of its claims whether it is marked as ours."""
    rows = re.findall(r"^\| ([^|]+) \|[^|]*\| ([^|]+) \|$", (PAGES / "index.md").read_text("utf-8"), re.M)
    claims = {kind: re.split(r"\b\d\. ", told)[1:] for kind, told in rows}
    return {kind: ["(ours)" in claim for claim in one] for kind, one in claims.items() if one}


def test_the_list_has_fourteen_kinds_and_every_experiment_tests_what_it_says():
    listed = kinds()
    assert len(listed) == 14
    experiments = [load_experiment(name) for name in NAMES]
    ours = {one.kind: [claim.where.startswith("ours") for claim in one.claims] for one in experiments}
    assert ours == {one.kind: listed.get(one.kind) for one in experiments}


@pytest.mark.parametrize("name", NAMES)
def test_an_experiment_is_a_folder_of_a_scenario_its_claims_and_at_most_60_lines(name):
    folder, experiment = FOLDER / name.replace("-", "_"), load_experiment(name)
    code = (folder / "experiment.py").read_text("utf-8")
    lines = [line for line in re.sub(r'""".*?"""', "", code, flags=re.S).splitlines() if line.strip()]
    assert len(lines) <= 60
    assert {file.suffix for file in folder.iterdir() if file.is_file()} <= {".py", ".toml", ".urdf"}
    assert [cp.Scenario.load(file) for file in folder.glob("*.toml") if file.stem != "experiment"]
    assert experiment.chosen
    assert experiment.deviations
    names = [claim.name for claim in experiment.claims]
    assert len(set(names)) == len(names)
    judged = [claim.name for claim in experiment.claims if not claim.unjudged]
    assert [claim for claim in judged if f'"{claim}"' not in code] == []


@pytest.mark.parametrize("name", NAMES)
def test_the_page_of_an_experiment_has_the_words_of_its_file(name):
    experiment, text = load_experiment(name), (PAGES / f"{name}.md").read_text("utf-8")
    told = [experiment.title, experiment.source, experiment.had, experiment.cell, experiment.picture.caption]
    told += [*experiment.chosen, *experiment.deviations, f"coop-pin zoo {name}"]
    told += [part for claim in experiment.claims for part in (claim.text, claim.where, claim.theirs)]
    assert [words for words in told if words not in text] == []
    assert "| - | yes |" not in text
    assert (REPOSITORY / "docs" / "images" / f"zoo-{name}.png").is_file()
    assert f"**{VERDICTS[3]}**" in text or not any(claim.unjudged for claim in experiment.claims)


def test_the_table_of_methods_has_every_experiment():
    assert tool.methods() in tool.METHODS.read_text("utf-8")
    assert [name for name in NAMES if f"({name}.md)" not in tool.methods()] == []


# ---------------------------------------------------------------- verdicts


def made(*values, unjudged=""):
    numbers = tuple(Measured("c", f"n{k}", value, "mm", most=1.0) for k, value in enumerate(values))
    return Reproduction("made", {"c": unjudged}, numbers, ())


@pytest.mark.parametrize(
    ("run", "verdict"),
    [
        (made(0.5, 1.0), "holds"),
        (made(0.5, 1.5), "holds in part"),
        (made(1.5, np.nan), "does not hold"),
        (made(), "cannot be judged"),
        (Reproduction("made", {"c": ""}, (Measured("c", "told", 1.0),), ()), "cannot be judged"),
        (made(0.5, unjudged="no text"), "cannot be judged"),
    ],
)
def test_a_verdict_follows_from_the_numbers_of_its_claim(run, verdict):
    assert run.verdict("c") == verdict
    assert verdict in VERDICTS
    assert max(map(len, run.summary().splitlines())) <= 80
    told = json.loads(json.dumps(run.to_json(), allow_nan=False))
    assert told["verdicts"] == {"c": verdict}
    assert [one["holds"] for one in told["numbers"]] == [one.value <= 1.0 for one in run.numbers]


def test_a_limit_is_told_by_what_it_bounds():
    assert Measured("c", "n", 1.0, most=2.0).limit == "<= 2"
    assert Measured("c", "n", 1.0).limit == "-"
    assert Measured("c", "n", 1.0, least=0.5).limit == ">= 0.5"
    assert Measured("c", "n", 1.0, least=0.5, most=2.0).limit == "0.5 to 2"


def test_numbers_of_a_page_are_told_from_its_words():
    words, numbers = tool.numbers_of("| 20 N, arXiv:2005.03153 | 0.143 mm | -1e-05 | zoo63 |")
    assert numbers == [20.0, 0.143, -1e-05]
    assert words == "| # N, arXiv:2005.03153 | # mm | # | zoo63 |"


def test_a_wrong_name_and_a_claim_without_its_source_are_refused():
    with pytest.raises(NameNotFoundError, match="object-impedance"):
        load_experiment("object-impedence")
    with pytest.raises(FieldError, match="where"):
        Claim(name="c", text="It moves.", theirs="no digit")


def test_a_file_with_mistakes_or_todo_and_missing_code_are_told_with_their_path(tmp_path):
    file = tmp_path / "experiment.toml"
    file.write_text("kind = 'TODO'", "utf-8")
    with pytest.raises(FileReadError, match=r"experiment\.toml: (.|\n)*claims: must be given") as error:
        Experiment.load(file)
    assert [word in str(error.value) for word in ("kind: is 'TODO'", "title: must be given")] == [True, True]
    text = (FOLDER / "force_leader" / "experiment.toml").read_text("utf-8")
    file.write_text(re.sub(r'^where = .*"$', 'where = "TODO: section"', text, flags=re.M), "utf-8")
    with pytest.raises(FileReadError, match=r"claims\.2\.where: is 'TODO"):
        load_experiment(tmp_path)
    with pytest.raises(FileReadError, match=r"experiment\.py: must define reproduce"):
        load_experiment(QUICK).replace(folder=tmp_path).run()
    (tmp_path / "experiment.py").write_text("def reproduce(cell, *, short):\n    return [1.0], []\n", "utf-8")
    with pytest.raises(NameNotFoundError, match=r"no scenario .*cell\.toml"):
        load_experiment(QUICK).replace(folder=tmp_path).run()
    shutil.copy(FOLDER / "object_impedance" / "cell.toml", tmp_path)
    with pytest.raises(WrongTypeError, match="Measured"):
        load_experiment(QUICK).replace(folder=tmp_path).run()


def copied(folder, code=None):
    """A folder outside the package with the quick experiment, or with its claims and other code."""
    shutil.copytree(FOLDER / "force_leader", folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(FOLDER / "puck.urdf", folder.parent)
    if code is not None:
        (folder / "experiment.py").write_text(code, "utf-8")
    return folder


@pytest.mark.parametrize(
    ("code", "error"),
    [
        ("import sys\n\ndef reproduce(cell, *, short):\n    sys.exit(0)\n", FileReadError),
        ("def reproduce(cell, *, short)\n", FileReadError),
        ("reproduce = 3\n", FileReadError),
        ("def reproduce(cell, *, short):\n    return [], [], []\n", FileReadError),
        (
            "from coop_pin.zoo import Measured\n\ndef reproduce(cell, *, short):\n"
            "    return [Measured('forces align by the object\\'s motion alone', 'n', 'abc')], []\n",
            WrongTypeError,
        ),
    ],
    ids=["exits", "does not parse", "no function", "three values", "a text for a number"],
)
def test_code_of_a_folder_that_ends_or_returns_something_else_is_an_error(tmp_path, code, error):
    with pytest.raises(error):
        load_experiment(copied(tmp_path / "paper", code)).run()


STATED = """
from coop_pin.zoo import Measured, Trace

def reproduce(cell, *, short):
    return [Measured("forces align by the object's motion alone", "angle", {angle}, "deg", most=10.0)], []
"""


def test_a_folder_anywhere_is_judged_and_loaded_anew(tmp_path, monkeypatch, capsys):
    folder = copied(tmp_path / "kim.2020_paper", STATED.format(angle=9.0))
    monkeypatch.chdir(tmp_path)
    assert main(["zoo", "./kim.2020_paper", "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)
    assert told["name"] == "kim.2020-paper"
    assert list(told["verdicts"].values()) == ["holds", "cannot be judged", "cannot be judged"]
    (folder / "experiment.py").write_text(STATED.format(angle=11.0), "utf-8")
    assert load_experiment("kim.2020_paper").run().verdict(next(iter(told["verdicts"]))) == "does not hold"
    assert main(["zoo", "kim_2020"]) == 2
    assert "experiment.toml, cell.toml and experiment.py" in capsys.readouterr().err


@pytest.mark.gate
def test_a_copy_of_an_experiment_outside_the_package_has_its_numbers(tmp_path):
    packaged = load_experiment(QUICK).run(short=True)
    assert load_experiment(copied(tmp_path / QUICK)).run(short=True).to_json() == packaged.to_json()


def test_a_number_of_no_claim_is_refused():
    experiment = load_experiment(QUICK)
    with pytest.raises(NameNotFoundError, match="typo"):
        experiment.reproduction([Measured("typo", "n", 1.0)], [])
    claim = experiment.claims[0].name
    assert experiment.reproduction([Measured(claim, "n", 1.0, most=2.0)], []).verdict(claim) == "holds"


# ---------------------------------------------------------------- the command


def test_the_command_lists_experiments_and_runs_a_short_form(capsys):
    assert not main(["zoo"])
    listed = capsys.readouterr().out
    assert [name for name in NAMES if name not in listed] == []
    assert not main(["zoo", "--json"])
    assert [one["name"] for one in json.loads(capsys.readouterr().out)] == NAMES
    assert not main(["zoo", QUICK, "--short"])
    assert "holds" in capsys.readouterr().out
    assert main(["zoo", "no-such"]) == 2


# ---------------------------------------------------------------- runs beside pages


def outside(text):
    """What a page shows beyond its limit."""
    return set(re.findall(r"^\| \d \| ([^|]+) \|.*\| no \|$", text, re.M))


@pytest.mark.gate
@pytest.mark.parametrize("name", NAMES)
def test_the_short_form_of_an_experiment_is_within_the_limits_that_its_page_keeps(name):
    run, text = load_experiment(name).run(short=True), (PAGES / f"{name}.md").read_text("utf-8")
    assert run.numbers
    beyond = {number.text for number in run.numbers if not number.holds}
    assert beyond <= outside(text)
    assert [curve.label for curve in run.curves if len(curve.x) != len(curve.y)] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_an_experiment_gives_the_numbers_of_its_page(name):
    experiment = load_experiment(name)
    words, numbers = tool.numbers_of(tool.page(experiment, experiment.run()))
    stored_words, stored = tool.numbers_of((PAGES / f"{name}.md").read_text("utf-8"))
    assert words == stored_words
    assert_allclose(numbers, stored, rtol=0.01, atol=1e-6)
