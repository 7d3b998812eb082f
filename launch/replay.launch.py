"""Replay a bag through the estimator: `ros2 launch emoflow_ros replay.launch.py bag:=FILE`.

Takes the arguments of estimator.launch.py, too; with `use_sim_time:=true` the bag is the clock.
"""

from pathlib import Path
from runpy import run_path
from typing import Any

ARGUMENTS = {
    "bag": (None, "ROS 1 .bag, rosbag2 folder, .mcap or .db3 file"),
    "rate": ("1.0", "pace: 2.0 is twice as fast"),
    "wait": ("60", "seconds to wait for the estimator, which needs a while to warm up"),
    "record": ("", "folder of a new bag of what the estimator says; empty: none"),
}
RECORDED = (
    "egomotion/twist",
    "egomotion/twist_now",
    "egomotion/twist_with_covariance",
    "egomotion/status",
)

_ESTIMATOR = Path(__file__).with_name("estimator.launch.py")


def generate_launch_description() -> Any:
    """Describe a replay, an estimator and a recorder of its answers."""
    # Not at the top: a machine without the launch packages can still import this file.
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    include = IncludeLaunchDescription(PythonLaunchDescriptionSource(str(_ESTIMATOR)))
    check, start = OpaqueFunction(function=_check), OpaqueFunction(function=_start)
    return LaunchDescription([*declared, check, include, start])


def _check(context: Any) -> None:
    """Refuse a bag that is not there, or an unknown argument, before the estimator is started."""
    from launch.substitutions import LaunchConfiguration

    from emoflow_ros.node.ros_arguments import refuse_unknown, require_path

    known = [*ARGUMENTS, *run_path(str(_ESTIMATOR))["ARGUMENTS"]]
    refuse_unknown(Path(__file__).name, known)
    require_path("bag", LaunchConfiguration("bag").perform(context))


def _start(context: Any) -> list[Any]:
    from launch.actions import ExecuteProcess
    from launch.substitutions import LaunchConfiguration
    from launch_ros.actions import Node

    from emoflow_ros.node.ros_arguments import flag

    names = (*ARGUMENTS, "use_sim_time", "namespace")
    value = {name: LaunchConfiguration(name).perform(context) for name in names}
    clock = ["--clock"] if flag("use_sim_time", value["use_sim_time"]) else []
    actions = [
        Node(
            package="emoflow_ros",
            executable="replay",
            arguments=[value["bag"], "--rate", value["rate"], "--wait", value["wait"], *clock],
            output="screen",
            on_exit=_end_all_where_it_failed,
        )
    ]
    if value["record"]:
        prefix = f"/{value['namespace'].strip('/')}" if value["namespace"].strip("/") else ""
        topics = [*(f"{prefix}/{topic}" for topic in RECORDED), "/diagnostics"]
        command = ["ros2", "bag", "record", "--output", value["record"], *topics]
        actions.append(ExecuteProcess(cmd=command, output="screen"))
    return actions


def _end_all_where_it_failed(event: Any, context: Any) -> None:
    """Leave no estimator that waits for a bag which cannot be replayed."""
    from emoflow_ros.node.ros_arguments import require_success

    require_success("replay", event.returncode)
