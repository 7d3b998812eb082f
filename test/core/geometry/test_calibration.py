import pytest

from emoflow_ros.core.geometry.calibration import load_calibration
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
    path.write_text(
        "# fx fy cx cy k1 ...\n\n199.1 198.8 132.2 110.7 -0.37 0.15 -0.0003 -0.0008 0.0\n"
    )
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


RADTAN = "[-0.37, 0.15, -0.0003, -0.0008]"
KALIBR = f"""
cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: {RADTAN}
  distortion_model: radtan
  intrinsics: [226.0, 227.0, 173.5, 133.5]
  resolution: [346, 260]
  rostopic: /davis/image_raw
"""
OPENCV = """%YAML:1.0
---
calibration_time: "Mon 02 Mar 2026 09:12:11"
image_width: 346
image_height: 260
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 226., 0., 1.735e+02, 0., 227., 133.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -3.7e-01, 0.15, -0.0003, -0.0008, 0.02 ]
"""
ASSUMED = "distortion_model is empty; its {} coefficients are taken as {}"


def load(tmp_path, text, name="c.yaml"):
    (tmp_path / name).write_text(text)
    return load_calibration(tmp_path / name)


@pytest.mark.parametrize("model", ["", '""'])
@pytest.mark.parametrize(
    ("d", "expected"),
    [
        ((0.1, 0.2, 0.3, 0.4), "plumb_bob"),
        ((0.1, 0.2, 0.3, 0.4, 0.5), "plumb_bob"),
        ((0.1,) * 8, "rational_polynomial"),
    ],
)
def test_coefficients_without_a_model_are_what_ros_takes_them_for(tmp_path, model, d, expected):
    text = YAML.replace("equidistant", model).replace("-0.05, 0.01, -0.06, 0.02", str(d)[1:-1])
    camera = load(tmp_path, text if model else text.replace("distortion_model: \n", ""))
    assert (camera.model, camera.distortion) == (expected, d)
    assert camera.note == ASSUMED.format(len(d), expected)


def test_no_model_with_zeros_is_no_lens_and_other_numbers_are_refused(tmp_path):
    text = YAML.replace("equidistant", "").replace("-0.05, 0.01, -0.06, 0.02", "D")
    camera = load(tmp_path, text.replace("D", "0, 0, 0, 0, 0"))
    assert (camera.model, camera.distortion, camera.note) == ("none", (), "")
    for d, count in (("0.1, 0.2, 0.3", 3), ("0.1, 0.2, 0.3, 0.4, 0.5, 0.6", 6)):
        with pytest.raises(InputError) as error:
            load(tmp_path, text.replace("D", d))
        assert str(error.value) == (
            f"{tmp_path / 'c.yaml'}: an empty distortion_model with {count} coefficients; name the "
            "model, one of none, plumb_bob, rational_polynomial, equidistant"
        )


def test_zeros_behind_a_models_coefficients_are_left_out(tmp_path):
    camera = load(tmp_path, YAML.replace("0.02]", "0.02, 0]"))
    assert (camera.model, camera.distortion) == ("equidistant", (-0.05, 0.01, -0.06, 0.02))
    with pytest.raises(InputError, match="equidistant with 5 coefficients; give 4"):
        load(tmp_path, YAML.replace("0.02]", "0.02, 0.1]"))


def test_kalibr_camchain(tmp_path):
    camera = load(tmp_path, KALIBR)
    assert (camera.size, camera.model) == ((346, 260), "plumb_bob")
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (226.0, 227.0, 173.5, 133.5)
    assert camera.distortion == (-0.37, 0.15, -0.0003, -0.0008)
    fisheye = load(tmp_path, KALIBR.replace("radtan", "equidistant"))
    assert (fisheye.model, fisheye.distortion) == ("equidistant", camera.distortion)
    bare = load(tmp_path, KALIBR.replace("radtan", "none").replace(RADTAN, "[]"))
    assert (bare.model, bare.distortion) == ("none", ())


def test_a_camchain_of_several_cameras_asks_which(tmp_path):
    second = KALIBR.replace("cam0", "cam1").replace("226.0", "300.0").replace("davis", "flir")
    path = tmp_path / "chain.yaml"
    with pytest.raises(InputError) as error:
        load(tmp_path, KALIBR + second, path.name)
    assert str(error.value) == (
        f"{path}: a camchain of 2 cameras: cam0 (/davis/image_raw), cam1 (/flir/image_raw); choose "
        "the event camera with FILE:cam0"
    )
    assert load_calibration(path.with_name("chain.yaml:cam1")).fx == 300.0
    with pytest.raises(InputError, match="holds no camera 'cam2'"):
        load_calibration(path.with_name("chain.yaml:cam2"))


@pytest.mark.parametrize("name", ["c.yaml", "c.yml", "calibration.txt"])
def test_opencv_yaml(tmp_path, name):
    camera = load(tmp_path, OPENCV, name)
    assert (camera.size, camera.model) == ((346, 260), "plumb_bob")
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (226.0, 227.0, 173.5, 133.5)
    assert camera.distortion == (-0.37, 0.15, -0.0003, -0.0008, 0.02)
    assert camera.note == ASSUMED.format(5, "plumb_bob")


def test_opencv_fisheye_and_older_names(tmp_path):
    fisheye = OPENCV.replace(", 0.02 ]", " ]") + "fisheye_model: 1\n"
    camera = load(tmp_path, fisheye)
    assert (camera.model, camera.note) == ("equidistant", "")
    older = OPENCV.replace("image_w", "image_W").replace("image_h", "image_H")
    older = older.replace("camera_matrix", "Camera_Matrix").replace("dist", "Dist", 1)
    assert load(tmp_path, older).distortion == (-0.37, 0.15, -0.0003, -0.0008, 0.02)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (KALIBR.replace("pinhole", "omni"), "cam0 is of the camera model 'omni'"),
        (KALIBR.replace("radtan", "fov"), "unknown distortion model 'fov'"),
        (KALIBR.replace("[346, 260]", "346"), "cam0.resolution is 346"),
        (KALIBR.replace("226.0, ", ""), "cam0.intrinsics has 3 values"),
        (KALIBR.replace(RADTAN, "7"), "cam0.distortion_coeffs is missing or not a list"),
        (OPENCV.replace("opencv-matrix", "opencv-nd-matrix"), "not YAML (could not determine"),
        (OPENCV.replace("camera_matrix", "M1"), "camera_matrix.data is missing"),
        (YAML.replace("226.0, 0, 173.5, 0, 227.0, 133.5, 0, 0, 1", "0" + ", 0" * 8), "K is zero"),
        ("a: [", "not YAML (expected the node content, but found '<stream end>', line 1)"),
    ],
)
def test_what_is_wrong_with_other_tools_files_is_named(tmp_path, text, words):
    with pytest.raises(InputError) as error:
        load(tmp_path, text)
    line = str(error.value)
    assert line.startswith(f"{tmp_path / 'c.yaml'}: ")
    assert words in line
    assert "\n" not in line
