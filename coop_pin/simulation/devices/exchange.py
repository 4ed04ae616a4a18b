"""Exchange of messages in a run, and what crosses between the arms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.errors import ShapeError
from coop_pin.control import ArmMeasurement, ArmReference, CellController, Message
from coop_pin.control.measurement import Outgoing, Sent, SentIf
from coop_pin.description.scenario import Scenario
from coop_pin.simulation.devices.network import (
    NUMBER_BYTES,
    Mail,
    NetworkSignals,
    NetworkState,
    cell_network,
    said,
)


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
        return NUMBER_BYTES * self.numbers

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
    exchange: Callable[[Sequence[Outgoing]], Sequence[Mail]],
) -> list[ArmMeasurement]:
    """Return measurements with the messages of the arms; without any where the law says nothing.

    Args:
        controller: Controller of the cell.
        measurements: Measurements of a tick.
        references: References of a tick.
        state: State of the controller; None before ``init``.
        exchange: Function of the messages of all arms that returns the mail of each.
    """
    messages = controller.messages(measurements, references, state)
    if not any(message is None or len(said(message).numbers) for message in messages):
        return [measured._replace(sent=Sent(0, 0)) for measured in measurements]
    pairs = zip(measurements, exchange(messages), strict=True)
    return [measured._replace(messages=mail.received, sent=mail.sent) for measured, mail in pairs]


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

    def at_once(self, messages: Sequence[Outgoing]) -> list[Mail]:
        """Return what each arm hears of messages that arrive at once and exactly; nothing without a network.

        Args:
            messages: Messages of all arms; one on a condition is sent.
        """
        if (network := self.network) is None:
            return [Mail(None)] * len(messages)
        by_sender = {
            name: Message(said(message).numbers, np.inf if message is None else 0.0)
            for name, message in zip(network.arms, messages, strict=True)
        }
        return [
            Mail({one: by_sender[one] for one, other in network.edges if other == name})
            for name in network.arms
        ]

    def traffic(self, messages: Sequence[Outgoing]) -> Traffic:
        """Return what crosses a tick along the graph of the start; what an arm tells itself does not cross.

        Args:
            messages: Messages of all arms, shape (w_i,) each; none where a law says nothing. They count as
                sent at every tick at which they may be.
        """
        network, arms = self._scenario.network, list(self._scenario.cell.arms)
        if network is None or not messages:
            return Traffic(0.0, 0.0)
        sizes = {name: len(said(each).numbers) for name, each in zip(arms, messages, strict=True)}
        edges = network.edges_at(0.0, arms)
        every = [self._scenario.clock.ticks_between(network.channel(edge).rate_hz) for edge in edges]
        counts = [sizes[sender] / ticks for (sender, _), ticks in zip(edges, every, strict=True)]
        return Traffic(sum(counts), sum(1.0 / ticks for ticks in every) if any(counts) else 0.0)

    def step(self, messages: Sequence[Outgoing], signals: NetworkSignals | tuple[()]) -> list[Mail]:
        """Return the mail of each arm at a tick.

        Args:
            messages: Messages of all arms of this tick, shape (w_i,) each.
            signals: Timing of this tick.

        Raises:
            ShapeError: an arm says another number of numbers than in its first message.
            FieldError: a threshold has another number of numbers.
        """
        assert self.network is not None
        assert isinstance(signals, NetworkSignals)
        earlier = [None] * len(messages) if self.state is None else self.state.said
        sent = list[SentIf]()
        for name, message, now in zip(self.network.arms, messages, earlier, strict=True):
            numbers, condition = said(message, now)
            sent.append(SentIf(np.asarray(numbers, dtype=np.float64), bool(condition)))
            expected = now.shape[1:] if now is not None and now.size else np.shape(numbers)[:1]
            if sent[-1].numbers.shape != expected:
                raise ShapeError(f"message of arm {name!r}", np.shape(numbers), expected or (1,))
        mail, self.state = self.network.step(self._sized(sent), sent, signals)
        return mail

    def _sized(self, sent: Sequence[SentIf]) -> NetworkState:
        """Return the memory of the network, sized by the first messages of the arms.

        Args:
            sent: Messages of this tick.
        """
        assert self.network is not None
        if self.state is None:
            return self.network.start(sent)
        if all(len(one.numbers) == now.shape[1] for one, now in zip(sent, self.state.said, strict=True)):
            return self.state
        first, (said_before, edges) = self.network.start(sent), self.state
        new = [now if now.size else fresh for fresh, now in zip(first.said, said_before, strict=True)]
        return NetworkState(
            tuple(new),
            tuple(edge if edge.heard.size else fresh for fresh, edge in zip(first.edges, edges, strict=True)),
        )
