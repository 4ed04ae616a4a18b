# Sourced by the other tools: puts coop_pin into .venv of this repository. Defines setup_environment and setup_browser; needs no stdin.

# Print the first interpreter that coop_pin supports; PYTHON overrides the search.
find_python() {
    local candidate
    for candidate in ${PYTHON:+"$PYTHON"} python3 python3.13 python3.12 python3.11; do
        if "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
    echo "no Python 3.11, 3.12 or 3.13 found; install one or name it: PYTHON=/path/to/python" >&2
    return 1
}

# Print a fingerprint of everything that decides what gets installed.
installation_hash() {
    "$1" - pyproject.toml constraints.txt <<'PY'
import hashlib, pathlib, sys
read = [pathlib.Path(name).read_bytes() for name in sys.argv[1:]]
print(hashlib.sha256(b"\0".join([sys.version.encode(), str(pathlib.Path.cwd()).encode(), *read])).hexdigest())
PY
}

# ticking TEXT COMMAND...: run a command that says nothing for long; on a terminal, tell every other second that it goes on.
ticking() {
    local text="$1" ticker code=0
    shift
    if [ ! -t 2 ]; then
        "$@"
        return
    fi
    (
        seconds=0
        while sleep 2; do
            seconds=$((seconds + 2))
            printf '\r== set-up: %s, %s s' "$text" "$seconds" >&2
        done
    ) &
    ticker=$!
    "$@" || code=$?
    kill "$ticker" 2>/dev/null
    wait "$ticker" 2>/dev/null || true
    printf '\r\033[K' >&2
    return "$code"
}

# setup_environment [EXTRA,...]: make .venv if there is none, install '.[EXTRA,...]' into it if something changed, and set VENV_PYTHON.
setup_environment() {
    local extra="${1:-}" stamp wanted python
    VENV_PYTHON="$PWD/.venv/bin/python"
    if [ ! -x "$VENV_PYTHON" ]; then
        echo "== set-up: creating .venv"
        python="$(find_python)"
        "$python" -m venv .venv
    fi
    stamp=".venv/coop_pin-${extra:-core}.stamp"
    wanted="$(installation_hash "$VENV_PYTHON")"
    if [ "$(cat "$stamp" 2>/dev/null || true)" = "$wanted" ]; then
        return
    fi
    echo "== set-up: installing coop_pin${extra:+[$extra]}"
    "$VENV_PYTHON" -m pip --version >/dev/null 2>&1 || "$VENV_PYTHON" -m ensurepip >/dev/null
    # -qq hides pip's warnings, not its errors; what is imported is compiled then: most never is
    ticking "installing" "$VENV_PYTHON" -m pip install -qq --no-compile --no-input --disable-pip-version-check -e ".${extra:+[$extra]}" -c constraints.txt </dev/null
    echo "$wanted" >"$stamp"
    echo "$wanted" >.venv/coop_pin-core.stamp # an extra brings the core with it
}

# setup_browser: install Debian's Chromium for the browser tests where there is none and we may; elsewhere those tests skip and say so.
setup_browser() {
    if [ -n "${CHROMIUM:-}" ] || command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null; then
        return
    fi
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        echo "== set-up: installing chromium"
        { apt-get update -qq </dev/null && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium </dev/null >/dev/null; } ||
            echo "== set-up: Chromium could not be installed; the browser tests will skip" >&2
    else
        echo "== set-up: there is no Chromium and no right to install it; the browser tests will skip" >&2
    fi
}
