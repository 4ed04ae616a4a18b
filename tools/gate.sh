#!/usr/bin/env bash
# The gate: format, lint, types, tests, notebooks and pages. Sets itself up; stops at the first failure.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source tools/setup.sh

export MPLBACKEND=Agg
unset PYTHONDONTWRITEBYTECODE # tests start hundreds of processes, and compiling is a quarter of an import
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}" OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}" # one worker, one core

stage() {
    local name="$1"
    shift
    echo "== $name"
    "$VENV_PYTHON" -m "$@" </dev/null
}

setup_environment test,docs
setup_browser
stage "format" ruff format --check .
stage "lint" ruff check .
stage "types" mypy
stage "tests, notebooks, examples, pages" pytest -n auto --dist worksteal -q -m "not slow"
echo "== gate passed"
