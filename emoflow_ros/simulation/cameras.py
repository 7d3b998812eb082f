"""The simulated camera: a DAVIS346 with a choice of lens models."""

from emoflow_ros.core.camera import Camera

_LENSES: dict[str, tuple[float, ...]] = {
    "none": (),
    "plumb_bob": (-0.34, 0.14, 0.0004, -0.0003),
    # MVSEC's left camera, indoor_flying.
    "equidistant": (
        -0.048031442223833355,
        0.011330957517194437,
        -0.055378166304281135,
        0.021500973881459395,
    ),
}
LENSES = tuple(_LENSES)


def davis346(lens: str) -> Camera:
    """A DAVIS346 with the intrinsics of MVSEC's left camera (indoor_flying).

    Raises:
        KeyError: the lens is not one of LENSES.
    """
    return Camera(
        width=346,
        height=260,
        fx=226.38018519795807,
        fy=226.15002947047415,
        cx=173.6470807871759,
        cy=133.73271487507847,
        model=lens,
        distortion=_LENSES[lens],
    )
