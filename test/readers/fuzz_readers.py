"""Damaged files of every format, through the readers' public functions: part of `make fuzz`.

Bytes of a small valid file are flipped, zeroed, cut out or doubled, or its end is cut off. Reading
what is left may end in an InputError of one line, and in nothing else: no other exception, not
more memory than a small file explains, no hang.

    python test/readers/fuzz_readers.py [--runs N] [--seed N] [--format NAME]
"""

import argparse
import contextlib
import io
import resource
import shutil
import signal
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import h5py
import numpy as np
import psutil

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS.parent), str(TESTS / "recordings"), str(TESTS / "msg_adapters")]

from column_files import ARRAY_WRITERS  # noqa: E402
from encoders import ENCODERS, payload  # noqa: E402
from event_bags import make_events, write_event_bag  # noqa: E402

from emoflow_ros.core.geometry.calibration import load_calibration  # noqa: E402
from emoflow_ros.core.geometry.camera import Camera  # noqa: E402
from emoflow_ros.core.types.events import Events  # noqa: E402
from emoflow_ros.errors import InputError  # noqa: E402
from emoflow_ros.readers import open_recording  # noqa: E402
from emoflow_ros.truth import load_truth  # noqa: E402

CAMERA = Camera(32, 24, 20.0, 20.0, 16.0, 12.0)
CALIB = "20 20 16 12 0.1 0 0 0 0\n"
YAML = """image_width: 32
image_height: 24
camera_name: davis
camera_matrix: {rows: 3, cols: 3, data: [20.0, 0, 16, 0, 20, 12, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 4, data: [-0.05, 0.01, -0.06, 0.02]}
"""
KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [20.0, 20, 16, 12]
  resolution: [32, 24]
  distortion_model: radtan
  distortion_coeffs: [-0.05, 0.01, -0.06, 0.02]
"""
OPENCV = """%YAML:1.0
---
image_width: 32
image_height: 24
camera_matrix: !!opencv-matrix {rows: 3, cols: 3, dt: d, data: [20., 0, 16, 0, 20, 12, 0, 0, 1]}
distortion_coefficients: !!opencv-matrix {rows: 5, cols: 1, dt: d, data: [0.1, 0, 0, 0, 0]}
"""
MEMORY = 1 << 30  # bytes more than before the first damaged file
PATIENCE_S = 20

type Read = Callable[[Path], None]


def main() -> int:
    """Damage files of one format or all; 1 at the first that ends in anything but a line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000, help="files of each format")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--format", choices=FORMATS, help="default: all")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        made = {name: make(Path(folder)) for name, (make, _) in FORMATS.items()}
        for name, path in made.items():
            FORMATS[name][1](path)  # the valid one; and all is imported now
        _limit_memory()
        for number, (name, path) in enumerate(made.items()):
            if options.format in (None, name):
                rng = np.random.default_rng((options.seed, number))
                refused = sum(damage_and_read(name, path, rng) for _ in range(options.runs))
                print(f"== {name}: {options.runs} files, {refused} refused", flush=True)
    return 0


def damage_and_read(name: str, path: Path, rng: np.random.Generator) -> bool:
    """Read a damaged copy of a file; return whether it was refused.

    Raises:
        AssertionError: anything but an InputError of one line came of it. The file is kept.
    """
    whole = path.read_bytes()
    damaged = damage(whole, rng)
    path.write_bytes(damaged)
    signal.signal(signal.SIGALRM, _too_long)
    signal.alarm(PATIENCE_S)
    try:
        with contextlib.redirect_stderr(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)  # two lines in the user's terminal
            FORMATS[name][1](path)
    except InputError as error:
        if "\n" not in str(error):
            return True
        _keep(name, path, error)
    except BaseException as error:
        _keep(name, path, error)
    finally:
        signal.alarm(0)
        path.write_bytes(whole)
    return False


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    """Flip, zero, cut out or double some bytes, or cut off the end."""
    changed = bytearray(data)
    at, length = int(rng.integers(len(data))), int(rng.integers(1, 40))
    match rng.integers(5):
        case 0:
            for place in rng.integers(len(data), size=rng.integers(1, 5)):
                changed[place] ^= 1 << rng.integers(8)
        case 1:
            changed[at : at + length] = bytes(len(changed[at : at + length]))
        case 2:
            del changed[at : at + length]
        case 3:
            changed[at:at] = changed[at : at + length]
        case _:
            del changed[at:]
    return bytes(changed)


def _keep(name: str, path: Path, error: BaseException) -> None:
    kept = Path(tempfile.gettempdir()) / f"damaged_{name}{path.suffix}"
    shutil.copyfile(path, kept)
    raise AssertionError(f"{name}: {kept} ends in {type(error).__name__}: {error}") from error


def _too_long(number: int, frame: FrameType | None) -> None:
    raise TimeoutError(f"not read within {PATIENCE_S} s")


def _limit_memory() -> None:
    limit = psutil.Process().memory_info().vms + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))


def read_recording(path: Path) -> None:
    """Open a recording and read all of its events."""
    with open_recording(path) as recording:
        for _ in recording.event_chunks():
            pass


def read_calibration(path: Path) -> None:
    """Read a camera."""
    load_calibration(path)


def read_truth(path: Path) -> None:
    """Read the ground truth beside a good recording and use it."""
    recording = path.parent.parent / "a.bag"
    with open_recording(recording) as opened:
        truth = load_truth(opened, [path])
    if truth.twists is not None:
        truth.twists.twist(1_100_000_000)


def _bag(storage: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / ("a.bag" if storage == "ros1" else f"a_{storage}")
        write_event_bag(path, [make_events(100), make_events(100, start_s=2)], storage=storage)
        return path if storage == "ros1" else next(p for p in path.iterdir() if p.suffix != ".yaml")

    return make


def _raw(folder: Path) -> Path:
    path = folder / "a.raw"
    header = b"% evt 3.0\n% geometry 32x24\n% end\n"
    path.write_bytes(header + payload(ENCODERS["evt3"](make_events(100))))
    return path


def _npz(folder: Path) -> Path:
    events = make_events(100)
    np.savez(folder / "a.npz", x=events.x, y=events.y, t_ns=events.t, p=events.p)
    return folder / "a.npz"


def _dsec(folder: Path) -> Path:
    events = make_events(300)
    with h5py.File(folder / "events.h5", "w") as file:
        for name, column in _columns(events):
            file.create_dataset(f"events/{name}", data=column, chunks=(100,), compression="gzip")
        file["t_offset"] = 5
    return folder / "events.h5"


def _columns(events: Events) -> Iterator[tuple[str, np.ndarray]]:
    yield from (("x", events.x), ("y", events.y), ("t", (events.t // 1000).astype(np.uint32)))
    yield "p", events.p.astype(np.uint8)


def _columns_file(folder: Path) -> Path:
    events = make_events(300)
    with h5py.File(folder / "columns.h5", "w") as file:
        for name, column in _columns(events):
            file[f"prophesee/left/{name}"] = column
        file["prophesee/left/calib/resolution"] = [32, 24]
    return folder / "columns.h5"


def _array(kind: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        events = make_events(300)
        (folder / kind).mkdir()
        return ARRAY_WRITERS[kind](folder / kind, events, events.t // 1000)

    return make


def _mvsec(folder: Path) -> Path:
    events = make_events(300)
    with h5py.File(folder / "a_data.hdf5", "w") as file:
        table = [events.x, events.y, events.t / 1e9, np.where(events.p, 1, -1)]
        file["davis/left/events"] = np.stack(table, axis=1)
    return folder / "a_data.hdf5"


def _ecd(folder: Path) -> Path:
    events = make_events(300)
    (folder / "ecd").mkdir()
    rows = zip(events.t / 1e9, events.x, events.y, events.p, strict=True)
    text = "".join(f"{t:.9f} {x} {y} {int(p)}\n" for t, x, y, p in rows)
    (folder / "ecd" / "events.txt").write_text(text)
    return folder / "ecd" / "events.txt"


def _text(name: str, text: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / "text").mkdir(exist_ok=True)
        path = folder / "text" / name
        path.write_text(text)
        return path

    return make


def _table(columns: int) -> str:
    rows = np.random.default_rng(1).normal(size=(40, columns))
    rows[:, 0] = 1 + 0.01 * np.arange(40)
    return "".join(" ".join(f"{v:.6f}" for v in row) + "\n" for row in rows)


FORMATS: dict[str, tuple[Callable[[Path], Path], Read]] = {
    "ros1": (_bag("ros1"), read_recording),
    "sqlite3": (_bag("sqlite3"), read_recording),
    "mcap": (_bag("mcap"), read_recording),
    "raw": (_raw, read_recording),
    "npz": (_npz, read_recording),
    "dsec": (_dsec, read_recording),
    "mvsec": (_mvsec, read_recording),
    "hdf5": (_columns_file, read_recording),
    "npy": (_array("npy"), read_recording),
    "fields": (_array("fields"), read_recording),
    "table": (_array("table"), read_recording),
    "compound": (_array("compound"), read_recording),
    "ecd": (_ecd, read_recording),
    "calib_txt": (_text("calib.txt", CALIB), read_calibration),
    "calib_yaml": (_text("calib.yaml", YAML), read_calibration),
    "calib_kalibr": (_text("kalibr.yaml", KALIBR), read_calibration),
    "calib_opencv": (_text("opencv.yaml", OPENCV), read_calibration),
    "motion_txt": (_text("motion.txt", "0.1 0.2 0.3\n"), read_truth),
    "imu_txt": (_text("imu.txt", _table(7)), read_truth),
    "groundtruth_txt": (_text("groundtruth.txt", _table(8)), read_truth),
}

if __name__ == "__main__":
    sys.exit(main())
