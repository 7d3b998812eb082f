"""Options of the lattice estimator."""

from dataclasses import dataclass

from emoflow_ros.core.types.options import option


@dataclass(frozen=True)
class LatticeConfig:
    """How the lattice estimator fits a window; docs/method.md explains each option."""

    max_events: int = option(
        30_000, "events used per window, spread evenly over it", minimum=1000, maximum=10_000_000
    )
    min_events: int = option(1500, "fewer events in a window give no estimate", minimum=100)
    spacing_px: float = option(
        26.0, "distance of the flow lattice's nodes", unit="px", minimum=8.0, maximum=200.0
    )
    smoothness: float = option(
        1.5, "weight of the flow's second differences in space", minimum=1e-3, maximum=1e3
    )
    edge_px: float = option(
        0.4,
        "second difference of the flow above which it counts as an edge of depth",
        unit="px per window",
        minimum=1e-3,
        maximum=100.0,
    )
    smoothness_in_time: float = option(
        0.01, "weight of the flow's change within the window", minimum=1e-3, maximum=1e3
    )
    dec_weight: float = option(
        20.0,
        "weight of the differential epipolar constraint on the flow",
        minimum=1e-3,
        maximum=1e6,
    )
    dec_inlier_px: float = option(
        0.7,
        "residual of the constraint at which a node costs half as much as by squares; nodes on "
        "moving objects have larger residuals and count little",
        unit="px per window",
        minimum=1e-2,
        maximum=100.0,
    )
    motion_stiffness: float = option(
        0.3, "weight of the motion's change within the window", minimum=0.0, maximum=1e6
    )
    warm_iterations: int = option(
        3,
        "steps at full resolution after a warm start, and where the motion turns out to be another",
        minimum=1,
        maximum=100,
    )
    cold_iterations: int = option(
        6, "steps at full resolution after a cold start", minimum=1, maximum=100
    )
    deadline_ms: float = option(
        0.0,
        "after this time a warm window takes no step but its last one; 0 means no deadline",
        unit="ms",
        minimum=0.0,
        maximum=60_000.0,
    )
    model: str = option(
        "auto",
        "motion model: decided by the evidence, or fixed",
        choices=("auto", "full", "rotation", "translation"),
    )
    direction_drift: float = option(
        120.0,
        "random walk of the direction of translation between measurements",
        unit="deg per square root of a second",
        minimum=0.1,
        maximum=1e4,
    )
    angular_drift: float = option(
        60.0,
        "random walk of the angular velocity between measurements",
        unit="deg/s per square root of a second",
        minimum=0.1,
        maximum=1e5,
    )
    depth_drift: float = option(
        0.3,
        "relative error that is expected of inverse depths which earlier windows have shown",
        minimum=1e-3,
        maximum=1e3,
    )
    min_contrast_gain: float = option(
        1.1,
        "contrast of the warped over that of the unwarped events below which nothing moves",
        minimum=1.0,
        maximum=10.0,
    )
    tracked_events: int = option(
        120_000,
        "the same as max_events for the memory of positions (core.odometry); it takes part where "
        "estimator.model is auto",
        minimum=1000,
        maximum=10_000_000,
    )

    @property
    def remembers(self) -> bool:
        """Whether positions are remembered: only where the motion model is not fixed."""
        return self.model == "auto"
