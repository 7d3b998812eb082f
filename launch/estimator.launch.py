"""Start the estimator: `ros2 launch emoflow_ros estimator.launch.py events:=/cam/events`.

Others include it once per camera, each with a namespace of its own.
"""

from pathlib import Path
from typing import Any

ARGUMENTS = {
    "events": ("events", "topic of the event messages; default: the only event topic there is"),
    "camera_info": ("camera_info", "calibration topic; default: the one beside the events"),
    "imu": ("", "topic of an IMU whose gyro is to be used, as imu.use=auto; empty: none is"),
    "calibration_file": (
        "",
        "file (camera_info YAML, Kalibr, OpenCV, ECD) instead of the topic",
    ),
    "profile": ("realtime", "configuration: the name of a file in config/"),
    "params_file": (
        "",
        "YAML file of ROS parameters, or the name of one in config/sensors (mvsec, dsec, davis240, "
        "evk4); its values replace those of profile and twist_rate",
    ),
    "twist_rate": ("60.0", "twists per second, of the newest event; 0: one per window"),
    "speed": ("", "speed of the camera in m/s, if it is known; empty: directions without a scale"),
    "frame": ("", "optical frame of the camera; empty: that of the event messages"),
    "use_sim_time": ("false", "take time from /clock"),
    "namespace": ("", "namespace of the node and its topics"),
    "rviz": ("false", "show flow, sharpened events, tracks and twist in RViz"),
}
VIEWED = ("egomotion/twist", "flow/color", "flow/iwe", "flow/tracks")

_CONFIG = Path(__file__).resolve().parent.parent / "config"


def generate_launch_description() -> Any:
    """Describe one estimator, and RViz beside it if that is wanted."""
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

    from emoflow_ros.node.ros_arguments import flag, refuse_unknown, require_package

    refuse_unknown(Path(__file__).name, ARGUMENTS)
    value = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    parameters = _parameters(value)
    rviz = flag("rviz", value["rviz"])
    if rviz:  # found missing later, the estimator would be left alone
        require_package("rviz", "rviz2")
    nodes = [
        Node(
            package="emoflow_ros",
            executable="estimator",
            namespace=value["namespace"],
            parameters=parameters,
            remappings=[
                (name, value[name])
                for name in ("events", "camera_info", "imu")
                if value[name] != ARGUMENTS[name][0]
            ],
            output="screen",
            on_exit=_end_all_where_it_failed,
        )
    ]
    if rviz:
        frame = ["-f", value["frame"]] if value["frame"] else []
        nodes.append(
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=value["namespace"],
                arguments=["-d", str(_CONFIG / "layouts" / "emoflow.rviz"), *frame],
                parameters=[{"use_sim_time": parameters[0]["use_sim_time"]}],
                remappings=[(f"/{topic}", topic) for topic in VIEWED],
            )
        )
    return nodes


def _end_all_where_it_failed(event: Any, context: Any) -> None:
    """Leave no RViz and no replay alone, unless somebody else's launch file includes this one."""
    from emoflow_ros.node.ros_arguments import is_launched, require_success

    if is_launched(Path(__file__).name, "replay.launch.py"):
        require_success("estimator", event.returncode)


def _parameters(value: dict[str, str]) -> list[Any]:
    """List the sources of parameters: later ones count before earlier ones."""
    from emoflow_ros.config import load_config
    from emoflow_ros.core.geometry.calibration import load_calibration
    from emoflow_ros.node.calibration_url import calibration_path
    from emoflow_ros.node.ros_arguments import flag, number, parameter_file

    load_config(value["profile"])
    if value["calibration_file"]:
        load_calibration(calibration_path(value["calibration_file"]))
    arguments: dict[str, Any] = {
        "use_sim_time": flag("use_sim_time", value["use_sim_time"]),
        "profile": value["profile"],
        "output.twist_rate": number("twist_rate", value["twist_rate"]),
    }
    if value["speed"]:
        arguments |= {"scale.source": "parameter", "scale.speed": number("speed", value["speed"])}
    if value["imu"]:
        arguments["imu.use"] = "auto"
    sources: list[Any] = [arguments]
    if value["params_file"]:
        sources.append(parameter_file(value["params_file"], _CONFIG / "sensors"))
    camera = {
        "camera.calibration_file": value["calibration_file"],
        "camera.frame_id": value["frame"],
    }
    if any(camera.values()):
        sources.append({name: given for name, given in camera.items() if given})
    return sources
