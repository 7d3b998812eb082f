"""A loop of simulated events of a sensor as EVT3 packets, and bags that repeat it.

A camera circles in the room of the scene `calm`, about as fast as there, and comes back where it
began: a loop of one turn has no jump at its seam. A bag repeats the packets, with later times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg
from tqdm import tqdm

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events, WindowPolicy, WindowSlicer
from emoflow_ros.simulation.messages import CAMERA_INFO, OPTICAL_FRAME, MessageEncoder
from emoflow_ros.simulation.raycast import RayCaster
from emoflow_ros.simulation.recording import build_scene, davis346
from emoflow_ros.simulation.recording_files import Topic, write_bag
from emoflow_ros.simulation.scene import (
    PITCH,
    ROLL,
    YAW,
    Scene,
    Trajectory,
    Wave,
    X,
    Y,
    Z,
)
from emoflow_ros.simulation.sensor import EventPixels, SensorModel, background_noise
from emoflow_ros.simulation.textures import make_textures

EVENTS, CALIBRATION, MARKS = "/camera/events", "/camera/camera_info", "/benchmark/marks"
START = 1_500_000_000 * NS_PER_S  # ROS time of the first events; the sensor counts from 0

_SCENE, _SEED, _TEXTURES = "calm", 0, 6
_FRAME_US = 4096  # rendered; one step of EVT3's high time word
_FRAME = 1000 * _FRAME_US
_FRAMES = 1000  # per turn
_CALIBRATION_PERIOD = 50 * NS_PER_MS
_LEAD_IN_S = 2.0  # of the clock
_PACKET = "event_camera_msgs/msg/EventPacket"
_PACKET_MSG = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\nuint64 time_base\n"
    "string encoding\nbool is_bigendian\nuint8[] events\n"
)
_MARK = "std_msgs/msg/Header"


@dataclass(frozen=True)
class Sensor:
    """A sensor: its size in px, and its pixels' contrast threshold."""

    width: int
    height: int
    threshold: float


@dataclass
class Loop:
    """One turn of the camera, over and over.

    Attributes:
        camera: whose events they are.
        mev_per_s: a rate in million events per second above which the sensor leaves events out
            evenly, as rate controllers in sensors do; None: all are sent.
        per_frame: packets per rendered frame of 4.096 ms.
        packets: words of EVT3 of each packet of a turn.
        spans: times of each packet's first and last event from the turn's start, ns.
        counts: events of each packet.
    """

    camera: Camera
    mev_per_s: float | None
    per_frame: int
    packets: list[NDArray[np.uint16]] = field(default_factory=list)
    spans: list[tuple[int, int]] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)

    @property
    def period(self) -> int:
        """From one packet to the next, ns."""
        return _FRAME // self.per_frame

    def add_frame(self, events: Events) -> None:
        """Take the next frame's events, in order of time.

        Raises:
            ValueError: a packet would be empty.
        """
        if self.mev_per_s is not None:
            most = round(self.mev_per_s * _FRAME_US)
            if len(events) > most:
                events = events[np.arange(most) * len(events) // most]
        for _ in range(self.per_frame):
            begin = len(self.packets) * self.period
            first, last = np.searchsorted(events.t, [begin, begin + self.period])
            if first == last:
                raise ValueError(f"no events from {begin} to {begin + self.period} ns")
            part = events[first:last]
            self.packets.append(evt3(part))
            self.spans.append((int(part.t[0]), int(part.t[-1])))
            self.counts.append(len(part))

    def size(self, duration_s: float) -> int:
        """Return the number of packets in so many seconds."""
        return int(duration_s * NS_PER_S) // self.period

    def packet(self, k: int) -> NDArray[np.uint16]:
        """Return the words of the k-th packet from the start, its time included."""
        words = self.packets[k % len(self.packets)].copy()
        words[0] = 0x8000 | k // self.per_frame & 0xFFF
        return words

    def span(self, k: int) -> tuple[int, int]:
        """Return the times of the first and the last event of the k-th packet, ns."""
        shift = k // len(self.packets) * len(self.packets) * self.period
        first, last = self.spans[k % len(self.packets)]
        return first + shift, last + shift

    def events(self, duration_s: float) -> int:
        """Return the number of events in so many seconds."""
        turns, rest = divmod(self.size(duration_s), len(self.packets))
        return turns * sum(self.counts) + sum(self.counts[:rest])

    def windows(self, duration_s: float, policy: WindowPolicy) -> int:
        """Return the number of windows by time in so many seconds of events."""
        slicer = WindowSlicer(policy)
        # The ends of a packet tell as much as all of it: windows are longer than packets.
        ends = (np.array(self.span(k)) for k in range(self.size(duration_s)))
        zeros = np.zeros(2, np.uint16)
        return sum(len(slicer.push(Events(zeros, zeros, t, zeros > 0))) for t in ends)


def simulate_loops(
    sensor: Sensor, rates: Sequence[tuple[float | None, int]], *, progress: bool = False
) -> list[Loop]:
    """Simulate one turn, once for all loops.

    Args:
        sensor: what looks.
        rates: `mev_per_s` and `per_frame` of each loop.
        progress: whether to show a bar.
    """
    camera = scaled_camera(sensor.width, sensor.height)
    layout_rng, texture_rng, pixel_rng, noise_rng = np.random.default_rng(_SEED).spawn(4)
    trajectory = circle(_FRAMES * _FRAME / NS_PER_S)
    scene = Scene(build_scene(_SCENE, 1.0, layout_rng).quads, trajectory)
    textures = make_textures(_TEXTURES, texture_rng)
    caster = RayCaster(camera, scene.quads)
    model = SensorModel(sensor.threshold, sensor.threshold, refractory_us=100)
    pixels = EventPixels(model, caster.render(*scene.poses(0.0), textures), 0, pixel_rng)
    shape = (camera.height, camera.width)
    loops = [Loop(camera, *rate) for rate in rates]
    label = f"rendering {camera.width}x{camera.height}"
    for frame in tqdm(range(_FRAMES), label, unit="frame", disable=not progress):
        begin, end = frame * _FRAME, (frame + 1) * _FRAME
        seen = pixels.advance(caster.render(*scene.poses(end / NS_PER_S), textures), end)
        noise = background_noise(scene.noise_hz, shape, begin, end, noise_rng)
        events = Events.concatenate([seen[seen.t < end], noise])
        events = events[np.argsort(events.t, kind="stable")]
        for loop in loops:
            loop.add_frame(events)
    return loops


def scaled_camera(width: int, height: int) -> Camera:
    """Build a camera of another size with the DAVIS346's horizontal field of view."""
    davis = davis346("none")
    focal = davis.fx * width / davis.width
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def circle(seconds: float) -> Trajectory:
    """Move about as the camera of `calm` does, but come back after so many seconds."""
    hz = 1 / seconds
    waves = []
    for x, y, z, rate in ((X, Y, Z, 0.4), (YAW, PITCH, ROLL, np.radians(10.0))):
        amplitude = float(rate) / (2 * np.pi * hz)
        waves.append(Wave(x, amplitude, hz, 0.0))
        waves.append(Wave(y, amplitude, hz, np.pi / 2 if x == X else -np.pi / 2))
        waves.append(Wave(z, 0.2 * amplitude, 2 * hz, 0.0))
    return Trajectory(waves=tuple(waves))


def evt3(events: Events) -> NDArray[np.uint16]:
    """Encode events of one step of the high time word, which is the first word."""
    us = events.t // 1000
    words = np.empty((len(events), 4), np.uint16)
    words[:, 0] = 0x8000 | us >> 12 & 0xFFF
    words[:, 1] = 0x6000 | us & 0xFFF
    words[:, 2] = events.y
    words[:, 3] = 0x2000 | events.p.astype(np.uint16) << 11 | events.x
    says = np.ones(words.shape, np.bool_)  # time and row hold until they change
    says[1:, :3] = words[1:, :3] != words[:-1, :3]
    return words[says]


def write_loop(
    path: Path, loop: Loop, duration_s: float, pace: float, *, progress: bool = False
) -> None:
    """Write a bag for a replay at this pace: packets, calibration, and marks.

    A mark stands before a packet, with the packet's end. There is one in about 4 ms of the replay:
    one for each packet would take 0.3 of a core at a pace of 10.

    Args:
        path: does not exist yet.
        loop: what is repeated.
        duration_s: length of the events.
        pace: of the replay. Before the events it plays the calibration alone for 2 s, in which all
            subscribers find their topics.
        progress: whether to show a bar.
    """
    encoder = MessageEncoder(ros1=False)
    store = encoder.typestore
    store.register(get_types_from_msg(_PACKET_MSG, _PACKET))
    packet, header = store.types[_PACKET], store.types[_MARK]
    stamp = store.types["builtin_interfaces/msg/Time"]
    camera, period = loop.camera, loop.period
    ends = range(START + period, START + (loop.size(duration_s) + 1) * period, period)

    def encode_packet(end: int) -> bytes:
        k = (end - START) // period - 1
        arrived = START + loop.span(k)[0]  # a driver stamps the first event's arrival
        message = packet(
            header=header(stamp(*divmod(arrived, NS_PER_S)), OPTICAL_FRAME),
            height=camera.height,
            width=camera.width,
            seq=k,
            time_base=0,
            encoding="evt3",
            is_bigendian=False,
            events=loop.packet(k).view(np.uint8),
        )
        return bytes(store.serialize_cdr(message, _PACKET))

    def encode_mark(end: int) -> bytes:
        return bytes(store.serialize_cdr(header(stamp(*divmod(end, NS_PER_S)), ""), _MARK))

    calibrations = range(START - round(_LEAD_IN_S * pace * NS_PER_S), ends[-1], _CALIBRATION_PERIOD)
    topics = [
        Topic(MARKS, _MARK, ends[:: max(1, round(_FRAME * pace / period))], encode_mark),
        Topic(EVENTS, _PACKET, ends, encode_packet),
        Topic(CALIBRATION, CAMERA_INFO, calibrations, lambda t: encoder.camera_info(t, camera)),
    ]
    write_bag(path, encoder, topics, progress=progress)
