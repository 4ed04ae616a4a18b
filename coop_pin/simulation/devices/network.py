"""Network of a run: messages between arms, delayed, lost, rounded, kept back where nothing changed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, frozen
from coop_pin.base.errors import FieldError, ShapeError
from coop_pin.base.spatial.generic_numbers import known, where
from coop_pin.control import Message
from coop_pin.control.measurement import Outgoing, Sent, SentIf
from coop_pin.description.network import Channel, Edge, Network
from coop_pin.description.scenario import Scenario
from coop_pin.simulation.devices.signals import EARLY, generator

NUMBER_BYTES = 8
"""Bytes of a number of a message, as a double."""


class NetworkSignals(NamedTuple):
    """Timing of the messages on each edge at n ticks, or without the first axis at one.

    Attributes:
        due: whether one may be sent, by rate and graph, masks, shape (n, edges).
        arrives: whether that of 0, 1, ... D ticks ago arrives if it was sent, masks, shape (n, edges, D + 1).
    """

    due: Array
    arrives: Array

    def ticks(self) -> Iterator[NetworkSignals]:
        """Return the timing of one tick after the other."""
        return map(NetworkSignals, self.due.tolist(), self.arrives.tolist())


class EdgeState(NamedTuple):
    """Memory of an edge; what counts ticks or messages is an integer, which has no derivative.

    Attributes:
        went: 1 where a message was sent and 0 elsewhere, over the last D + 1 ticks, the newest first.
        last: message sent last, inf before the first, shape (w_sender,); empty without a threshold.
        quiet: ticks since then.
        heard: message that the receiver holds, shape (w_sender,).
        age: ticks since that was sent, inf before the first.
        count: number of messages sent.
    """

    went: tuple[Any, ...]
    last: Array
    quiet: Any
    heard: Array
    age: Any
    count: Any


class NetworkState(NamedTuple):
    """Memory of a network.

    Attributes:
        said: messages of each arm over the last ticks, the newest first, shape (D + 1, w_i) each.
        edges: memory of each edge.
    """

    said: tuple[Array, ...]
    edges: tuple[EdgeState, ...]


class Mail(NamedTuple):
    """Messages of an arm at a tick.

    Attributes:
        received: latest message of each arm that it hears, by the sender's name; None without a network.
        sent: messages and bytes that it has sent since the start; None where nobody counts.
    """

    received: dict[str, Message] | None
    sent: Sent | None = None


class CellNetwork(NamedTuple):
    """Edges between arms, each of which holds the newest message that has arrived.

    A message is sent on an edge at a tick if it is due, the law has something to say, and a number differs
    from the last one sent by the threshold, or the edge was silent for too long.

    Attributes:
        arms: names of the arms.
        edges: sender and receiver of each edge; of each arm one to itself.
        resolution: step of the numbers on each edge, 0 for none, shape (edges,).
        thresholds: change at which a message is sent on each edge, shape (1,) or (w_sender,) each.
        silence: ticks after which one is sent on each edge in any case.
        ages: 0 to D, the ages at which a message may arrive, ticks.
    """

    arms: tuple[str, ...]
    edges: tuple[Edge, ...]
    resolution: Array
    thresholds: tuple[Array, ...]
    silence: tuple[float, ...]
    ages: tuple[int, ...]

    def start(self, messages: Sequence[Outgoing]) -> NetworkState:
        """Return the state before the first tick, with messages of the sizes of those of the arms.

        Raises:
            FieldError: a threshold has neither one number nor as many as a message.
        """
        sizes = {name: len(said(each).numbers) for name, each in zip(self.arms, messages, strict=True)}
        went, edges = (0,) * len(self.ages), list[EdgeState]()
        for (sender, _), threshold in zip(self.edges, self.thresholds, strict=True):
            if len(threshold) not in (1, size := sizes[sender]) and size:
                detail = f"has {len(threshold)} numbers, but the messages of {sender!r} have {size}"
                raise FieldError(detail, "network.threshold")
            last = np.full(0 if _is_zero(threshold) else size, np.inf)
            edges.append(EdgeState(went, last, 0, np.zeros(size), np.inf, 0))
        return NetworkState(tuple(np.zeros((len(self.ages), n)) for n in sizes.values()), tuple(edges))

    def step(
        self, state: NetworkState, messages: Sequence[Outgoing], signals: NetworkSignals
    ) -> tuple[list[Mail], NetworkState]:
        """Return the mail of each arm, and the state.

        Args:
            state: State after the tick before.
            messages: Messages of all arms of this tick, shape (w_i,) each.
            signals: Timing of this tick.
        """
        news = [said(message, now) for message, now in zip(messages, state.said, strict=True)]
        kept = tuple(
            np.concatenate((each.numbers[None], earlier[:-1]))
            for each, earlier in zip(news, state.said, strict=True)
        )
        received: dict[str, dict[str, Message]] = {name: {} for name in self.arms}
        edges, counts = list[EdgeState](), dict.fromkeys(self.arms, 0)
        for index, (sender, receiver) in enumerate(self.edges):
            arm = self.arms.index(sender)
            edge = self._crossed(state.edges[index], index, kept[arm], news[arm].condition, signals)
            edges.append(edge)
            received[receiver][sender] = Message(frozen(edge.heard), edge.age + 0.0)
            if sender != receiver:
                counts[sender] = counts[sender] + edge.count
        mail = list[Mail]()
        for (name, count), said_now in zip(counts.items(), kept, strict=True):
            mail.append(Mail(received[name], Sent(count, NUMBER_BYTES * said_now.shape[1] * count)))
        return mail, NetworkState(kept, tuple(edges))

    def _crossed(
        self, edge: EdgeState, index: int, said: Array, condition: Any, signals: NetworkSignals
    ) -> EdgeState:
        """Return the memory of an edge after a tick.

        Args:
            edge: Memory before.
            index: Index of the edge.
            said: Messages of the sender over the last ticks, the newest first, shape (D + 1, w_sender).
            condition: Whether it says the newest.
            signals: Timing of this tick.
        """
        threshold, quiet, last = self.thresholds[index], edge.quiet, edge.last
        is_sent = (signals.due[index] > 0.5) & condition
        if not _is_zero(threshold):
            is_sent &= _differs(said[0], last, threshold) | (quiet + 1 >= self.silence[index])
            last, quiet = where(is_sent, said[0], last), where(is_sent, 0, quiet + 1)
        went = (where(is_sent, 1, 0), *edge.went[:-1])
        heard, age = edge.heard, edge.age + 1
        for possible, message, gone, arrives in zip(
            self.ages, said, went, signals.arrives[index], strict=True
        ):
            is_newer = possible == 0 or possible < age
            is_this = (arrives > 0.5) & (gone > 0.5) & is_newer
            heard = where(is_this, _rounded(message, self.resolution[index]), heard)
            age = where(is_this, possible, age)
        return EdgeState(went, last, quiet, heard, age, edge.count + went[0])


def said(message: Outgoing, now: Array | None = None) -> SentIf:
    """Return what an arm says with its condition; for nothing the numbers of the tick before, if any.

    Args:
        message: Message of the arm.
        now: Messages over the last ticks, the newest first, shape (D + 1, w).

    Raises:
        ShapeError: the message is no array.
    """
    if message is None:
        return SentIf(np.zeros(0) if now is None else now[0], False)
    this = message if isinstance(message, SentIf) else SentIf(message, True)
    if not hasattr(this.numbers, "__len__"):
        raise ShapeError("message", np.shape(this.numbers), (1,))
    return this


def _is_zero(threshold: Array) -> bool:
    """Return whether a threshold is known to be zero, so that all is sent."""
    return known(np.logical_not(np.any(threshold > 0.0)))


def _differs(numbers: Array, last: Array, threshold: Array) -> Any:
    """Return whether a number differs from the last one sent by the threshold."""
    differs = np.any(np.abs(numbers - last) >= threshold)
    return bool(differs) if isinstance(differs, np.bool_) else differs


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
    return CellNetwork(
        arms,
        edges,
        np.array([channel.resolution for channel in channels]),
        tuple(np.atleast_1d(np.array(channel.threshold)) for channel in channels),
        tuple(channel.longest_silence(scenario.clock) for channel in channels),
        _ages(channels),
    )


def _ages(channels: Sequence[Channel]) -> tuple[int, ...]:
    """Return the ages at which a message may arrive, ticks."""
    return tuple(range(1 + max(channel.slowest for channel in channels)))


def _all_edges(network: Network, arms: Sequence[str]) -> tuple[Edge, ...]:
    """Return all edges, and those of the arms to themselves, by sender in the order of the arms."""
    present = {*network.edges(arms), *((name, name) for name in arms)}
    return tuple((one, other) for one in arms for other in arms if (one, other) in present)


# ---------------------------------------------------------------- timing


class _EdgeTiming:
    """Timing of the messages of one edge, drawn in blocks of ticks that follow each other."""

    def __init__(self, scenario: Scenario, edge: Edge, channel: Channel, ages: int) -> None:
        self._channel, self._every = channel, scenario.clock.ticks_between(channel.rate_hz)
        source = f"{edge[0]} to {edge[1]}/network"
        self._loss = generator(scenario.seed, f"{source}/loss")
        self._jitter = generator(scenario.seed, f"{source}/jitter")
        self._spans = _spans(scenario, edge)
        self._coming = np.zeros((channel.slowest, ages))  # what arrives at the coming ticks

    def draw(self, ticks: Array) -> tuple[Array, Array]:
        """Return whether a message is due at each tick, and which of the last ones arrive."""
        channel, count = self._channel, len(ticks)
        arrives = np.concatenate((self._coming, np.zeros((count, self._coming.shape[1]))))
        due = (ticks % self._every == 0.0) & np.any(
            [(first <= ticks) & (ticks < end) for first, end in self._spans], axis=0
        )
        is_kept = due & (self._loss.random(count) >= channel.loss) if channel.loss else due
        delays = np.full(count, channel.delay)
        if channel.jitter:
            delays += np.floor(self._jitter.random(count) * (channel.jitter + 1)).astype(int)
        (sent,) = np.nonzero(is_kept)
        arrives[sent + delays[sent], delays[sent]] = 1.0
        self._coming = arrives[count:]
        return due.astype(np.float64), arrives[:count]


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
        channels = [network.channel(edge) for edge in edges]
        ages = len(_ages(channels))
        self._edges = [_EdgeTiming(scenario, *each, ages) for each in zip(edges, channels, strict=True)]
        self._tick = 0

    def draw(self, count: int) -> NetworkSignals:
        """Return the timing at the next ticks."""
        ticks = np.arange(self._tick, self._tick + count, dtype=np.float64)
        self._tick += count
        parts = zip(*(edge.draw(ticks) for edge in self._edges), strict=True)
        return NetworkSignals(*(np.stack(part, axis=1) for part in parts))
