"""Replay a bag through the estimator: `ros2 launch emoflow_ros replay.launch.py bag:=FILE`."""

from pathlib import Path
from typing import Any

ARGUMENTS = {
    "bag": (None, "ROS 1 .bag, rosbag2 folder, .mcap or .db3 file"),
    "rate": ("1.0", "pace: 2.0 is twice as fast"),
    "wait": ("60", "seconds to wait for the estimator, which needs a while to warm up"),
}


def generate_launch_description() -> Any:
    """Describe a replay and an estimator, which takes the arguments of its own launch file."""
    # Not at the top: a machine without the launch packages can still import this file.
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
    from launch.launch_description_sources import PythonLaunchDescriptionSource
    from launch.substitutions import LaunchConfiguration
    from launch_ros.actions import Node

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    estimator = Path(__file__).with_name("estimator.launch.py")
    bag, rate, wait = (LaunchConfiguration(name) for name in ARGUMENTS)
    replay = Node(
        package="emoflow_ros",
        executable="replay",
        arguments=[bag, "--rate", rate, "--wait", wait],
        output="screen",
    )
    include = IncludeLaunchDescription(PythonLaunchDescriptionSource(str(estimator)))
    return LaunchDescription([*declared, include, replay])
