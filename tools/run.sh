#!/usr/bin/env bash
# Runs the paper's experiment. Usage: bash tools/run.sh [FOLDER]; results go to FOLDER, out/adept-paper unless stated.
set -euo pipefail
out="${1:-out/adept-paper}"
case "$out" in /*) ;; *) [ $# -eq 0 ] || out="$PWD/$out" ;; esac # a folder is named from where the user stands
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source tools/setup.sh

setup_environment
exec .venv/bin/coop-pin run adept-paper --out "$out"
