"""A lost scheduler is a typed error in every state of dask's client; other errors pass unchanged."""

import signal
import subprocess
import sys

import pytest

pytest.importorskip("distributed", reason="dask is not installed (extra 'sweep')")

import coop_pin as cp
from coop_pin.errors import FieldError, WorkersLostError
from coop_pin.sweeps.cluster import Cluster


class Client:
    """Dask's client, as far as a cluster asks it; every call raises."""

    def __init__(self, status, error):
        self.status, self._error = status, error

    def nthreads(self):
        raise self._error

    def submit(self, *_, **__):
        raise self._error

    def subscribe_topic(self, *_):
        raise self._error


CALLS = {
    "threads": lambda cluster: cluster.threads(),
    "submit": lambda cluster: cluster.submit(print),
    "listen": lambda cluster: cluster.listen("topic", print),
}


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize(
    ("status", "error"),
    [("running", OSError("refused")), ("closed", Exception("closed")), ("connecting", TimeoutError())],
)
def test_a_scheduler_that_is_gone_is_a_typed_error(call, status, error):
    with pytest.raises(WorkersLostError, match="does not answer"):
        CALLS[call](Cluster(Client(status, error), lambda: None))


@pytest.mark.parametrize("call", CALLS)
def test_another_mistake_is_left_as_it_is(call):
    with pytest.raises(TypeError, match="pickle"):
        CALLS[call](Cluster(Client("running", TypeError("cannot pickle")), lambda: None))


@pytest.mark.parametrize("address", ["127.0.0.1", "localhost:port", "nonsense://127.0.0.1:1"])
def test_what_is_no_address_is_refused_at_its_field(tmp_path, address):
    with pytest.raises(
        FieldError,
        match=rf"^scheduler: is '{address}'",
    ):
        cp.sweep("adept-paper", out=tmp_path, scheduler=address, quiet=True)


def test_a_host_that_is_not_known_is_one_without_a_scheduler(tmp_path):
    with pytest.raises(WorkersLostError, match=r"no dask scheduler at 'no-such-host\.invalid:8786'"):
        cp.sweep("adept-paper", out=tmp_path, scheduler="no-such-host.invalid:8786", quiet=True)


STILLBORN = """
import asyncio
import coop_pin.sweeps.worker_host as host

class Stillborn:
    def __init__(self, *_, **__):
        pass

    def __await__(self):
        raise RuntimeError("Nanny failed to start.")
        yield

host.Nanny = Stillborn
asyncio.run(host.main("tcp://127.0.0.1:1", 2))
"""


def test_a_worker_that_dies_while_it_is_started_ends_its_keeper_without_a_word():
    """LocalWorkers then starts the keeper again."""
    keeper = subprocess.Popen(
        [sys.executable, "-c", STILLBORN],
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    keeper.wait(timeout=60)
    assert (keeper.returncode, keeper.stderr.read()) == (-signal.SIGKILL, b"")
    keeper.stdin.close()
    keeper.stderr.close()
