"""The calibration that a bag holds: camera_info beside the events."""

from pathlib import Path

from emoflow_ros.core.geometry.calibration import camera_from_info
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.errors import InputError, say
from emoflow_ros.readers.bag_files import Bag, deserialize, read_messages


def camera_beside(path: Path, bag: Bag, topic: str) -> Camera | None:
    """Read the first usable camera_info in the namespace of an event topic.

    Drivers that load their calibration late publish zeros first.

    Returns:
        The camera, of which what was assumed is said; None where there is no such message.

    Raises:
        InputError: there are some, and not one can be used.
    """
    name = topic.rpartition("/")[0] + "/camera_info"
    found = [c for c in bag.connections if c.topic == name]
    if not found:
        return None
    where = f"{path} {name}"
    refused: InputError | None = None
    for connection, _, data in read_messages(path, bag, found):
        info = deserialize(bag, connection, data)
        try:
            camera = camera_from_info(info, where, "a calibration with --calib FILE")
        except InputError as error:
            refused = refused or error
            continue
        if camera.note:
            say(where, camera.note)
        return camera
    if refused is not None:
        raise refused
    return None
