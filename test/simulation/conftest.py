import pytest

from emoflow_ros.simulation.recording import SimulatedRecording, simulate
from emoflow_ros.simulation.sensor import SensorModel
from emoflow_ros.simulation.textures import make_textures


@pytest.fixture
def painted_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Textures of a seed are not those that a test before has painted."""
    monkeypatch.setattr("emoflow_ros.simulation.recording.make_textures", make_textures)


@pytest.fixture(scope="session")
def mover() -> SimulatedRecording:
    """Return 60 ms of the scene with a moving object, without noise, at a realistic epoch."""
    return simulate(
        "mover",
        duration_s=0.06,
        seed=3,
        sensor=SensorModel(noise_hz=0),
        start_ns=1_500_000_000_000_000_000,
    )
