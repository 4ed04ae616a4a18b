"""The compiler by itself: a copy of its folder and of its tests, where coop_pin cannot be imported."""

import inspect
import re
import shutil
import subprocess
import sys
from pathlib import Path

from coop_pin.tracing.tape import Tape

WITHOUT = """import sys

for name in ("coop_pin", "pinocchio", "pydantic", "scipy"):
    sys.modules[name] = None  # importing it raises
"""


def test_a_copy_of_the_package_passes_its_tests_where_there_is_no_coop_pin(tmp_path):
    copy, tests = tmp_path / "tracing", tmp_path / "test_tracing.py"
    shutil.copytree(
        Path(inspect.getfile(Tape)).parent, copy, ignore=shutil.ignore_patterns("__pycache__", "*.pyc")
    )
    shutil.copy(Path(__file__).with_name("test_tracing.py"), tests)
    oracle = shutil.copy(Path(__file__).parents[1] / "numpy_machine.py", tmp_path)
    for file in (tests, Path(oracle), copy / "README.md"):  # as the README says
        text = file.read_text(encoding="utf-8")
        file.write_text(text.replace("coop_pin.tracing", "tracing"), encoding="utf-8")
    (tmp_path / "conftest.py").write_text(WITHOUT, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", ".", tests.name]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=600)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert int(re.search(r"(\d+) passed", answer.stdout)[1]) > 90
