"""The dimensions of a plan: what varies along each, and how it changes a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from coop_pin.sweeps.axis import label
from coop_pin.sweeps.sampling import Sample


class FieldsDimension(NamedTuple):
    """One field, or several that move together; the first gives the dimension its name.

    Attributes:
        fields: the values of each field, all of one length.
    """

    fields: Mapping[str, tuple[Any, ...]]

    @property
    def name(self) -> str:
        """Name of the dimension."""
        return next(iter(self.fields))

    @property
    def size(self) -> int:
        """Number of places."""
        return len(self.fields[self.name])

    def changes(self, place: int) -> dict[str, Any]:
        """Return the changed fields at one place."""
        return {field: values[place] for field, values in self.fields.items()}

    def labels(self, place: int) -> dict[str, Any]:
        """Return what a table shows of one place."""
        return {field: label(value) for field, value in self.changes(place).items()}

    def describe(self) -> str:
        """Return one line for people."""
        shown = [_short(label(value)) for value in self.fields[self.name][:6]]
        more = ", ..." if self.size > len(shown) else ""
        together = f" together with {', '.join(list(self.fields)[1:])}" if len(self.fields) > 1 else ""
        return f"{self.size} values: {', '.join(shown)}{more}{together}"


class CasesDimension(NamedTuple):
    """Named bundles of changes: controllers, payloads, anything that takes more than one field to say.

    Attributes:
        name: name of the dimension.
        cases: the changes of each case by its name.
    """

    name: str
    cases: Mapping[str, Mapping[str, Any]]

    @property
    def size(self) -> int:
        """Number of cases."""
        return len(self.cases)

    def changes(self, place: int) -> dict[str, Any]:
        """Return the changed fields of one case."""
        return dict(list(self.cases.values())[place])

    def labels(self, place: int) -> dict[str, Any]:
        """Return what a table shows of one case."""
        return {self.name: list(self.cases)[place]}

    def describe(self) -> str:
        """Return one line for people."""
        return f"{self.size} cases: {', '.join(self.cases)}"


class SampleDimension(NamedTuple):
    """Sampled points, numbered.

    Attributes:
        sample: the points.
    """

    sample: Sample

    @property
    def name(self) -> str:
        """Name of the dimension."""
        return "sample"

    @property
    def size(self) -> int:
        """Number of points."""
        return len(self.sample)

    def changes(self, place: int) -> dict[str, Any]:
        """Return the changed fields at one point."""
        return dict(self.sample.point(place))

    def labels(self, place: int) -> dict[str, Any]:
        """Return what a table shows of one point."""
        return {"sample": place, **self.sample.point(place)}

    def describe(self) -> str:
        """Return one line for people."""
        ranges = (f"{name} in [{span.low:g}, {span.high:g}]" for name, span in self.sample.fields.items())
        return f"{self.size} {self.sample.method} points over {', '.join(ranges)}"


class RepeatDimension(NamedTuple):
    """The same again with the next seeds.

    Attributes:
        size: how often.
    """

    size: int

    @property
    def name(self) -> str:
        """Name of the dimension."""
        return "repeat"

    def changes(self, place: int) -> dict[str, Any]:
        """Return nothing: the seed depends on the scenario, and the plan counts it up."""
        return {}

    def labels(self, place: int) -> dict[str, Any]:
        """Return what a table shows of one repeat."""
        return {"repeat": place}

    def describe(self) -> str:
        """Return one line for people."""
        return f"{self.size} repeats, the seed counted up from the scenario's"


Dimension = FieldsDimension | CasesDimension | SampleDimension | RepeatDimension


def _short(value: Any) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)
