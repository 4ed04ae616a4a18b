"""Consensus over a graph: how arms that hear their neighbours only come to the mean of all."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import reduce
from operator import add
from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.control.interface import Message
from coop_pin.errors import FieldError

Edges = Collection[tuple[str, str]]
"""Pairs of sender and receiver."""
_AT_REST = 1e-9
"""Distance from 1 of a factor that counts as it: of an integral without an anchor."""


def laplacian(edges: Edges, names: Sequence[str]) -> Array:
    """Return L of a graph: the number of those that an arm hears, and -1 for each of them, shape (m, m)."""
    heard = np.array([[float((one, other) in edges) for one in names] for other in names])
    return np.asarray(np.diag(heard.sum(axis=1)) - heard)


def consensus_bound(largest: float, delay: int = 0) -> float:
    """Return the gain at which consensus goes unstable: 2 sin(pi / (4 D + 2)) / lambda_m.

    Each mode of the disagreement obeys x[k+1] = x[k] - g lambda x[k-D]. Levin and May (1976).

    Args:
        largest: lambda_m, largest eigenvalue of L.
        delay: D, ticks by which messages are late.
    """
    return float(2.0 * np.sin(np.pi / (4 * delay + 2)) / largest)


class MeanGains(NamedTuple):
    """Gains of proportional-integral average consensus, and the delay of its messages.

    Attributes:
        input_gain: gamma.
        proportional_gain: k_P.
        integral_gain: k_I.
        delay: D, ticks by which messages are late.
    """

    input_gain: float
    proportional_gain: float
    integral_gain: float
    delay: int = 0

    def modes(self, eigenvalue: float) -> Array:
        """Return the polynomial of a mode of the disagreement, times z^2D.

        (z - 1 + gamma + k_P lambda z^-D)(z - 1) + (k_I lambda z^-D)^2, of Freeman, Yang and Lynch (2006) in
        discrete time.
        """
        late, step = np.append(1.0, np.zeros(self.delay)), np.array([1.0, -1.0])
        alone = np.polymul(np.polymul([1.0, self.input_gain - 1.0], step), np.polymul(late, late))
        told = self.proportional_gain * eigenvalue * np.polymul(step, late)
        return np.polyadd(np.polyadd(alone, told), [(self.integral_gain * eigenvalue) ** 2])


def estimator_radius(eigenvalues: Array, gains: MeanGains) -> float:
    """Return the largest ``|z|`` of average consensus, by which it converges in a tick.

    That of the mean is 1 - gamma.

    Args:
        eigenvalues: lambda of the graph's L, the first of them 0, shape (m,).
        gains: Gains.
    """
    sizes = [np.abs(np.roots(gains.modes(eigenvalue))).max() for eigenvalue in eigenvalues[1:]]
    return float(max([abs(1.0 - gains.input_gain), *sizes]))


def averaged_loop_radius(
    eigenvalues: Array, gains: MeanGains, *, anchor_gain: float, force_gain: float = 0.0, delay: int = 0
) -> float:
    """Return the largest ``|z|`` of anchor and force feedback on internal wrenches by average consensus.

    f = F - c m nu is the own wrench but for what nu follows of it, H = gamma (z - 1) z^2D / modes(z), with
    equal shares c m = 1. With Z[k] = Z[k-1] - g f_m[k] and a wrist that is late by ``delay`` ticks::

        (z - 1) z^(delay + 1) + (g z + K_f (z - 1)) (1 - H(z)) = 0

    Args:
        eigenvalues: lambda of the graph's L, the first of them 0, shape (m,).
        gains: Gains of the consensus.
        anchor_gain: g.
        force_gain: K_f.
        delay: Ticks by which the wrist is late.
    """
    step, sizes = np.array([1.0, -1.0]), [0.0]
    path = np.append(step, np.zeros(delay + 1))
    feedback = np.array([anchor_gain + force_gain, -force_gain])
    followed = gains.input_gain * np.append(step, np.zeros(2 * gains.delay))
    for eigenvalue in eigenvalues[1:]:
        modes = gains.modes(eigenvalue)
        fed_back = np.polymul(feedback, np.polysub(modes, followed))
        z = np.roots(np.polyadd(np.polymul(path, modes), fed_back))
        sizes.append(float(np.abs(z[np.abs(z - 1.0) > _AT_REST]).max(initial=0.0)))
    return max(sizes)


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


def require_consensus(edges: Edges, names: Sequence[str], gain: float, delay: int, path: str) -> None:
    """Refuse a graph, or a gain on it, for consensus on the mean.

    Args:
        edges: Edges.
        names: Names of the arms.
        gain: g.
        delay: Ticks by which messages are late.
        path: Path of the gain, for errors.

    Raises:
        FieldError: as ``graph_eigenvalues``, or the gain is not below ``consensus_bound``.
    """
    bound = consensus_bound(float(graph_eigenvalues(edges, names)[-1]), delay)
    if gain >= bound:
        detail = f"is {gain:g}; with this graph and messages {delay} ticks late it must be less than"
        raise FieldError(f"{detail} {bound:.4g}", path)


def disagreement(name: str, heard: Mapping[str, Message]) -> Any:
    """Return sum_j (x_i - x_j) over the neighbours that were heard, all as they were sent.

    Args:
        name: Name of the arm, whose own message is among those heard.
        heard: Messages by name.
    """
    mine, others = heard[name], [message for one, message in heard.items() if one != name]
    terms: Iterable[Any] = [
        np.where(mine.age + other.age < np.inf, mine.numbers - other.numbers, 0.0) for other in others
    ]
    return reduce(add, terms)
