"""The verdict on a run: what breaches a trust threshold is found, with its first time, on planar and spatial cells."""

import json

import numpy as np
import pytest
from cells import SCENARIOS, planar_scenario, spatial_scenario

import coop_pin as cp
from coop_pin.cli import main
from coop_pin.errors import ArgumentError, DivergedError, OutOfRangeError
from coop_pin.results import Window
from coop_pin.results.metrics import STEADY_METRICS

PAST_STRETCH = {  # 0.8 m from the left base is as far as the arm reaches
    "motion": {
        "kind": "line",
        "start": {"xyz": [0.6, 0.146, 0.0], "rpy": [0, 0, 0.947]},
        "goal": {"xyz": [0.95, 0.146, 0.0], "rpy": [0, 0, 0.947]},
        "duration": 2.0,
    },
    "events": [],
    "duration": 3.0,
}
