#!/usr/bin/env bash
# Run a command of the image with ROS, the virtual environment and the package on its paths.
set -eo pipefail
cd "$(dirname "$0")/.."
source scripts/env.sh
exec "$@"
