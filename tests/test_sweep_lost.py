"""A scheduler that is gone is said in the package's own words, however far dask has noticed; the package's own mistakes are not."""

import pytest

pytest.importorskip("distributed", reason="dask is not installed (extra 'sweep')")

from coop_pin.errors import WorkersLostError
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
    ("status", "error"), [("running", OSError("refused")), ("closed", Exception("closed")), ("connecting", TimeoutError())]
)
def test_a_scheduler_that_is_gone_is_a_typed_error(call, status, error):
    with pytest.raises(WorkersLostError, match=r"does not answer.*finished runs are kept"):
        CALLS[call](Cluster(Client(status, error), lambda: None))


@pytest.mark.parametrize("call", CALLS)
def test_another_mistake_is_left_as_it_is(call):
    with pytest.raises(TypeError, match="pickle"):
        CALLS[call](Cluster(Client("running", TypeError("cannot pickle")), lambda: None))
