"""Where the parts of a DSEC sequence lie (Gehrig et al., RA-L 2021)."""

import re
from dataclasses import dataclass
from pathlib import Path

from emoflow_ros.errors import InputError

RECTIFY_MAP = "rectify_map.h5"
# As the archives of the whole data set unpack, and as those of one sequence are named.
_EVENTS = ("events/left/events.h5", "*events_left/events.h5", "events.h5")
_CALIBRATION = ("calibration/cam_to_cam.yaml", "*calibration/cam_to_cam.yaml", "cam_to_cam.yaml")
_FLOW = ("flow/forward", "*optical_flow_forward_event", "flow_forward")
_FLOW_TIMES = (
    "flow/forward_timestamps.txt",
    "*optical_flow_forward_timestamps.txt",
    "forward_timestamps.txt",
)
_NAME = re.compile(r"(interlaken|thun|zurich_city)_\d\d_[a-z]")


@dataclass(frozen=True)
class DsecFolder:
    """The folder of a sequence, named after it. Its parts raise InputError where they miss."""

    path: Path

    @property
    def recognised(self) -> bool:
        """Whether this is a DSEC sequence, by its name or by any of its parts."""
        if not self.path.is_dir():
            return False
        parts = (_EVENTS, _CALIBRATION, _FLOW, _FLOW_TIMES)
        named = _NAME.fullmatch(self.path.resolve().name) is not None
        return named or any(self._find(patterns) for patterns in parts)

    @property
    def events(self) -> Path:
        """The left event camera's `events.h5`."""
        return self._require(_EVENTS, "unpack its events_left.zip there")

    @property
    def rectify_map(self) -> Path:
        """The left event camera's rectify map, beside the events."""
        path = self.events.with_name(RECTIFY_MAP)
        if not path.is_file():
            raise self._missing(path.relative_to(self.path), "unpack its events_left.zip again")
        return path

    @property
    def calibration(self) -> Path:
        """`cam_to_cam.yaml`."""
        return self._require(_CALIBRATION, "unpack its calibration.zip there")

    @property
    def has_flow(self) -> bool:
        """Whether there is any part of the flow truth; test sequences have none."""
        return self._find(_FLOW) is not None or self._find(_FLOW_TIMES) is not None

    @property
    def flow(self) -> Path:
        """The folder of the forward flow images."""
        return self._require(_FLOW, "unpack its optical_flow_forward_event.zip there")

    @property
    def flow_times(self) -> Path:
        """The intervals of the flow images."""
        return self._require(_FLOW_TIMES, "put its optical_flow_forward_timestamps.txt there")

    @property
    def test_times(self) -> Path | None:
        """The benchmark's intervals of a test sequence, `<sequence>.csv`."""
        return self._find((f"{self.path.resolve().name}.csv",))

    def _find(self, patterns: tuple[str, ...]) -> Path | None:
        return next((p for pattern in patterns for p in sorted(self.path.glob(pattern))), None)

    def _require(self, patterns: tuple[str, ...], fix: str) -> Path:
        found = self._find(patterns)
        if found is None:
            raise self._missing(patterns[0], fix)
        return found

    def _missing(self, part: Path | str, fix: str) -> InputError:
        return InputError(self.path, f"a DSEC sequence without {part}", fix)
