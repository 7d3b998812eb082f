"""What a configuration needs of the machine: PyTorch and a CUDA device.

PyTorch is an option: only the published method and CUDA need it. So this file imports it late.
"""

from importlib.util import find_spec

from emoflow_ros.core.config import Config
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.errors import InputError

_INSTALL = "install it (pip install torch torchdiffeq)"


def require_cuda() -> None:
    """Refuse a machine without a CUDA device.

    Raises:
        InputError: there is none, or torch cannot use it.
    """
    import torch

    if not torch.cuda.is_available():
        raise InputError(
            "estimator.device", "no CUDA device was found", "use cpu, or check the driver"
        )


def require_torch(config: Config) -> None:
    """Refuse a configuration that needs PyTorch where that is not installed.

    Raises:
        InputError: it is missing; the line names what asks for it.
    """
    if find_spec("torch") is not None and find_spec("torchdiffeq") is not None:
        return
    if not isinstance(config.estimator, LatticeConfig):
        raise InputError(
            "profile", f"{config.profile} needs PyTorch", f"{_INSTALL}, or use the profile realtime"
        )
    if config.estimator.device != "cpu":
        raise InputError("estimator.device", "CUDA needs PyTorch", f"{_INSTALL}, or use cpu")
