"""Network of a run: messages between arms, delayed, lost, rounded and counted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, frozen
from coop_pin.base.errors import ShapeError
from coop_pin.base.spatial.generic_numbers import known, where
from coop_pin.control import ArmMeasurement, ArmReference, CellController, Message
from coop_pin.description.network import Channel, Edge, Network
from coop_pin.description.scenario import Scenario
from coop_pin.simulation.devices.signals import EARLY, generator

_NUMBER_BYTES = 8
"""Bytes of a number of a message, as a double."""


class NetworkSignals(NamedTuple):
    """Timing of the messages on each edge at n ticks, or without the first axis at one.

    Attributes:
        arrived: whether a message arrives that is newer than the last, masks, shape (n, edges).
        age: age of the newest that has arrived, ticks, inf before the first, shape (n, edges).
    """

    arrived: Array
    age: Array

    def ticks(self) -> Iterator[NetworkSignals]:
        """Return the timing of one tick after the other."""
        return map(NetworkSignals, self.arrived.tolist(), self.age.tolist())


class NetworkState(NamedTuple):
    """Memory of a network.

    Attributes:
        sent: messages of each arm over the last ticks, the newest first, shape (D + 1, w_i) each.
        heard: message that each edge holds, shape (w_sender,) each.
    """

    sent: tuple[Array, ...]
    heard: tuple[Array, ...]


class CellNetwork(NamedTuple):
    """Edges between arms, each of which holds the newest message that has arrived.

    Attributes:
        arms: names of the arms.
        edges: sender and receiver of each edge; of each arm one to itself.
        resolution: step of the numbers on each edge, 0 for none, shape (edges,).
        ages: 0 to D, the ages at which a message may arrive, ticks.
    """

    arms: tuple[str, ...]
    edges: tuple[Edge, ...]
    resolution: Array
    ages: tuple[float, ...]

    def start(self, messages: Sequence[Array]) -> NetworkState:
        """Return the state before the first tick, with messages of the sizes of those of the arms."""
        sizes = dict(zip(self.arms, map(len, messages), strict=True))
        sent = tuple(np.zeros((len(self.ages), size)) for size in sizes.values())
        return NetworkState(sent, tuple(np.zeros(sizes[sender]) for sender, _ in self.edges))

    def step(
        self, state: NetworkState, messages: Sequence[Array], signals: NetworkSignals
    ) -> tuple[list[dict[str, Message]], NetworkState]:
        """Return what each arm has heard by a tick, by the sender's name, and the state.

        Args:
            state: State after the tick before.
            messages: Messages of all arms of this tick, shape (w_i,) each.
            signals: Timing of this tick.
        """
        sent = tuple(
            np.concatenate((message[None], earlier[:-1]))
            for message, earlier in zip(messages, state.sent, strict=True)
        )
        by_sender, heard = dict(zip(self.arms, sent, strict=True)), list[Array]()
        received: dict[str, dict[str, Message]] = {name: {} for name in self.arms}
        for index, (sender, receiver) in enumerate(self.edges):
            numbers, age = state.heard[index], signals.age[index]
            for possible, message in zip(self.ages, by_sender[sender], strict=True):
                is_this = (signals.arrived[index] > 0.5) & (age == possible)
                numbers = where(is_this, _rounded(message, self.resolution[index]), numbers)
            heard.append(numbers)
            received[receiver][sender] = Message(frozen(numbers), age)
        return list(received.values()), NetworkState(sent, tuple(heard))


def _rounded(numbers: Array, resolution: Any) -> Array:
    """Return numbers as multiples of a resolution, unless that is 0."""
    if known(resolution == 0.0):
        return numbers
    step = np.where(resolution > 0.0, resolution, 1.0)
    return np.where(resolution > 0.0, step * np.round(numbers / step), numbers)


def cell_network(scenario: Scenario) -> CellNetwork | None:
    """Return the network of a scenario; None without one."""
    if scenario.network is None:
        return None
    arms = tuple(scenario.cell.arms)
    edges = _all_edges(scenario.network, arms)
    channels = [scenario.network.channel(edge) for edge in edges]
    ages = tuple(map(float, range(1 + max(channel.slowest for channel in channels))))
    return CellNetwork(arms, edges, np.array([channel.resolution for channel in channels]), ages)


def _all_edges(network: Network, arms: Sequence[str]) -> tuple[Edge, ...]:
    """Return all edges, and those of the arms to themselves, by sender in the order of the arms."""
    present = {*network.edges(arms), *((name, name) for name in arms)}
    return tuple((one, other) for one in arms for other in arms if (one, other) in present)


# ---------------------------------------------------------------- timing


class _EdgeTiming:
    """Timing of the messages of one edge, drawn in blocks of ticks that follow each other."""

    def __init__(self, scenario: Scenario, edge: Edge, channel: Channel) -> None:
        self._channel, self._every = channel, scenario.clock.ticks_between(channel.rate_hz)
        source = f"{edge[0]} to {edge[1]}/network"
        self._loss = generator(scenario.seed, f"{source}/loss")
        self._jitter = generator(scenario.seed, f"{source}/jitter")
        self._spans = _spans(scenario, edge)
        self._arriving = np.full(channel.slowest, -np.inf)  # the newest that arrives at each coming tick
        self._newest = -np.inf

    def draw(self, ticks: Array) -> tuple[Array, Array]:
        """Return whether a newer message arrives at each tick, and the age of the newest."""
        channel, count = self._channel, len(ticks)
        arriving = np.concatenate((self._arriving, np.full(count, -np.inf)))
        is_sent = (ticks % self._every == 0.0) & np.any(
            [(first <= ticks) & (ticks < end) for first, end in self._spans], axis=0
        )
        if channel.loss:
            is_sent &= self._loss.random(count) >= channel.loss
        delays = np.full(count, channel.delay)
        if channel.jitter:
            delays += np.floor(self._jitter.random(count) * (channel.jitter + 1)).astype(int)
        (sent,) = np.nonzero(is_sent)
        np.maximum.at(arriving, sent + delays[sent], ticks[sent])
        newest = np.maximum.accumulate(np.concatenate(([self._newest], arriving[:count])))
        self._arriving, self._newest = arriving[count:], newest[-1]
        return (newest[1:] > newest[:-1]).astype(np.float64), ticks - newest[1:]


def _spans(scenario: Scenario, edge: Edge) -> list[tuple[float, float]]:
    """Return the ticks [first, end) at which the graph has an edge; an arm always hears itself."""
    network, arms, period = scenario.network, list(scenario.cell.arms), scenario.clock.period
    assert network is not None
    if edge[0] == edge[1]:
        return [(0.0, np.inf)]
    times = sorted({0.0, *(change.time for change in network.changes)})
    ends = [*(math.ceil(time / period - EARLY) for time in times), np.inf]
    spans = zip(times, pairwise(ends), strict=True)
    return [span for time, span in spans if edge in network.edges_at(time, arms)] or [(0.0, 0.0)]


class MessageSignals:
    """Source of the timing of a run's messages, drawn in blocks of ticks that follow each other."""

    def __init__(self, scenario: Scenario) -> None:
        """Begin before the first tick of a scenario with a network."""
        network = scenario.network
        assert network is not None
        edges = _all_edges(network, list(scenario.cell.arms))
        self._edges = [_EdgeTiming(scenario, edge, network.channel(edge)) for edge in edges]
        self._tick = 0

    def draw(self, count: int) -> NetworkSignals:
        """Return the timing at the next ticks."""
        ticks = np.arange(self._tick, self._tick + count, dtype=np.float64)
        self._tick += count
        arrived, age = zip(*(edge.draw(ticks) for edge in self._edges), strict=True)
        return NetworkSignals(np.stack(arrived, axis=1), np.stack(age, axis=1))


# ---------------------------------------------------------------- in a run


class Traffic(NamedTuple):
    """What crosses between the arms, a tick on average.

    Attributes:
        numbers: numbers on all edges.
        messages: messages on all edges.
    """

    numbers: float
    messages: float

    @property
    def bytes(self) -> float:
        """Bytes of the numbers, as doubles."""
        return _NUMBER_BYTES * self.numbers

    def summary(self, rate_hz: float) -> str:
        """Return the counts, for people to read, at a control rate, Hz."""
        if not self.messages:
            return "nothing crosses between the arms"
        return (
            f"between the arms cross {self.messages:g} messages, {self.numbers:g} numbers and"
            f" {self.bytes:g} bytes a tick: {1e-3 * self.bytes * rate_hz:.3g} kB/s"
        )


def heard(
    controller: CellController,
    measurements: Sequence[ArmMeasurement],
    references: Sequence[ArmReference],
    state: Any,
    exchange: Callable[[Sequence[Array]], Sequence[Mapping[str, Message] | None]],
) -> list[ArmMeasurement]:
    """Return measurements with the messages of the arms; without any where the law says nothing.

    Args:
        controller: Controller of the cell.
        measurements: Measurements of a tick.
        references: References of a tick.
        state: State of the controller; None before ``init``.
        exchange: Function of the messages of all arms that returns what each hears, by the sender's name.
    """
    messages = controller.messages(measurements, references, state)
    if not any(map(len, messages)):
        return list(measurements)
    pairs = zip(measurements, exchange(messages), strict=True)
    return [measured._replace(messages=received) for measured, received in pairs]


class Exchange:
    """Messages of a run.

    Attributes:
        network: the network; None without one.
        state: memory of the network; None before the first messages.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Begin before the first tick of a scenario."""
        self.network, self._scenario = cell_network(scenario), scenario
        self.state: NetworkState | None = None

    def at_once(self, messages: Sequence[Array]) -> list[dict[str, Message] | None]:
        """Return what each arm hears of messages that arrive at once and exactly; None without a network."""
        if (network := self.network) is None:
            return [None] * len(messages)
        by_sender = dict(zip(network.arms, messages, strict=True))
        return [
            {one: Message(by_sender[one], 0.0) for one, other in network.edges if other == name}
            for name in network.arms
        ]

    def traffic(self, messages: Sequence[Array]) -> Traffic:
        """Return what crosses a tick along the graph of the start; what an arm tells itself does not cross.

        Args:
            messages: Messages of all arms, shape (w_i,) each; none where a law says nothing.
        """
        network, arms = self._scenario.network, list(self._scenario.cell.arms)
        if network is None or not messages:
            return Traffic(0.0, 0.0)
        sizes, edges = dict(zip(arms, map(len, messages), strict=True)), network.edges_at(0.0, arms)
        every = [self._scenario.clock.ticks_between(network.channel(edge).rate_hz) for edge in edges]
        counts = [sizes[sender] / ticks for (sender, _), ticks in zip(edges, every, strict=True)]
        return Traffic(sum(counts), sum(1.0 / ticks for ticks in every) if any(counts) else 0.0)

    def step(
        self, messages: Sequence[Array], signals: NetworkSignals | tuple[()]
    ) -> list[dict[str, Message]]:
        """Return what each arm has heard by a tick.

        Args:
            messages: Messages of all arms of this tick, shape (w_i,) each.
            signals: Timing of this tick.

        Raises:
            ShapeError: an arm says another number of numbers than at the first tick.
        """
        assert self.network is not None
        assert isinstance(signals, NetworkSignals)
        sent = [np.asarray(message, dtype=np.float64) for message in messages]
        for index, (name, message) in enumerate(zip(self.network.arms, sent, strict=True)):
            expected = message.shape[:1] if self.state is None else self.state.sent[index].shape[1:]
            if message.ndim != 1 or message.shape != expected:
                raise ShapeError(f"message of arm {name!r}", message.shape, expected or (1,))
        state = self.network.start(sent) if self.state is None else self.state
        received, self.state = self.network.step(state, sent, signals)
        return received
