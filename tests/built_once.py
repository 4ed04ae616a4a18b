"""What takes long to build is built by one of the workers of a test run, and used by all."""

import fcntl
import os
import shutil


def built_once(tmp_path_factory, name, build):
    """The folder that ``build(folder)`` fills; a build that fails starts afresh for the next who asks."""
    top = tmp_path_factory.getbasetemp()
    top = (
        top.parent if "PYTEST_XDIST_WORKER" in os.environ else top
    )  # each worker has a folder of its own there
    folder, done = top / name, top / f"{name}.done"
    with (top / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            build(folder)
            done.touch()
    return folder
