"""The documented lines for a workspace with ROS 2 Jazzy, against a prefix like /opt/ros/jazzy.

The prefix is put together from the wheels of rclpy: setup.bash, lib and share. Where a machine
without ROS has no more, something else stands in:

- `ros2 run` is a script that starts the executable which the real one would start: the wheels have
  no ros2cli. The launch file of `ros2 launch` is looked for, and not started.
- PYTHONPATH names a folder with the Python packages that apt and pip would install. pip checks
  their versions and installs nothing, since nothing is missing.
- `rosdep` is a script that checks its arguments, since the real one needs apt. So these tests
  cannot see whether rosdep finds the keys of package.xml. docker/Dockerfile has its line, too.
"""

import os
import re
import shlex
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from importlib.metadata import distributions
from pathlib import Path

import pytest
from event_bags import write_event_bag

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.simulation.recording import simulate

ROOT = Path(__file__).resolve().parents[1]
MESSAGES = ROOT / ".test_messages" / "install"
REAL = Path("/opt/ros/jazzy")
CAMERA = Camera(120, 90, 110.0, 110.0, 60.0, 45.0)
WAIT_S = 600.0  # only what hangs takes so long, also on a busy machine
SETUP = """\
export AMENT_PREFIX_PATH={0}${{AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}}
export LD_LIBRARY_PATH={0}/lib${{LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}}
export PYTHONPATH={0}/{1}${{PYTHONPATH:+:$PYTHONPATH}}
export PATH={0}/bin:$PATH
"""
ROS2 = """\
#!/usr/bin/env bash
[ "$1" = run ] || exit 2
for prefix in ${AMENT_PREFIX_PATH//:/ }; do
    [ -x "$prefix/lib/$2/$3" ] && exec "$prefix/lib/$2/$3" "${@:4}"
done
echo "no executable $3 of $2" >&2
exit 1
"""
ROSDEP = """\
#!/usr/bin/env bash
[ "$*" = "install --from-paths src --ignore-src --rosdistro jazzy --yes" ] && [ -d src ]
"""
CALIBRATION = """\
image_width: 120
image_height: 90
camera_name: davis
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
camera_matrix: {rows: 3, cols: 3, data: [110, 0, 60, 0, 110, 45, 0, 0, 1]}
"""

pytestmark = [
    pytest.mark.skipif(REAL.exists(), reason=f"{REAL} is there, so that the wheels are not"),
    pytest.mark.skipif(
        not MESSAGES.is_dir(), reason="no dvs_msgs: run scripts/build_test_messages.sh"
    ),
]


def lines(page: str, heading: str) -> list[str]:
    """Commands of the first block below a heading."""
    section = (ROOT / page).read_text().partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    return re.findall(r"^```\n(.*?)^```$", section, re.DOTALL | re.MULTILINE)[0].splitlines()


def link(source: Path, target: Path) -> None:
    """Make folders like those of the source, with links to its files."""
    target.mkdir(parents=True, exist_ok=True)
    subprocess.run(["cp", "-rsn", f"{source}/.", target], check=True)


def make_prefix(prefix: Path, others: Path) -> None:
    """Lay ROS out from the wheels and the test messages; packages that are not of ROS go apart."""
    modules = Path("lib") / f"python{sysconfig.get_python_version()}" / "site-packages"
    site = Path(sysconfig.get_path("purelib"))
    (prefix / modules).mkdir(parents=True)
    others.mkdir()
    of_ros = {
        path.parts[0]
        for wheel in distributions(path=[str(site)])
        if wheel.name.startswith("ros-")
        for path in wheel.files or ()
    }
    for path in site.iterdir():
        (prefix / modules if path.name in of_ros else others).joinpath(path.name).symlink_to(path)
    for library in (Path(sys.prefix) / "lib").glob("*.so*"):
        (prefix / "lib" / library.name).symlink_to(library)
    for folder in site.glob("ros_*.libs"):
        link(folder, prefix / "lib")
    link(Path(sys.prefix) / "share", prefix / "share")
    for package in MESSAGES.iterdir():
        if package.is_dir():
            link(package / "lib", prefix / "lib")
            link(package / "share", prefix / "share")
    (prefix / "bin").mkdir()
    for name, text in (("ros2", ROS2), ("rosdep", ROSDEP)):
        (prefix / "bin" / name).write_text(text)
        (prefix / "bin" / name).chmod(0o755)
    for name in ("setup.bash", "local_setup.bash"):  # the latter is for workspaces on top of it
        (prefix / name).write_text(SETUP.format(prefix, modules))


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with the repository in src, a recording and its calibration."""
    folder = tmp_path_factory.mktemp("workspace")
    (folder / "src").mkdir()
    (folder / "src" / "emoflow_ros").symlink_to(ROOT)
    (folder / "camera.yaml").write_text(CALIBRATION)
    events = simulate("calm", duration_s=0.47, seed=5, camera=CAMERA, fps=250).events
    size = (CAMERA.width, CAMERA.height)
    write_event_bag(folder / "BAG", [events], size=size, with_info=False, storage="sqlite3")
    return folder


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What a user's shell has on Ubuntu, and nothing of this process's environment of Python."""
    folder = tmp_path_factory.mktemp("ubuntu")
    make_prefix(folder / "jazzy", folder / "dist-packages")
    kept = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "OMP_NUM_THREADS", "NUMBA_CACHE_DIR")
    return {name: os.environ[name] for name in kept if name in os.environ} | {
        "HOME": str(folder),
        "PATH": os.pathsep.join([f"{sys.base_prefix}/bin", "/usr/bin", "/bin"]),
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        "PIP_NO_INDEX": "1",
        "PYTHONPATH": str(folder / "dist-packages"),
        "PYTHONUNBUFFERED": "1",
    }


def shell(commands: list[str], folder: Path, environment: dict[str, str]) -> str:
    """Run commands in one shell, up to the first that fails; what they print."""
    ran = subprocess.run(
        ["bash", "-ec", "\n".join(commands)],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout + ran.stderr


@pytest.fixture(scope="module")
def installed(workspace: Path, environment: dict[str, str]) -> Path:
    """The workspace after the lines of docs/operations.md."""
    commands = lines("docs/operations.md", "Install")
    assert commands[0] == f"source {REAL}/setup.bash"
    assert [c.split()[0] for c in commands[-2:]] == [".venv/bin/python", "source"]
    prefix = Path(environment["HOME"]) / "jazzy"
    shell([c.replace(str(REAL), str(prefix)) for c in commands], workspace, environment)
    return workspace


@pytest.fixture
def node(installed: Path, environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """The estimator, by its line in the README."""
    command = lines("README.md", "Your own camera")[0]
    assert command.startswith("ros2 run emoflow_ros estimator ")
    process = subprocess.Popen(
        ["bash", "-ec", f"source install/setup.bash\nexec {command}"],
        cwd=installed, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, start_new_session=True,
    )  # fmt: skip
    yield process
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def test_recording_is_read_and_evaluated_by_the_lines_of_the_readme(
    installed: Path, environment: dict[str, str]
) -> None:
    info, evaluate, _ = lines("README.md", "Your own recording")
    source = "source install/setup.bash"
    assert "dvs_msgs/msg/EventArray" in shell([source, info], installed, environment)
    shell([source, evaluate], installed, environment)
    assert list(installed.glob("**/report.html"))


def test_node_takes_a_replay_by_the_lines_of_the_readme(
    installed: Path, environment: dict[str, str], node: subprocess.Popen[str]
) -> None:
    replay = lines("README.md", "Your own recording")[2]
    shell(["source install/setup.bash", replay], installed, environment)
    os.killpg(node.pid, signal.SIGINT)
    said, _ = node.communicate(timeout=WAIT_S)
    assert node.returncode == 0, said
    assert "/cam/events" in said


def test_launch_file_of_the_readme_is_installed(installed: Path) -> None:
    command = shlex.split(lines("README.md", "Your own camera")[1])
    assert command[:3] == ["ros2", "launch", "emoflow_ros"]
    path = installed / "install" / "emoflow_ros" / "share" / "emoflow_ros" / "launch" / command[3]
    compile(path.read_text(), path, "exec")


def test_container_asks_rosdep_for_what_package_xml_names() -> None:
    text = (ROOT / "docker" / "Dockerfile").read_text()
    assert "COPY package.xml ./\n" in text.partition("rosdep install")[0]
    assert re.search(r"rosdep install --from-paths \. --ignore-src --rosdistro jazzy", text)
