"""What takes long to build is built by one of the workers of a test run, and used by all."""

import fcntl
import os
import shutil


def top_folder(tmp_path_factory):
    """The temporary folder of a test run, in which each of its workers has a folder of its own."""
    top = tmp_path_factory.getbasetemp()
    return top.parent if "PYTEST_XDIST_WORKER" in os.environ else top


def built_once(tmp_path_factory, name, build):
    """The folder that ``build(folder)`` fills; a build that fails starts afresh for the next who asks."""
    top = top_folder(tmp_path_factory)
    folder, done = top / name, top / f"{name}.done"
    with (top / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            build(folder)
            done.touch()
    return folder
