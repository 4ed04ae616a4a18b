"""Random sources of a simulation: one generator for each, derived from the scenario's seed by its name."""

from __future__ import annotations

import hashlib

import numpy as np


def generator(seed: int, source: str) -> np.random.Generator:
    """Return the random generator of a source, independent of those of all other names and seeds.

    Adding a source does not change what another one draws.

    Args:
        seed: of the scenario, not negative.
        source: its name, for example "left/encoder".
    """
    name = int.from_bytes(hashlib.sha256(source.encode()).digest()[:16], "big")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence((seed, name))))
