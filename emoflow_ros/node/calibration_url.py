"""Where the file of `camera.calibration_file` is."""

from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from emoflow_ros.errors import InputError

_PACKAGE = "package://"
_FILE = "file://"


def calibration_path(url: str) -> Path:
    """Find the file of `package://PACKAGE/PATH`, `file://PATH` or a plain path.

    The forms are those of camera_info_manager.

    Raises:
        InputError: the package is not installed, or the URL leaves its folder.
    """
    if not url.startswith(_PACKAGE):
        return Path(url.removeprefix(_FILE))
    package, _, path = url.removeprefix(_PACKAGE).partition("/")
    try:
        share = Path(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError):
        raise InputError(
            url, f"the package {package} is not installed", "install it, or give a path"
        ) from None
    if ".." in Path(path).parts:
        raise InputError(url, "leaves the package's folder", "give a path without '..'")
    return share / path
