"""Experiment: what a source states and leaves open, as its file has it, and its run."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator

from coop_pin.base.arrays import require_type, typed
from coop_pin.base.errors import FieldError, FileReadError, NameNotFoundError, ScenarioError
from coop_pin.base.schema.base import Description, Name, Text
from coop_pin.base.user_files import read_toml
from coop_pin.description.scenario import Scenario
from coop_pin.zoo.reproduction import Measured, Reproduction, Trace

_FOLDER = Path(__file__).parent


def _stated(text: str) -> str:
    """Return a text that is not still to be written."""
    if "TODO" in text:
        raise FieldError(f"is {text!r}; write what the source states, or that it does not")
    return text


Stated = Annotated[Text, AfterValidator(_stated)]
"""Text without the word TODO."""


class Claim(Description):
    """Statement of a source, in our words.

    Attributes:
        name: Name of the claim within its experiment, a few words.
        text: Statement.
        where: Section, equation or part of the source that states it.
        theirs: Measured, shape or sign of the source, beside which the measured number stands.
        unjudged: Reason why it cannot be judged here; empty if it can.
    """

    name: Name
    text: Stated
    where: Stated
    theirs: Stated
    unjudged: Stated = ""


class Picture(Description):
    """Axes of the one picture of a page.

    Attributes:
        x: Label of the horizontal axis.
        y: Label of the vertical axis.
        caption: Text below.
        log: Whether the vertical axis is logarithmic.
    """

    x: Stated
    y: Stated
    caption: Stated
    log: bool = False


class Experiment(Description):
    """Published experiment, what its source states, and what was chosen here.

    Attributes:
        kind: Kind of method, as the list of the zoo names it.
        title: Heading of its page.
        source: Citation, with a link.
        had: Text of the source that could be read.
        cell: Cell in which it is rebuilt, and the law, in a sentence or two.
        measures: Signals that each arm measures.
        commands: Quantity that each arm commands.
        messages: Messages that arms exchange.
        knows: Knowledge of load, grasps and arms that the law is given.
        claims: Claims of the source.
        chosen: Gaps of the source, each with what was chosen.
        deviations: Differences from the source, each with its cause.
        picture: Axes of its picture.
        folder: Folder of the file, with its scenarios and its code.
    """

    kind: Stated
    title: Stated
    source: Stated
    had: Stated
    cell: Stated
    measures: Stated
    commands: Stated
    messages: Stated
    knows: Stated
    claims: tuple[Claim, ...]
    chosen: tuple[Stated, ...]
    deviations: tuple[Stated, ...]
    picture: Picture
    folder: Path

    @classmethod
    def load(cls, file: Path) -> Self:
        """Return the experiment of an ``experiment.toml``.

        Raises:
            FileReadError: the file is not TOML, or has mistakes, or still says TODO.
        """
        try:
            return cls(**read_toml(file, kind="an experiment") | {"folder": file.parent.resolve()})
        except ScenarioError as error:
            raise FileReadError(str(error), str(file)) from error

    @property
    def name(self) -> str:
        """Name: that of its folder, with hyphens."""
        return self.folder.name.replace("_", "-")

    def run(self, *, short: bool = False) -> Reproduction:
        """Return its numbers and curves, by ``reproduce(cell, *, short)`` of its ``experiment.py``.

        The cell is the scenario ``cell.toml`` of its folder, which is loaded at each call, as the code is.

        Args:
            short: run the short form, of the same code with fewer seconds, arms or draws.

        Raises:
            FileReadError: its folder has no ``experiment.py``, or no such function in it, or it cannot be
                read, exits, or returns more or less than two values.
            NameNotFoundError: its folder has no ``cell.toml``, or a number names a claim that is not stated.
            ScenarioError: the cell has mistakes.
            WrongTypeError: a number is something else.
        """
        file = self.folder / "experiment.py"
        spec: Any = importlib.util.spec_from_file_location(f"{self.folder.name}.experiment", file)
        module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
        try:
            if file.is_file():
                spec.loader.exec_module(module)
            if not callable(getattr(module, "reproduce", None)):
                raise FileReadError("must define reproduce(cell, *, short)", str(file))
            results = module.reproduce(Scenario.load(self.folder / "cell.toml"), short=short)
        except (SyntaxError, SystemExit) as error:
            raise FileReadError(f"{type(error).__name__}: {error}", str(file)) from error
        if not (isinstance(results, tuple) and len(results) == 2):
            raise FileReadError("reproduce must return two values: numbers, curves", str(file))
        return self.reproduction(*results)

    def reproduction(self, numbers: Sequence[Measured], curves: Sequence[Trace]) -> Reproduction:
        """Return numbers and curves of a run, with the claims.

        Raises:
            WrongTypeError: an entry is something else than a number with its claim.
            NameNotFoundError: a number names a claim that is not stated.
        """
        claims = {claim.name: claim.unjudged for claim in self.claims}
        for number in numbers:
            require_type("a number", number, Measured)
            require_type(f"the value of {number.text!r}", number.value, int, float)
            if number.claim not in claims:
                raise NameNotFoundError("claim", number.claim, claims, f"experiment.toml of {self.name!r}")
        return Reproduction(self.name, claims, tuple(numbers), tuple(curves))


def experiment_names() -> list[str]:
    """Return the names of the experiments that come with coop_pin."""
    return sorted(path.parent.name.replace("_", "-") for path in _FOLDER.glob("*/experiment.toml"))


@typed
def load_experiment(name: str | Path) -> Experiment:
    """Return an experiment of the zoo, or of a folder of one's own.

    Args:
        name: one of ``experiment_names()``, or a folder with ``experiment.toml``, ``cell.toml``
            and ``experiment.py``.

    Raises:
        NameNotFoundError: there is neither an experiment nor a folder of that name.
        FileReadError: its file is missing, is not TOML, or has mistakes.
    """
    known = experiment_names()
    folder = _FOLDER / str(name).replace("-", "_") if name in known else Path(name)
    if not folder.is_dir():
        remedy = "the zoo, and no such folder (yours has experiment.toml, cell.toml and experiment.py)"
        raise NameNotFoundError("experiment", str(name), known, remedy)
    return Experiment.load(folder / "experiment.toml")
