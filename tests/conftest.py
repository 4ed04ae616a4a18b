"""What all tests share."""

import signal
import sys
from pathlib import Path

import pytest
from built_once import top_folder
from matplotlib import get_cachedir

# A shell starts background jobs with Ctrl-C ignored, and children inherit that; several tests send it to
# children.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests of one package use scenarios and checks of another's.
sys.path += sorted(str(folder) for folder in Path(__file__).parent.iterdir() if folder.is_dir())


@pytest.fixture(autouse=True, scope="session")
def cache(tmp_path_factory):
    """Compiled code is kept in a folder of the tests' own, which all workers of a test run share.

    Matplotlib keeps its own: to build its list of fonts anew takes seconds.
    """
    folder = top_folder(tmp_path_factory) / "cache"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MPLCONFIGDIR", get_cachedir())
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield


@pytest.fixture(autouse=True, scope="session")
def thinned_once():
    """Each mesh is thinned once in a process: half of the time of a page with spatial arms."""
    from coop_pin.viz import cell_scene

    known, thinned = {}, cell_scene.thinned

    def once(mesh, faces):
        key = mesh.vertices.tobytes(), mesh.faces.tobytes(), faces
        if key not in known:
            known[key] = thinned(mesh, faces)
        return type(mesh)(*known[key])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cell_scene, "thinned", once)
        yield
