"""Records of arms: CSV and MCAP there and back, topics that do not fit, and what leaves."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, FileReadError
from coop_pin.logs import log_findings, mcap_log, write_episodes, write_run
from coop_pin.logs.csv_log import write_csv
from coop_pin.logs.record import ArmRecord
from coop_pin.logs.topics import Topic, table_of

PARTS = ("time", "position", "velocity", "effort", "wrench_time", "wrench")


@pytest.fixture(scope="module")
def scenario():
    cell = cp.Scenario.load("adept-anchored", {"events": [], "duration": 1.0})
    return cell.replace(log=table_of(cell))


def made(scenario, seed=0):
    """A record with another clock for each arm, and wrists that are slower than the joints."""
    rng, arms = np.random.default_rng(seed), {}
    for number, name in enumerate(scenario.cell.arms):
        time, slow = 100.0 + 0.013 * number + np.arange(0, 4, 0.01), 100.0 + np.arange(0, 4, 0.04)
        q = 0.5 + 0.1 * np.sin(time[:, None] + np.arange(3))
        noise = rng.normal(size=(len(slow), 6))
        arms[name] = ArmRecord(time, q, np.gradient(q, time, axis=0), rng.normal(size=q.shape), slow, noise)
    X = np.tile(np.eye(4), (50, 1, 1))
    X[:, 0, 3] = np.linspace(0.0, 1.0, 50)
    return cp.logs.Record(arms, 100.0 + np.arange(50) * 0.05, X)


def same(one, other, zero=0.0, tolerance=0.0):
    """Whether two records have the same numbers, the stamps of the second beginning earlier."""
    for name, arm in one.arms.items():
        for part in PARTS:
            off = zero if "time" in part else 0.0
            difference = getattr(arm, part) - off - getattr(other.arms[name], part)
            assert np.abs(difference).max() <= tolerance + 1e-12 * (off != 0.0), (name, part)
    assert np.abs(one.desired - other.desired).max() < 1e-12
    assert np.abs(one.desired_time - zero - other.desired_time).max() < 1e-9


def test_csv_there_and_back_has_the_same_numbers(scenario, tmp_path):
    record = made(scenario)
    write_csv(record.topics(scenario), tmp_path / "log.csv")
    same(record, cp.logs.Record.load(tmp_path / "log.csv", scenario), 100.0)


def test_mcap_there_and_back_has_the_same_numbers(scenario, tmp_path):
    """Columns of bytes have what the library decodes, message by message."""
    pytest.importorskip("mcap_ros2")
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    record = made(scenario)
    mcap_log.write_mcap(record.topics(scenario), tmp_path / "log.mcap")
    loaded = cp.logs.Record.load(tmp_path / "log.mcap", scenario)
    for name, arm in record.arms.items():
        for part in PARTS[1:4] + PARTS[5:]:
            assert np.array_equal(getattr(arm, part), getattr(loaded.arms[name], part))
        assert np.abs(arm.time - 100.0 - loaded.arms[name].time).max() < 2e-9
    with (tmp_path / "log.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        topics = ["/left/joint_states", "/left/wrench"]
        decoded = [(one.topic, message) for _, one, _, message in reader.iter_decoded_messages(topics)]
    joints = [message.position for topic, message in decoded if topic == "/left/joint_states"]
    forces = [message.wrench.torque.y for topic, message in decoded if topic == "/left/wrench"]
    assert np.array_equal(joints, loaded.arms["left"].position)
    assert np.array_equal(forces, loaded.arms["left"].wrench[:, 4])


def test_messages_of_other_lengths_and_json_are_read(scenario, tmp_path):
    pytest.importorskip("mcap_ros2")
    from mcap.writer import Writer

    names = ["joint_3", "joint_1", "joint_2"]
    with (tmp_path / "log.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for arm in ("left", "right"):
            schema = writer.register_schema("sensor_msgs/msg/JointState", "jsonschema", b"{}")
            channel = writer.register_channel(f"/{arm}/joint_states", "json", schema)
            for k in range(5):
                stamp = {"sec": 7, "nanosec": 10**7 * k}
                message = {
                    "header": {"stamp": stamp, "frame_id": ""},
                    "name": names,
                    "position": [3, 1, 2 + k],
                }
                data = json.dumps(message | {"velocity": [], "effort": []}).encode()
                writer.add_message(channel, log_time=k, data=data, publish_time=k)
        writer.finish()
    stated = table_of(scenario)
    arms = {name: arm.replace(wrench="") for name, arm in stated.arms.items()}
    cell = scenario.replace(log=stated.replace(arms=arms, desired=""))
    left = cp.logs.Record.load(tmp_path / "log.mcap", cell).arms["left"]
    assert left.position.tolist() == [[1, 2 + k, 3] for k in range(5)]
    assert np.isnan(left.velocity).all()
    assert len(left.wrench_time) == 0
    assert np.abs(left.time - 0.01 * np.arange(5)).max() < 1e-9


def test_the_table_has_degrees_milliseconds_and_the_sign_of_the_wrench(scenario, tmp_path):
    record = made(scenario)
    topics = record.topics(scenario)
    other = {}
    for name, topic in topics.items():
        values = dict(topic.values)
        for part in ("position", "velocity"):
            if topic.kind == "JointState":
                values[part] = np.degrees(values[part])
        for part in ("force", "torque"):
            if name == "/right/wrench":
                values[part] = -values[part]
        other[name] = topic._replace(time=1e3 * topic.time, values=values)
    write_csv(other, tmp_path / "log.csv")
    changes = {"log.angle": "deg", "log.time": "ms", "log.arms.right.wrench_sign": -1}
    loaded = cp.logs.Record.load(tmp_path / "log.csv", scenario.override(changes))
    same(record, loaded, 100.0, 1e-12)


def test_what_a_file_does_not_have_is_named(scenario, tmp_path):
    record, path = made(scenario), tmp_path / "log.csv"
    write_csv(record.topics(scenario), path)
    with pytest.raises(FileReadError, match="/left/joints"):
        cp.logs.Record.load(path, scenario.override({"log.arms.left.joints": "/left/joints"}))
    with pytest.raises(ArgumentError, match="log"):
        cp.logs.Record.load(path, scenario.replace(log=None))
    with pytest.raises(FileReadError):
        cp.logs.Record.load(tmp_path / "none.csv", scenario)
    text = path.read_text()
    path.write_text(text.replace(".joint_1", ".elbow"))
    with pytest.raises(FileReadError, match="joint_1"):
        cp.logs.Record.load(path, scenario)
    path.write_text(text.replace("left/wrench.force", "left/wrench.pull"))
    with pytest.raises(FileReadError, match="force"):
        cp.logs.Record.load(path, scenario)
    path.write_text(text.splitlines()[0])
    with pytest.raises(FileReadError, match="samples"):
        cp.logs.Record.load(path, scenario)
    path.write_text(text.replace("time", "t", 1))
    with pytest.raises(FileReadError, match="time"):
        cp.logs.Record.load(path, scenario)


def test_a_sample_without_a_moment_is_named_by_column_and_row(scenario, tmp_path):
    record, path = made(scenario), tmp_path / "log.csv"
    record.arms["left"].wrench[17, 5] = np.nan
    write_csv(record.topics(scenario), path)
    with pytest.raises(FileReadError, match=r"/left/wrench\.torque\.z .* row 18 "):
        cp.logs.Record.load(path, scenario)
    record.arms["left"].wrench[17] = np.nan  # a row of which the topic has no sample
    write_csv(record.topics(scenario), path)
    assert len(cp.logs.Record.load(path, scenario).arms["left"].wrench) == len(record.arms["left"].wrench) - 1


def test_an_mcap_file_that_is_cut_or_foreign_is_refused(scenario, tmp_path):
    pytest.importorskip("mcap_ros2")
    path = tmp_path / "log.mcap"
    mcap_log.write_mcap(made(scenario).topics(scenario), path)
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(FileReadError):
        cp.logs.Record.load(path, scenario)
    path.write_bytes(b"nothing")
    with pytest.raises(FileReadError):
        cp.logs.Record.load(path, scenario)
    early = {
        "/x": Topic(
            "WrenchStamped", np.array([-1.0]), {"force": np.zeros((1, 3)), "torque": np.zeros((1, 3))}
        )
    }
    with pytest.raises(ArgumentError):
        mcap_log.write_mcap(early, path)


@pytest.mark.parametrize(
    ("change", "severity"),
    [
        (lambda arm: {"time": 1e3 * arm.time}, "error"),
        (lambda arm: {"time": np.where(arm.time > 102.0, arm.time - 1.5, arm.time)}, "error"),
        (lambda arm: {"time": np.where(arm.time > 102.0, arm.time + 0.5, arm.time)}, "warning"),
        (lambda arm: {"time": arm.time + 1e9}, "error"),
        (lambda arm: {"position": np.degrees(arm.position), "velocity": np.degrees(arm.velocity)}, "error"),
        (lambda arm: {"velocity": 1e-3 * arm.velocity}, "error"),
    ],
)
def test_units_gaps_and_resets_are_findings(scenario, change, severity):
    record = made(scenario)
    assert {one.severity for one in log_findings(record, scenario)} == {"note"}
    arms = dict(record.arms)
    arms["right"] = replace(arms["right"], **change(arms["right"]))
    off = [one for one in log_findings(replace(record, arms=arms), scenario) if one.severity != "note"]
    assert off
    assert {one.severity for one in off} == {severity}


@pytest.mark.parametrize("end", [103.7, 106.0])
def test_a_log_in_which_arms_hardly_hold_is_an_error(scenario, end):
    record = replace(made(scenario), free=(100.0, end))
    (off,) = [one for one in log_findings(record, scenario) if one.severity != "note"]
    assert (off.severity, off.place, off.limit) == ("error", "free", 1.0)
    assert off.value == pytest.approx(103.99 - end)


def test_a_log_of_one_sample_is_an_error(scenario):
    record = made(scenario)
    arms = dict(record.arms)
    arms["right"] = replace(
        arms["right"], **{part: getattr(arms["right"], part)[:1] for part in ("time", "position", "velocity")}
    )
    told = log_findings(replace(record, arms=arms), scenario)
    assert "error" in {one.severity for one in told}


@pytest.fixture(scope="module")
def run(scenario):
    return cp.run(scenario, warn=False)


def test_a_run_leaves_as_mcap_with_its_internal_wrench_and_frames(run, tmp_path):
    pytest.importorskip("mcap_ros2")
    write_run(run, tmp_path / "run.mcap")
    topics = mcap_log.read_mcap(tmp_path / "run.mcap", ["/left/internal_wrench", "/desired_pose"])
    data = run.data
    logged = np.hstack([*topics["/left/internal_wrench"].values.values()])
    norms = np.linalg.norm(logged[:, :3], axis=1)
    expected = np.linalg.norm(np.nan_to_num(data.internal_wrench.sel(arm="left").values)[:, :3], axis=1)
    assert np.abs(norms - expected).max() < 1e-9
    assert np.abs(topics["/desired_pose"].values["position"] - data.desired_position.values).max() == 0.0
    frames = frames_of(tmp_path / "run.mcap")
    assert {*frames} == {"payload", "left/tip", "right/tip"}
    assert np.array_equal(frames["payload"], data.payload_position.values)


def frames_of(path):
    """The origins of the frames of a file over time, by name."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        transforms = [message.transforms[0] for _, _, _, message in reader.iter_decoded_messages(["/tf"])]
    frames = {}
    for one in transforms:
        p = one.transform.translation
        frames.setdefault(one.child_frame_id, []).append((p.x, p.y, p.z))
    return {name: np.array(origins) for name, origins in frames.items()}


@pytest.mark.parametrize("name", ["adept-compliant", "two-pandas-hinges"])
def test_frames_of_tips_are_where_grasps_let_them_be(name, tmp_path):
    """Springs give and hinges turn: the origins are those that the plant has."""
    pytest.importorskip("mcap_ros2")
    result = cp.run(name, {"duration": 0.1, "events": []}, warn=False)
    write_run(result, tmp_path / "run.mcap")
    frames = frames_of(tmp_path / "run.mcap")
    for arm in result.scenario.cell.arms:
        tip = result.data.tip_position.sel(arm=arm).values
        assert np.abs(frames[f"{arm}/tip"] - tip).max() < 1e-12


def test_runs_leave_as_episodes_of_lerobot(run, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    n = run.data.time.size
    assert write_episodes([run, run], tmp_path) == 2 * n
    info = json.loads((tmp_path / "meta" / "info.json").read_text())
    assert (info["fps"], info["total_episodes"], info["total_frames"]) == (80, 2, 2 * n)
    file = info["data_path"].format(chunk_index=0, file_index=0)
    table = parquet.read_table(tmp_path / file)
    assert {*table.column_names} == {*info["features"]}
    internal = np.array(table["observation.internal_wrench"].to_pylist()).reshape(2, n, 2, 6)
    expected = np.nan_to_num(run.data.internal_wrench.values)
    assert np.abs(internal - expected).max() < 1e-5 * np.abs(expected).max()
    assert table["episode_index"].to_pylist() == [0] * n + [1] * n
    episodes = parquet.read_table(
        tmp_path / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    ).to_pylist()
    assert [one["dataset_to_index"] for one in episodes] == [n, 2 * n]
    tasks = pd.read_parquet(tmp_path / "meta" / "tasks.parquet")
    assert tasks.task_index.to_dict() == {run.scenario.summary: 0}
    assert tasks.index.name == "task"
    with pytest.raises(ArgumentError):
        write_episodes([], tmp_path)


@pytest.mark.slow
def test_lerobot_reads_the_episodes(run, tmp_path):
    datasets = pytest.importorskip("lerobot.datasets.lerobot_dataset")
    write_episodes([run, run], tmp_path / "set")
    read = datasets.LeRobotDataset("local/set", root=tmp_path / "set")
    assert len(read) == 2 * run.data.time.size
    assert read[3]["observation.internal_wrench"].shape == (12,)
