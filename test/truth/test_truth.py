"""Ground truth against motions with a closed form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.truth.flow_maps import DepthFlowMaps, PropagatedFlow
from emoflow_ros.truth.ground_truth import PoseTrack, PoseTwist, TrueFlow
from emoflow_ros.truth.mvsec_truth import MvsecFlowMaps
from emoflow_ros.truth.text_truth import ConstantRotation

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
LENS = Camera(64, 48, 60.0, 60.0, 31.5, 23.5, "plumb_bob", (-0.3, 0.1, 0.001, 0.0))
START = 5 * NS_PER_S


def ns(seconds):
    return START + round(seconds * NS_PER_S)


def track(pose, duration=2.0, rate=20.0, noise=0.0):
    """Sample pose(t) -> (Rotation, position) as a PoseTrack."""
    times = np.arange(0, duration + 1e-9, 1 / rate)
    poses = [pose(t) for t in times]
    rng = np.random.default_rng(0)
    return PoseTrack(
        np.array([ns(t) for t in times]),
        np.array([p for _, p in poses]) + rng.normal(0, noise, (len(times), 3)),
        np.array([r.as_quat() for r, _ in poses]),
    )


def helix(t):
    """Constant twist: w about the camera's own axes, v along them."""
    w, v = np.array([0.3, -0.5, 0.8]), np.array([0.4, 0.1, -0.2])
    angle = np.linalg.norm(w)
    k = w / angle
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    a = angle * t
    integral = t * np.eye(3) + (1 - np.cos(a)) / angle * cross
    integral += (t - np.sin(a) / angle) * cross @ cross
    return Rotation.from_rotvec(w * t), integral @ v


class TestPoses:
    def test_constant_twist_in_the_cameras_frame(self):
        twists = PoseTwist(track(helix), "test")
        for t in (0.05, 0.5, 1.02, 1.9):
            twist = twists.twist(ns(t))
            np.testing.assert_allclose(twist.angular, [0.3, -0.5, 0.8], atol=1e-6)
            np.testing.assert_allclose(twist.linear, [0.4, 0.1, -0.2], atol=1e-4)

    def test_oscillation_keeps_its_amplitude(self):
        """The declared filter loses less than 2 % of 1 Hz."""

        def swing(t):
            angle = 0.2 * np.sin(2 * np.pi * t)
            return Rotation.from_rotvec([0, angle, 0]), np.array([angle, 0, 0])

        twist = PoseTwist(track(swing), "test").twist(ns(1.0))
        peak = 0.2 * 2 * np.pi
        assert twist.angular[1] == pytest.approx(peak, rel=0.02)
        assert twist.linear[0] == pytest.approx(peak, rel=0.02)

    def test_noise_of_a_millimetre_is_averaged_out(self):
        twist = PoseTwist(track(helix, rate=200.0, noise=1e-3), "test").twist(ns(1.0))
        np.testing.assert_allclose(twist.linear, [0.4, 0.1, -0.2], atol=0.01)

    @pytest.mark.parametrize("t", [-0.1, 2.1])
    def test_nothing_outside_the_poses(self, t):
        assert PoseTwist(track(helix), "test").twist(ns(t)) is None

    def test_nothing_in_a_gap(self):
        whole = track(helix)
        keep = np.abs(whole.stamps - ns(1.0)) > 0.12 * NS_PER_S
        gap = PoseTrack(whole.stamps[keep], whole.positions[keep], whole.quaternions[keep])
        assert PoseTwist(gap, "test").twist(ns(1.0)) is None

    def test_transform_between_two_poses(self):
        two = PoseTrack(
            np.array([0, 10]),
            np.array([[0.0, 0, 0], [2, 0, 0]]),
            Rotation.from_rotvec([[0, 0, 0], [0, 0, 1.0]]).as_quat(),
        )
        transform = two.transform(5)
        np.testing.assert_allclose(transform[:3, 3], [1, 0, 0])
        half_turn = Rotation.from_rotvec([0, 0, 0.5]).as_matrix()
        np.testing.assert_allclose(transform[:3, :3], half_turn, atol=1e-12)


class TestConstantRotation:
    def test_small_rotation_is_the_motion_field(self):
        """Over 1 ms the displacement is B w dt."""
        w = np.array([0.2, 0.5, -0.3])
        flow = ConstantRotation(CAMERA, w, "test").displacement(START, START + 1_000_000)
        assert flow.valid.all()
        x, y = CAMERA.bearings[..., 0], CAMERA.bearings[..., 1]
        u = x * y * w[0] - (1 + x * x) * w[1] + y * w[2]
        v = (1 + y * y) * w[0] - x * y * w[1] - x * w[2]
        expected = 60.0 * 1e-3 * np.stack([u, v], -1)
        np.testing.assert_allclose(flow.displacement, expected, atol=2e-5)

    def test_optical_axis_of_a_distorted_camera(self):
        """The ray on the axis moves to the pixel of the turned ray."""
        w = np.array([0.0, 0.5, 0.0])
        truth = ConstantRotation(LENS, w, "test").displacement(START, START + NS_PER_S // 5)
        row, column = 23, 31
        x, y = LENS.bearings[row, column].astype(float)
        ray = Rotation.from_rotvec([0, -0.1, 0]).apply([x, y, 1.0])
        moved = LENS.project(ray) - (column, row)
        np.testing.assert_allclose(truth.displacement[row, column], moved, atol=1e-4)


class Maps:
    """Flow maps from a list of (H, W, 2) arrays, 100 ns apart from 1000 ns on."""

    name = "test"

    def __init__(self, maps, moving=None):
        self.maps = [np.asarray(m, np.float32) for m in maps]
        self._moving = moving
        self.stamps = 1000 + 100 * np.arange(len(maps), dtype=np.int64)

    def read(self, index):
        return self.maps[index]

    def moving(self, index):
        return None if self._moving is None else self._moving[index]


def slow_propagation(maps, t0, t1) -> TrueFlow:
    """Pixel after pixel, map after map."""
    height, width = maps.maps[0].shape[:2]
    out, valid = np.zeros((height, width, 2)), np.zeros((height, width), bool)
    for row in range(height):
        for column in range(width):
            x, y, ok = float(column), float(row), True
            for i in range(len(maps.maps) - 1):
                begin, end = maps.stamps[i], maps.stamps[i + 1]
                overlap = min(end, t1) - max(begin, t0)
                if overlap <= 0:
                    continue
                c, r = round(x), round(y)
                if not (0 <= c < width and 0 <= r < height):
                    ok = False
                    break
                u, v = maps.maps[i][r, c]
                if not np.isfinite([u, v]).all() or (u == 0 and v == 0):
                    ok = False
                    break
                x += u * overlap / (end - begin)
                y += v * overlap / (end - begin)
            if ok:
                out[row, column] = x - column, y - row
            valid[row, column] = ok
    return TrueFlow(out, valid)


class TestPropagation:
    def test_part_of_one_map(self):
        flow = PropagatedFlow(Maps([np.full((4, 5, 2), (2.0, -1.0))] * 2))
        part = flow.displacement(1025, 1050)
        np.testing.assert_allclose(part.displacement, np.full((4, 5, 2), (0.5, -0.25)))

    def test_hand_computed_chain(self):
        """2 px right, then 1 px down from there; the last columns leave the image."""
        right, down = np.full((3, 5, 2), (2.0, 0.0)), np.full((3, 5, 2), (0.0, 1.0))
        flow = PropagatedFlow(Maps([right, down, down]))
        moved = flow.displacement(1000, 1150)
        expected_valid = np.zeros((3, 5), bool)
        expected_valid[:, :3] = True
        np.testing.assert_array_equal(moved.valid, expected_valid)
        np.testing.assert_allclose(moved.displacement[:, :3], np.full((3, 3, 2), (2.0, 0.5)))
        assert not moved.displacement[:, 3:].any()

    def test_equals_the_slow_implementation(self):
        rng = np.random.default_rng(3)
        stack = rng.normal(0, 2, (6, 9, 11, 2))
        stack[rng.random((6, 9, 11)) < 0.1] = 0
        stack[rng.random((6, 9, 11)) < 0.05] = np.nan
        maps = Maps(stack)
        flow = PropagatedFlow(maps)
        for t0, t1 in [(1000, 1500), (1010, 1090), (1050, 1333), (1100, 1200)]:
            ours, slow = flow.displacement(t0, t1), slow_propagation(maps, t0, t1)
            np.testing.assert_array_equal(ours.valid, slow.valid)
            np.testing.assert_allclose(ours.displacement, slow.displacement, atol=1e-5)

    def test_what_meets_a_moving_object_moves(self):
        """Two maps, 1 px to the right each; the object sits in column 3 first, in 5 then."""
        masks = [np.zeros((2, 8), bool) for _ in range(3)]
        masks[0][:, 3], masks[1][:, 5] = True, True
        flow = PropagatedFlow(Maps([np.full((2, 8, 2), (1.0, 0.0))] * 3, masks))
        moving = flow.displacement(1000, 1200).moving
        np.testing.assert_array_equal(np.flatnonzero(moving[0]), [3, 4])
        assert (
            PropagatedFlow(Maps([np.ones((2, 2, 2))] * 2)).displacement(1000, 1100).moving is None
        )

    def test_published_rule_scales_one_map_in_short_intervals(self):
        """Half of each map: 1 px right and 1 px up; by the published rule all of the first."""
        right, up = np.full((4, 5, 2), (2.0, 0.0)), np.full((4, 5, 2), (0.0, -2.0))
        chained = PropagatedFlow(Maps([right, up, up]))
        published = chained.as_published()
        exact = chained.displacement(1050, 1150).displacement
        np.testing.assert_allclose(exact[1:, :-1], np.full((3, 4, 2), (1.0, -1.0)))
        ours = published.displacement(1050, 1140)
        np.testing.assert_allclose(ours.displacement, np.full((4, 5, 2), (1.8, 0.0)), rtol=1e-6)
        assert ours.valid.all()  # nothing leaves the image, as nothing is looked up there
        assert "the first map alone, scaled" in published.description

    def test_published_rule_in_uneven_maps_and_long_intervals(self):
        """Its condition is the length of the map that the interval begins in, not of the next."""
        rng = np.random.default_rng(5)
        maps = Maps(rng.normal(0, 2, (6, 9, 11, 2)))
        maps.stamps = np.array([1000, 1100, 1150, 1350, 1400, 1500])
        chained, published = PropagatedFlow(maps), PropagatedFlow(maps).as_published()
        scaled = {(1090, 1180): (0, 0.9), (1160, 1340): (2, 0.9), (1290, 1489): (2, 0.995)}
        for (t0, t1), (index, share) in scaled.items():
            ours = published.displacement(t0, t1).displacement
            np.testing.assert_allclose(ours, share * maps.read(index), rtol=1e-5)
        for t0, t1 in [(1120, 1170), (1090, 1190), (1000, 1500)]:
            ours, slow = published.displacement(t0, t1), chained.displacement(t0, t1)
            np.testing.assert_array_equal(ours.displacement, slow.displacement)
            np.testing.assert_array_equal(ours.valid, slow.valid)

    @pytest.mark.parametrize(("t0", "t1"), [(999, 1050), (1050, 1101), (1050, 1050)])
    def test_nothing_outside_the_stamps(self, t0, t1):
        assert PropagatedFlow(Maps([np.ones((2, 2, 2))] * 2)).displacement(t0, t1) is None


class TestMvsecNpz:
    def write(self, path, save=np.savez):
        x = np.arange(4 * 30 * 50, dtype=np.float64).reshape(4, 30, 50)
        save(path, timestamps=[10.0, 10.05, 10.1, 10.15], x_flow_dist=x, y_flow_dist=-x)
        return x

    @pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
    def test_maps_in_any_order(self, tmp_path, save):
        path = tmp_path / "a_gt_flow_dist.npz"
        x = self.write(path, save)
        maps = MvsecFlowMaps(path)
        np.testing.assert_array_equal(maps.stamps[:2], [10_000_000_000, 10_050_000_000])
        for i in (0, 2, 1, 3):
            np.testing.assert_array_equal(maps.read(i), np.stack([x[i], -x[i]], -1))

    def test_what_moves_is_read_where_the_file_tells(self, tmp_path):
        path = tmp_path / "a_gt_flow_dist.npz"
        self.write(path)
        assert MvsecFlowMaps(path).moving(0) is None
        masks = np.random.default_rng(0).random((2, 3, 4)) < 0.5
        flow = np.ones((2, 3, 4))
        np.savez(path, timestamps=[0.0, 0.1], x_flow_dist=flow, y_flow_dist=flow, moving=masks)
        maps = MvsecFlowMaps(path)
        for i in (1, 0):
            np.testing.assert_array_equal(maps.moving(i), masks[i])

    def test_other_files_are_refused(self, tmp_path):
        path = tmp_path / "a.npz"
        for make in (
            lambda: np.savez(path, other=np.zeros(3)),
            lambda: path.write_bytes(b"no archive"),
            lambda: np.savez(
                path, timestamps=[1.0], x_flow_dist=np.zeros(3), y_flow_dist=np.zeros(3)
            ),
        ):
            make()
            with pytest.raises(InputError, match="not a flow ground truth"):
                MvsecFlowMaps(path)


class TestDepth:
    def test_sideways_motion_before_a_wall(self):
        """Flow is -f v dt / Z everywhere."""
        moving = track(lambda t: (Rotation.identity(), np.array([0.5 * t, 0, 0])))
        stamps = np.array([ns(t) for t in (0.0, 0.05, 0.1, 3.0)])
        wall = np.full((48, 64), 2.0, np.float32)
        wall[0, 0] = np.nan
        maps = DepthFlowMaps(CAMERA, moving, stamps, lambda i: wall, "test")
        assert len(maps.stamps) == 3  # the last one is beyond the poses
        flow = maps.read(0)
        assert np.isnan(flow[0, 0]).all()
        np.testing.assert_allclose(flow[1:, :, 0], -60 * 0.5 * 0.05 / 2.0, rtol=1e-5)
        np.testing.assert_allclose(flow[1:, :, 1], 0, atol=1e-5)

    def test_pure_rotation_needs_no_depth(self):
        """Any depth gives the flow of ConstantRotation, lens included."""
        w = np.array([0.1, 0.6, -0.2])
        turning = track(lambda t: (Rotation.from_rotvec(w * t), np.zeros(3)))
        stamps = np.array([ns(0.0), ns(0.05)])
        depth = np.random.default_rng(0).uniform(1, 9, (48, 64)).astype(np.float32)
        flow = DepthFlowMaps(LENS, turning, stamps, lambda i: depth, "test").read(0)
        expected = ConstantRotation(LENS, w, "test").displacement(*stamps.tolist())
        np.testing.assert_allclose(flow, expected.displacement, atol=1e-3)
