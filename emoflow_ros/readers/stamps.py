"""Stamps that come twice: one rule for all ground truth and readings of IMUs in files."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError, say


def distinct(
    where: object, stamps: NDArray[np.int64], *, keep_last: bool = False
) -> NDArray[np.intp]:
    """Return which rows to keep, so that every stamp comes once; how many are dropped is said.

    Args:
        where: the file or topic.
        stamps: (N,) ns.
        keep_last: keep the last row of each stamp, not the first.

    Raises:
        InputError: times that go back, or several rows that all have the same stamp.
    """
    steps = np.diff(stamps)
    if (steps < 0).any():
        at = int((steps < 0).argmax())
        before, after = stamps[at] / NS_PER_S, stamps[at + 1] / NS_PER_S
        raise InputError(
            where,
            f"times are not increasing ({after:.6f} s follows {before:.6f} s)",
            "sort the rows by time",
        )
    is_new = steps > 0
    keep = np.append(is_new, True) if keep_last else np.insert(is_new, 0, True)
    kept = np.flatnonzero(keep[: len(stamps)])
    dropped = len(stamps) - len(kept)
    if dropped and len(kept) == 1:
        wrong = f"all {len(stamps)} stamps are {stamps[0] / NS_PER_S:.6f} s"
        raise InputError(where, wrong, "write them with more digits")
    if dropped:
        say(where, f"{dropped} of {len(stamps)} rows left out, whose stamps come twice")
    return kept
