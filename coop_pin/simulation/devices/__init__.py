"""Devices of a cell: sensors, drives, servos and network, as frozen numbers and pure functions of a tick."""
