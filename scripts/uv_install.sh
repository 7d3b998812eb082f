#!/usr/bin/env bash
# Install packages into a virtual environment by uv: uv_install.sh ENVIRONMENT OPTION... (those of
# `uv pip install`). uv itself has 38 MB and is wanted for this only, so that it does not stay.
set -euo pipefail
cd "$(dirname "$0")/.."

tools=$(mktemp -d)
trap 'rm -rf "$tools"' EXIT
.venv/bin/python -m pip install --quiet --disable-pip-version-check --target "$tools" \
    --constraint requirements.lock uv
"$tools/bin/uv" pip install --quiet --python "$1/bin/python" "${@:2}"
