"""Windows with a memory: the lattice's flow, and the motion by positions (core.odometry)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.consistency import Experience
from emoflow_ros.core.back_end.known_depths import known_depths
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import AdjustedMotion, MotionAt, interpolated
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.front_end.slices import SliceEvents, grid_nodes
from emoflow_ros.core.front_end.slicing import slices
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.preparation import WorkingImage
from emoflow_ros.core.lattice.refinement import Depths, ShownFlow
from emoflow_ros.core.lattice.uncertainty import without_translation
from emoflow_ros.core.odometry import Hint, Odometry, State
from emoflow_ros.core.told_motion import ToldMotion, across, as_experienced, told_bias
from emoflow_ros.core.types.estimate import (
    REMEMBERED,
    Estimate,
    Estimator,
    FlowSampler,
    MotionModel,
    Status,
    velocity_at,
)
from emoflow_ros.core.types.events import NS_PER_MS, Window
from emoflow_ros.core.types.gyro import GyroState, SeenBias
from emoflow_ros.core.window_evidence import (
    expected_by_memory,
    measured_by_window,
    variance_of_window,
)

Array = NDArray[np.float64]
F32 = NDArray[np.float32]

_LONGEST_GAP_NS = 300 * NS_PER_MS  # between slices; after a longer one the memory begins anew
_MOST_SHOWN = 16  # windows whose flow is kept: bounds the time where they are short


@dataclass(frozen=True)
class Memory:
    """What outlives a window.

    Attributes:
        odometry: nodes, patches and what they tell.
        experience: of what adjustments are worth.
        end: of the last slice, ns; None before the first one.
        shown: flows of the newest windows.
        bias: of a gyro, as the window told it; None where it told nothing new.
    """

    odometry: State
    experience: Experience
    end: int | None = None
    shown: tuple[ShownFlow, ...] = ()
    bias: SeenBias | None = None

    def end_before(self, window: Window) -> int | None:
        """End of the last slice, ns; None where a window does not go on from there."""
        follows = self.end is not None and 0 <= window.t_end - self.end <= _LONGEST_GAP_NS
        return self.end if follows else None


class RememberingEstimator:
    """Adjusts the motion to positions that are remembered, window by window (an Estimator).

    The lattice gives the flow, and its motion as evidence. Patches are followed through windows in
    which it sees no motion, too; others without a flow are passed on as they are.

    Args:
        estimator: of the windows' flow.
        camera: whose pixels the events lie on.
        refine: fits the flow of a window again, once its motion is known, and tells what it shows;
            the estimator's next window starts from that flow.
        learn_bias: takes what is seen of a gyro's bias.
        front: settings of the front end.
        back: settings of the back end.

    Attributes:
        image: the tracking image.
    """

    def __init__(
        self, estimator: Estimator, camera: Camera,
        refine: Callable[[Estimate, Depths], tuple[Estimate, ShownFlow | None]],
        front: FrontEndSettings | None = None, back: BackEndSettings | None = None, *,
        learn_bias: Callable[[SeenBias], None] | None = None,
    ) -> None:  # fmt: skip
        self._estimator = estimator
        self._refine = refine
        self._learn_bias = learn_bias
        self._front = front or FrontEndSettings()
        self.image = WorkingImage.of(camera, self._front.longer_side_px)
        self._odometry = Odometry(self.image.camera, self._front, back)
        self._grid = grid_nodes(self.image.camera.size).reshape(-1, 2) * self.image.sensor_px
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._estimator.reset()
        self._memory = self.nothing()

    def estimate(self, window: Window) -> Estimate:
        """Estimate a window's flow and motion."""
        memory = self._memory
        if memory.end_before(window) is not None:
            expected = expected_by_memory(self._odometry, memory.odometry, self.image)
            window = replace(window, expected=expected)
        found = self._estimator.estimate(window)
        self._memory, estimate = self.step(memory, window, found)
        bias, used = self._memory.bias, found.gyro.state is GyroState.USED
        if self._learn_bias is not None and used and bias is not None:
            self._learn_bias(bias)
        return estimate

    def step(self, memory: Memory, window: Window, found: Estimate) -> tuple[Memory, Estimate]:
        """Take the window's new slices into the memory, and read the motion off it.

        Args:
            memory: of the windows before.
            window: its events.
            found: what the lattice estimates of it.
        """
        end = memory.end_before(window)
        if end is None:
            memory, end = self.nothing(), window.t_start
        memory = replace(memory, bias=None)
        seen, before = found.flow is not None, memory.odometry
        if not seen and (found.status is not Status.NO_MOTION or before.adjusted is None):
            return replace(memory, end=end), found
        state = self._taken(before, window, end, found)
        if seen and self._is_refuted(state, found):
            since = max(end, found.t_start)  # a part that was chosen for its motion
            state = self._taken(self._odometry.start(), window, since, found)
        if not (seen or self._follows(before, state)):
            return replace(memory, end=end), found
        memory, motion = replace(memory, odometry=state, end=window.t_end), state.motion(found.t)
        if motion is None:
            return memory, self._first(found)
        if state.bias is not None and state is not before:
            memory = replace(memory, bias=told_bias(state, found.t, self._odometry.back))
        memory = replace(memory, experience=self._learnt(memory, found, motion))
        return self._read(window, found, memory)

    def nothing(self) -> Memory:
        """A memory of nothing."""
        return Memory(self._odometry.start(), Experience.none(self._odometry.back.errors))

    def _first(self, found: Estimate) -> Estimate:
        """Tell the lattice's motion, less sure of itself; a gyro's angular velocity stays."""
        by_gyro, known = found.gyro.state is GyroState.USED, found.translation_observable
        wider = np.repeat([known, not by_gyro], 3)
        factor = np.where(np.outer(wider, wider), self._odometry.back.errors.first, 1.0)
        return replace(found, covariance=factor * found.covariance)

    def _learnt(self, memory: Memory, found: Estimate, motion: MotionAt) -> Experience:
        experience, state, bias = memory.experience, memory.odometry, None
        before, known = experience.t, found.gyro.bias
        again = None if before is None or before < state.t[0] else state.motion(before)
        if memory.bias is not None and known is not None:
            bias = memory.bias, known
        measured, law = (found.angular, found.linear), self._odometry.back.errors
        return experience.after(found.t, motion, again, measured, law, bias)

    def _taken(self, state: State, window: Window, since: int, found: Estimate) -> State:
        """Take a window's slices since a time (ns) into a state."""
        return self._odometry.step(state, self._slices(state, window, since, found))

    def _follows(self, before: State, state: State) -> bool:
        """Tell whether patches were found again in a window of which no flow is known."""
        shown = int(state.patches.shown.sum())
        later = state.adjusted is not None and state.t[-1] > before.t[-1]
        return later and shown >= self._odometry.back.fewest_patches

    def _is_refuted(self, state: State, found: Estimate) -> bool:
        """Tell whether, with the window adjusted, w is far from its own and patches are lost.

        When a motion begins at once, they are looked for at wrong places. The window is the
        lattice's then: fewer than three slices tell no motion. Experience stays.
        """
        motion, back = state.motion(found.t), self._odometry.back
        if motion is None:
            return False
        variance = variance_of_window(found, self.image.camera, back)
        apart = (found.angular - motion.angular) / np.sqrt(variance)
        kept = state.patches.kept(self._front.patience)
        return float(apart @ apart) > back.refuted**2 and kept < back.refuting_share

    def _slices(
        self, state: State, window: Window, since: int, found: Estimate
    ) -> Iterator[tuple[SliceEvents, Hint]]:
        """Cut a window into slices; where no flow was seen, by that of the remembered scene."""
        if found.flow is None:
            grid = self._odometry.scene_flow(state)
        else:
            grid = self._on_grid(found.flow, found.t)
        measured = measured_by_window(found, self.image.camera, self._odometry.back)
        front, px = self._front, self.image.sensor_px
        most = front.first_slices if state.adjusted is None else front.most_slices
        for events in slices(window.events, since, window.t_end, grid, px, most, front):
            at = int(np.clip(events.t, found.t_start, found.t_end))
            flow = np.zeros_like(grid) if found.flow is None else self._on_grid(found.flow, at)
            yield events, Hint(flow, found.angular, found.linear, measured)
            measured = ()  # a window is evidence once

    def _on_grid(self, flow: FlowSampler, t: int) -> F32:
        """Flow at a time on the tracking image's grid, (rows, columns, 2) px/s of that image."""
        velocity = velocity_at(flow, self._grid, t) / self.image.sensor_px
        return velocity.reshape(*self._odometry.grid.a.shape[:2], 2).astype(np.float32)

    def _read(self, window: Window, found: Estimate, memory: Memory) -> tuple[Memory, Estimate]:
        """Put the motion by positions into an estimate, and fit its flow again with it."""
        state = memory.odometry
        assert state.hypotheses is not None
        kept = state.patches.kept(self._front.patience)
        told = ToldMotion.of(window, found, state, memory.experience, kept, self._odometry.back)
        motion = AdjustedMotion(
            state.t,
            state.hypotheses.mean,
            told.model is MotionModel.FULL,
            found.motion,
            found.motion if found.gyro.state is GyroState.USED else None,
        )
        quality = found.quality
        if found.flow is None:
            quality = replace(quality, stop_reason=REMEMBERED)
        estimate = replace(
            found,
            status=Status.OK,
            quality=quality,
            model=told.model,
            linear=told.linear,
            angular=told.angular,
            covariance=told.covariance,
            motion=motion,
            angular_walk=state.walks.angular,
        )
        flow, shown = self._refined(estimate, motion, memory, told.variance)
        if shown is not None:
            memory = replace(memory, shown=(*memory.shown, shown)[-_MOST_SHOWN:])
        covariance = told.covariance
        if found.gyro.state is GyroState.USED:
            covariance = as_experienced(covariance, memory.experience, self._odometry.back)
        return memory, replace(estimate, flow=flow, covariance=covariance)

    def _refined(
        self, estimate: Estimate, told: AdjustedMotion, memory: Memory, variance: float
    ) -> tuple[FlowSampler | None, ShownFlow | None]:
        """Fit the flow again along the likeliest way, which the depths belong to.

        That way may translate though its direction is too uncertain to be told. Its w, too, is what
        the depths belong to: a gyro's has a bias. w is as sure as the adjustment or the gyro says.

        Args:
            estimate: of the window.
            told: its motion.
            memory: with its slices.
            variance: of the direction of translation, rad^2.

        Returns:
            The flow, and what it shows.
        """
        state = memory.odometry
        assert state.x is not None and state.adjusted is not None and state.hypotheses is not None
        way, model, direction = state.hypotheses.ways[0], MotionModel.ROTATION, np.zeros(3)
        covariance = without_translation(estimate.covariance)
        velocity = interpolated(state.t, way, estimate.t)[1]
        speed = float(np.linalg.norm(velocity))
        if state.adjusted.translates and speed > 0:
            model, direction = MotionModel.FULL, velocity / speed
            covariance[:3, :3] = across(direction, variance)
        translates = model is MotionModel.FULL
        motion = replace(told, x=way, translates=translates, by_gyro=None)
        likeliest = replace(
            estimate, model=model, linear=direction, covariance=covariance, motion=motion
        )
        depths = known_depths(
            state.patches, state.x, memory.shown, motion, estimate, self.image, self._odometry.back
        )
        again, shown = self._refine(
            likeliest, replace(depths, inverse_depth=speed * depths.inverse_depth)
        )
        return again.flow, shown
