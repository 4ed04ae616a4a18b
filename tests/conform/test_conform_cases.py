"""The closed forms of ``coop-pin conform``, without any engine: one linear system of bodies and grasps."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import block_diag

CONFORM = Path(__file__).parents[2] / "benchmarks" / "conform"


@pytest.fixture(scope="module")
def cases():
    """The cases, as the command loads them."""
    sys.path.insert(0, str(CONFORM))
    yield importlib.import_module("cases").all_cases()
    sys.path.remove(str(CONFORM))


def cross(r):
    return np.array(((0, -r[2], r[1]), (r[2], 0, -r[0]), (-r[1], r[0], 0)))


def skew_at(r):
    """Twist of a point of a body at r from its origin, by that of the body."""
    return np.block([[np.eye(3), -cross(r)], [np.zeros((3, 3)), np.eye(3)]])


def rows_of(hand):
    """What a grasp holds, in axes of the grasp frame."""
    return np.eye(6)[: 5 if hand.grasp == "hinge" else 6]


def solved(case):
    """Wrenches on the payload about P, and rows of them that grasps and guides determine.

    In the unknowns a (six for each hand, six for the payload) and lambda, with M a = F + G^T lambda and
    G a = -gamma. Cases with springs are at rest: displacements in place of accelerations, stiffness in place
    of M, and no gamma.
    """
    n, resting = len(case.hands), any(np.any(hand.stiffness) for hand in case.hands)
    omega = np.array((0.0, 0.0, case.spin))
    blocks, forces, G, gamma = [], [], [], []
    for k, hand in enumerate(case.hands):
        weight = np.concatenate((hand.mass * np.array(case.gravity), np.zeros(3)))
        u = np.zeros(6)
        u[list(hand.guides)] = hand.force(np.zeros(len(hand.guides)), np.zeros(len(hand.guides)))
        M = np.diag((*(hand.mass,) * 3, *hand.inertia))
        blocks.append(np.diag(hand.stiffness) if resting else M)
        forces.append(u + weight)
        for axis in set(range(6)) - set(hand.guides):  # guides that stand
            row = np.zeros((1, 6 * n + 6))
            row[0, 6 * k + axis] = 1.0
            G.append(row)
            gamma.append([0.0])
        turn = np.kron(np.eye(2), hand.rotation.T)
        row = np.zeros((6, 6 * n + 6))
        row[:, 6 * k : 6 * k + 6] = -turn
        row[:, 6 * n :] = turn @ skew_at(np.array(hand.tip))
        centripetal = np.cross(omega, np.cross(omega, hand.tip))
        # In world axes a hand accelerates as its tip of the payload: omega x (omega x r) is of the payload's.
        G.append(rows_of(hand) @ row)
        gamma.append(rows_of(hand) @ turn @ np.concatenate((centripetal, np.zeros(3))))
    blocks.append(np.zeros((6, 6)) if resting else np.diag((*(case.mass,) * 3, *case.inertia)))
    forces.append(np.concatenate((case.mass * np.array(case.gravity), np.zeros(3))))
    rows, M, F = np.concatenate(G), block_diag(*blocks), np.concatenate(forces)
    give = np.zeros((len(rows), len(rows)))
    at = 0
    for hand in case.hands:
        at += 6 - len(hand.guides)
        count = len(rows_of(hand))
        if hand.grasp == "spring":
            give[at : at + count, at : at + count] = np.diag(1.0 / np.array(hand.spring))
        at += count
    kkt = np.block([[M, -rows.T], [rows, give]])
    x = np.linalg.lstsq(kkt, np.concatenate((F, -np.concatenate(gamma))), rcond=1e-13)[0]
    assert_allclose(kkt @ x, np.concatenate((F, -np.concatenate(gamma))), atol=1e-9)
    free = np.linalg.svd(kkt)
    null = free[2][free[1] < 1e-10 * free[1][0]]
    wrenches, blind, at = [], [], 0
    for hand in case.hands:
        at += 6 - len(hand.guides)
        count = len(rows_of(hand))
        part = slice(len(M) + at, len(M) + at + count)
        to_P = (rows_of(hand) @ np.kron(np.eye(2), hand.rotation.T) @ skew_at(np.array(hand.tip))).T
        wrenches.append(to_P @ x[part])
        blind.append(np.abs(to_P @ null[:, part].T).max(axis=1, initial=0.0))
        at += count
    return np.array(wrenches), np.max(blind, axis=0) < 1e-9


def test_closed_forms_are_those_of_one_linear_system(cases):
    assert len(cases) == 24
    for case in cases:
        wrenches, determined = solved(case)
        compared = [*case.compared]
        assert determined[compared].all(), case.label
        inner, expected = (each - each.mean(axis=0) for each in (wrenches, case.wrenches))
        assert_allclose(inner[:, compared], expected[:, compared], rtol=0, atol=1e-9, err_msg=case.label)
        assert np.allclose(case.errors(wrenches), 0.0, atol=1e-9), case.label
