"""A window's events on a device of torch, sorted by lattice cell."""

import numpy as np
import torch
from torch import Tensor

from emoflow_ros.core.contrast import STIFFNESS_STRIDE
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.window_events import PARTS, WindowEvents

_BLOCK = 64  # slots; on a DAVIS346 with 30 000 events about an eighth stays empty


class DeviceEvents:
    """Events of one window on a device, and all about them that no step changes.

    They lie in S slots, in blocks that each belong to one lattice cell, so that sums over a
    cell's events are products of small matrices. Slots without an event have weight 0. The
    shapes depend on the capacity only, and nothing here makes the host wait for the device.

    Args:
        lattice: whose cells sort the events.
        capacity: the most events that a window holds.
        device: of torch.

    Attributes:
        columns: (4, capacity + 1) x, y, s, weight in the order given; zeros behind them.
        xy: (S, 2) px.
        lever: (S, 1) from the events' times to the middle, in windows.
        weights: (S,) as in WindowEvents.
        part: (S,) which part of the window an event belongs to, see Contrast.
        copies: (S,) how many events the stiffness of this one stands for; 0 where not taken.
        nodes, hats: (S, 8) the nodes around an event in space and time, and their weights.
        basis: (S, 8) weights of the cell's nodes in the derivatives (derivatives.pull).
        members: (cells, S / 64) 1 where a block belongs to a cell.
    """

    def __init__(self, lattice: Lattice, capacity: int, device: str) -> None:
        self.capacity = capacity
        self._lattice = lattice
        self._shape = (lattice.columns - 1, lattice.rows - 1, lattice.times - 1)
        cells = int(np.prod(self._shape))
        blocks = -(-capacity // _BLOCK) + cells
        slots = blocks * _BLOCK
        self._staging = host_buffer((4, capacity), device)
        self._loaded: WindowEvents | None = None
        self._ref = 0.5
        self._per_px = torch.tensor(lattice.per_px, device=device)[:, None]
        steps = torch.tensor([lattice.rows * lattice.times, lattice.times, 1])
        corners = torch.cartesian_prod(*[torch.arange(2)] * 3)  # time innermost
        self._to_nodes = (corners @ steps).to(device)
        self.columns = torch.zeros(4, capacity + 1, device=device)
        self.xy = torch.zeros(slots, 2, device=device)
        self.lever = torch.zeros(slots, 1, device=device)
        self.weights = torch.zeros(slots, device=device)
        self.part = torch.zeros(slots, dtype=torch.int64, device=device)
        self.copies = torch.zeros(slots, device=device)
        self.nodes = torch.zeros(slots, 8, dtype=torch.int64, device=device)
        self.hats = torch.zeros(slots, 8, device=device)
        self.basis = torch.zeros(slots, 8, device=device)
        self.members = torch.zeros(cells, blocks, device=device)

    def load(self, events: WindowEvents, ref: float = 0.5) -> None:
        """Upload a window's events and sort them, unless they are the last ones loaded.

        Args:
            events: of the window.
            ref: the reference time that they will be warped to.

        Raises:
            ValueError: more events than the capacity.
        """
        if events is self._loaded and ref == self._ref:
            return
        count = len(events)
        if count > self.capacity:
            raise ValueError(f"{count} events in buffers for {self.capacity}")
        staged = self._staging[:, :count]
        np.stack([events.x, events.y, events.s, events.weights], out=staged.numpy())
        self.columns[:, :count].copy_(staged, non_blocking=True)
        self.columns[:, count:].zero_()
        self._ref = ref
        self._fill_slots(count)
        self._loaded = events

    def _fill_slots(self, count: int) -> None:
        cell, _ = self._place(self.columns[:, :-1], 0.5 * (self.columns[2, :-1] + self._ref))
        source = self._sources(self._flat(cell))
        slotted = self.columns[:, source]
        self.xy.copy_(slotted[:2].T)
        self.weights.copy_(slotted[3])
        self.lever.copy_((self._ref - slotted[2])[:, None])
        for k in range(PARTS):
            self.part.masked_fill_(source >= k * count // PARTS, k)
        # The change in time acts through the acceleration, too: as at half the way.
        _, part = self._place(slotted, 0.5 * (slotted[2] + self._ref))
        self.basis.copy_(_corner_weights(part))
        cell, part = self._place(slotted, slotted[2])
        self.hats.copy_(_corner_weights(part))
        node = (cell[0] * self._lattice.rows + cell[1]) * self._lattice.times + cell[2]
        self.nodes.copy_(node[:, None] + self._to_nodes)

    def _place(self, columns: Tensor, s: Tensor) -> tuple[Tensor, Tensor]:
        """Find the cell (3, N) of events seen at times s (N,), and the fractions inside it."""
        at = torch.cat([columns[:2] * self._per_px, s[None] * self._shape[2]])
        cell = torch.stack(
            [axis.long().clamp(max=n - 1) for axis, n in zip(at, self._shape, strict=True)]
        )
        return cell, at - cell

    def _flat(self, cell: Tensor) -> Tensor:
        _, rows, times = self._shape
        return (cell[0] * rows + cell[1]) * times + cell[2]

    def _sources(self, cell: Tensor) -> Tensor:
        """Choose the event in each slot, (S,), the blocks' cells and whose stiffness is taken.

        Args:
            cell: (capacity,) of each event; slots left empty get the one behind the last.
        """
        cells, blocks = self.members.shape
        count = torch.zeros(cells, dtype=torch.int64, device=cell.device)
        count.index_add_(0, cell, torch.ones_like(cell))
        used = (count + _BLOCK - 1) // _BLOCK
        last = used.cumsum(0)
        first = last - used
        block = torch.arange(blocks, device=cell.device)
        self.members.copy_((block >= first[:, None]) & (block < last[:, None]))
        order = torch.argsort(cell, stable=True)
        home = cell[order]
        before = count.cumsum(0) - count
        rank = torch.arange(self.capacity, device=cell.device) - before[home]
        source = torch.full((blocks * _BLOCK,), self.capacity, device=cell.device)
        slot = first[home] * _BLOCK + rank
        source[slot] = order
        self.copies.zero_()
        taken = rank % STIFFNESS_STRIDE == home % STIFFNESS_STRIDE
        self.copies[slot] = STIFFNESS_STRIDE * taken.to(self.copies.dtype)
        return source


def host_buffer(shape: tuple[int, ...], device: str) -> Tensor:
    """Make a buffer that a CUDA device copies from and to without the host's help."""
    return torch.zeros(shape, pin_memory=device != "cpu")


def _corner_weights(part: Tensor) -> Tensor:
    """Trilinear weights (N, 8) of a cell's nodes, time innermost, from fractions (3, N)."""
    ends = torch.stack([1 - part, part], dim=-1)
    return torch.einsum("ni,nj,nk->nijk", *ends).reshape(-1, 8)
