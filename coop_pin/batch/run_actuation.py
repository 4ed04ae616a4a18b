"""Actuators of the runs of a block as traced code: see coop_pin.description.actuators for the equations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coop_pin.batch.arm_dynamics import newton_euler
from coop_pin.batch.run_block import RunBlock
from coop_pin.batch.run_constants import RunConstants
from coop_pin.batch.serial_arm import Numbers
from coop_pin.simulation.actuation import TorqueResponse
from coop_pin.tracing.kernel import Kernel
from coop_pin.tracing.traced_array import traced

_RESPONSE = ("target", "sign", "ramp", "rest")
"""Fields of a TorqueResponse that change."""


class RunActuation:
    """Actuators of a block."""

    def __init__(self, block: RunBlock) -> None:
        self._block, self._shape = block, block.shape

    def actuate(self, kernel: Kernel, constants: RunConstants, commanded: Sequence[Numbers]) -> None:
        """Write what the drives make of commands: see coop_pin.description.actuators."""
        split, missed = self._block.split, self._block.signal(kernel, "missed")
        q, last = split(kernel.read("q")), split(kernel.read("last"))
        arrived, requested = list(commanded), []
        for index, (arm, body) in enumerate(zip(constants.arms, constants.cell.arms, strict=True)):
            if self._shape.misses[index]:
                arrived[index] = np.where(missed[index], last[index], commanded[index])
            asked = arrived[index]
            if arm.carried is not None:
                rest = np.zeros(len(q[index]))
                weight, *_ = newton_euler(body, constants.cell.gravity, q[index], rest, rest)
                asked = asked + arm.carried * arm.to_joints.T.dot(traced(weight))
            requested.append(asked)
        torques = [
            np.minimum(np.maximum(asked, -arm.limit), arm.limit)
            for arm, asked in zip(constants.arms, requested, strict=True)
        ]
        saturated = np.concatenate(
            [np.not_equal(torque, asked) for torque, asked in zip(torques, requested, strict=True)]
        )
        if constants.response is not None:
            response = self.response(kernel, constants.response)
            response = response.follow(kernel.uniform("s"), traced(np.concatenate(torques)))
            saturated = np.maximum(saturated, response.is_limited(constants.period))
            kernel.write("response", np.stack([getattr(response, name) for name in _RESPONSE]))
            torques = self.acting(kernel, response.at(0.0))
        if any(self._shape.misses):
            kernel.write("last", np.concatenate(arrived))
        if any(arm.carried is not None for arm in constants.arms):
            kernel.write("requested", np.concatenate(requested))
        kernel.write("torque", np.concatenate(torques))
        kernel.write("saturated", saturated)
        self.hold(kernel, constants, torques)

    def response(self, kernel: Kernel, start: TorqueResponse) -> TorqueResponse:
        """Return the response of the drives as it is."""
        return start._replace(**dict(zip(_RESPONSE, kernel.read("response"), strict=True)))

    def acting(self, kernel: Kernel, torques: Numbers) -> list[Numbers]:
        """Return the torques of each arm, zero where they are lost."""
        parts = zip(kernel.uniform("gives"), self._block.split(torques), strict=True)
        return [gives * torque for gives, torque in parts]

    def hold(self, kernel: Kernel, constants: RunConstants, torques: Sequence[Numbers]) -> None:
        """Write the generalised force of drive torques."""
        forces = [arm.drive.T.dot(torque) for arm, torque in zip(constants.arms, torques, strict=True)]
        kernel.write("force", np.concatenate(forces))
