"""What a window leaves to the next one: the warm start."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.egomotion import Motion
from emoflow_ros.core.lattice.fit import LatticeFit
from emoflow_ros.core.lattice.known import Structure
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.types.estimate import MotionModel
from emoflow_ros.core.types.events import NS_PER_S, Window

# Shares of the flow's change in a window that may go on: the events decide.
_EXTRAPOLATIONS = np.array([0.5, 0.0, 1.0, 1.5], np.float32)


@dataclass(frozen=True)
class Memory:
    """The previous window, as far as it starts the next one.

    Attributes:
        t_start, t_end: the window, ns.
        flow: (columns, rows, times, 2) px per window.
        motion: the egomotion.
        structure: what is known of the scene, or None.
        model: of the motion.
    """

    t_start: int
    t_end: int
    flow: NDArray[np.float32]
    motion: Motion
    structure: Structure | None
    model: MotionModel

    @classmethod
    def of(cls, window: Window, fit: LatticeFit, model: MotionModel) -> "Memory":
        """Take it from a fit of a window, with a motion.

        Args:
            window: its interval.
            fit: of the window.
            model: of that motion; a rotation shows no depths.
        """
        motion, structure = fit.motion, None
        assert motion is not None
        if model is not MotionModel.ROTATION:
            flow = fit.node_flow.mean(axis=1)
            structure = Structure.observe(
                fit.epipolar, flow, motion.at(0.5), fit.evidence, fit.structure
            )
        return cls(window.t_start, window.t_end, fit.flow, motion, structure, model)

    @classmethod
    def expected(
        cls, window: Window, fit: LatticeFit, sensor_px: NDArray[np.float32]
    ) -> "Memory | None":
        """Take what is expected of a window for the one before; it shows no structure.

        Args:
            window: that nothing before it reaches.
            fit: that starts from it.
            sensor_px: (2,) pixels of the sensor per one of the fit's.

        Returns:
            None where nothing is expected.
        """
        expected, lattice = window.expected, fit.lattice
        if expected is None:
            return None
        velocity = expected.flow(lattice.pixels * sensor_px) / sensor_px
        flow = np.empty(lattice.shape, np.float32)
        flow[:] = (window.duration * velocity).reshape(lattice.columns, lattice.rows, 1, 2)
        model, v = MotionModel.FULL, expected.linear
        if not v.any():
            model, v = MotionModel.ROTATION, np.array([0.0, 0.0, 1.0])
        motion = Motion.constant(window.duration * expected.angular, v)
        return cls(window.t_start, window.t_end, flow, motion, None, model)

    def reaches(self, window: Window) -> bool:
        """Tell whether a window comes soon enough after this one to start from it."""
        silence = window.t_start - self.t_end
        return window.t_end >= self.t_end and silence <= LATTICE.longest_gap_s * NS_PER_S

    def flows(self, window: Window) -> list[NDArray[np.float32]]:
        """Flows (columns, rows, times, 2) that a later window may show, for _EXTRAPOLATIONS."""
        ratio, ahead = self._scale(window)
        mean = self.flow.mean(axis=2, keepdims=True)
        change = self.flow[:, :, -1:] - self.flow[:, :, :1]
        times = self.flow.shape[2]
        nodes = ((np.linspace(0, 1, times) - 0.5) * ratio + ahead).astype(np.float32)  # in windows
        slopes = _EXTRAPOLATIONS[:, None, None, None, None] * change * nodes[:, None]
        return list((mean + slopes) * np.float32(ratio))

    def rotation(self, window: Window) -> NDArray[np.float64]:
        """Angular velocity (3,) of this window, in rad per a later window."""
        ratio, _ = self._scale(window)
        return self.motion.at(0.5)[0] * ratio

    def predict(self, fit: LatticeFit, window: Window) -> None:
        """Set motion and structure of a fit to what a later window is expected to show."""
        ratio, ahead = self._scale(window)
        mean = self.flow.mean(axis=2, keepdims=True)
        w, v = self.motion.at(1.0)
        fit.motion = Motion.constant(w * ratio, v, speed=ratio)
        if fit.known is not None:
            fit.motion = replace(fit.motion, w=fit.known.ends())
        fit.structure = self.structure and self.structure.predict(
            fit.lattice,
            fit.epipolar,
            mean.reshape(-1, 2).astype(np.float64),
            ahead,
            v,
            fit.config.depth_drift,
        )

    def _scale(self, window: Window) -> tuple[float, float]:
        """Length of a later window and way to its middle, both in lengths of this one."""
        length = self.t_end - self.t_start
        ahead = 0.5 * (window.t_start + window.t_end - self.t_start - self.t_end)
        return (window.t_end - window.t_start) / length, ahead / length
