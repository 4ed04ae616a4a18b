"""Compiled plant: kinematics and dynamics of a cell as scalar code, and the plant of a single run."""
