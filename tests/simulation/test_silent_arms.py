"""Arms that may have nothing to say: what is sent, held and counted, against networks stepped by hand."""

import copy

import numpy as np
import pytest
from batches import require_same_samples
from cells import ANCHORED, SCENARIOS
from network_cells import BIASED, CELLS, samples
from numpy.testing import assert_allclose, assert_array_equal

import coop_pin as cp
from coop_pin.base.errors import CoopPinError, FieldError, ScenarioError, ShapeError, TracingError
from coop_pin.control.force_paths.exchanged_wrench import ExchangedWrench
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.devices.network import MessageSignals, cell_network

LATE = {"delay": 1, "jitter": 2, "loss": 0.2}


def told(name, **fields):
    """A cell whose arms tell each other their wrists' wrenches, the first arm's tip 1 mm off."""
    of, cell = CELLS[name]
    scenario, law = of(cell)
    stated = {"controller": law.model_dump() | {"force_path": {"kind": "messages"}}, "beyond_bound": True}
    stated |= {"sensors.wrist": {"noise": {"force": 0.2}}, "network": {}}
    arm = next(iter(scenario.cell.arms))
    return scenario.override(stated | {BIASED.format(arm): [1e-3, 0.0, 0.0]}).override(fields)


# ---------------------------------------------------------------- what is sent and held


def by_hand(scenario, said, timing):
    """What each edge holds, its age and what was sent on it, tick by tick, by a queue for every edge.

    ``said`` has the messages of each arm, None where it has nothing to say.
    """
    arms, network, clock = list(scenario.cell.arms), scenario.network, scenario.clock
    flights = {edge: [] for edge in cell_network(scenario).edges}
    last, held, counts = {}, {}, dict.fromkeys(flights, 0)
    history = []
    for tick in range(len(said)):
        for index, (sender, receiver) in enumerate(flights):
            channel, message = network.channel((sender, receiver)), said[tick][arms.index(sender)]
            every = clock.ticks_between(channel.rate_hz)
            if message is not None and tick % every == 0:
                before = last.get((sender, receiver))
                changed = before is None or any(
                    abs(a - b) >= c
                    for a, b, c in zip(
                        message, before[1], np.broadcast_to(channel.threshold, len(message)), strict=True
                    )
                )
                quiet = channel.least_rate_hz and before and (tick - before[0])
                if changed or (quiet and quiet >= clock.ticks_between(channel.least_rate_hz)):
                    last[sender, receiver] = tick, message
                    counts[sender, receiver] += 1
                    for late in range(channel.slowest + 1):
                        if tick + late < len(said) and timing.arrives[tick + late, index, late]:
                            flights[sender, receiver].append((tick + late, tick, message))
            for arrival, sent, message in flights[sender, receiver]:
                if arrival == tick and sent > held.get((sender, receiver), (-1,))[0]:
                    held[sender, receiver] = sent, message
        history.append((dict(held), dict(counts)))
    return history


NETWORKS = {
    "threshold": {"threshold": 0.7},
    "late and lost": LATE | {"threshold": 0.7, "least_rate_hz": 8.0},
    "by halves": LATE | {"threshold": [0.5, 1e3, 2.0, 0.3], "rate_hz": 40.0},
    "always": LATE,
}


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("cell", ["two planar", "three spatial"])
def test_what_arrives_is_that_of_queues_by_hand(cell, network):
    fields = dict(NETWORKS[network])
    rate = told(cell).clock.rate_hz
    fields |= {name: rate / (10 if name == "least_rate_hz" else 2) for name in fields if "rate" in name}
    scenario = told(cell, network=fields, duration=5.0)
    rng, arms, width, ticks = np.random.default_rng(2), list(scenario.cell.arms), 4, 200
    walks = np.cumsum(rng.normal(scale=0.3, size=(ticks, len(arms), width)), axis=0)
    says = rng.random((ticks, len(arms))) < 0.8
    said = [
        [x if is_said else None for x, is_said in zip(*row, strict=True)]
        for row in zip(walks, says, strict=True)
    ]
    said[0] = list(walks[0])
    device, timing = cell_network(scenario), MessageSignals(scenario).draw(ticks)
    state, signals = device.start(said[0]), timing.ticks()
    for tick, (held, counts) in enumerate(by_hand(scenario, said, timing)):
        mail, state = device.step(state, said[tick], next(signals))
        for name, one in zip(arms, mail, strict=True):
            sent = sum(count for (sender, other), count in counts.items() if sender == name != other)
            assert one.sent == (sent, sent * 8 * width)
            for sender, message in one.received.items():
                when, numbers = held.get((sender, name), (-np.inf, np.zeros(width)))
                assert_array_equal(message.numbers, numbers)
                assert message.age == tick - when


@pytest.mark.parametrize("cell", ["two planar", "two spatial"])
def test_without_losses_what_is_held_is_within_the_threshold_of_what_is_said(cell):
    """The property of send on delta; a heartbeat bounds the age, too."""
    scenario = told(cell)
    every = 12
    scenario = told(cell, network={"threshold": 0.4, "least_rate_hz": scenario.clock.rate_hz / every})
    device = cell_network(scenario)
    signals = MessageSignals(scenario).draw(150).ticks()
    walks = np.cumsum(np.random.default_rng(3).normal(scale=0.05, size=(150, 2, 3)), axis=0)
    state, ages = device.start(list(walks[0])), []
    for said in walks:
        mail, state = device.step(state, list(said), next(signals))
        for one in mail:
            held = np.array([message.numbers for message in one.received.values()])
            assert np.abs(held - said).max() < 0.4
            ages += [message.age for message in one.received.values()]
    assert max(ages) == every - 1
    assert mail[0].sent.messages < 75


# ---------------------------------------------------------------- laws


class Caller(cp.ArmController):
    """Holds the pose, and says it where it moved by more than a part of it since it was said last."""

    def __init__(self, scenario, arm, part=0.0):
        self.rows, self.part, self.name = scenario.cell.task_rows, part, arm
        self.share = 1.0 / len(scenario.cell.arms)
        self.scale = np.where(np.array(self.rows.indices) < 3, 1.0, 0.04)

    def init(self, measurement, reference):
        return np.full(self.rows.size, 1e3)  # far from any error: the first is said

    def error(self, measurement, reference):
        return self.rows.pose_error(measurement.payload_pose, reference.pose)

    def message(self, measurement, reference, state):
        error = self.error(measurement, reference)
        apart = error - (self.init(measurement, reference) if state is None else state)
        return cp.network.SentIf(error, apart.dot(apart) >= self.part**2)

    def step(self, measurement, reference, state):
        said = Caller.message(self, measurement, reference, state)
        views = measurement.messages
        error = 0.0 * said.numbers
        for view in views.values():
            error = error + self.share * np.where(view.age < np.inf, view.numbers, said.numbers)
        push = self.scale * (2000.0 * error + 500.0 * (measurement.payload_twist - reference.twist))
        squeeze = self.rows.turn(measurement.payload_pose, reference.internal_wrench)
        torque = -measurement.payload_jacobian.T @ (self.share * push + squeeze)
        return cp.ArmCommand(torque, np.where(said.condition, said.numbers, state))


class Brancher(Caller):
    """The same with a branch, and None for nothing."""

    def message(self, measurement, reference, state):
        numbers, condition = super().message(measurement, reference, state)
        return numbers if condition else None


class Mute(Caller):
    """Has nothing to say ever, not even how long its messages would be."""

    def message(self, measurement, reference, state):
        return None

    def step(self, measurement, reference, state):
        assert [len(message.numbers) for message in measurement.messages.values()] == [0, 0]
        assert {message.age for message in measurement.messages.values()} == {np.inf}
        return cp.ArmCommand(0.0 * measurement.q, state)


class Bare(Caller):
    """Says a number, and no array."""

    def message(self, measurement, reference, state):
        return 3.0


class Late(Caller):
    """Has nothing to say until the fifth tick, then says the tick's number at every third."""

    def message(self, measurement, reference, state):
        tick = 0 if state is None else state
        return np.full(2, float(tick)) if tick >= 5 and tick % 3 == 0 else None

    def init(self, measurement, reference):
        return 0

    def step(self, measurement, reference, state):
        heard = {float(message.numbers.sum()) for message in measurement.messages.values()}
        newest = 0 if state < 6 else state - state % 3
        assert heard == {2.0 * newest}
        return cp.ArmCommand(0.0 * measurement.q, state + 1)


def under(law, cell, **fields):
    target = {"controller": {"kind": "user", "target": f"{__name__}:{law}"}, "network": {}, "events": []}
    return SCENARIOS[cell]().override(target | {"duration": 0.3} | fields)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_nothing_said_on_a_condition_is_none_and_batches_have_it(cell):
    fields = {"controller.options": {"part": 5e-3}, "network": LATE}
    flagged, branched = under("Caller", cell, **fields), under("Brancher", cell, **fields)
    data = samples(flagged)
    assert data.equals(samples(branched))
    ticks = len(data.time)
    sent = data.messages_sent.values[-1]
    assert np.all(sent > 1)
    assert np.all(sent < ticks)
    if cell == "planar":
        assert cp.compiled.support(flagged) is None
        require_same_samples(cp.compiled.simulate_batch([flagged]).result(0).data, data)
        with pytest.raises(TracingError, match="branches"):
            cp.compiled.simulate_batch([branched])


@pytest.mark.parametrize("cell", SCENARIOS)
def test_an_arm_that_never_speaks_sends_no_byte(cell):
    run = cp.simulate(under("Mute", cell, duration=0.1), build_controller(under("Mute", cell)))
    assert_array_equal(run.data.bytes_sent, 0.0)
    assert run.metrics()["sent_B"] == 0.0
    anchored = SCENARIOS[cell]().override(
        {"controller": ANCHORED[cell].model_dump(), "duration": 0.1, "events": []}
    )
    assert "sent_B" not in cp.simulate(anchored, build_controller(anchored)).metrics()
    silent = anchored.override({"network": {}})
    assert cp.simulate(silent, build_controller(silent)).metrics()["sent_B"] == 0.0


@pytest.mark.parametrize("cell", SCENARIOS)
def test_bytes_are_counted_when_something_is_sent(cell):
    """Two numbers to one other arm, at the ticks 6, 9, 12 and so on."""
    scenario = under("Late", cell)
    run = cp.simulate(scenario, build_controller(scenario))
    tick = np.arange(len(run.data.time))
    count = np.maximum(tick // 3 - 1, 0)
    assert_array_equal(run.data.messages_sent.values, np.column_stack((count, count)))
    assert_array_equal(run.data.bytes_sent.values, 16.0 * run.data.messages_sent.values)
    assert run.metrics()["sent_B"] == 2 * 16 * count[-1]
    every = scenario.override({"clock.record_every": 4})
    assert cp.simulate(every, build_controller(every)).metrics()["sent_B"] == 2 * 16 * count[-1]


def test_exported_code_has_no_form_for_nothing(tmp_path):
    with pytest.raises(TracingError, match="nothing to say"):
        cp.export.export_c(under("Caller", "planar"), "left", tmp_path)


# ---------------------------------------------------------------- thresholds in runs


@pytest.mark.parametrize("cell", ["two planar", pytest.param("two spatial", marks=pytest.mark.slow)])
def test_both_engines_keep_back_the_same(cell):
    network = LATE | {"least_rate_hz": told(cell).clock.rate_hz / 10}
    never, some = (told(cell, network=network | {"threshold": x}) for x in (1e9, 0.6))
    single, batch = samples(some), cp.compiled.simulate_batch([never, some])
    require_same_samples(batch.result(1).data, single)
    ticks, width = len(single.time), 1 + some.cell.task_rows.size
    sent = batch.samples["bytes_sent"][:, -1].sum(axis=-1) / (2 * 8 * width)
    assert sent[0] == 1 + (ticks - 1) // 10
    assert sent[0] < sent[1] < 0.8 * ticks


@pytest.mark.slow
@pytest.mark.parametrize("cell", CELLS)
def test_a_threshold_of_zero_sends_always_in_the_same_bits(cell):
    """In one batch with others, whose threshold is a number of each run; and alone, where it folds."""
    always, some = (told(cell, network=LATE | {"threshold": x}) for x in (0.0, 2.0))
    batch, alone = (cp.compiled.simulate_batch(runs).samples for runs in ([always, some], [always]))
    for name, values in alone.items():
        assert_array_equal(batch[name][0], values[0], err_msg=name)


@pytest.mark.parametrize("cell", ["two planar", "three spatial"])
def test_a_threshold_that_every_message_passes_leaves_the_bits(cell):
    always, every = (told(cell, network={"threshold": x}, duration=0.2) for x in (0.0, 1e-300))
    data = samples(always)
    assert data.equals(samples(every))
    neighbours = len(always.cell.arms) - 1
    assert_array_equal(data.messages_sent.values[-1], neighbours * len(data.time))


@pytest.mark.parametrize("cell", SCENARIOS)
def test_a_run_with_silent_arms_goes_on_from_its_state_with_the_same_bits(cell):
    scenario = told(f"two {cell}", network=LATE | {"threshold": 0.5}, duration=0.2)
    run = cp.Simulation(scenario, build_controller(scenario))
    for _ in range(9):
        run.tick()
    other = copy.deepcopy(run)
    for one in (run, other):
        while not one.is_finished:
            one.tick()
    assert run.result().data.equals(other.result().data)


def test_what_was_said_last_counts_as_new_until_an_arm_is_silent_for_too_long():
    """Of the force path by messages, 2 ticks late; 10 ticks of silence are allowed."""
    law = ExchangedWrench(None, None, 2.0, 10.0)
    assert [float(law.lateness(age)) for age in (0.0, 2.0, 3.0, 12.0, 13.0, np.inf)] == [
        *(0.0, 2.0, 2.0, 2.0, 13.0),
        np.inf,
    ]
    always = ExchangedWrench(None, None, 2.0, 0.0)
    assert [float(always.lateness(age)) for age in (0.0, 2.0, 3.0, np.inf)] == [0.0, 2.0, 3.0, np.inf]


@pytest.mark.parametrize("cell", ["planar", "spatial"])
def test_a_few_messages_keep_the_squeeze_as_many_do(cell):
    """The anchor goes on by what it heard last, with one arm 1 mm off."""
    scenario = told(f"two {cell}", duration=2.5 if cell == "planar" else 0.5)
    scenario = scenario.override({"sensors.wrist.noise": {}})
    rare = scenario.override({"network": {"threshold": 0.3}})
    many, few = (samples(each) for each in (scenario, rare))
    errors = [np.abs(each.internal_axial_error.values[-1]).max() for each in (many, few)]
    assert few.bytes_sent.values[-1].sum() < 0.5 * many.bytes_sent.values[-1].sum()
    assert_allclose(errors[1], errors[0], atol=0.5)


@pytest.mark.slow
def test_check_says_that_its_count_is_without_the_threshold():
    scenario = told("two planar", network={"threshold": 1.0})
    simulation = cp.Simulation(scenario, build_controller(scenario))
    (note,) = (each.sentence for each in cp.check(scenario, poses=3) if each.place == "network")
    assert note == "without its threshold " + simulation.traffic().summary(scenario.clock.rate_hz)


# ---------------------------------------------------------------- mistakes


@pytest.mark.parametrize(
    ("network", "path"),
    [
        ({"threshold": -1.0}, "network.threshold"),
        ({"threshold": 1.0, "least_rate_hz": 33.0}, "network.least_rate_hz"),
        ({"links": [{"sender": "left", "receiver": "right", "least_rate_hz": 33.0}]}, "network.links.0"),
    ],
)
def test_mistakes_of_thresholds_are_told_by_path(network, path):
    with pytest.raises((ScenarioError, FieldError)) as caught:
        told("two planar", network=network)
    assert path in str(caught.value)


def test_thresholds_must_fit_messages_and_the_law():
    with pytest.raises(CoopPinError, match=r"network\.threshold.*4"):
        samples(told("two planar", network={"threshold": [1.0, 1.0]}))
    gains = ANCHORED["planar"].gains.replace(anchor_gain=0.0, leak=1.0)
    skips = {"controller": cp.laws.MeanPose(gains=gains, on_loss="skip"), "events": []}
    scenario = SCENARIOS["planar"]().override(skips | {"network": {"threshold": 1e-5}})
    with pytest.raises(FieldError, match="skip"):
        build_controller(scenario)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_a_message_is_an_array(cell):
    with pytest.raises(ShapeError, match="message"):
        samples(under("Bare", cell))


def test_analyses_near_rest_take_all_messages():
    links = [{"sender": "left", "receiver": "right", "threshold": 2.0}]
    exact = cp.network.Network(threshold=1.0, loss=0.1, links=links).exact
    assert exact.channel(("left", "right")).threshold == 0.0
    assert exact.channel(("right", "left")).threshold == 0.0
    assert exact.channel(("left", "right")).loss == 0.0
