"""Two flows blended by which is sharper: known flows, and depths that only one of them shows."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import motion_field
from emoflow_ros.core.lattice.blending import Blend, Rigid
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.refinement import Depths
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.window_events import WindowEvents
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status

SIZE = 173, 130
WINDOW_NS = 100_000_000
CAMERA = Camera(*SIZE, 120.0, 120.0, 86.0, 64.5)
COARSE = Lattice.with_spacing(*SIZE, 26.0)
W, V = np.array([0.02, -0.03, 0.01]), np.array([1.0, 0.0, 0.0])
RHO = 0.08  # ways per window: 10 px


class Still:
    """A constant motion (a Motion)."""

    def angular(self, _: int) -> np.ndarray:
        return W * (1e9 / WINDOW_NS)

    def linear(self, _: int) -> np.ndarray:
        return V


class Growing(Still):
    """A rotation that grows from half to one and a half of it over the window."""

    def angular(self, t: int) -> np.ndarray:
        return (0.5 + t / WINDOW_NS) * super().angular(t)


def estimate(motion: Still | None = None) -> Estimate:
    found = Estimate(0, WINDOW_NS, WINDOW_NS // 2, Status.OK, Quality(1, 1, "", 2.0))
    covariance = np.diag([0.0, 0.1, 0.1, 0.1, 0.1, 0.1])
    return replace(
        found, model=MotionModel.FULL, linear=V, covariance=covariance, motion=motion or Still()
    )


def depths(near: float = 1.0) -> Depths:
    """Points all over the image; those of the right half are so many times as near."""
    x, y = np.meshgrid(np.arange(4.0, SIZE[0], 8), np.arange(4.0, SIZE[1], 8))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    rho = RHO * np.where(points[:, 0] > SIZE[0] / 2, near, 1.0)
    return Depths(points, rho * (1e9 / WINDOW_NS), np.ones(len(points)))


NO_DEPTHS = Depths(np.zeros((0, 2)), np.zeros(0), np.zeros(0))


def flow_of(points: np.ndarray, rho: np.ndarray) -> np.ndarray:
    a, b = motion_field(CAMERA, points)
    return b @ W + rho[:, None] * (a @ V)


def events(near: float = 1.0) -> WindowEvents:
    """Edges of a rigid scene whose right half is nearer, seen at their true places."""
    rng = np.random.default_rng(3)
    spots = rng.uniform(8, np.array(SIZE) - 8, (400, 2))
    spots = spots[np.abs(spots[:, 0] - SIZE[0] / 2) > 12]
    which = rng.integers(len(spots), size=12_000)
    s = np.sort(rng.uniform(size=len(which)))
    at = spots[which]
    rho = RHO * np.where(at[:, 0] > SIZE[0] / 2, near, 1.0)
    xy = at + (s[:, None] - 0.5) * flow_of(at, rho)
    seen = ((xy > 0) & (xy < np.array(SIZE) - 1)).all(axis=1)
    columns = (xy[seen, 0], xy[seen, 1], s[seen], np.where(which % 2, 1.0, -1.0)[seen])
    return WindowEvents(*(c.astype(np.float32) for c in columns))


def lattice_flow(near: float = 1.0) -> np.ndarray:
    nodes = COARSE.pixels
    rho = RHO * np.where(nodes[:, 0] > SIZE[0] / 2, near, 1.0)
    return np.repeat(flow_of(nodes, rho)[:, None], 2, axis=1).reshape(COARSE.shape)


def rigid_scene(blend: Blend, near: float = 1.0, seen: WindowEvents | None = None) -> Rigid:
    """The scene of the true motion and of depths, as its own events, or others, show it."""
    rigid = blend.rigid(events(near) if seen is None else seen, estimate(), depths(near))
    assert rigid is not None
    return rigid


def right_of(blend: Blend) -> np.ndarray:
    """Nodes of the fine lattice that lie in the right half, away from its sides.

    Beside the left half that counts, too, for it is farther away.
    """
    x, y = blend.fine.pixels.T
    return (x > SIZE[0] / 2 + 24) & (x < SIZE[0] - 20) & (y > 20) & (y < SIZE[1] - 20)


def share_of_depths(blend: Blend, flow: np.ndarray, blended: np.ndarray) -> np.ndarray:
    """Share of twice the depth in the right half, of a blend with the lattice's one depth."""
    nodes, right = blend.fine.pixels, right_of(blend)
    own = COARSE.interpolate(flow.mean(axis=2).reshape(-1, 2).astype(float), nodes)
    other = flow_of(nodes, np.full(len(nodes), 2 * RHO))
    return (blended.mean(axis=2).reshape(-1, 2) - own)[right, 0] / (other - own)[right, 0]


def test_every_third_node_is_one_of_the_lattice():
    blend = Blend(CAMERA, COARSE, 0.3)
    pixels = blend.fine.pixels.reshape(blend.fine.columns, blend.fine.rows, 2)
    assert pixels[::3, ::3].reshape(-1, 2) == pytest.approx(COARSE.pixels)


def test_a_rigid_flow_is_that_of_the_depths():
    blend = Blend(CAMERA, COARSE, 0.3)
    rigid = rigid_scene(blend, 2.0).flow
    nodes = blend.fine.pixels
    true = flow_of(nodes, RHO * np.where(nodes[:, 0] > SIZE[0] / 2, 2.0, 1.0))
    off_the_edge = np.abs(nodes[:, 0] - SIZE[0] / 2) > 30
    for time in range(2):
        flow = rigid[:, :, time].reshape(-1, 2)
        assert flow[off_the_edge] == pytest.approx(true[off_the_edge], abs=0.05)


def test_a_rotation_that_grows_is_in_the_rigid_flow():
    blend = Blend(CAMERA, COARSE, 0.3)
    rotating = replace(estimate(Growing()), model=MotionModel.ROTATION, linear=np.zeros(3))
    rigid = blend.rigid(events(), rotating, NO_DEPTHS)
    assert rigid is not None
    at_rest = np.zeros(len(blend.fine.pixels))
    for time, share in enumerate((0.5, 1.5)):
        true = share * flow_of(blend.fine.pixels, at_rest)
        assert rigid.flow[:, :, time].reshape(-1, 2) == pytest.approx(true, abs=1e-3)


def test_a_camera_that_travels_shows_no_rigid_flow_without_depths():
    assert Blend(CAMERA, COARSE, 0.3).rigid(events(), estimate(), NO_DEPTHS) is None


def test_two_flows_that_agree_stay_as_they_are():
    blend, flow = Blend(CAMERA, COARSE, 0.3), lattice_flow().astype(np.float32)
    blended = blend(events(), flow, rigid_scene(blend))
    own = COARSE.interpolate(flow[:, :, 0].reshape(-1, 2).astype(float), blend.fine.pixels)
    for time in range(2):
        assert blended[:, :, time].reshape(-1, 2) == pytest.approx(own, abs=0.03)


def test_where_the_depths_are_sharper_they_are_believed():
    blend = Blend(CAMERA, COARSE, 0.3)
    flow = lattice_flow().astype(np.float32)  # the whole scene at one depth
    blended = blend(events(2.0), flow, rigid_scene(blend, 2.0)).mean(axis=2).reshape(-1, 2)
    true = flow_of(blend.fine.pixels, np.full(len(blended), 2 * RHO))
    right = right_of(blend)
    own = COARSE.interpolate(flow.mean(axis=2).reshape(-1, 2).astype(float), blend.fine.pixels)
    before, after = (np.linalg.norm((f - true)[right], axis=1).mean() for f in (own, blended))
    assert before > 8
    assert after < 1


def test_where_the_lattice_is_sharper_depths_are_not_believed():
    blend, flow = Blend(CAMERA, COARSE, 0.3), lattice_flow(2.0).astype(np.float32)
    blended = (
        blend(events(2.0), flow, rigid_scene(blend, 1.0, events(2.0))).mean(axis=2).reshape(-1, 2)
    )
    own = COARSE.interpolate(flow.mean(axis=2).reshape(-1, 2).astype(float), blend.fine.pixels)
    right = right_of(blend)
    assert np.linalg.norm((blended - own)[right], axis=1).mean() < 0.5


def test_another_fit_takes_the_depths_that_are_near_a_node():
    blend, known = Blend(CAMERA, COARSE, 0.3), depths()
    left = known.points[:, 0] < 80
    known = Depths(known.points[left], known.inverse_depth[left], known.weight[left])
    rigid = blend.rigid(events(), estimate(), known)
    assert rigid is not None
    structure = rigid.structure
    assert structure is not None
    among, far = COARSE.pixels[:, 0] < 60, COARSE.pixels[:, 0] > 130
    assert structure.inverse_depth == pytest.approx(RHO, rel=0.01)
    sure = 1 / (0.3 * RHO) ** 2
    assert structure.information[among].min() > 0.4 * sure
    assert structure.information.max() < sure
    assert structure.information[far].max() < 0.05 * sure
    far_away = replace(known, inverse_depth=1e-3 * known.inverse_depth)
    rigid = blend.rigid(events(), estimate(), far_away)
    assert rigid is not None and rigid.structure is not None
    of_flow = LATTICE.flow_error_px**2 / CAMERA.fx**2  # along the image plane
    assert rigid.structure.information.max() < 1.01 / of_flow


def test_without_events_both_count_the_same():
    blend, flow = Blend(CAMERA, COARSE, 0.3), lattice_flow().astype(np.float32)
    nothing = WindowEvents(*np.zeros((4, 1), np.float32))
    rigid = rigid_scene(blend, 2.0, nothing)
    share = share_of_depths(blend, flow, blend(nothing, flow, rigid))
    assert share == pytest.approx(0.5, abs=0.01)


def test_where_events_are_equally_sharp_both_count_the_same():
    blend, flow = Blend(CAMERA, COARSE, 0.3), lattice_flow().astype(np.float32)
    edges = events()
    at_once = replace(edges, s=np.full_like(edges.s, 0.5))  # no flow moves them
    blended = blend(at_once, flow, rigid_scene(blend, 2.0, at_once))
    assert share_of_depths(blend, flow, blended) == pytest.approx(0.5, abs=0.01)


def starts_with_the_scene(near: float, seen: float) -> np.ndarray:
    """Which of the lattice's right nodes begin with a scene that is so many times as near."""
    blend, flow = Blend(CAMERA, COARSE, 0.3), lattice_flow().astype(np.float32)
    rigid = rigid_scene(blend, near, events(seen))
    begin = blend.start(events(seen), flow, rigid)
    assert begin.shape == COARSE.shape and begin.dtype == np.float32
    of_scene = (begin == rigid.flow[::3, ::3].astype(np.float32)).all(axis=(2, 3))
    of_lattice = np.abs(begin - flow).max(axis=(2, 3)) < 1e-4
    assert (of_scene | of_lattice).all()
    x, y = COARSE.pixels.T
    right = (x > SIZE[0] / 2 + 16) & (x < SIZE[0] - 20) & (y > 20) & (y < SIZE[1] - 20)
    return of_scene.ravel()[right]


def test_another_fit_begins_with_the_rigid_scene_where_it_is_sharper():
    assert starts_with_the_scene(near=2.0, seen=2.0).all()


def test_another_fit_begins_with_the_rigid_scene_where_both_are_as_sharp():
    blend, flow = Blend(CAMERA, COARSE, 0.3), lattice_flow().astype(np.float32)
    edges = events()
    at_once = replace(edges, s=np.full_like(edges.s, 0.5))  # no flow moves them
    rigid = rigid_scene(blend, 2.0, at_once)
    assert blend.start(at_once, flow, rigid) == pytest.approx(rigid.flow[::3, ::3], abs=1e-3)


def test_another_fit_begins_with_the_lattice_where_that_is_clearly_sharper():
    assert not starts_with_the_scene(near=2.0, seen=1.0).any()


@pytest.mark.parametrize("place", [(40.0, 90.0), (150.0, 20.0), (70.0, 60.0)])
def test_contrast_is_that_around_a_node(place):
    blend = Blend(CAMERA, COARSE, 0.3)
    x, y = (np.array([value], np.float32) for value in place)
    event = WindowEvents(x, y, np.full(1, 0.5, np.float32), np.full(1, 1e3, np.float32))
    around = blend._around(event, np.zeros(blend.fine.shape)).ravel()
    apart = np.linalg.norm(blend.fine.pixels - place, axis=1)
    assert around.argmax() == apart.argmin()
    close = apart < 30
    expected = np.exp(-(apart**2) / (2 * LATTICE.blend_px**2))
    share = around[close] / around.max() / (expected[close] / expected.max())
    assert share == pytest.approx(1, abs=0.08)


def test_where_the_lens_has_no_inverse_the_lattice_counts():
    camera = replace(CAMERA, model="plumb_bob", distortion=(-0.9, 0.0, 0.0, 0.0))
    blend, flow = Blend(camera, COARSE, 0.3), lattice_flow().astype(np.float32)
    unusable = ~np.isfinite(camera.undistort(blend.fine.pixels)[0]).all(axis=-1)
    rigid = rigid_scene(blend, 2.0)
    blended = blend(events(2.0), flow, rigid).mean(axis=2).reshape(-1, 2)
    own = COARSE.interpolate(flow.mean(axis=2).reshape(-1, 2).astype(float), blend.fine.pixels)
    apart = np.linalg.norm(blended - own, axis=1)
    assert unusable.any() and not unusable.all()
    assert apart[unusable].max() < 1e-4
    assert apart.max() > 1
    begin = blend.start(events(2.0), flow, rigid)
    of_lattice = unusable.reshape(blend.fine.columns, blend.fine.rows)[::3, ::3]
    assert of_lattice.any()
    assert begin[of_lattice] == pytest.approx(flow[of_lattice], abs=1e-4)
    assert np.abs(begin - flow)[~of_lattice].max() > 1
