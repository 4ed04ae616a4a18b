#!/usr/bin/env bash
# Builds the documentation site into out/docs; warnings are errors. Options go to sphinx: bash tools/docs.sh -D nb_execution_mode=off
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source tools/setup.sh

export MPLBACKEND=Agg OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}" OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}"
setup_environment docs
"$VENV_PYTHON" -m sphinx -E -b html -W --keep-going -n -q -d out/docs-doctrees "$@" docs out/docs </dev/null
echo "== written to out/docs/index.html"
