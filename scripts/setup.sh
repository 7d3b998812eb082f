#!/usr/bin/env bash
# Make .venv, install the pinned requirements and build the package into install/.
# A second call finds nothing to do and ends at once. PARTS=light leaves out what is optional at run
# time (PyTorch, Ray, libraries of single file formats) and what only tests need.
set -euo pipefail
cd "$(dirname "$0")/.."

ROS=/opt/ros/jazzy
VENV=.venv
PYTHON_WANTED=3.12
PARTS=${PARTS:-full}

fail() {
    echo "error: $1" >&2
    exit 1
}

# Child processes of a ROS wheel's interpreter inherit its guard, which breaks the next one.
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE VIRTUAL_ENV
if [ -f "$ROS/setup.bash" ]; then
    set +u
    # shellcheck disable=SC1091
    source "$ROS/setup.bash"
    set -u
fi

runs_wanted_python() {
    "$1" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$PYTHON_WANTED')" 2>/dev/null
}

find_python() {
    local candidate
    for candidate in "${PYTHON:-}" "python$PYTHON_WANTED" python3 \
        "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"$PYTHON_WANTED".*/bin/python \
        "$(uv python find "$PYTHON_WANTED" 2>/dev/null || true)"; do
        if [ -n "$candidate" ] && runs_wanted_python "$candidate"; then
            echo "$candidate"
            return
        fi
    done
    fail "no Python $PYTHON_WANTED found (ROS 2 Jazzy needs it); install python$PYTHON_WANTED and\
 python$PYTHON_WANTED-venv, run 'uv python install $PYTHON_WANTED', or set PYTHON=/path/to/python"
}

# Digest of what decides the contents of .venv and install/; the sources themselves are linked.
digest() {
    {
        cat scripts/{setup,uv_install}.sh requirements{,-ros}.{in,lock} requirements-{offline,ray,test,torch}.in
        cat package.xml setup.py setup.cfg
        find launch config resource -type f | sort
        [ -d "$ROS" ] && echo "$ROS"
        pwd
    } | sha256sum | cut -d " " -f 1
}

make_venv() {
    local python options=()
    python=$(find_python)
    [ -d "$ROS" ] && options=(--system-site-packages)
    echo "setup: $VENV with $("$python" --version)"
    "$python" -m venv --clear "${options[@]}" "$VENV" ||
        fail "$python cannot make a virtual environment; install python$PYTHON_WANTED-venv"
    touch "$VENV/COLCON_IGNORE"
}

# The lock constrains and does not list what to install, so that a CPU build of PyTorch
# (UV_TORCH_BACKEND=cpu) leaves the CUDA libraries out.
install_requirements() {
    local part options=(--constraints requirements.lock --requirements requirements.in)
    local size="600 MB"
    if [ "$PARTS" != light ]; then
        for part in offline ray test torch; do
            options+=(--requirements "requirements-$part.in")
        done
        size="several gigabytes"
    fi
    [ -d "$ROS" ] || options+=(--requirements requirements-ros.in --constraints requirements-ros.lock)
    echo "setup: requirements ($size the first time)"
    scripts/uv_install.sh "$VENV" "${options[@]}"
    # Wheels of ROS bring the same libraries several times, and headers to build against them.
    rm -rf "$VENV"/include/*
    if command -v hardlink >/dev/null; then
        hardlink --quiet --ignore-time "$VENV/lib"
    fi
}

build_package() {
    local log
    log=$(mktemp)
    echo "setup: colcon build into install/"
    if ! "$VENV/bin/python" -m colcon build --base-paths . --packages-select emoflow_ros \
        --symlink-install >"$log" 2>&1; then
        cat "$log" >&2
        fail "colcon build failed"
    fi
    rm -f "$log"
}

stamp=$VENV/.emoflow_setup
if [ -f "$stamp" ] && [ -f install/setup.bash ]; then
    read -r made parts <"$stamp"
    if [ "$made" = "$(digest)" ] && [[ $parts == full || $PARTS == light ]]; then
        exit 0
    fi
fi
if ! runs_wanted_python "$VENV/bin/python" || [ ! -x "$VENV/bin/pip" ]; then
    make_venv
fi
install_requirements
rm -rf build install
build_package
echo "$(digest) $PARTS" >"$stamp"
