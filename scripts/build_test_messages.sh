#!/usr/bin/env bash
# Build the message packages of the event camera drivers that Python does not find, for tests.
# event_camera_msgs is released for Jazzy (ros-jazzy-event-camera-msgs): where it is installed, that
# one is used. The wheels of ROS have none of these packages, so their field lists are here.
# The packages go into .test_messages/install. The generators have an environment of their own
# there, which is removed after the build.
set -euo pipefail
cd "$(dirname "$0")/.."

ROS=/opt/ros/jazzy
ROOT=.test_messages
PACKAGES=(dvs_msgs prophesee_event_msgs dv_ros2_msgs event_camera_msgs event_array_msgs)

fail() {
    echo "error: $1" >&2
    exit 1
}

write_interface() { # package file line...
    mkdir -p "$ROOT/src/$1/msg"
    printf '%s\n' "${@:3}" >"$ROOT/src/$1/msg/$2"
}

write_package() { # package message...
    local folder=$ROOT/src/$1
    cat >"$folder/package.xml" <<XML
<package format="3">
  <name>$1</name>
  <version>0.0.0</version>
  <description>Test build of the messages of $1.</description>
  <maintainer email="maintainers@example.org">emoflow_ros maintainers</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>builtin_interfaces</depend>
  <depend>std_msgs</depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
XML
    cat >"$folder/CMakeLists.txt" <<CMAKE
cmake_minimum_required(VERSION 3.14)
project($1)
find_package(ament_cmake REQUIRED)
find_package(builtin_interfaces REQUIRED)
find_package(std_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(\${PROJECT_NAME} ${*:2} DEPENDENCIES builtin_interfaces std_msgs)
ament_export_dependencies(rosidl_default_runtime)
ament_package()
CMAKE
}

write_sources() {
    local package
    for package in dvs_msgs prophesee_event_msgs dv_ros2_msgs; do
        write_interface "$package" Event.msg \
            "uint16 x" "uint16 y" "builtin_interfaces/Time ts" "bool polarity"
        write_interface "$package" EventArray.msg \
            "std_msgs/Header header" "uint32 height" "uint32 width" "Event[] events"
        write_package "$package" msg/Event.msg msg/EventArray.msg
    done
    local packet=("std_msgs/Header header" "uint32 height" "uint32 width" "uint64 seq"
        "uint64 time_base" "string encoding" "bool is_bigendian" "uint8[] events")
    write_interface event_camera_msgs EventPacket.msg "${packet[@]}"
    write_package event_camera_msgs msg/EventPacket.msg
    write_interface event_array_msgs EventArray.msg "${packet[@]}"
    write_package event_array_msgs msg/EventArray.msg
}

# The wheels' CMake exports hold the paths of the machine that built the wheels.
mend_exports() {
    local venv=$1 include
    include=$("$venv/bin/python" -c "import sysconfig; print(sysconfig.get_path('include'))")
    find "$venv/share" -path '*/cmake/*Export.cmake' -exec sed -i \
        -e "s|/opt/python/cp312-cp312/include/python3.12|$include|g" \
        -e "s|/opt/python/cp312-cp312/lib|$venv/lib|g" {} +
}

build() { # package...
    local venv=$PWD/.venv log=$ROOT/build.log
    if [ -f "$ROS/setup.bash" ]; then
        set +u
        # shellcheck disable=SC1091
        source "$ROS/setup.bash"
        set -u
    else
        venv=$PWD/$ROOT/venv
        .venv/bin/python -m venv --without-pip "$venv"
        scripts/uv_install.sh "$venv" --requirements requirements-messages.lock
        mend_exports "$venv"
        export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv
    fi
    write_sources
    "$venv/bin/python" -m colcon --log-base "$ROOT/log" build --base-paths "$ROOT/src" \
        --packages-select "$@" --build-base "$ROOT/build" --install-base "$ROOT/install" \
        --cmake-args -DPython3_EXECUTABLE="$venv/bin/python" -DBUILD_TESTING=OFF \
        >"$log" 2>&1 || { cat "$log" >&2; fail "the test messages could not be built"; }
    rm -rf "$ROOT/venv" "$ROOT/build"
}

# Name the packages that Python does not find.
missing() {
    ( # shellcheck disable=SC1091
        set +eu
        source scripts/env.sh
        for package in "${PACKAGES[@]}"; do
            python -c "import $package.msg" 2>/dev/null || echo "$package"
        done
    )
}

stamp=$ROOT/stamp
if [ -f "$stamp" ] && cmp -s "$stamp" <(cat "$0" requirements-messages.lock) &&
    [ -z "$(missing)" ]; then
    exit 0
fi
rm -rf "$ROOT" # an earlier build would hide what is installed
mapfile -t needed < <(missing)
[ ${#needed[@]} -gt 0 ] || exit 0
command -v cmake >/dev/null || fail "no cmake found; install cmake"
command -v "${CXX:-c++}" >/dev/null || fail "no C++ compiler found; install g++"
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE VIRTUAL_ENV
echo "setup: test messages (${needed[*]})"
mkdir -p "$ROOT"
touch "$ROOT/COLCON_IGNORE"
build "${needed[@]}"
cat "$0" requirements-messages.lock >"$stamp"
