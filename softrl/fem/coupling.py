"""Rigid plate and ribs by kinematic coupling: six unknowns a body, exact finite rotations."""

from dataclasses import dataclass
from functools import cached_property

import numba as nb
import numpy as np
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from softrl.artifacts.mesh import BASE, FREE
from softrl.fem.assembly import NodePairs

FIXED = -2


@dataclass(frozen=True)
class Pose:
    """Where every node and rigid body is.

    Attributes
    ----------
    position : (nodes, 3) m
    centre : (bodies, 3) m, the bodies' reference points
    rotation : (bodies, 3, 3) relative to rest
    """

    position: np.ndarray
    centre: np.ndarray
    rotation: np.ndarray


class Coupling:
    """The map between unknowns and nodes: three unknowns a free node, then (shift, spin) of each rigid body.

    Parameters
    ----------
    points : (nodes, 3) m at rest
    region : (nodes,) as in ``Mesh.node_region``
    bodies : region numbers of the rigid bodies
    centres : (bodies, 3) m, reference point of each body
    pairs : node pairs of the stiffness
    """

    def __init__(
        self, points: np.ndarray, region: np.ndarray, bodies: list[int], centres: np.ndarray, pairs: NodePairs
    ) -> None:
        self.points, self.centres, self.pairs = points, centres, pairs
        self.body = np.full(len(points), -1)
        self.body[region == BASE] = FIXED
        for k, number in enumerate(bodies):
            self.body[region == number] = k
        self.free = np.flatnonzero(region == FREE)
        self.members = [np.flatnonzero(self.body == k) for k in range(len(bodies))]
        self.arms = [points[m] - c for m, c in zip(self.members, centres, strict=True)]
        self.unknowns = 3 * len(self.free) + 6 * len(bodies)
        self._build_pattern()

    def rest(self) -> Pose:
        """Return the stress-free pose."""
        return Pose(self.points.copy(), self.centres.copy(), np.tile(np.eye(3), (len(self.members), 1, 1)))

    def body_slice(self, k: int) -> slice:
        """Return the six unknowns of body ``k``."""
        start = 3 * len(self.free) + 6 * k
        return slice(start, start + 6)

    def reduce(self, force: np.ndarray, pose: Pose) -> np.ndarray:
        """Return the generalised force (unknowns,) of nodal forces (nodes, 3) N: moments about the centres."""
        reduced = np.empty(self.unknowns)
        reduced[: 3 * len(self.free)] = force[self.free].ravel()
        for k, member in enumerate(self.members):
            own = force[member]
            moment = np.cross(pose.position[member] - pose.centre[k], own).sum(axis=0)
            reduced[self.body_slice(k)] = np.r_[own.sum(axis=0), moment]
        return reduced

    def expand(self, change: np.ndarray, pose: Pose) -> np.ndarray:
        """Return the linearised nodal displacement (nodes, 3) of a small change of the unknowns."""
        nodal = np.zeros_like(pose.position)
        nodal[self.free] = change[: 3 * len(self.free)].reshape(-1, 3)
        for k, member in enumerate(self.members):
            shift, spin = np.split(change[self.body_slice(k)], 2)
            nodal[member] = shift + np.cross(spin, pose.position[member] - pose.centre[k])
        return nodal

    def move(self, pose: Pose, change: np.ndarray) -> Pose:
        """Return ``pose`` after ``change`` (unknowns,), with the spins applied as exact rotations."""
        position, centre, rotation = pose.position.copy(), pose.centre.copy(), pose.rotation.copy()
        position[self.free] += change[: 3 * len(self.free)].reshape(-1, 3)
        for k, (member, arm) in enumerate(zip(self.members, self.arms, strict=True)):
            shift, spin = np.split(change[self.body_slice(k)], 2)
            centre[k] += shift
            rotation[k] = Rotation.from_rotvec(spin).as_matrix() @ rotation[k]
            position[member] = centre[k] + arm @ rotation[k].T
        return Pose(position, centre, rotation)

    def difference(self, start: Pose, end: Pose) -> np.ndarray:
        """Return the change (unknowns,) that ``move`` takes from ``start`` to ``end``."""
        change = np.empty(self.unknowns)
        change[: 3 * len(self.free)] = (end.position - start.position)[self.free].ravel()
        for k in range(len(self.members)):
            spin = Rotation.from_matrix(end.rotation[k] @ start.rotation[k].T).as_rotvec()
            change[self.body_slice(k)] = np.r_[end.centre[k] - start.centre[k], spin]
        return change

    def spread(self, k: int) -> np.ndarray:
        """Return shares (nodes,) that spread a force over body ``k`` without a moment about its centre.

        They sum to one and have no first moment at rest, hence none in any orientation.
        """
        conditions = np.vstack([np.ones(len(self.members[k])), self.arms[k].T / np.abs(self.arms[k]).max()])
        shares = np.zeros(len(self.points))
        shares[self.members[k]] = np.linalg.lstsq(conditions, np.array([1.0, 0.0, 0.0, 0.0]), rcond=None)[0]
        return shares

    def stiffness(self, blocks: np.ndarray, gradient: np.ndarray, pose: Pose) -> sp.csr_matrix:
        """Return the upper triangle of the Hessian in the unknowns.

        Parameters
        ----------
        blocks : (pairs, 3, 3) N/m, Hessian in the nodes
        gradient : (nodes, 3) N, gradient in the nodes; a force on a rigid node stiffens the body's rotation
        """
        data = np.zeros(len(self._indices))
        arms = np.zeros_like(pose.position)
        for k, member in enumerate(self.members):
            arms[member] = pose.position[member] - pose.centre[k]
        _scatter(
            blocks, self.pairs.first, self.pairs.second, arms, self._source, self._kind, self._start, data
        )
        for k, member in enumerate(self.members):
            product = arms[member].T @ gradient[member]
            turn = 0.5 * (product + product.T) - np.trace(product) * np.eye(3)
            for i in range(3):
                row = self.body_slice(k).start + 3 + i
                data[self._indptr[row] : self._indptr[row] + 3 - i] += turn[i, i:]
        return sp.csr_matrix((data, self._indices, self._indptr), shape=(self.unknowns, self.unknowns))

    @cached_property
    def diagonal(self) -> np.ndarray:
        """Positions of the diagonal entries in the data of ``stiffness``; each row starts with its own."""
        return self._indptr[:-1]

    def _build_pattern(self) -> None:
        """Find where every node-pair block goes in the upper triangle of the reduced matrix."""
        free_block = np.full(len(self.points), -1)
        free_block[self.free] = np.arange(len(self.free))
        count = len(self.free) + 2 * len(self.members)

        def block_of(node: np.ndarray, part: int) -> np.ndarray:
            """Reduced block of a node: its own, or the shift (part 0) or spin (1) of its body; -1 for none."""
            body = self.body[node]
            own = free_block[node] if part == 0 else np.full(len(node), -1)
            return np.where(body >= 0, len(self.free) + 2 * body + part, own)

        source, kind, row, column = [], [], [], []
        first, second = self.pairs.first, self.pairs.second
        for swap in (0, 1):
            left, right = (second, first) if swap else (first, second)
            for left_part in (0, 1):
                for right_part in (0, 1):
                    i, j = block_of(left, left_part), block_of(right, right_part)
                    keep = np.flatnonzero((i >= 0) & (j >= i) & ((first != second) | (swap == 0)))
                    source.append(keep)
                    kind.append(8 * (i == j)[keep] + 4 * swap + 2 * left_part + right_part)
                    row.append(i[keep])
                    column.append(j[keep])
        rows, columns = np.concatenate(row), np.concatenate(column)
        key, target = np.unique(rows.astype(np.int64) * count + columns, return_inverse=True)
        self._source, self._kind = np.concatenate(source), np.concatenate(kind)
        self._fill_csr(key // count, key % count, target, count)

    def _fill_csr(self, row: np.ndarray, column: np.ndarray, target: np.ndarray, count: int) -> None:
        """Lay the blocks (row <= column, sorted) out as scalar rows; diagonal blocks keep their upper half."""
        blocks_in_row = np.bincount(row, minlength=count)
        first_block = np.r_[0, np.cumsum(blocks_in_row)]
        length = np.stack([3 * blocks_in_row - i for i in range(3)], axis=1).ravel()
        self._indptr = np.r_[0, np.cumsum(length)].astype(np.int32)
        self._indices = np.empty(self._indptr[-1], dtype=np.int32)
        start = np.empty((len(row), 3), dtype=np.int64)  # data position of (block, i, 0); column 0 may be virtual
        rank = np.arange(len(row)) - first_block[row]
        for i in range(3):
            start[:, i] = self._indptr[3 * row + i] + 3 * rank - i
            for j in range(3):
                real = (row != column) | (j >= i)
                self._indices[start[real, i] + j] = 3 * column[real] + j
        self._start = start[target]


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """Return the unit quaternion (4,) w x y z, w >= 0, of a rotation matrix (3, 3)."""
    return Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)


@nb.njit(cache=True)
def _scatter(
    blocks: np.ndarray, first: np.ndarray, second: np.ndarray, arms: np.ndarray, source: np.ndarray,
    kind: np.ndarray, start: np.ndarray, data: np.ndarray,
) -> None:
    """Add every block to the reduced matrix, turned by the arms where a side spins with a rigid body.

    ``kind`` = 8 (on the diagonal) + 4 (transposed) + 2 (left spins) + (right spins).
    A spin w moves a node by w x r = -[r]x w.
    """
    k = np.empty((3, 3))
    for n in range(len(source)):
        s = source[n]
        same, swap = kind[n] >= 8, (kind[n] // 4) % 2 == 1
        left_spins, right_spins = (kind[n] // 2) % 2 == 1, kind[n] % 2 == 1
        a, b = (second[s], first[s]) if swap else (first[s], second[s])
        for i in range(3):
            for j in range(3):
                k[i, j] = blocks[s, j, i] if swap else blocks[s, i, j]
        if right_spins:  # rows m -> r x m
            x, y, z = arms[b, 0], arms[b, 1], arms[b, 2]
            for i in range(3):
                m0, m1, m2 = k[i, 0], k[i, 1], k[i, 2]
                k[i, 0], k[i, 1], k[i, 2] = y * m2 - z * m1, z * m0 - x * m2, x * m1 - y * m0
        if left_spins:  # columns m -> r x m
            x, y, z = arms[a, 0], arms[a, 1], arms[a, 2]
            for j in range(3):
                m0, m1, m2 = k[0, j], k[1, j], k[2, j]
                k[0, j], k[1, j], k[2, j] = y * m2 - z * m1, z * m0 - x * m2, x * m1 - y * m0
        for i in range(3):
            for j in range(3):
                if not same or j >= i:
                    data[start[n, i] + j] += k[i, j]
