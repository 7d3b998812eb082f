"""Numbers that tune the lattice: one table."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LatticeSettings:
    """How a window's flow and motion are fitted, judged and told.

    Chosen on random recordings and those of another simulator, those of a rotation on rotations and
    on translations past flat walls (docs/experiments.md). Pixels are those of the working image,
    whatever the sensor. What users may set is in LatticeConfig.

    Attributes:
        longer_side_px: longer side of the working image of a large sensor, px. Options in pixels
            are meant for an image of this size; smaller sensors keep their pixels.
        shortest_spread: share of the window between the first and the last tenth of the events;
            less is a burst.
        fewest_blocks: blocks of 8 x 8 px that must hold events.
        density_cell: side of the cells in which the density of events is counted, px.
        density_floor: share of the mean density that is added: lone events stay weak.
        sampling: pixels of an image of warped events per pixel of the working image, at full
            resolution. With 1 events that have not moved lie exactly upon each other, and look
            sharper than they are.
        stiffness_stride: events per event whose stiffness is computed: it is costly, and a mean.
        search_events, search_reach_px: number of events, and reach in px per window, of the search
            for a cold start.
        low_resolution_events: number of events that are enough at low resolution: to compare flows,
            and for the search beside a warm start.
        fresh_reach_px: reach of the search beside a warm start, px per window.
        lost: contrast of a constant flow over that of the fit, from which the fit is lost.
        longest_gap_s: a longer gap ends a warm start: dropped windows are such gaps, and a cold
            start takes longer, s.
        coarse_events: number of events that are enough at reduced resolution.
        on_one_side: agreement on the sign of v from which the fit relies on it.
        switch: share of the present residual cost by which another direction must be cheaper.
        straight_px: flow of rotation that a camera which does not rotate may have, px per window.
        structure_trust: share of the information on earlier depths: errors of neighbouring nodes go
            together.
        structure_inlier_px: least residual from which an earlier depth counts little, px; else 3
            standard deviations.
        information_excess: information of the normal equations over the true one. It is too large,
            because errors of events are not independent: many come from one edge, and the lattice
            smooths their errors into each other.
        flow_error_px: error of the flow that nodes and windows share, so that no residual shows it,
            px per window.
        slope_error: standard deviation that is added to half of the change of w by a gyro, rad/s.
        least_flow_px: flow that cannot be told from zero, px per window.
        directions: number of directions of v over the hemisphere, about 16 degrees apart.
        reweightings: number of solutions for each direction; twice as many for a rotation alone.
        independent_depths: number per node: it says how much likelier a motion of less flow is.
        rotation_share: of the flow, that a pure rotation may leave at half of the nodes.
        freedom: factor by which a depth for each node lowers the cost of such a flow anyway.
        lasting_px2: variance of a node's flow that more events do not reduce, px^2 per window^2: of
            depth edges and of the lattice between its nodes. A rotation may leave no more, either.
        usual_misfit: least residual cost over what lasting_px2 explains, median over windows.
        least_misfit, most_misfit: bounds of a window's misfit over the usual one.
        agree: spread of the possible directions up to which one is told, rad.
        one_spot: share of the image up to which the evidence is one spot.
        elsewhere: distance from a spot's middle, in its standard deviations, that is elsewhere.
        least_sigma_px: least standard deviation of a spot, px.
        fewest_elsewhere: number of events elsewhere that tell something.
        sharper: contrast of these, warped, over that as they came; of noise it is about 1.
        fast: quantile of the displacements that bounds a window: where it is fast, warps fail
            first.
        first_shares: shares of a window's events that are tried in turn while no motion is known.
            Usually the camera hardly moves then, and whole windows show best when it begins to; but
            it may also be too fast for them.
        change_px: largest displacement off the fit within a part, px of the working image.
        unsteady_px, steady_px: such a displacement from which a part is fitted again, shortened to
            that, px of the working image.
        shortest_way_px: but to no less way of half of the image, px of the working image.
        few_events, third_events: number of events of a third of a window that tell something of it,
            and that are enough.
        refining_steps: of the second fit, at full resolution.
        stiffer: weight of its epipolar constraint over dec_weight; and that of a rotation, which
            leaves the flow no freedom of its own.
        sharper_edges: its edge_px over that of the first fit: with the motion known edges of depth
            show better.
        hardly: contrast of a rigid scene's flow over the lattice's, from which that is hardly
            sharper.
        closer: number of nodes of a blended flow for each one of the lattice, along an axis.
        depth_reaches: standard deviations of the distance to known depths, px, and how much they
            count: the wide ones where none is near.
        farther: a known depth counts by the square of its distance over that around it, as far as
            this factor.
        blend_px: standard deviation of the distance within which contrasts of two flows are
            compared, px.
        blend_power: the share of the other flow is the logistic function of so many times the
            logarithm of its contrast over the lattice's.
    """

    longer_side_px: int = 346
    shortest_spread: float = 0.1
    fewest_blocks: int = 16
    density_cell: int = 4
    density_floor: float = 0.1
    sampling: float = 0.6
    stiffness_stride: int = 4
    search_events: int = 6_000
    search_reach_px: float = 48.0
    low_resolution_events: int = 2_000
    fresh_reach_px: float = 16.0
    lost: float = 1.05
    longest_gap_s: float = 0.9
    coarse_events: int = 10_000
    on_one_side: float = 0.5
    switch: float = 0.2
    straight_px: float = 0.1
    structure_trust: float = 0.3
    structure_inlier_px: float = 1.0
    information_excess: float = 10.0
    flow_error_px: float = 0.15
    slope_error: float = 1e-3
    least_flow_px: float = 0.3
    directions: int = 80
    reweightings: int = 4
    independent_depths: float = 0.02
    rotation_share: float = 0.06
    freedom: float = 4.5
    lasting_px2: float = 0.4
    usual_misfit: float = 0.13
    least_misfit: float = 0.2
    most_misfit: float = 5.0
    agree: float = 0.3
    one_spot: float = 0.35
    elsewhere: float = 2.5
    least_sigma_px: float = 5.0
    fewest_elsewhere: int = 100
    sharper: float = 1.1
    fast: float = 0.9
    first_shares: tuple[float, ...] = (1.0, 0.25, 1.0, 0.06)
    change_px: float = 2.0
    unsteady_px: float = 1.5
    steady_px: float = 1.0
    shortest_way_px: float = 6.0
    few_events: int = 300
    third_events: int = 3_000
    refining_steps: int = 2
    stiffer: float = 10.0
    sharper_edges: float = 0.5
    hardly: float = 0.6
    closer: int = 3
    depth_reaches: tuple[tuple[float, float], ...] = ((8.0, 1.0), (24.0, 0.03), (80.0, 0.003))
    farther: float = 2.0
    blend_px: float = 16.0
    blend_power: float = 8.0


LATTICE = LatticeSettings()
