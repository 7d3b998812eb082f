#!/usr/bin/env bash
# Bring the lock files up to date with requirements*.in. Run it after editing one of those;
# with --upgrade it takes the newest versions that they allow.
set -euo pipefail
cd "$(dirname "$0")/.."

upgrade=("$@")

lock() {
    .venv/bin/uv pip compile --quiet --no-header --no-annotate \
        --no-emit-index-url --no-emit-find-links \
        --python .venv/bin/python "$1.in" --output-file "$1.lock" "${@:2}" "${upgrade[@]}"
}

lock requirements requirements-{offline,ray,test,torch}.in
lock requirements-ros --constraints requirements.lock  # both go into one environment
lock requirements-messages
