"""Text files, NumPy files and HDF5 files of events, in the layouts that tools write."""

import h5py
import numpy as np

from emoflow_ros.core.types.events import Events

SCALES = {"s": 1e-9, "ms": 1e-6, "us": 1e-3, "ns": 1}


def steady_events(count: int, step_ns: int = 3000, seed: int = 4) -> Events:
    """Events at a steady rate from 2 s on, anywhere on a sensor of 346x260."""
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, 346, count), rng.integers(0, 260, count)
    t = 2_000_000_000 + np.arange(count) * step_ns
    return Events(x.astype(np.uint16), y.astype(np.uint16), t, rng.random(count) < 0.5)


def write_text(path, events, layout="txyp", unit="s", off=0, first="", between="", last=""):
    columns = {"x": events.x, "y": events.y, "p": np.where(events.p, 1, off)}
    form = {"s": "{:.9f}", "ms": "{:.6f}", "us": "{:.0f}", "ns": "{:.0f}"}[unit]
    columns["t"] = [form.format(t * SCALES[unit]) for t in events.t]
    rows = [" ".join(map(str, row)) for row in zip(*(columns[c] for c in layout), strict=True)]
    middle = len(rows) // 2
    rows[middle:middle] = [between] if between else []
    path.write_text(first + "\n".join(rows) + "\n" + last)
    return path


def write_npz(folder, events, t):
    np.savez(folder / "a.npz", x=events.x, y=events.y, t=t, p=events.p)
    return folder / "a.npz"


def write_hdf5(folder, events, t):
    with h5py.File(folder / "a.h5", "w") as file:
        columns = {"x": events.x, "y": events.y, "t": t, "p": events.p.astype(np.uint8)}
        for name, column in columns.items():
            file[f"events/{name}"] = column
    return folder / "a.h5"


def write_npy(folder, events, t):
    np.save(folder / "a.npy", np.stack([events.x, events.y, t, events.p], axis=1).astype(float))
    return folder / "a.npy"


def write_fields(folder, events, t):
    fields = [("timestamp", t.dtype), ("x", "u2"), ("y", "u2"), ("polarity", "u1")]
    array = np.empty(len(t), fields)
    array["timestamp"], array["x"], array["y"], array["polarity"] = t, events.x, events.y, events.p
    np.save(folder / "a.npy", array)
    return folder / "a.npy"


def write_table(folder, events, t):
    """As v2e does."""
    with h5py.File(folder / "a.h5", "w") as file:
        file["events"] = np.stack([t, events.x, events.y, events.p], axis=1).astype(t.dtype)
    return folder / "a.h5"


def write_compound(folder, events, t):
    """As Metavision does."""
    array = np.empty(len(t), [("x", "u2"), ("y", "u2"), ("p", "i2"), ("t", t.dtype)])
    array["x"], array["y"], array["t"], array["p"] = events.x, events.y, t, events.p
    with h5py.File(folder / "a.h5", "w") as file:
        file["CD/events"] = array
        file["CD/indexes"] = np.zeros(3)
    return folder / "a.h5"


ARRAY_WRITERS = {
    "npz": write_npz,
    "hdf5": write_hdf5,
    "npy": write_npy,
    "fields": write_fields,
    "table": write_table,
    "compound": write_compound,
}
