"""Runs of compiled code in each of its ways, whatever the choice of the engine: tests compare them."""

from coop_pin import simulate
from coop_pin.compiled import Lane, plant_of
from coop_pin.laws import build_controller


def run_on(engine, scenario, **options):
    """The run on the plant of an engine, under the law as Python."""
    return simulate(scenario, build_controller(scenario), plant=plant_of(engine), **options)


def run_as_lane(scenario, **options):
    """The run as compiled code of plant, sensors, law and drives."""
    return Lane(scenario).run(**options)


WAYS = {
    "pinocchio": lambda scenario: run_on("pinocchio", scenario),
    "plant": lambda scenario: run_on("compiled", scenario),
    "lanes": run_as_lane,
}
"""Functions of a scenario that return its run, by the way in which it is computed."""
