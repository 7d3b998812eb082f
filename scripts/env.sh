# Source this to run the package, its tests and its tools from the repository root.
# shellcheck shell=bash disable=SC1090,SC1091
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE
for _setup in /opt/ros/jazzy/setup.bash .test_messages/install/local_setup.bash \
    install/local_setup.bash; do
    if [ -f "$_setup" ]; then
        source "$_setup"
    fi
done
unset _setup
export PATH="$PWD/.venv/bin:$PATH"
export PYTHONPATH="$PWD${PYTHONPATH:+:$PYTHONPATH}"
# Small windows gain nothing from more threads, and tests run several processes at once.
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}" NUMBA_NUM_THREADS="${NUMBA_NUM_THREADS:-2}"
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
