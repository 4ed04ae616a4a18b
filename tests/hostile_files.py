"""Hostile files: what users hand in, damaged at random, each read in a process of its own.

    python tests/hostile_files.py SEED FIRST COUNT

reads files FIRST, FIRST + 1, ... of a seed and writes a line of JSON for each: what it is and how its reading
ended. The readers are imported once; then one process is forked for each file, with limits of time and
memory. How a reading ends:

- "result": it returns, and what it returns is sound: finite, or equal to what was written;
- "refused": it raises a CoopPinError;
- "bare": it raises anything else; "unsound": it returns what is not sound;
- "exit code -n": signal n ended the process; "slow": it never ended, or took more than ``LIMIT_S`` of
  processor time, with the processes that it started;
- "wrote": it created, changed or removed a file outside its folder.

The first two are allowed.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import json
import os
import random
import re
import resource
import signal
import struct
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

import numpy as np
import pinocchio  # noqa: F401  loaded once, before the forks
import xarray as xr
from cells import SCENARIOS
from malformed_urdf import CORPUS, arm

import coop_pin as cp
from coop_pin.model.visuals import CellVisuals
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.sweeps.workers.job import checked_content, checksummed

ALLOWED = {"result", "refused"}
LIMIT_S, LIMIT_BYTES = 5, 4 << 30
PATIENCE_S = 60.0
MESHES = ("stl", "ascii.stl", "obj", "ply", "off", "glb", "gltf", "dae", "3mf")
SHORT = {"duration": 0.1, "events": ()}

NUMBERS = (
    *("nan", "-nan", "inf", "-inf", "1e400", "-1", "0", "1e300", "5e-324", "9" * 400, "1_0", "0x7f", "''"),
    *("[]", "{}", "true", "2147483648", "-9223372036854775809", "1" + "0" * 19, "1e", "--1", "\0", '"', "%n"),
)
PLAUSIBLE = (
    "0",
    "1",
    "-1",
    "2",
    "7",
    "1.0",
    "-0.5",
    "0.0",
    "1e3",
    "-1e6",
    "1e-9",
    "1e12",
    "1e300",
    "-1e-300",
)
LENGTHS = [struct.pack("<I", value) for value in (0, 2**31 - 1, 2**31, 2**32 - 1)] + [b"\xff" * 8, bytes(8)]
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:e[+-]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]\w+")

# ---------------------------------------------------------------- damage


def flipped(chance: random.Random, data: bytes) -> bytes:
    """Return the data with one to eight bits flipped."""
    damaged = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 8))):
        damaged[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return bytes(damaged)


def truncated(chance: random.Random, data: bytes) -> bytes:
    """Return a beginning of the data."""
    return data[: chance.randrange(len(data))]


def cut(chance: random.Random, data: bytes) -> bytes:
    """Return the data without a piece, or with it twice or a thousand times."""
    start = chance.randrange(len(data))
    end = start + chance.choice((1, 4, 40, 400))
    return data[:start] + data[start:end] * chance.choice((0, 2, 1000)) + data[end:]


def filled(chance: random.Random, data: bytes) -> bytes:
    """Return the data with a piece replaced by noise or zeros."""
    start, size = chance.randrange(len(data)), chance.choice((1, 8, 64, 512))
    piece = chance.choice((bytes(size), chance.randbytes(size), b"\xff" * size))
    return data[:start] + piece + data[start + size :]


def measured(chance: random.Random, data: bytes) -> bytes:
    """Return the data with a length or an address in it replaced."""
    start, length = chance.randrange(min(len(data), chance.choice((200, 4000)))), chance.choice(LENGTHS)
    return data[:start] + length + data[start + len(length) :]


def renumbered(chance: random.Random, data: bytes) -> bytes:
    """Return a text with one to three of its numbers replaced by hostile ones."""
    for _ in range(chance.choice((1, 1, 3))):
        data = _replaced(chance, data, _NUMBER, chance.choice(NUMBERS).encode())
    return data


def varied(chance: random.Random, data: bytes) -> bytes:
    """Return a text with one to three of its numbers replaced by others that are written correctly."""
    for _ in range(chance.choice((1, 1, 3))):
        others = (*PLAUSIBLE, chance.choice(_NUMBER.findall(data) or [b"1"]).decode())
        data = _replaced(chance, data, _NUMBER, chance.choice(others).encode())
    return data


def reworded(chance: random.Random, data: bytes) -> bytes:
    """Return a text with a word replaced by another of its words, or by a hostile one."""
    words = [*_WORD.findall(data), b"../../x", b"\xff\xfe", b"\xed\xa0\x80", b"x" * 5000, b"${9**9**9}"]
    return _replaced(chance, data, _WORD, chance.choice(words))


def _replaced(chance, data, pattern, by):
    places = [found.span() for found in pattern.finditer(data)]
    if not places:
        return data
    start, end = chance.choice(places)
    return data[:start] + by + data[end:]


def resigned(chance: random.Random, data: bytes) -> bytes:
    """Return a file of a sweep with a damaged line and the checksum that belongs to it."""
    lines = [line for line in data.split(b"\n") if line]  # batches begin with an empty one
    number = chance.randrange(len(lines))
    content = json.loads(checked_content(lines[number]))
    tables = [content] + [entry for entry in content.values() if isinstance(entry, dict) and entry]
    table = chance.choice(tables)
    table[chance.choice(sorted(table))] = chance.choice((None, -1, "nan", [], {}, [[]], {"a": {}}, "x" * 99))
    lines[number] = checksummed(json.dumps(content).encode())
    return b"\n".join(lines) + b"\n"


BYTES, TEXT = (
    (flipped, truncated, cut, filled, measured),
    (varied, varied, varied, varied, varied, renumbered, renumbered, reworded),
)

# ---------------------------------------------------------------- files


class Files:
    """A sound file of every kind, how it is damaged and read.

    Attributes:
        kinds: by name, the file's name, its sound content, the kinds of damage and the reader; the reader
            returns whether what it has read is sound.
    """

    def __init__(self, folder: Path) -> None:
        self.kinds = {}
        scenario = SCENARIOS["planar"]().override(SHORT)
        spatial = SCENARIOS["spatial"]().override(SHORT)
        table = b"time,x,y,z,roll,pitch,yaw\n0,0.1,0,0,0,0,0\n1,0.2,0.1,0,0,0.5,0\n2.5,0.3,0,0,0,0,0.1\n"
        xacro = (
            '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="m" default="2"/>'
            '<xacro:property name="l" value="${0.25 * 2}"/><xacro:macro name="mass" params="value:=1">'
            '<mass value="${value}"/></xacro:macro>'
        )
        parts = {"declaration": "", "robot": xacro, "mass": '<xacro:mass value="$(arg m)"/>'}
        urdf = arm(visual=PART.format(mesh="part.obj")).encode()
        self._add("scenario.toml", scenario.to_toml().encode(), TEXT + BYTES, read_scenario)
        self._add("spatial.toml", spatial.to_toml().encode(), TEXT + BYTES, read_scenario)
        self._add("motion.csv", table, TEXT + BYTES, read_table)
        self._add("arm.urdf", urdf, (*TEXT, *BYTES, malformed), read_arm)
        self._add("arm.xacro", arm(**parts).encode(), TEXT + BYTES, read_arm)
        self._add_meshes()
        self._add_results(folder, scenario)

    @functools.cached_property
    def groups(self) -> list[list[str]]:
        """Names of the kinds that come in turn: "body.stl", "body.obj" and so on are one group."""
        names = sorted(self.kinds, key=_group)
        return [list(group) for _, group in itertools.groupby(names, _group)]

    def _add(self, name, content, damages, read) -> None:
        self.kinds[name] = content, damages, read

    def _add_meshes(self) -> None:
        import trimesh

        box = trimesh.creation.box((0.1, 0.2, 0.3))
        for kind in MESHES:
            content = box.export(file_type="stl_ascii" if kind == "ascii.stl" else kind)
            if kind == "gltf":
                content = trimesh.exchange.gltf.export_gltf(box, embed_buffers=True)["model.gltf"]
            content = content.encode() if isinstance(content, str) else content
            damages = BYTES if kind in ("stl", "glb", "3mf") else TEXT + BYTES
            self._add(f"body.{kind}", content, damages, read_body)
            if kind != "3mf":
                self._add(f"part.{kind}", content, damages, read_visual)

    def _add_results(self, folder, scenario) -> None:
        result = cp.run(scenario)
        result.save(folder / "result.nc")
        read = functools.partial(read_result, result)
        self._add("result.nc", (folder / "result.nc").read_bytes(), (*BYTES, *BYTES, foreign), read)
        sweep = cp.sweep(
            scenario,
            {"duration": [0.02, 0.03]},
            out=folder / "sweep",
            execution=cp.Execution(workers=0, quiet=True),
        )
        files = sorted(path for path in (folder / "sweep").rglob("*.json*"))
        self.kinds |= {
            f"sweep/{path.relative_to(folder / 'sweep')}": (
                path.read_bytes(),
                BYTES if path.name == "tables.json" else (*BYTES, resigned, resigned),  # digests alone
                None,
            )
            for path in files
        }
        whole = {path: content for path, (content, *_) in self.kinds.items() if path.startswith("sweep/")}
        for path in whole:
            self.kinds[path] = *self.kinds[path][:2], functools.partial(read_sweep, sweep, whole)


def _group(name: str) -> str:
    return re.split(r"[./]", name)[0]


PART = '<visual><geometry><mesh filename="package://parts/{mesh}"/></geometry></visual>'


def malformed(chance: random.Random, _data: bytes) -> bytes:
    """Return one of the malformed documents."""
    text = CORPUS[chance.choice(sorted(CORPUS))].text
    return text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")


def foreign(chance: random.Random, data: bytes) -> bytes:
    """Return a netCDF file of somebody else, with some of the names of a result."""
    names = ["time", "torque", "arm", "pose_error", "x" * 200, "joint_name"]
    values = [np.zeros(3), np.array(["a", "b"]), np.array(1j), np.zeros((0, 2)), np.full(5, np.nan)]
    table = {}
    for name in chance.sample(names, 3):
        value = chance.choice(values)
        table[name] = ([f"{name}_{axis}" for axis in range(value.ndim)], value)
    attributes = chance.choice(({}, {"coop_pin_scenario": "duration = 1"}, {"coop_pin_scenario": 3}))
    data = xr.Dataset(table, attrs={**attributes, "coop_pin_sha256": "0" * 64})
    return bytes(data.to_netcdf(engine="h5netcdf", invalid_netcdf=True))


# ---------------------------------------------------------------- readers


def read_scenario(path: Path) -> bool:
    """Read a scenario, write and read it again, and simulate its first two ticks."""
    scenario = cp.Scenario.load(path)
    if cp.Scenario.from_toml(scenario.to_toml()) != scenario:
        return False
    simulation = Simulation(scenario, build_controller(scenario))
    simulation.tick()
    return bool(np.isfinite(simulation.snapshot().configuration).all())


def read_table(path: Path) -> bool:
    """Read a table of poses."""
    motion = cp.motions.CsvMotion(path=str(path))
    return all(np.isfinite(motion.at(time).X_WP_d).all() for time in (0.0, 0.7, 1e3))


def read_arm(path: Path) -> bool:
    """Read a robot and compute its dynamics."""
    model = cp.model.ArmModel(cp.Arm.from_urdf(path, tip="c"))
    return bool(np.isfinite(model.inverse_dynamics(*np.zeros((3, model.nv)))).all())


def read_body(path: Path) -> bool:
    """Read a mesh as a payload."""
    payload = cp.Payload.mesh(path, mass=1.0)
    return bool(np.isfinite(payload.inertia).all())


def read_visual(path: Path) -> bool:
    """Read a mesh as a visual of an arm."""
    (path.parent / "parts").mkdir()
    mesh = path.rename(path.parent / "parts" / path.name)
    (path.parent / "arm.urdf").write_text(arm(visual=PART.format(mesh=mesh.name)))
    body = cp.Payload.box(1.0, (0.1, 0.1, 0.1))
    arms = {"only": cp.Arm.from_urdf(path.parent / "arm.urdf", tip="c")}
    visuals = CellVisuals(cp.Cell(arms=arms, payload=body, grasps={"only": cp.Pose()}), "rooted")
    meshes = [visual.shape for body in visuals.bodies for visual in body.visuals]
    return all(np.isfinite(mesh.vertices).all() and mesh.faces.max() < len(mesh.vertices) for mesh in meshes)


def read_result(written: cp.RunResult, path: Path) -> bool:
    """Read a result."""
    result = cp.RunResult.load(path)
    return result.data.identical(written.data) and result.scenario == written.scenario


def read_sweep(written: cp.SweepResult, whole: dict[str, bytes], path: Path) -> bool:
    """Read the folder of a sweep of which one file is damaged."""
    folder = next(folder for folder in path.parents if folder.name == "sweep")
    for name, content in whole.items():
        file = folder.parent / name
        if file != path:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
    result = cp.SweepResult.load(folder)
    return set(result.data.dims) <= {*written.data.dims}


# ---------------------------------------------------------------- processes


def hostile_file(files: Files, seed: int, number: int):
    """A file by its number: its name, its damage and its content."""
    chance = random.Random(f"{seed} {number}")
    name = chance.choice(files.groups[number % len(files.groups)])
    content, damages, _ = files.kinds[name]
    if chance.random() < 0.05:
        other = chance.choice(sorted(files.kinds))
        return name, f"content of {other}", files.kinds[other][0]
    damage = chance.choice(damages)
    return name, damage.__name__, damage(chance, content)


def read(files: Files, name: str, path: Path) -> tuple[str, str]:
    """How the reading of a file ends, and what was raised."""
    try:
        sound = files.kinds[name][2](path)
    except cp.CoopPinError as error:
        return "refused", f"{type(error).__name__}: {error}"[:300]
    except BaseException as error:
        return "bare", "".join(traceback.format_exception(error)[-4:])
    return ("result" if sound else "unsound"), ""


def read_alone(files: Files, name: str, path: Path) -> tuple[str, str]:
    """How the reading of a file in a process of its own ends."""
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receive)
        silent = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(silent, stream)
        resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S))
        signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)  # its default action ends the process
        os.chdir(path.parent)
        os.write(send, json.dumps(read(files, name, path)).encode())
        os._exit(0)
    os.close(send)
    with os.fdopen(receive, "rb") as answer:
        said = answer.read()
    _, status, used = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if -code in (signal.SIGALRM, signal.SIGXCPU, signal.SIGKILL) or used.ru_utime + used.ru_stime > LIMIT_S:
        return "slow", ""
    return tuple(json.loads(said)) if said else (f"exit code {code}", "")


def tree(folder: Path, without: Path) -> dict[str, tuple[int, int]]:
    """Size and time of every file below a folder, but those of one folder."""
    return {
        str(path): (path.lstat().st_size, path.lstat().st_mtime_ns)
        for path in folder.rglob("*")
        if path.is_file() and not path.is_relative_to(without)
    }


def main(seed: int, first: int, count: int) -> None:
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    out = os.fdopen(os.dup(1), "w")
    with tempfile.TemporaryDirectory() as temporary, contextlib.redirect_stdout(sys.stderr):
        watched = Path(temporary).resolve()
        for variable in ("HOME", "TMPDIR", "XDG_CACHE_HOME"):
            os.environ[variable] = str(watched)
        (watched / "sound").mkdir()
        files = Files(watched / "sound")
        for number in range(first, first + count):
            name, damage, content = hostile_file(files, seed, number)
            folder = watched / "cases" / str(number)
            path = folder / name
            path.parent.mkdir(parents=True)
            path.write_bytes(content)
            before = tree(watched, folder)
            end, text = read_alone(files, name, path)
            if tree(watched, folder) != before:
                end = "wrote"
            print(
                json.dumps({"number": number, "file": name, "damage": damage, "end": end, "text": text}),
                file=out,
                flush=True,
            )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
