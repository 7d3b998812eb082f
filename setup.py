"""Build description of the ROS 2 package (ament_python)."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "emoflow_ros"

setup(
    name=PACKAGE,
    version="0.2.0",
    description="Camera egomotion and dense optical flow from event cameras.",
    license="Apache-2.0",
    python_requires=">=3.12",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*", "msg_adapters", "msg_adapters.*"]),
    package_data={f"{PACKAGE}.report": ["templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{PACKAGE}/config", sorted(glob("config/*.yaml"))),
        *(
            (f"share/{PACKAGE}/config/{folder}", sorted(glob(f"config/{folder}/*")))
            for folder in ("calibration", "dds", "filters", "layouts", "sensors")
        ),
    ],
    extras_require={"test": ["pytest"], "ray": ["ray"]},
    entry_points={
        "console_scripts": [
            f"estimator = {PACKAGE}.node.executable:main",
            f"replay = {PACKAGE}.cli:replay",
            f"evaluate = {PACKAGE}.cli:evaluate",
            f"simulate = {PACKAGE}.cli:simulate",
            f"info = {PACKAGE}.cli:info",
            f"label = {PACKAGE}.cli:label",
        ],
    },
)
