"""Average consensus over a graph of neighbours: its Laplacian, its bounds, and its step from messages."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, as_count, as_positive
from coop_pin.base.errors import FieldError
from coop_pin.control.measurement import Messages

Edges = Collection[tuple[str, str]]
"""Pairs of sender and receiver."""


def laplacian(edges: Edges, names: Sequence[str]) -> Array:
    """Return L of a graph: the number of those that an arm hears, and -1 for each of them, shape (m, m)."""
    adjacency = np.array([[float((one, other) in edges) for one in names] for other in names])
    return np.asarray(np.diag(adjacency.sum(axis=1)) - adjacency)


def consensus_bound(largest: float, delay: int = 0) -> float:
    """Return the gain at which consensus goes unstable: 2 sin(pi / (4 D + 2)) / lambda_m.

    Each mode of the disagreement obeys x[k+1] = x[k] - g lambda x[k-D]. Levin and May (1976).

    Args:
        largest: lambda_m, largest eigenvalue of L.
        delay: D, ticks by which messages are late.

    Raises:
        ArgumentError: one is no such number.
    """
    largest, delay = as_positive("largest", largest), as_count("delay", delay)
    return float(2.0 * np.sin(np.pi / (4 * delay + 2)) / largest)


def graph_eigenvalues(edges: Edges, names: Sequence[str]) -> Array:
    """Return the eigenvalues of L of a connected graph, the least first, shape (m,).

    Raises:
        FieldError: an edge goes one way, or the graph does not connect all.
    """
    L = laplacian(edges, names)
    eigenvalues = np.linalg.eigvalsh((L + L.T) / 2.0)
    if not np.array_equal(L, L.T):
        raise FieldError("has an edge that goes one way; consensus on the mean needs both", "network.graph")
    if eigenvalues[1] < 0.5 / len(names) ** 2:  # of a connected graph at least 4 / m^2
        raise FieldError("does not connect all arms; then they come to no common mean", "network.graph")
    return np.asarray(eigenvalues)


def require_consensus(network: Any, names: Sequence[str], gain: float, path: str) -> None:
    """Refuse the graph of a network, or a gain on it, for consensus on the mean.

    Args:
        network: Network of the scenario.
        names: Names of the arms.
        gain: g.
        path: Path of the gain, for errors.

    Raises:
        FieldError: as ``graph_eigenvalues``, or the gain is not below ``consensus_bound``.
    """
    edges, delay = network.edges_at(0.0, names), network.slowest_of(names)
    bound = consensus_bound(float(graph_eigenvalues(edges, names)[-1]), delay)
    if gain >= bound:
        detail = f"is {gain:g}; with this graph and messages {delay} ticks late it must be less than"
        raise FieldError(f"{detail} {bound:.4g}", path)


def disagreement(name: str, messages: Messages) -> Any:
    """Return sum_j (x_i - x_j) over the neighbours j of an arm i, all as they were sent.

    Args:
        name: Name of the arm i, whose own message is among those.
        messages: x of each arm.
    """
    mine, others = messages[name], [message for one, message in messages.items() if one != name]
    terms: Iterable[Any] = [
        np.where(mine.age + other.age < np.inf, mine.numbers - other.numbers, 0.0) for other in others
    ]
    return reduce(add, terms)


ANY_AGE = float(np.finfo(float).max)
"""Age of the oldest message that arrived at all, ticks."""


def mean_received(messages: Messages, fallback: Array, oldest: float = ANY_AGE) -> Array:
    """Return the mean of messages, the own as sent among them.

    Args:
        messages: Messages of all arms.
        fallback: Numbers in its place before any arrived, shape (n,).
        oldest: Largest age of a message in the mean, ticks.
    """
    weights = [np.where(one.age <= oldest, 1.0, 0.0) for one in messages.values()]
    parts = [w * one.numbers for w, one in zip(weights, messages.values(), strict=True)]
    total = reduce(add, weights)
    alone = total < 0.5
    return np.where(alone, fallback, reduce(add, parts) / np.where(alone, 1.0, total))
