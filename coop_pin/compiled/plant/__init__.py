"""Compiled plant: dynamics of a cell as scalar code, with the numbers of its Pinocchio tree.

Open first: ``cell_dynamics`` (closures and forces on the payload), ``serial_arm`` (kinematics of an arm;
``arm_dynamics`` its forces), ``compiled_plant`` (the plant of a single run).

``cell_numbers`` has the constants, ``plant_code`` joins all into a Runge-Kutta step and an observation. The
plant on Pinocchio is ``simulation/plant``; tests hold the two together.

Imports what ``compiled`` imports.
"""
