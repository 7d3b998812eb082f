"""Camera models: pixels to bearings on the undistorted normalised plane, and back."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.lens_models import DISTORTION_MODELS, choose_lens
from emoflow_ros.errors import InputError

# The largest event sensors have 1 to 2 million; maps of more would only fill the memory.
MAX_PIXELS = 2**24

_NEWTON_STEPS = 30
_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Camera:
    """A calibrated pinhole camera with lens distortion.

    Distortion follows OpenCV: `plumb_bob` (k1 k2 p1 p2 [k3]), `rational_polynomial`
    (k1 k2 p1 p2 k3 k4 k5 k6) and `equidistant` (the fisheye model, k1 k2 k3 k4).

    Args:
        width, height: sensor size in pixels.
        fx, fy, cx, cy: intrinsics in pixels.
        model: a key of DISTORTION_MODELS.
        distortion: the model's coefficients.
        note: what was assumed about the lens, in words, for the user; no part of the camera.

    Raises:
        InputError: a size or focal length that is not positive, more than MAX_PIXELS, an
            unknown model, a wrong number of coefficients, or values that are not finite.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: str = "none"
    distortion: tuple[float, ...] = ()
    note: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise InputError("camera", f"size {self.width}x{self.height}", "give a positive size")
        if self.width * self.height > MAX_PIXELS:
            raise InputError(
                "camera",
                f"size {self.width}x{self.height}",
                f"give the sensor's: at most {MAX_PIXELS} pixels",
            )
        if not (self.fx > 0 and self.fy > 0):
            raise InputError(
                "camera",
                f"focal lengths fx={self.fx}, fy={self.fy}",
                "calibrate the camera: both must be positive",
            )
        if not np.isfinite([self.fx, self.fy, self.cx, self.cy, *self.distortion]).all():
            raise InputError("camera", "values that are not finite", "correct the calibration")
        if self.model not in DISTORTION_MODELS:
            raise InputError(
                "camera",
                f"unknown distortion model '{self.model}'",
                f"use one of {', '.join(DISTORTION_MODELS)}",
            )
        if len(self.distortion) not in DISTORTION_MODELS[self.model]:
            raise InputError(
                "camera",
                f"{self.model} with {len(self.distortion)} coefficients",
                f"give {' or '.join(map(str, DISTORTION_MODELS[self.model]))}",
            )

    @classmethod
    def from_intrinsic_matrix(
        cls,
        width: int,
        height: int,
        k: Sequence[float],
        model: str,
        d: Sequence[float],
    ) -> "Camera":
        """Build a camera from CameraInfo's fields: K (9, row-major), model name and D.

        What an empty name, another name or too many coefficients mean: see `choose_lens`.

        Raises:
            InputError: the camera is not calibrated, or see Camera and `choose_lens`.
        """
        if not any(k):
            raise InputError("camera", "K is zero: it is not calibrated", "calibrate the camera")
        lens = choose_lens(model, d)
        fx, fy, cx, cy = (float(k[i]) for i in (0, 4, 2, 5))
        return cls(
            int(width), int(height), fx, fy, cx, cy, lens.model, lens.coefficients, lens.note
        )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.width, self.height

    @property
    def description(self) -> str:
        """For example `346x260, plumb_bob`, and what was assumed."""
        noted = f" ({self.note})" if self.note else ""
        return f"{self.width}x{self.height}, {self.model}{noted}"

    @property
    def intrinsic_matrix(self) -> NDArray[np.float64]:
        """K, (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def resized(self, width: int, height: int) -> "Camera":
        """Build the camera whose corner pixels see what this one's see, with other pixels between.

        Args:
            width, height: its size in pixels, at least 2 each.
        """
        x, y = (width - 1) / (self.width - 1), (height - 1) / (self.height - 1)
        return replace(
            self, width=width, height=height,
            fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y,
        )  # fmt: skip

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Project points (..., 3) in the optical frame (z > 0) to pixels (..., 2)."""
        distorted, _ = self.distort(points[..., :2] / points[..., 2:3])
        return distorted * (self.fx, self.fy) + (self.cx, self.cy)

    def distort(
        self, normalised: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Apply the lens to undistorted normalised coordinates.

        Args:
            normalised: (..., 2), x = X / Z and y = Y / Z.

        Returns:
            Distorted normalised coordinates (..., 2) and their Jacobian (..., 2, 2).
        """
        if self.model == "none":
            jacobian = np.broadcast_to(np.eye(2), (*normalised.shape[:-1], 2, 2))
            return normalised, jacobian
        if self.model == "equidistant":
            return _equidistant(normalised, self.distortion)
        return _brown_conrady(normalised, self.distortion)

    def undistort(
        self, pixels: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Map pixels to the undistorted normalised plane, by Newton's method on `distort`.

        Args:
            pixels: (..., 2).

        Returns:
            Bearings (..., 2), such that X = (x, y, 1), and the flow Jacobian (..., 2, 2)
            d(bearing) / d(pixel), which maps px/s to 1/s. Both are NaN where the lens
            model has no inverse.
        """
        focal = np.array([self.fx, self.fy])
        target = (np.asarray(pixels, np.float64) - (self.cx, self.cy)) / focal
        estimate = target.copy()
        with np.errstate(all="ignore"):
            for _ in range(_NEWTON_STEPS):
                distorted, jacobian = self.distort(estimate)
                error = distorted - target
                if not np.nanmax(np.abs(error), initial=0.0) > _TOLERANCE:
                    break
                estimate = estimate - _solve_2x2(jacobian, error)
            distorted, jacobian = self.distort(estimate)
            failed = ~(np.abs(distorted - target).max(axis=-1) < 1e-6)
            for share in np.linspace(0.1, 1.0, 10):  # no fold between the centre and there
                _, lens = self.distort(share * estimate)
                failed |= ~_keeps_its_side(lens)
            inverse = _inverse_2x2(jacobian) / focal
        estimate[failed] = np.nan
        inverse[failed] = np.nan
        return estimate, inverse

    @cached_property
    def _maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        grid = np.stack(np.meshgrid(np.arange(self.width), np.arange(self.height)), axis=-1)
        bearings, jacobian = self.undistort(grid.astype(np.float64))
        return bearings.astype(np.float32), jacobian.astype(np.float32)

    @property
    def bearings(self) -> NDArray[np.float32]:
        """Undistorted normalised coordinates of every pixel, (height, width, 2)."""
        return self._maps[0]

    @property
    def flow_jacobian(self) -> NDArray[np.float32]:
        """d(bearing) / d(pixel) at every pixel, (height, width, 2, 2), in 1/px."""
        return self._maps[1]


def _brown_conrady(
    normalised: NDArray[np.float64], distortion: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """OpenCV's plumb_bob and rational model (calib3d documentation)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, *(0.0,) * (8 - len(distortion)))
    x, y = normalised[..., 0], normalised[..., 1]
    r2 = x * x + y * y
    numerator = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    denominator = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = numerator / denominator
    slope = (  # d(radial) / d(r2)
        k1 + r2 * (2 * k2 + 3 * k3 * r2) - radial * (k4 + r2 * (2 * k5 + 3 * k6 * r2))
    ) / denominator
    distorted = np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )
    jacobian = np.empty((*x.shape, 2, 2))
    jacobian[..., 0, 0] = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    jacobian[..., 1, 1] = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    jacobian[..., 0, 1] = cross
    jacobian[..., 1, 0] = cross
    return distorted, jacobian


def _equidistant(
    normalised: NDArray[np.float64], distortion: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """OpenCV's fisheye model: theta_d = theta (1 + k1 theta^2 + ... + k4 theta^8)."""
    k = np.array(distortion)
    r = np.maximum(np.hypot(normalised[..., 0], normalised[..., 1]), 1e-12)
    theta = np.arctan(r)
    t2 = theta * theta
    theta_d = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    derivative = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
    scale = theta_d / r
    # d(scale)/dr / r: the lens acts along the radius only.
    growth = (derivative / (1 + r * r) - scale) / (r * r)
    jacobian = growth[..., None, None] * normalised[..., :, None] * normalised[..., None, :]
    jacobian[..., 0, 0] += scale
    jacobian[..., 1, 1] += scale
    return normalised * scale[..., None], jacobian


def _keeps_its_side(matrix: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether determinant and trace are positive; numpy's own take 20 times as long for 2x2."""
    a, b, c, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1]
    return np.asarray((a * d - b * c > 0) & (a + d > 0))


def _inverse_2x2(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    a, b, c, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1]
    adjugate = np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], -2)
    return adjugate / (a * d - b * c)[..., None, None]


def _solve_2x2(matrix: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.einsum("...ij,...j->...i", _inverse_2x2(matrix), vector)
