"""Network between the arms: who hears whom, and when and how exactly a message arrives."""

from __future__ import annotations

import collections
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, Magnitude, NotNegative, Positive, unknown_arms
from coop_pin.base.schema.delay import Delay
from coop_pin.base.schema.parts import fields_of
from coop_pin.description.plant import Clock

Edge = tuple[str, str]
"""Names of the sender and of the receiver."""
Graph = Literal["all", "ring", "star"] | tuple[Edge, ...]
Probability = Annotated[float, Field(ge=0.0, lt=1.0)]
Ticks = Annotated[int, Field(ge=0)]


class Channel(Description):
    """Way of a message: ``resolution * round(message / resolution)``, ``delay`` ticks later, or lost.

    With a threshold a message is sent when a number of it differs from the last one sent by as much: send on
    delta, as of Miskowicz, Sensors 6 (2006), or event-triggered. The receiver keeps the last that arrived.

    Attributes:
        delay: ticks from a message to its arrival, or a time such as "5 ms", rounded up to ticks; 0 arrives
            before any arm steps, in a round of its own, 1 is sent with the command.
        jitter: largest further delay of a message, ticks; each from 0 to it is as likely. A message that
            a newer one overtakes is not heard.
        loss: probability that a message is lost.
        rate_hz: rate of the messages, Hz: the control rate, which is the default, divided by a whole number.
        resolution: step of every number of a message, in its own unit; 0 rounds nothing.
        threshold: change of a number since the last message at which the next is sent, in its own unit; one
            for all numbers of a message or one for each. 0, the default, sends at every tick of the rate.
        least_rate_hz: rate at which messages are sent though nothing changes, Hz, the control rate divided by
            a whole number; none when omitted.
    """

    delay: Delay = 0
    jitter: Ticks = 0
    loss: Probability = 0.0
    rate_hz: Positive | None = None
    resolution: NotNegative = 0.0
    threshold: Magnitude = 0.0
    least_rate_hz: Positive | None = None

    @property
    def slowest(self) -> int:
        """Largest delay of a message, ticks."""
        return self.delay + self.jitter

    def channel_problems(self, clock: Clock, duration: float) -> list[FieldError]:
        """Return what is wrong with delay and rate for a run of a duration, s."""
        rates = {"rate_hz": self.rate_hz, "least_rate_hz": self.least_rate_hz}
        uneven = [problem for name, rate in rates.items() for problem in clock.uneven(rate, name)]
        return clock.late(self.slowest, duration, "delay") + uneven

    def longest_silence(self, clock: Clock) -> float:
        """Return how long an arm may have nothing to say, ticks: 0 without a threshold, or inf."""
        if not np.any(self.threshold):
            return 0.0
        return np.inf if self.least_rate_hz is None else float(clock.ticks_between(self.least_rate_hz))


class EdgeChannel(Description):
    """Channel of one edge, where it differs from that of the network.

    Attributes:
        sender: arm that sends.
        receiver: arm that hears.
        delay: ticks from a message to its arrival; that of the network when omitted, as for those below.
        jitter: largest further delay, ticks.
        loss: probability that a message is lost.
        rate_hz: rate of the messages, Hz.
        resolution: step of every number of a message.
        threshold: change at which a message is sent.
        least_rate_hz: rate at which messages are sent though nothing changes, Hz.
    """

    sender: str
    receiver: str
    delay: Delay | None = None
    jitter: Ticks | None = None
    loss: Probability | None = None
    rate_hz: Positive | None = None
    resolution: NotNegative | None = None
    threshold: Magnitude | None = None
    least_rate_hz: Positive | None = None


class GraphChange(Description):
    """Graph from a time on.

    Attributes:
        time: time of the first messages along the new graph, s.
        graph: graph, as that of the network.
    """

    time: NotNegative
    graph: Graph


class ArmClock(Description):
    """Clock of an arm: ``t_i = t + offset + drift t``, by which it reads its own desired motion.

    Attributes:
        offset: error at t = 0, s.
        drift: growth of the error, s/s; crystals have 1e-5 to 1e-4.
    """

    offset: float = 0.0
    drift: float = 0.0

    def reading(self, time: float) -> float:
        """Return what the clock shows at a time, s, and 0 before the run."""
        return max(0.0, time + self.offset + self.drift * time)


class Network(Channel):
    """Messages between the arms; every edge is a channel of its own, drawn from the scenario's seed.

    An arm also hears its own messages, rounded and delayed like those of the network but never lost: so all
    can compute with the same numbers.

    Attributes:
        graph: who hears whom: "all", "ring" and "star" about the first arm, both ways, in the order of the
            cell's arms, or pairs [sender, receiver].
        changes: graphs from later times on.
        links: edges with channels of their own.
        clocks: clocks of single arms; exact when omitted.
    """

    graph: Graph = "all"
    changes: tuple[GraphChange, ...] = ()
    links: tuple[EdgeChannel, ...] = ()
    clocks: dict[str, ArmClock] = Field(default_factory=dict)

    def edges_at(self, time: float, arms: Sequence[str]) -> tuple[Edge, ...]:
        """Return the edges from a time on, s."""
        later = sorted(self.changes, key=lambda change: change.time)
        graph = next((change.graph for change in reversed(later) if change.time <= time), self.graph)
        return edges_of(graph, arms)

    def edges(self, arms: Sequence[str]) -> tuple[Edge, ...]:
        """Return the edges that there are at some time, by sender and receiver in the order of the arms."""
        graphs = [self.graph, *(change.graph for change in self.changes)]
        present = {edge for graph in graphs for edge in edges_of(graph, arms)}
        return tuple((one, other) for one in arms for other in arms if (one, other) in present)

    @property
    def exact(self) -> Network:
        """The network without losses, rounding and thresholds."""
        exact = {"loss": 0.0, "resolution": 0.0, "threshold": 0.0}
        links = tuple(link.replace(**dict.fromkeys(exact)) for link in self.links)
        return self.replace(**exact, links=links)

    def channel(self, edge: Edge) -> Channel:
        """Return the channel of an edge; an arm hears itself without loss and jitter."""
        values = {name: part for name, part in fields_of(self).items() if name in Channel.model_fields}
        if edge[0] == edge[1]:
            return Channel(**values | {"loss": 0.0, "jitter": 0})
        for link in self.links:
            if (link.sender, link.receiver) == edge:
                stated = {name: part for name, part in fields_of(link).items() if part is not None}
                values |= {name: stated[name] for name in values.keys() & stated.keys()}
        return Channel(**values)

    def clocks_by_number(self, arms: Iterable[str]) -> dict[int, ArmClock]:
        """Return the clocks that are not exact, by the arm's number."""
        return {index: self.clocks[name] for index, name in enumerate(arms) if name in self.clocks}

    def slowest_of(self, arms: Sequence[str]) -> int:
        """Return the largest age of a message that is not lost, ticks without those between messages."""
        return max((self.channel(edge).slowest for edge in self.edges(arms)), default=self.slowest)

    def longest_silence_of(self, arms: Sequence[str], clock: Clock) -> float:
        """Return how long an arm may have nothing to say to one that hears it or to itself, ticks."""
        edges = [*self.edges(arms), *((name, name) for name in arms)]
        return max(self.channel(edge).longest_silence(clock) for edge in edges)

    def oldest_of(self, arms: Sequence[str], clock: Clock) -> int:
        """Return the largest age of the latest message, ticks, where none is lost."""
        every = [clock.ticks_between(self.channel(edge).rate_hz) for edge in self.edges(arms)]
        return self.slowest_of(arms) + max(every, default=1) - 1

    def timing_problems(self, run: Mapping[str, Any]) -> list[FieldError]:
        """Return unknown arms, and what is wrong with delays, rates and times.

        Args:
            run: fields of the run; what has mistakes itself is not there, and nothing is checked by it.
        """
        problems = self._repeated()
        if "cell" in run:
            problems += self._strangers(run["cell"].arms)
        if problems or not {"clock", "duration"} <= set(run):
            return problems
        clock, duration = run["clock"], run["duration"]
        problems += self.channel_problems(clock, duration)
        for index, link in enumerate(self.links):
            channel = self.channel((link.sender, link.receiver))
            late = [] if problems else channel.channel_problems(clock, duration)
            problems += [problem.below(f"links.{index}") for problem in late]
        for index, change in enumerate(self.changes):
            if change.time > duration:
                detail = (
                    f"is {change.time:g} s, but the run ends at {duration:g} s; it must be within the run"
                )
                problems.append(FieldError(detail, f"changes.{index}.time"))
        return problems

    def _graphs(self) -> dict[str, Graph]:
        """Return the graphs by their paths."""
        later = {f"changes.{index}.graph": each.graph for index, each in enumerate(self.changes)}
        return {"graph": self.graph} | later

    def _repeated(self) -> list[FieldError]:
        """Return edges from an arm to itself, and edges, links and times of changes that are stated twice."""
        links = [(link.sender, link.receiver) for link in self.links]
        problems = _twice(links, "links") + _twice([change.time for change in self.changes], "changes")
        for path, graph in self._graphs().items():
            edges = () if isinstance(graph, str) else graph
            problems += _twice(edges, path)
            for name, _ in [edge for edge in edges if edge[0] == edge[1]][:1]:
                detail = f"has an edge from {name!r} to itself; leave it out: an arm hears itself always"
                problems.append(FieldError(detail, path))
        return problems

    def _strangers(self, arms: Mapping[str, Any]) -> list[FieldError]:
        """Return the names of graphs, links and clocks that are no arms, and links that are no edges."""
        problems = [problem.below("clocks") for problem in unknown_arms(self.clocks, arms)]
        for path, graph in self._graphs().items():
            names = [] if isinstance(graph, str) else [name for edge in graph for name in edge]
            problems += [problem.below(path) for problem in unknown_arms(dict.fromkeys(names), arms)]
        if problems:
            return problems
        edges = self.edges(list(arms))
        for index, link in enumerate(self.links):
            if (link.sender, link.receiver) not in edges:
                stated = ", ".join(f"{one} to {other}" for one, other in edges)
                detail = f"is from {link.sender!r} to {link.receiver!r}, which is no edge; there are {stated}"
                problems.append(FieldError(detail, f"links.{index}"))
        return problems


def _twice(values: Iterable[Any], path: str) -> list[FieldError]:
    """Return the first value that is stated more than once."""
    count = collections.Counter(values)
    again = [value for value, number in count.items() if number > 1][:1]
    return [FieldError(f"has {value!r} {count[value]} times; state it once", path) for value in again]


def edges_of(graph: Graph, arms: Sequence[str]) -> tuple[Edge, ...]:
    """Return the edges of a graph among arms."""
    if not isinstance(graph, str):
        return graph
    m = len(arms)
    numbers = [(i, j) for i in range(m) for j in range(m) if i != j]
    if graph == "ring":
        numbers = [(i, j) for i, j in numbers if (i - j) % m in (1, m - 1)]
    if graph == "star":
        numbers = [(i, j) for i, j in numbers if 0 in (i, j)]
    return tuple((arms[i], arms[j]) for i, j in numbers)
