"""coop_pin: the same cell on its plant by MuJoCo."""

from engines.coop_pin_cell import RATE, STEPS, CoopPin

import coop_pin as cp
from coop_pin.model.mujoco_model import mujoco_module
from coop_pin.simulation.mujoco_plant import MujocoPlant


class CoopPinMujoco(CoopPin):
    """Cell whose grasps are soft welds."""

    name = f"coop_pin {cp.__version__}, engine mujoco"
    settings = f"RK4, {1 / RATE / STEPS:g} s, torques held over {1 / RATE:g} s; plant.mujoco as shipped"
    plant = MujocoPlant

    def __init__(self) -> None:
        mujoco_module()
