"""Start the estimator: `ros2 launch emoflow_ros estimator.launch.py events:=/cam/events`."""

from typing import Any

ARGUMENTS = {
    "events": ("events", "topic of the event messages; alone in the graph it is found"),
    "camera_info": ("camera_info", "calibration topic; default: the one beside the events"),
    "calibration_file": ("", "camera_info YAML or ECD calib.txt instead of the topic"),
    "profile": ("realtime", "configuration: the name of a file in config/"),
    "params_file": ("", "YAML file of ROS parameters, counts before all other arguments"),
    "twist_rate": ("0.0", "twists per second, sampled inside the windows; 0: one per window"),
    "speed": ("", "speed of the camera in m/s, if it is known; empty: directions without a scale"),
    "use_sim_time": ("false", "take time from /clock"),
    "namespace": ("", "namespace of the node and its topics"),
}


def generate_launch_description() -> Any:
    """Describe one estimator."""
    # Not at the top: a machine without the launch packages can still import this file.
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, OpaqueFunction

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_start)])


def _start(context: Any) -> list[Any]:
    from launch.substitutions import LaunchConfiguration
    from launch_ros.actions import Node

    value = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    parameters: list[Any] = [
        {
            "use_sim_time": value["use_sim_time"].lower() == "true",
            "profile": value["profile"],
            "camera.calibration_file": value["calibration_file"],
            "output.twist_rate": float(value["twist_rate"]),
        }
    ]
    if value["speed"]:
        parameters[0] |= {"scale.source": "parameter", "scale.speed": float(value["speed"])}
    if value["params_file"]:
        parameters.append(value["params_file"])
    changed = [
        (name, value[name])
        for name in ("events", "camera_info")
        if value[name] != ARGUMENTS[name][0]
    ]
    node = Node(
        package="emoflow_ros",
        executable="estimator",
        namespace=value["namespace"],
        parameters=parameters,
        remappings=changed,
        output="screen",
    )
    return [node]
