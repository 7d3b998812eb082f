"""The file `estimates.h5`: one row per window. docs/estimates_file.md is its description."""

import contextlib
import dataclasses
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

import emoflow_ros
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.estimates_columns import (
    ADDED,
    COLUMNS,
    TEXT,
    Column,
    flow_column,
    quality_values,
    track_columns,
)
from emoflow_ros.evaluation.track_errors import ComparedTracks

FORMAT = "emoflow_ros/estimates"
VERSION = 1
# Rows are written together: each time takes 2 ms.
_PERIOD_S = 1.0
_MOST_ROWS, _MOST_BYTES = 64, 16 * 2**20  # that wait: a dense flow has megabytes


class EstimatesWriter:
    """Write estimates row by row. Use as a context manager.

    A row is written at once, unless others were within the second before: it then waits for the
    next one, or for the end.

    Args:
        path: the file.
        camera: of the recording.
        source: what was estimated from, for the reader's information.
        configuration: option values by dotted name.
        save_flow: whether to store the dense displacement of every window, too.
        tracks: number of point tracks to store for every window.
        more: further columns by name, whose values `append` is given.
        attributes: further attributes of the file.
        keep: how many rows of an existing file to keep (written with the same arguments); with 0
            it is replaced.

    Raises:
        InputError: the file cannot be written, or what is to be kept has fewer rows, or fewer
            columns, since an earlier version wrote it.
    """

    def __init__(
        self,
        path: Path,
        *,
        camera: Camera,
        source: str,
        configuration: Mapping[str, Any],
        save_flow: bool = False,
        tracks: int = 0,
        more: Mapping[str, Column] | None = None,
        attributes: Mapping[str, str] | None = None,
        keep: int = 0,
    ) -> None:
        try:
            self._file = h5py.File(path, "r+" if keep else "w")
        except OSError as error:
            raise InputError(path, f"cannot be written ({error})", "give another --out") from None
        self._waiting: list[dict[str, Any]] = []
        self._written_at = 0.0
        columns = COLUMNS | (track_columns(tracks) if tracks else {}) | dict(more or {})
        if save_flow:
            columns["flow"] = flow_column(camera)
        if keep:
            self._datasets = dict(self._file.items())
            wrong = lacking(self._file, columns)
            if not wrong and len(self._file["t_start_ns"]) < keep:
                wrong = f"has fewer than {keep} rows"
            if wrong:
                self._file.close()
                raise InputError(path, wrong, "start again without --resume")
            self.truncate(keep)
            return
        self._file.attrs.update(
            {
                "format": FORMAT,
                "version": VERSION,
                "software": f"emoflow_ros {emoflow_ros.__version__}",
                "source": source,
                "camera": json.dumps(dataclasses.asdict(camera)),
                "configuration": json.dumps(dict(configuration)),
                **(attributes or {}),
            }
        )
        for name, column in columns.items():
            self._create(name, column)
        self._rows, self._datasets = 0, dict(self._file.items())

    def append(
        self,
        estimate: Estimate,
        window_events: int,
        tracks: ComparedTracks | None = None,
        more: Mapping[str, Any] | None = None,
    ) -> None:
        """Add one window; with tracks and values of more columns where the file was made so.

        `window_events` counts all events from the estimate's t_start to its t_end.
        """
        ok = estimate.told
        values: dict[str, Any] = {
            "t_start": estimate.t_start / NS_PER_S,
            "t_end": estimate.t_end / NS_PER_S,
            "t_start_ns": estimate.t_start,
            "t_end_ns": estimate.t_end,
            "t": estimate.t / NS_PER_S,
            "linear": estimate.linear,
            "angular": estimate.angular if ok else np.nan,
            "covariance": estimate.covariance,
            "status": str(estimate.status),
            "model": str(estimate.model),
            **quality_values(estimate.quality, window_events, estimate.translation_observable),
        }
        if "flow" in self._datasets:
            flow = estimate.flow
            values["flow"] = flow.displacement(estimate.t_start, estimate.t_end) if flow else np.nan
        if tracks is not None:
            values["tracks"] = tracks.positions
            values["track_times_ns"] = tracks.times
            values["track_id"] = tracks.ids
        row = {
            name: value if isinstance(value, str) else np.asarray(value, self._datasets[name].dtype)
            for name, value in (values | dict(more or {})).items()
        }
        self._waiting.append(row)
        size = len(self._waiting) * sum(np.asarray(value).nbytes for value in row.values())
        is_much = len(self._waiting) >= _MOST_ROWS or size >= _MOST_BYTES
        if is_much or time.monotonic() - self._written_at >= _PERIOD_S:
            self.write()

    def write(self) -> None:
        """Write all rows that wait.

        Raises:
            OSError: the file cannot hold them, and keeps those before.
        """
        self._written_at = time.monotonic()
        if not self._waiting:
            return
        try:
            self._extend()
            self._file.flush()
        except OSError:
            with contextlib.suppress(OSError):
                self._cut_to(self._rows)
            raise
        self._rows += len(self._waiting)
        self._waiting.clear()

    def _extend(self) -> None:
        end = self._rows + len(self._waiting)
        for name in self._waiting[0]:
            dataset = self._datasets[name]
            rows = np.empty((len(self._waiting), *dataset.shape[1:]), dataset.dtype)
            for row, values in enumerate(self._waiting):
                rows[row] = values[name]
            dataset.resize(end, axis=0)
            dataset[self._rows :] = rows

    def _cut_to(self, rows: int) -> None:
        for dataset in self._datasets.values():
            dataset.resize(rows, axis=0)

    def truncate(self, rows: int) -> None:
        """Keep the first `rows` windows, which have to be there, and remove all others."""
        self.write()
        self._rows = rows
        self._cut_to(rows)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # A second error would hide the first one.
        hide = contextlib.suppress(OSError) if error else contextlib.nullcontext()
        try:
            with hide:
                self.write()
        finally:
            self._file.close()

    def _create(self, name: str, column: Column) -> None:
        dataset = self._file.create_dataset(
            name,
            (0, *column.shape),
            column.dtype,
            maxshape=(None, *column.shape),
            chunks=(column.chunk, *column.shape),
            compression="gzip" if column.compressed else None,
            shuffle=column.compressed,
        )
        dataset.attrs["unit"] = column.unit
        dataset.attrs["description"] = column.description


def lacking(file: h5py.File, columns: Mapping[str, Column]) -> str:
    """Say which data sets are missing in a file that is to be continued; empty if none is."""
    names = [name for name in columns if name not in file]
    return f"without {', '.join(names)}, as of an earlier version" if names else ""


@dataclass(frozen=True)
class Estimates:
    """The contents of an estimates file, N windows.

    Attributes:
        path: the file.
        source: what was estimated from.
        camera: of the recording.
        configuration: option values by dotted name.
        columns: every dataset but `flow`, by name; see docs/estimates_file.md. Files of earlier
            versions lack some of `estimates_columns.ADDED`.
        has_flow: whether `flow(i)` can be called.
    """

    path: Path
    source: str
    camera: Camera
    configuration: dict[str, Any]
    columns: dict[str, NDArray[Any]]
    has_flow: bool

    def __len__(self) -> int:
        return len(self.columns["t_start_ns"])

    def flow(self, index: int) -> NDArray[np.float16]:
        """Displacement over window `index`, (H, W, 2) px."""
        with h5py.File(self.path) as file:
            return np.asarray(file["flow"][index])


def read_estimates(path: Path) -> Estimates:
    """Read an estimates file; flow is read when it is asked for.

    Raises:
        InputError: the file is missing, not an estimates file or of another version.
    """
    fix = "give an estimates.h5 written by 'evaluate'"
    try:
        with h5py.File(path) as file:
            if file.attrs.get("format") != FORMAT:
                raise InputError(path, "not an estimates file", fix)
            if file.attrs["version"] != VERSION:
                wrong = f"version {file.attrs['version']}, known is {VERSION}"
                raise InputError(path, wrong, "write it again with this version of evaluate")
            camera = json.loads(file.attrs["camera"])
            camera["distortion"] = tuple(camera["distortion"])
            tracked = track_columns(0) if "tracks" in file else {}
            columns = {
                name: file[name].asstr()[:] if column.dtype is TEXT else file[name][:]
                for name, column in (COLUMNS | tracked).items()
                if name in file or name not in ADDED
            }
            return Estimates(
                path=path,
                source=file.attrs["source"],
                camera=Camera(**camera),
                configuration=json.loads(file.attrs["configuration"]),
                columns=columns,
                has_flow="flow" in file,
            )
    except (OSError, KeyError) as error:
        reason = " ".join(str(error).split())
        raise InputError(path, f"cannot be read ({reason})", fix) from None
