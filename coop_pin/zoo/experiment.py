"""Experiment: what a source states and leaves open, as its file has it, and its run."""

from __future__ import annotations

import importlib
from pathlib import Path

from coop_pin.base.arrays import typed
from coop_pin.base.errors import NameNotFoundError
from coop_pin.base.schema.base import Description, Name, Text
from coop_pin.base.user_files import read_toml
from coop_pin.zoo.reproduction import Reproduction

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

    def run(self, *, short: bool = False) -> Reproduction:
        """Return its numbers and curves, by the function ``reproduce`` of its folder.

        Args:
            short: run the short form, of the same code with fewer seconds, arms or draws.
        """
        module = importlib.import_module(f"{__package__}.{self.name.replace('-', '_')}.experiment")
        numbers, curves = module.reproduce(short=short)
        return Reproduction(
            self.name, {claim.name: claim.unjudged for claim in self.claims}, tuple(numbers), tuple(curves)
        )


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
    """
    if name not in experiment_names():
        raise NameNotFoundError("experiment", name, experiment_names(), "the zoo")
    file = _FOLDER / name.replace("-", "_") / "experiment.toml"
    return Experiment(**read_toml(file, kind="an experiment"), name=name)
