#!/usr/bin/env bash
# Write the lock files anew from requirements*.in. Run it after editing one of those.
set -euo pipefail
cd "$(dirname "$0")/.."

for name in requirements requirements-ros requirements-messages; do
    .venv/bin/uv pip compile --quiet --upgrade --no-header --no-annotate \
        --no-emit-index-url --no-emit-find-links \
        --python .venv/bin/python "$name.in" --output-file "$name.lock"
done
