"""The calibration that a bag brings or that is given: which one counts, and what is said."""

import pytest
from event_bags import INFO, make_events, write_event_bag

from emoflow_ros.commands.info import inspect
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording

K = INFO[2]
D = (0.1, 0.02, 0.003, 0.004, 0.0)
UNCALIBRATED = ("", (), (0.0,) * 9)


@pytest.fixture(params=["ros1", "sqlite3", "mcap"])
def write(request, tmp_path):
    def write(*infos):
        path = tmp_path / ("a.bag" if request.param == "ros1" else "a")
        return write_event_bag(path, [make_events(100)], storage=request.param, infos=infos)

    return write


def camera_of(path, **options):
    with open_recording(path, **options) as recording:
        return recording.camera


def test_a_bags_lens_without_a_name_counts_and_is_said_once(write, capsys):
    path = write(("", D, K))
    for _ in range(2):
        camera = camera_of(path)
        assert (camera.model, camera.distortion) == ("plumb_bob", D)
    assert capsys.readouterr().err == (
        f"{path} /cam/camera_info: distortion_model is empty; its 5 coefficients are taken as "
        "plumb_bob\n"
    )


def test_a_files_lens_without_a_name_counts_and_is_said(write, tmp_path, capsys):
    calibration = tmp_path / "c.yaml"
    calibration.write_text(
        "image_width: 32\nimage_height: 24\ndistortion_model: ''\n"
        "camera_matrix: {data: [20.0, 0, 16, 0, 20, 12, 0, 0, 1]}\n"
        "distortion_coefficients: {data: [0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.2]}\n"
    )
    camera = camera_of(write(INFO), calibration=calibration)
    assert (camera.model, camera.distortion) == ("rational_polynomial", (0.1,) * 7 + (0.2,))
    assert capsys.readouterr().err == (
        f"{calibration}: distortion_model is empty; its 8 coefficients are taken as "
        "rational_polynomial\n"
    )


def test_the_first_usable_camera_info_counts(write):
    camera = camera_of(write(UNCALIBRATED, UNCALIBRATED, ("plumb_bob", D, K), INFO))
    assert (camera.fx, camera.distortion) == (20.0, D)


def test_equidistant_with_a_fifth_zero(write):
    camera = camera_of(write(("equidistant", (0.1, 0.2, 0.3, 0.4, 0.0), K)))
    assert (camera.model, camera.distortion) == ("equidistant", (0.1, 0.2, 0.3, 0.4))


@pytest.mark.parametrize(
    ("info", "wrong"),
    [
        (UNCALIBRATED, "K is zero: it is not calibrated"),
        (("", (0.1, 0.2, 0.3), K), "an empty distortion_model with 3 coefficients"),
        (("omni", D, K), "unknown distortion model 'omni'"),
        (("equidistant", D[:3], K), "equidistant with 3 coefficients"),
        (("plumb_bob", (0.1,) * 14, K), "plumb_bob with 14 coefficients"),
        (("plumb_bob", (float("nan"),) * 5, K), "values that are not finite"),
    ],
)
def test_a_refusal_names_bag_topic_and_option(write, info, wrong):
    path = write(info, info)
    with pytest.raises(InputError) as error:
        open_recording(path)
    line = str(error.value)
    assert line.startswith(f"{path} /cam/camera_info: {wrong}; ")
    assert line.endswith(", or give a calibration with --calib FILE")
    [missing] = inspect(path).missing
    assert missing.startswith(
        f"/cam/events: camera_info cannot be used (/cam/camera_info: {wrong}; "
    )
