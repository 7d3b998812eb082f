import pytest

from emoflow_ros.core.calibration import load_calibration
from emoflow_ros.errors import InputError

YAML = """
image_width: 346
image_height: 260
camera_name: davis
camera_matrix: {rows: 3, cols: 3, data: [226.0, 0, 173.5, 0, 227.0, 133.5, 0, 0, 1]}
distortion_model: equidistant
distortion_coefficients: {rows: 1, cols: 4, data: [-0.05, 0.01, -0.06, 0.02]}
"""


def test_camera_info_yaml(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(YAML)
    camera = load_calibration(path)
    assert (camera.width, camera.height) == (346, 260)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (226.0, 227.0, 173.5, 133.5)
    assert camera.model == "equidistant"
    assert camera.distortion == (-0.05, 0.01, -0.06, 0.02)


def test_ecd_text(tmp_path):
    path = tmp_path / "calib.txt"
    path.write_text("199.1 198.8 132.2 110.7 -0.37 0.15 -0.0003 -0.0008 0.0\n")
    camera = load_calibration(path)
    assert (camera.width, camera.height, camera.model) == (240, 180, "plumb_bob")
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (199.1, 198.8, 132.2, 110.7)
    assert camera.distortion == (-0.37, 0.15, -0.0003, -0.0008, 0.0)
    assert load_calibration(path, (346, 260)).width == 346


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("c.yaml", "", "no mapping"),
        ("c.yaml", "a: [", "not YAML"),
        ("c.yaml", YAML.replace("image_width: 346", ""), "image_width is None"),
        ("c.yaml", YAML.replace("camera_matrix", "matrix"), "camera_matrix.data is missing"),
        ("c.yaml", YAML.replace("226.0, ", ""), "camera_matrix has 8 values"),
        ("c.yaml", YAML.replace("226.0", "-1"), "focal lengths fx=-1.0"),
        ("c.yaml", YAML.replace("equidistant", "foo"), "unknown distortion model 'foo'"),
        ("c.yaml", YAML.replace("-0.05, ", ""), "equidistant with 3 coefficients"),
        (
            "c.yaml",
            YAML.replace("equidistant", "plumb_bob").replace("-0.05, 0.01, -0.06, 0.02", "0, 0, 0"),
            "plumb_bob with 3 coefficients; give 0 or 4 or 5",
        ),
        ("calib.txt", "1 2 3", "holds 3 numbers"),
        ("calib.txt", "1 2 3 4 5 6 7 8 x", "not numbers"),
        ("calib.txt", "0 2 3 4 5 6 7 8 9", "focal lengths fx=0.0"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, name, text, words):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError) as error:
        load_calibration(path)
    line = str(error.value)
    assert line.startswith(f"{path}: ")
    assert words in line
    assert "\n" not in line


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_calibration(tmp_path / "none.yaml")
    (tmp_path / "b.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file"):
        load_calibration(tmp_path / "b.txt")
