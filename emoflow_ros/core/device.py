"""The device that a configuration asks for."""

import torch

from emoflow_ros.errors import InputError


def require_cuda() -> None:
    """Refuse a machine without a CUDA device.

    Raises:
        InputError: there is none, or torch cannot use it.
    """
    if not torch.cuda.is_available():
        raise InputError(
            "estimator.device", "no CUDA device was found", "use cpu, or check the driver"
        )
