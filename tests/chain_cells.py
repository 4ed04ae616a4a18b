"""Test cells for their chains, and torques at random."""

from __future__ import annotations

import numpy as np
from cells import catalogue_cell, cell_and_start, planar_three_arms


def cell_of(name):
    if name == "planar-three":
        scenario = planar_three_arms("adept-paper")
        return scenario.cell, scenario.start.matrix
    return cell_and_start(name) if name in ("planar", "spatial") else catalogue_cell(name)


def random_tau(chain, seed=5):
    return 10.0 * np.random.default_rng(seed).normal(size=chain.model.nv)
