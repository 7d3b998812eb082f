"""package.xml names what the package imports, by keys that rosdep knows.

The two lists of known keys were written by hand: SYSTEM_KEYS from rosdistro's base.yaml and
python.yaml, ROS_PACKAGES from the distribution of Jazzy. They hold no key that is uncertain: look a
key up there before you add it here.
"""

import ast
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("emoflow_ros", "msg_adapters", "launch")
OWN = {"emoflow_ros", "msg_adapters"}
REQUIREMENTS = ("requirements.in", *(f"requirements-{p}.in" for p in ("offline", "ray", "torch")))

ROS_PACKAGES = {
    "ament_index_python",
    "builtin_interfaces",
    "diagnostic_msgs",
    "event_camera_msgs",
    "geometry_msgs",
    "launch",
    "launch_ros",
    "launch_xml",
    "lifecycle_msgs",
    "nav_msgs",
    "rcl_interfaces",
    "rclpy",
    "ros2bag",
    "ros2cli",
    "ros2launch",
    "ros2run",
    "rosbag2_py",
    "rosbag2_storage_mcap",
    "rosgraph_msgs",
    "rviz2",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_msgs",
    "tf2_ros",
    "tf2_ros_py",
    "visualization_msgs",
}
SYSTEM_KEYS = {
    "python3-h5py",
    "python3-hypothesis",
    "python3-jinja2",
    "python3-matplotlib",
    "python3-numpy",
    "python3-opencv",
    "python3-pil",
    "python3-psutil",
    "python3-pytest",
    "python3-scipy",
    "python3-setuptools",
    "python3-tqdm",
    "python3-yaml",
}

PIP = "pip"
# By import: the rosdep key, or PIP for what pip alone installs.
KEY_OF = {
    "aedat": PIP,
    "ament_index_python": "ament_index_python",
    "backports": PIP,
    "builtin_interfaces": "builtin_interfaces",
    "cv2": "python3-opencv",
    "diagnostic_msgs": "diagnostic_msgs",
    "geometry_msgs": "geometry_msgs",
    "h5py": "python3-h5py",
    "hdf5plugin": PIP,
    "jinja2": "python3-jinja2",
    "launch": "launch",
    "launch_ros": "launch_ros",
    "lifecycle_msgs": "lifecycle_msgs",
    "matplotlib": "python3-matplotlib",
    "numba": PIP,
    "numpy": "python3-numpy",
    "psutil": "python3-psutil",
    "ray": PIP,
    "rcl_interfaces": "rcl_interfaces",
    "rclpy": "rclpy",
    "rosbags": PIP,
    "rosgraph_msgs": "rosgraph_msgs",
    "scipy": "python3-scipy",
    "sensor_msgs": "sensor_msgs",
    "skimage": PIP,
    "std_msgs": "std_msgs",
    "tf2_ros": "tf2_ros_py",
    "threadpoolctl": PIP,
    "torch": PIP,
    "torchdiffeq": PIP,
    "tqdm": "python3-tqdm",
    "visualization_msgs": "visualization_msgs",
    "yaml": "python3-yaml",
}
# Names in requirements*.in that differ from the import.
REQUIREMENT_OF = {
    "backports": "backports-zstd",
    "cv2": "opencv-python-headless",
    "skimage": "scikit-image",
    "yaml": "pyyaml",
}
# Used without an import in the sources.
NOT_IMPORTED = {
    "nav_msgs",  # the node imports it by name for scale.source: topic
    "python3-hypothesis",  # tests
    "python3-pytest",  # tests
    "ros2bag",  # `ros2 bag record` in replay.launch.py
    "ros2launch",  # `ros2 launch`
    "rosbag2_storage_mcap",  # what `ros2 bag record` writes
}


def depends() -> list[str]:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    return [str(tag.text) for tag in manifest if tag.tag.endswith("depend")]


def imported_names(tree: ast.AST) -> Iterator[str]:
    """Modules of all import statements, and of `import_module` with a constant."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield str(node.module)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            first = node.args[0]
            if isinstance(first, ast.Constant):
                yield str(first.value)


def third_party_imports() -> set[str]:
    paths = [path for folder in SOURCES for path in (ROOT / folder).rglob("*.py")]
    assert len(paths) > 50
    found = {
        name.partition(".")[0]
        for path in paths
        for name in imported_names(ast.parse(path.read_text(encoding="utf-8")))
    }
    return found - OWN - set(sys.stdlib_module_names)


def required_by_pip() -> set[str]:
    lines = [line for name in REQUIREMENTS for line in (ROOT / name).read_text().splitlines()]
    return {found[0].lower() for line in lines if (found := re.match(r"[\w-]+", line))}


def test_package_xml_is_complete_and_well_formed() -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    assert (manifest.tag, manifest.get("format")) == ("package", "3")
    for tag in ("name", "version", "description", "maintainer", "license"):
        assert (manifest.findtext(tag) or "").strip(), tag
    assert manifest.findtext("export/build_type") == "ament_python"
    names = depends()
    assert len(names) == len(set(names)) > 10


def test_every_import_is_in_the_table_and_the_table_has_no_other() -> None:
    assert third_party_imports() == set(KEY_OF)


@pytest.mark.parametrize("name", KEY_OF)
def test_every_import_has_its_dependency(name: str) -> None:
    if KEY_OF[name] == PIP:
        assert REQUIREMENT_OF.get(name, name) in required_by_pip()
    else:
        assert KEY_OF[name] in depends()
    if KEY_OF[name] in SYSTEM_KEYS:  # without /opt/ros/jazzy pip installs it
        assert REQUIREMENT_OF.get(name, name) in required_by_pip()


@pytest.mark.parametrize("key", depends())
def test_every_dependency_is_a_known_key_and_is_used(key: str) -> None:
    assert key in ROS_PACKAGES | SYSTEM_KEYS
    assert key in set(KEY_OF.values()) | NOT_IMPORTED


def test_an_invented_key_and_an_unknown_import_are_found() -> None:
    assert "python3-emoflow" not in ROS_PACKAGES | SYSTEM_KEYS
    tree = ast.parse("import a.b, numpy\nfrom c.d import e\nx = import_module('f.g')\n")
    assert list(imported_names(tree)) == ["a.b", "numpy", "c.d", "f.g"]
