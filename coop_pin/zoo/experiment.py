"""Experiment: what a source states and leaves open, as its file has it, and its run."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from coop_pin.base.arrays import typed
from coop_pin.base.errors import FieldError, FileReadError, NameNotFoundError, ScenarioError
from coop_pin.base.schema.base import Description, Name, Text
from coop_pin.base.user_files import read_toml
from coop_pin.zoo.reproduction import Measured, Reproduction, Trace

_FOLDER = Path(__file__).parent


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
    text: Text
    where: Text
    theirs: Text
    unjudged: Text = ""


class Picture(Description):
    """Axes of the one picture of a page.

    Attributes:
        x: Label of the horizontal axis.
        y: Label of the vertical axis.
        caption: Text below.
        log: Whether the vertical axis is logarithmic.
    """

    x: Text
    y: Text
    caption: Text
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
        name: Name, that of its folder with hyphens.
    """

    kind: Text
    title: Text
    source: Text
    had: Text
    cell: Text
    measures: Text
    commands: Text
    messages: Text
    knows: Text
    claims: tuple[Claim, ...]
    chosen: tuple[Text, ...]
    deviations: tuple[Text, ...]
    picture: Picture
    name: Name

    @classmethod
    def load(cls, file: Path) -> Self:
        """Return the experiment of an ``experiment.toml``.

        Raises:
            FileReadError: the file is not TOML, or has mistakes.
        """
        table = read_toml(file, kind="an experiment")
        try:
            return cls(**table, name=file.parent.name.replace("_", "-"))
        except (FieldError, ScenarioError) as error:
            raise FileReadError(str(error), str(file)) from error

    def run(self, *, short: bool = False) -> Reproduction:
        """Return its numbers and curves, by the function ``reproduce`` of its folder.

        Args:
            short: run the short form, of the same code with fewer seconds, arms or draws.

        Raises:
            FileReadError: its folder has no ``experiment.py``.
            NameNotFoundError: a number names a claim that is not stated.
        """
        file = _file(self.name).with_suffix(".py")
        if not file.is_file():
            raise FileReadError("is missing; it defines reproduce(*, short)", str(file))
        module = importlib.import_module(f"{__package__}.{file.parent.name}.experiment")
        return self.reproduction(*module.reproduce(short=short))

    def reproduction(self, numbers: Sequence[Measured], curves: Sequence[Trace]) -> Reproduction:
        """Return numbers and curves of a run, beside the claims.

        Raises:
            NameNotFoundError: a number names a claim that is not stated.
        """
        claims = {claim.name: claim.unjudged for claim in self.claims}
        for number in numbers:
            if number.claim not in claims:
                raise NameNotFoundError("claim", number.claim, claims, f"experiment.toml of {self.name!r}")
        return Reproduction(self.name, claims, tuple(numbers), tuple(curves))


def _file(name: str) -> Path:
    """Return the file of an experiment, beside which its code lies."""
    return _FOLDER / name.replace("-", "_") / "experiment.toml"


def experiment_names() -> list[str]:
    """Return the names of the experiments."""
    return sorted(path.parent.name.replace("_", "-") for path in _FOLDER.glob("*/experiment.toml"))


@typed
def load_experiment(name: str) -> Experiment:
    """Return an experiment.

    Args:
        name: one of ``experiment_names()``.

    Raises:
        NameNotFoundError: there is no experiment of that name.
        FileReadError: its file is not TOML, or has mistakes.
    """
    if name not in experiment_names():
        raise NameNotFoundError("experiment", name, experiment_names(), "the zoo")
    return Experiment.load(_file(name))
