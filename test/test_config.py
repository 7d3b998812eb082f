import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from emoflow_ros.config import Config, load_config
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.errors import InputError
from emoflow_ros.published.implicit_config import ImplicitConfig

PROFILES = {
    path.stem: path for path in (Path(__file__).resolve().parents[1] / "config").glob("*.yaml")
}


def write(folder: Path, text: str) -> Path:
    path = folder / "params.yaml"
    path.write_text(text)
    return path


def flatten(tree: dict, prefix: str = "") -> dict:
    flat = {}
    for key, value in tree.items():
        nested = isinstance(value, dict)
        flat |= flatten(value, f"{prefix}{key}.") if nested else {f"{prefix}{key}": value}
    return flat


@pytest.mark.parametrize("profile", PROFILES)
def test_a_profile_holds_what_its_file_says(profile):
    config = load_config(profile)
    written = flatten(yaml.safe_load(PROFILES[profile].read_text()))
    assert config.profile == profile
    assert written.items() <= config.flat().items()


def test_the_default_is_the_realtime_profile():
    config = load_config()
    assert (config.profile, config.method) == ("realtime", "lattice")
    assert isinstance(config.estimator, LatticeConfig)


def test_the_paper_profile_asks_for_the_network():
    config = load_config("paper")
    assert config.method == "implicit"
    assert isinstance(config.estimator, ImplicitConfig)


def test_overrides_beat_the_file_and_the_file_beats_the_profile(tmp_path):
    path = write(tmp_path, "window:\n  duration_ms: 70\n  stride_ms: 35.0\n")
    config = load_config(overrides={"window.duration_ms": 50.0}, params_file=path)
    assert (config.window.duration_ms, config.window.stride_ms) == (50.0, 35.0)
    assert load_config(params_file=path).window.duration_ms == 70.0


def test_files_may_nest_or_dot_their_names(tmp_path):
    nested = load_config(params_file=write(tmp_path, "estimator: {max_events: 5000}"))
    dotted = load_config(params_file=write(tmp_path, "estimator.max_events: 5000"))
    assert nested == dotted
    assert nested.estimator.max_events == 5000


def test_the_method_decides_which_options_there_are():
    assert load_config(overrides={"method": "implicit", "estimator.field.layers": 3})
    with pytest.raises(InputError, match=r"estimator\.field\.layers: no such option"):
        load_config(overrides={"estimator.field.layers": 3})


@pytest.mark.parametrize("profile", ["realtime", "rigid"])
def test_only_the_published_method_has_a_device(profile):
    assert load_config("paper", {"estimator.device": "cuda"}).device == "cuda"
    assert load_config(profile).device == "cpu"
    with pytest.raises(InputError) as refusal:
        load_config(profile, {"estimator.device": "cuda"})
    assert str(refusal.value) == (
        "estimator.device: only the profiles paper* have a device, this one runs on the processor; "
        "leave it out"
    )


def test_the_default_estimator_loads_no_torch():
    code = (
        "import sys; from emoflow_ros.factory import *; from emoflow_ros.config import *;"
        "make_estimator(Camera(346, 260, 226.0, 226.0, 173.0, 130.0), Config());"
        "print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_an_empty_file_changes_nothing(tmp_path):
    assert load_config(params_file=write(tmp_path, "# nothing yet\n")) == load_config()


def test_flat_values_load_the_same_configuration_again():
    config = load_config(overrides={"window.count": 30_000, "estimator.model": "rotation"})
    assert load_config(overrides=config.flat()) == config


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("window: {duration: 3.0}", r"window\.duration: no such option.*window\.duration_ms"),
        ("window: 90", "window: no such option"),
        ("estimator: {max_events: many}", "'many' is not of type int"),
        ("window: {duration_ms: 0.5}", r"0\.5 is out of range; use 1 to 10000"),
        ("window: {count: 20, count_stride: 30}", "leaves gaps"),
        ("window: {duration_ms: .nan}", "nan is out of range"),
        ("estimator: {model: magic}", "unknown value 'magic'; use one of auto, full, rotation"),
        ("method: magic", "method: unknown 'magic'; use lattice or implicit"),
        ("1: 2", "1: no such option"),
        ("- a\n- b", r"params\.yaml: holds no mapping"),
        ("just words", r"params\.yaml: holds no mapping"),
        ("window: [", r"params\.yaml: cannot be read"),
    ],
)
def test_files_that_are_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        load_config(params_file=write(tmp_path, text))


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match=r"absent\.yaml: cannot be read"):
        load_config(params_file=tmp_path / "absent.yaml")
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match=r"binary\.yaml: cannot be read"):
        load_config(params_file=binary)


def test_unknown_profiles_name_the_known_ones():
    known = r"unknown profile 'fast'; use one of paper, .*realtime"
    with pytest.raises(InputError, match=known):
        load_config("fast")


def test_a_default_configuration_is_the_dataclasses():
    assert Config().estimator == LatticeConfig()


def test_a_method_that_is_no_name_is_refused(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text("method: [lattice]\n")
    with pytest.raises(InputError, match="method: unknown"):
        load_config(params_file=path)


def test_a_file_cannot_rename_the_profile():
    with pytest.raises(InputError, match="profile: cannot be changed"):
        load_config("realtime", {"profile": "paper"})
    config = load_config("paper")
    assert load_config("paper", config.flat()) == config


def test_an_option_of_an_earlier_version_is_left_out_with_one_line(tmp_path, capsys):
    path = write(tmp_path, "estimator: {max_doubt: 0.5, min_events: 900}")
    assert load_config(params_file=path).estimator == LatticeConfig(min_events=900)
    load_config(overrides={"estimator.max_doubt": 1.0})
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].startswith("estimator.max_doubt: no longer an option, left out: nothing is with")
    assert "output.max_angular_sd" in said[0]
