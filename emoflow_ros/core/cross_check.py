"""Other explanations of a window, found in a thread beside the fit, to hold the fit against."""

from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core import earlier_scene, second_look
from emoflow_ros.core.contrast import Contrast
from emoflow_ros.core.earlier_scene import EarlierScene, EarlierScenes, Recalled
from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.estimate import Estimate
from emoflow_ros.core.events import Window
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.second_look import SecondLook, distance, fresh_start
from emoflow_ros.core.uncertainty import Disagreement
from emoflow_ros.core.window_events import WindowEvents

F32 = NDArray[np.float32]

_CREDIBLE_PX = 3.0  # distance of the second look up to which a scene is kept


class CrossCheck:
    """Explains each window a second time afresh, and a third time by an earlier scene.

    Args:
        lattice: of the flow.
        epipolar: its constraint.
        config: of the estimator.
    """

    def __init__(
        self,
        lattice: Lattice,
        epipolar: NodeEpipolar,
        config: LatticeConfig,
    ) -> None:
        scales = {*second_look.SCALES, *earlier_scene.SCALES}
        contrasts = {scale: Contrast(lattice, scale) for scale in sorted(scales)}
        self._second_look = SecondLook(lattice, contrasts, config)
        self._scenes = EarlierScenes(lattice, epipolar, contrasts, config)
        self._coarse, self._lattice = contrasts[min(scales)], lattice
        self._thread = ThreadPoolExecutor(1, "cross_check")

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the thread and what it works at, which a checkpoint cannot hold."""
        kept = ("_second_look", "_scenes", "_coarse", "_lattice")
        return {name: value for name, value in vars(self).items() if name in kept}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Begin with a thread of its own."""
        vars(self).update(state)
        self._thread = ThreadPoolExecutor(1, "cross_check")

    def forget(self) -> None:
        """Forget the scenes of earlier windows."""
        self._scenes.forget()

    def begin(self, window: Window, events: WindowEvents) -> None:
        """Begin with a window; the fit goes on meanwhile, where a core is free."""
        run = self._thread.submit
        self._fresh = run(fresh_start, self._coarse, events, self._lattice.shape)
        self._looked = run(
            lambda fresh: self._second_look.flow(events, fresh.result()), self._fresh
        )
        self._recalled: Future[Recalled | None] | None = None
        scene = self._scenes.choose(window)
        if scene is not None:
            self._recalled = run(partial(self._scenes.explain, scene, window, events))

    def fresh(self) -> F32:
        """Wait for the best constant flow (columns, rows, times, 2), px per window."""
        return self._fresh.result()

    def disagreement(self, window: Window, events: WindowEvents, flow: F32) -> Disagreement:
        """Wait for the other explanations and measure how far they lie from the fit.

        Args:
            window, events: as given to `begin`.
            flow: (columns, rows, times, 2) the fit, px per window.

        Raises:
            NotPositiveDefiniteError: the events have no best flow.
        """
        apart = partial(distance, self._lattice, flow, events=events)
        look = apart(self._looked.result())
        recalled = None if self._recalled is None else self._recalled.result()
        if recalled is None:
            return Disagreement(look)
        return Disagreement(look, apart(recalled.flow), recalled.w * window.duration)

    def keep(self, estimate: Estimate, flow: F32) -> None:
        """Keep for later windows what one has shown.

        Args:
            estimate: of the window.
            flow: (columns, rows, times, 2) px per window of the lattice.
        """
        if estimate.quality.second_look_px <= _CREDIBLE_PX:
            self._scenes.keep(EarlierScene.shown(estimate, flow))
