"""Camera motion from a memory of positions (docs/method.md).

Slices of the stream are drawn as images, patches are found again in later ones, and poses,
velocities and depths are adjusted to their places. `step` is all of it.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment import Adjusted
from emoflow_ros.core.back_end.adjustment_kernels import Unknowns
from emoflow_ros.core.back_end.bias import seen_bias
from emoflow_ros.core.back_end.evidence import Measured, observations, prior
from emoflow_ros.core.back_end.hypotheses import Hypotheses
from emoflow_ros.core.back_end.jackknife import ByParts
from emoflow_ros.core.back_end.scene import (
    Grid,
    at_second,
    deformations,
    depths_now,
    expected_places,
    rigid_flow,
)
from emoflow_ros.core.back_end.search import best, rotating, starts
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import (
    MotionAt,
    carried_on,
    first_node,
    interpolated,
    motion_at,
    superfluous_node,
    without_node,
)
from emoflow_ros.core.back_end.walks import Walks
from emoflow_ros.core.front_end.following import choose, completed, follow
from emoflow_ros.core.front_end.patches import Patches
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.front_end.slices import Slice, SliceEvents, drawn, flow_at, sharpness
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.core.types.gyro import SeenBias

Array = NDArray[np.float64]
F32 = NDArray[np.float32]


@dataclass(frozen=True)
class Hint:
    """What the flow lattice says of a slice.

    Attributes:
        flow: (rows, columns, 2) px/s of the tracking image at the slice's time.
        angular, direction: (3,) of its window; the direction is zero where unknown.
        measured: the window's motion as evidence, part by part; none where it was taken before.
    """

    flow: F32
    angular: Array
    direction: Array
    measured: tuple[Measured, ...]


@dataclass(frozen=True)
class State:
    """Everything that outlives a slice.

    Attributes:
        t: (K,) ns, the nodes.
        x: their motion; the depths are the patches'. None before the first slice.
        patches: that are followed.
        measured: motions of windows within the nodes.
        walks: how restless the camera is.
        adjusted: of the last step; None while patches are too few.
        hypotheses: ways that are possible at these nodes; None as well.
        parts: what parts of the patches make of that motion; likewise.
        bias: of the gyro, by the last adjustment; None without one.
    """

    walks: Walks
    t: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    x: Unknowns | None = None
    patches: Patches = field(default_factory=Patches.none)
    measured: tuple[Measured, ...] = ()
    adjusted: Adjusted | None = None
    hypotheses: Hypotheses | None = None
    parts: ByParts | None = None
    bias: SeenBias | None = None

    def motion(self, t: int) -> MotionAt | None:
        """The motion at a time (ns); None while nothing is adjusted."""
        if self.adjusted is None or self.hypotheses is None:
            return None
        angular, linear, _ = interpolated(self.t, self.hypotheses.mean, t)
        return replace(motion_at(self.t, self.adjusted, t), angular=angular, linear=linear)

    def spread(self, t: int) -> tuple[Array, Array]:
        """How far the ways lie apart at a time (ns), and how far they rest on parts of the patches.

        Returns:
            Covariances (3, 3) of the angular velocity, rad^2/s^2, and of the direction of
            translation, rad^2.
        """
        assert self.hypotheses is not None and self.parts is not None
        linear = interpolated(self.t, self.hypotheses.mean, t)[1]
        by_ways = self.hypotheses.spread(self.t, t)
        by_parts = self.parts.spread(self.t, t, linear)
        return by_ways[0] + by_parts[0], by_ways[1] + by_parts[1]


class Odometry:
    """Steps from slice to slice.

    Args:
        camera: of the tracking image.
        front: settings of the front end.
        back: settings of the back end.
    """

    def __init__(
        self, camera: Camera, front: FrontEndSettings | None = None,
        back: BackEndSettings | None = None,
    ) -> None:  # fmt: skip
        self.camera = camera
        self.front = front or FrontEndSettings()
        self.back = back or BackEndSettings()
        self.grid = Grid.of(camera)

    def start(self) -> State:
        """A state that knows nothing."""
        return State(Walks.unknown(self.back))

    def step(self, state: State, slices: Iterable[tuple[SliceEvents, Hint]]) -> State:
        """Take new slices: draw them, find the patches again, choose new ones, adjust, and learn.

        Args:
            state: of the slices before.
            slices: in order of time, with the lattice's flow and motion; those of an earlier time
                are left out.
        """
        picture = None
        for events, hint in slices:
            if len(state.t) and events.t - state.t[-1] < NS_PER_MS:
                continue
            state, picture = self._followed(state, events, hint)
        if picture is None:
            return state
        patches = choose(picture, state.patches, self.camera, self.front)
        return self._completed(self._adjusted(replace(state, patches=patches)), picture)

    def scene_flow(self, state: State) -> F32:
        """Flow (rows, columns, 2) px/s of the remembered scene at the newest node."""
        assert state.x is not None
        return self._scene_flow(state, expected_places(self.camera, state.patches, state.x))

    def _scene_flow(self, state: State, place: Array) -> F32:
        x, patches = state.x, state.patches
        assert x is not None
        depths = depths_now(patches, x, self.back.depths)
        return rigid_flow(self.grid, place, depths, patches.shown, x.angular[-1], x.velocity[-1])

    def _followed(self, state: State, events: SliceEvents, hint: Hint) -> tuple[State, Slice]:
        """Draw one slice and find the patches in it."""
        if state.x is None:
            return self._begin(state, events, hint)
        seconds = (events.t - state.t[-1]) / NS_PER_S
        ahead = self._carried_on(state, hint, seconds)
        by_scene = None  # where patches should be, by what is remembered
        if ahead.adjusted is not None and ahead.x is not None:
            by_scene = expected_places(self.camera, ahead.patches, ahead.x)
        picture, own = self._draw(ahead, events, hint, by_scene)
        expected = by_scene
        if expected is None or not own:
            expected = _carried(ahead.patches.place, picture.flow, seconds)
        patches = follow(ahead.patches, picture, expected, self.camera, self.front)
        return self._window(replace(ahead, patches=patches), events.t, hint), picture

    def _begin(self, state: State, events: SliceEvents, hint: Hint) -> tuple[State, Slice]:
        picture = Slice.of(events.t, drawn(events, hint.flow, self.camera.size), hint.flow)
        velocity = self.back.start_speed * hint.direction
        state = replace(
            state,
            t=np.array([events.t]),
            x=first_node(hint.angular, velocity),
            patches=choose(picture, state.patches, self.camera, self.front),
            measured=hint.measured,
        )
        return state, picture

    def _carried_on(self, state: State, hint: Hint, seconds: float) -> State:
        """Add a node; before the first adjustment with the lattice's motion."""
        x, patches = state.x, state.patches
        assert x is not None
        if state.adjusted is None:
            x = x._replace(angular=x.angular.copy(), velocity=x.velocity.copy())
            x.angular[-1] = hint.angular
            x.velocity[-1] = x.rotation[-1] @ hint.direction * self.back.start_speed
        followed = patches.followed(self.front.patience)
        depths = depths_now(patches, x, self.back.depths)[followed]
        x = carried_on(x, seconds)
        place, shape = patches.place[followed], patches.shape.copy()
        by_way = deformations(self.camera, place, x, depths)
        shape[followed] = by_way @ shape[followed]
        hypotheses = state.hypotheses and state.hypotheses.carried_on(seconds)
        patches = replace(patches, shape=shape)
        return replace(state, x=x, patches=patches, hypotheses=hypotheses)

    def _draw(
        self, state: State, events: SliceEvents, hint: Hint, place: Array | None
    ) -> tuple[Slice, bool]:
        """Draw a slice along the lattice's flow, or the remembered scene's if that is as sharp.

        Without the comparison a wrong memory would see what it expects.
        """
        size = self.camera.size
        by_lattice = drawn(events, hint.flow, size)
        if place is None:
            return Slice.of(events.t, by_lattice, hint.flow), False
        flow = self._scene_flow(state, place)
        by_scene = drawn(events, flow, size)
        if sharpness(by_scene) > self.front.own_sharpness * sharpness(by_lattice):
            return Slice.of(events.t, by_scene, flow), True
        return Slice.of(events.t, by_lattice, hint.flow), False

    def _window(self, state: State, t: int, hint: Hint) -> State:
        """Add a node's time, and forget nodes that are too many."""
        x, patches, times = state.x, state.patches, np.append(state.t, t)
        hypotheses = state.hypotheses
        assert x is not None
        while (node := superfluous_node(times, self.back)) is not None:
            patches = patches.without(node, *at_second(patches, x, self.back.depths))
            x, times = without_node(x, node), np.delete(times, node)
            hypotheses = hypotheses and hypotheses.without_node(node)
        measured = tuple(m for m in state.measured if m.t > times[0]) + hint.measured
        return replace(
            state, t=times, x=x, patches=patches, measured=measured, hypotheses=hypotheses
        )

    def _adjusted(self, state: State) -> State:
        """Adjust motion and depths to the places of the patches; decide whether it only rotates."""
        back, patches, x = self.back, state.patches, state.x
        used = patches.found.sum(axis=1) >= 2
        if len(state.t) < 3 or used.sum() < back.fewest_patches or x is None:
            return replace(state, adjusted=None, hypotheses=None, parts=None, bias=None)
        some = patches.at(used)
        problem = observations(some, back)
        known = prior(state.t, state.measured, state.walks, back)
        depth = np.where(np.isfinite(some.inverse_depth), some.inverse_depth, 1.0)
        begin = x._replace(inverse_depth=depth)
        guesses = starts(state.t, begin, state.measured, state.hypotheses, back)
        result = best(problem, begin, known, guesses, back)
        if result is None:
            return self.start()
        found, others = result
        rotated = rotating(problem, found, known, back)
        if rotated is not None and rotated.cost < found.cost:
            # Travel includes it: the search went astray.
            again = best(problem, rotated.x, known, [], back)
            if again is not None:
                others.append((found.x, found.cost))
                found = again[0]
        if rotated is not None and rotated.cost - found.cost < back.rotation_cost * len(some):
            found = rotated
        hypotheses = Hypotheses.weighed(found, others, back)
        parts = ByParts.of(problem, found, known, back)
        found = found.of_unit_depth()
        try:
            walks = state.walks.learnt(found, known.seconds, back)
            bias = seen_bias(found, known)
        except np.linalg.LinAlgError:
            return self.start()
        depths, of_depth = patches.inverse_depth.copy(), np.zeros(len(patches))
        depths[used] = found.x.inverse_depth
        of_depth[used] = found.of_depth
        return replace(
            state,
            x=found.x._replace(inverse_depth=np.zeros(0)),
            patches=replace(patches, inverse_depth=depths, of_depth=of_depth),
            walks=walks,
            adjusted=found,
            hypotheses=hypotheses,
            parts=parts,
            bias=bias,
        )

    def _completed(self, state: State, picture: Slice) -> State:
        """Let patches learn what a flow that has turned shows of them, where they should be."""
        if state.adjusted is None or state.x is None:
            return state
        place = expected_places(self.camera, state.patches, state.x)
        return replace(state, patches=completed(state.patches, picture, place, self.front))


def _carried(place: Array, flow: F32, seconds: float) -> Array:
    """Carry places (N, 2) px along a slice's flow for some seconds (the midpoint method)."""
    middle = place + 0.5 * seconds * flow_at(flow, place)
    return place + seconds * flow_at(flow, middle)
