"""Bounds that sampling puts on gains."""

from __future__ import annotations


def force_gain_bound(pole: float) -> float:
    """Return the force gain K_f at which sampled internal-force feedback goes unstable: (1 + p) / (1 - p).

    In a rigid chain f is an algebraic function of the torque: f[k] = c - K_f ftilde_m[k] while the torque of tick k
    acts. Through the filter f_m[k+1] = p f_m[k] + (1 - p) f[k] the error obeys
    ftilde_m[k+1] = (p - (1 - p) K_f) ftilde_m[k] + const, which is stable for K_f < (1 + p) / (1 - p).
    p = 0 is the wrench of one tick before: K_f < 1.

    Args:
        pole: p of the filter, in [0, 1).
    """
    return (1.0 + pole) / (1.0 - pole)
