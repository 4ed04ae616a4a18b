"""What all tests share."""

import signal

import pytest
from built_once import top_folder

# A shell starts background jobs with Ctrl-C ignored, and children inherit that; several tests send it to
# children.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def cache(tmp_path_factory):
    """Compiled code is kept in a folder of the tests' own, which all workers of a test run share."""
    folder = top_folder(tmp_path_factory) / "cache"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield
