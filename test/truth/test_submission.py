"""DSEC's flow images and the layout of a submission."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, Quality, Status
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.truth.dsec_flow import DsecInterval, Submission, read_flow_png, write_flow_png

RECTIFIED = Camera(640, 480, 569.76, 569.76, 335.1, 221.24)


def decode_png(data: bytes) -> np.ndarray:
    """Channels (H, W, 3) of a 16-bit RGB PNG, by the specification (ISO/IEC 15948)."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, body = 8, b""
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        chunk = data[at + 8 : at + 8 + size]
        if kind == b"IHDR":
            width, height, depth, colour = struct.unpack_from(">IIBB", chunk)
            assert (depth, colour) == (16, 2)  # 16 bits, RGB
        if kind == b"IDAT":
            body += chunk
        at += size + 12
    lines = zlib.decompress(body)
    rows, before = [], bytes(6 * width)
    for k in range(height):
        line = lines[k * (6 * width + 1) :][: 6 * width + 1]
        before = unfilter(line[0], line[1:], before)
        rows.append(np.frombuffer(before, ">u2").reshape(width, 3))
    return np.array(rows)


def unfilter(kind: int, line: bytes, above: bytes) -> bytes:
    out = bytearray(line)
    for i in range(len(line)):
        a, b = (out[i - 6] if i >= 6 else 0), above[i]
        c = above[i - 6] if i >= 6 else 0
        nearest = min((abs(b - c), 0, a), (abs(a - c), 1, b), (abs(a + b - 2 * c), 2, c))[2]
        out[i] = (line[i] + (0, a, b, (a + b) // 2, nearest)[kind]) % 256
    return bytes(out)


class TestFlowPng:
    def test_channels_are_x_y_and_valid(self, tmp_path):
        """flow * 128 + 2^15, in the order red, green, blue."""
        flow = np.zeros((3, 4, 2), np.float32)
        flow[1, 2] = (2.0, -0.5)
        flow[0, 3] = (300.0, -300.0)  # more than 16 bits hold
        write_flow_png(tmp_path / "a.png", flow)
        rgb = decode_png((tmp_path / "a.png").read_bytes())
        np.testing.assert_array_equal(rgb[1, 2], [32768 + 256, 32768 - 64, 1])
        np.testing.assert_array_equal(rgb[0, 3], [65535, 0, 1])
        np.testing.assert_array_equal(rgb[0, 0], [32768, 32768, 1])

    def test_round_trip_within_half_a_step(self, tmp_path):
        flow = np.random.default_rng(0).normal(0, 30, (20, 30, 2)).astype(np.float32)
        write_flow_png(tmp_path / "a.png", flow)
        read, valid = read_flow_png(tmp_path / "a.png")
        assert valid.all()
        np.testing.assert_allclose(read, flow, atol=0.5 / 128)

    def test_pixels_that_are_not_valid(self, tmp_path):
        bgr = np.zeros((2, 2, 3), np.uint16)
        bgr[0, 1] = (1, 32768 + 128, 32768 - 128)
        cv2.imwrite(str(tmp_path / "a.png"), bgr)
        flow, valid = read_flow_png(tmp_path / "a.png")
        np.testing.assert_array_equal(valid, [[False, True], [False, False]])
        np.testing.assert_array_equal(flow[0], [[0, 0], [-1, 1]])

    def test_other_images_are_refused(self, tmp_path):
        path = tmp_path / "a.png"
        with pytest.raises(InputError, match=r"a\.png: missing or damaged"):
            read_flow_png(path)
        cv2.imwrite(str(path), np.zeros((2, 2, 3), np.uint8))
        with pytest.raises(InputError, match="not a PNG of three 16-bit channels"):
            read_flow_png(path)


class Sideways:
    """Flow of (10, -3) px/s, unknown in the first column."""

    def displacement(self, t0, t1):
        flow = np.full((480, 640, 2), (10.0, -3.0)) * (t1 - t0) / NS_PER_S
        flow[:, 0] = np.nan
        return flow


def estimate(flow):
    return Estimate(0, 1, 0, Status.OK, Quality(events=1), flow=flow)


class TestSubmission:
    IMAGES = (DsecInterval(0, 100 * NS_PER_MS, 820), DsecInterval(5, 6, 1380))

    def test_layout_and_values(self, tmp_path):
        stale = tmp_path / "thun_01_a" / "000001.png"
        stale.parent.mkdir()
        stale.touch()
        submission = Submission(tmp_path, "thun_01_a", self.IMAGES, RECTIFIED)
        submission.offer(0, 100 * NS_PER_MS, estimate(Sideways()))
        submission.offer(0, 50 * NS_PER_MS, estimate(Sideways()))  # nobody asks for it
        assert submission.finish() == 1
        files = [p.relative_to(tmp_path).as_posix() for p in sorted(tmp_path.rglob("*.png"))]
        assert files == ["thun_01_a/000820.png", "thun_01_a/001380.png"]
        flow, valid = read_flow_png(tmp_path / "thun_01_a" / "000820.png")
        assert valid.all()
        np.testing.assert_allclose(flow[7, 9], (1.0, -0.3), atol=0.5 / 128)
        np.testing.assert_array_equal(flow[:, 0], np.zeros((480, 2)))
        assert not read_flow_png(tmp_path / "thun_01_a" / "001380.png")[0].any()

    def test_windows_without_an_estimate_write_nothing(self, tmp_path):
        submission = Submission(tmp_path, "thun_01_a", self.IMAGES, RECTIFIED)
        submission.offer(5, 6, estimate(None))
        assert not list(tmp_path.rglob("*.png"))

    def test_resumed_run_keeps_what_is_there(self, tmp_path):
        first = Submission(tmp_path, "thun_01_a", self.IMAGES, RECTIFIED)
        first.offer(0, 100 * NS_PER_MS, estimate(Sideways()))
        again = Submission(tmp_path, "thun_01_a", self.IMAGES, RECTIFIED, keep=True)
        assert again.finish() == 1

    def test_other_cameras_are_refused(self, tmp_path):
        camera = Camera(346, 260, 200.0, 200.0, 170.0, 130.0)
        with pytest.raises(InputError, match="flow of 346x260 px"):
            Submission(tmp_path, "thun_01_a", self.IMAGES, camera)
