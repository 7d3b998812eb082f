import pytest

from emoflow_ros.simulation.recording import SimulatedRecording, simulate
from emoflow_ros.simulation.sensor import SensorModel


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
