#!/usr/bin/env bash
# Write the lock files anew from requirements*.in. Run it after editing one of those.
set -euo pipefail
cd "$(dirname "$0")/.."

lock() {
    .venv/bin/uv pip compile --quiet --upgrade --no-header --no-annotate \
        --no-emit-index-url --no-emit-find-links \
        --python .venv/bin/python "$1.in" --output-file "$1.lock" "${@:2}"
}

lock requirements
lock requirements-ros --constraints requirements.lock  # both go into one environment
lock requirements-messages
