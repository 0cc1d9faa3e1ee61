"""The chain without a rigid-body program: closed-form kinematics, spring equilibrium and a contact plane, batched."""

from typing import NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import SolverError
from softrl.surrogate.fit import fit_joints
from softrl.surrogate.kinematics import Chain, chain_of, grouped_poses, joint_jacobians, pose, quaternion_of
from softrl.surrogate.springs import Springs, softness_at, springs_of, stiffness_matrix

ITERATIONS = 600
CALM_AFTER, CALMER_AFTER = 80, 250  # iterations from which steps are shortened: deep contact overshoots
TOLERANCE_N = 1e-9  # change of the reaction between two iterations
Plane = tuple[np.ndarray, np.ndarray]


class TwinState(NamedTuple):
    """Equilibria of a batch.

    Attributes
    ----------
    tip : (B, 3) m
    quaternion : (B, 4) w x y z
    contact_force : (B,) N, normal force of the plane on the tip
    reaction : (B, 3) N, whole force of the plane on the tip, friction included
    joints : (B, 3 gaps) single joints, deflected by the loads
    found : (B,) bool, where it is one: elsewhere the rest tells where the search ended
    """

    tip: np.ndarray
    quaternion: np.ndarray
    contact_force: np.ndarray
    reaction: np.ndarray
    joints: np.ndarray
    found: np.ndarray


class Twin:
    """Quasi-static model of the chain: every joint's spring balances the tip's loads.

    Notes
    -----
    Equilibrium ``K (q - q_command) = J(q)' (F + reaction)``, solved by fixed-point iteration; K is that of the commanded
    pose. The plane is a penalty of
    ``contact_stiffness`` as in PyBullet's soft contact; its share of an iteration is solved implicitly through the tip's
    compliance, so that stiff contact converges. Friction is Coulomb's with stick. Weight is not applied: the commands
    were fitted to a body that hangs in its weight already.
    """

    def __init__(self, surrogate: Surrogate) -> None:
        self.chain: Chain = chain_of(surrogate)
        self.low, self.high = surrogate.joint_low.copy(), surrogate.joint_high.copy()
        self.springs: Springs = springs_of(surrogate)
        self.contact_stiffness = float(surrogate.contact_stiffness_n_per_m)

    def tip(self, theta: np.ndarray) -> np.ndarray:
        """Return the unloaded tips (B, 3) m under grouped commands (B, 3)."""
        return grouped_poses(_rows(theta), self.chain)[0]

    def quaternion(self, theta: np.ndarray) -> np.ndarray:
        """Return the unloaded orientations (B, 4) w x y z."""
        return grouped_poses(_rows(theta), self.chain)[1]

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        """Return d tip / d theta (B, 3, 3) of the unloaded chain."""
        return grouped_poses(_rows(theta), self.chain)[2]

    def joints_for_tip(self, tip: np.ndarray) -> np.ndarray:
        """Return the grouped commands (B, 3) within the limits whose unloaded tips come nearest to (B, 3) m."""
        return fit_joints(self.chain, _rows(tip), self.low, self.high).theta

    def softness(self, theta: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Return by how many m/N the tips yield along ``direction`` (3,) under commands (B, 3)."""
        return np.einsum("i,bij,j->b", direction, self.compliance(theta), direction)

    def compliance(self, theta: np.ndarray) -> np.ndarray:
        """Return d tip / d force (B, 3, 3) m/N of the unloaded chain under commands (B, 3)."""
        return chain_compliance(_rows(theta), self.chain, self.springs)

    def stiffness(self, theta: np.ndarray) -> np.ndarray:
        """Return K (3 gaps, 3 gaps) of the joints' springs under the grouped command (3,)."""
        return stiffness_matrix(theta, self.springs)

    def solve(
        self,
        theta: np.ndarray,
        force: np.ndarray | None = None,
        plane: Plane | None = None,
        friction: float | np.ndarray = 0.0,
        start: np.ndarray | None = None,
        refuse: bool = True,
    ) -> TwinState:
        """Return the equilibria under commands (B, 3), tip forces (B, 3) N and a plane.

        Parameters
        ----------
        plane : (normal (3,) towards the robot's side, point (3,) m, or (B, 3) m if each has a height of its own)
        friction : Coulomb's coefficient, one or (B,)
        start : (B, 3) m, tips before the motion, from which sliding is counted; the unloaded tips by default
        refuse : if not, an equilibrium that was not found is answered by where the search ended; a chain that is pressed
            ten times harder than it is meant to buckles, and a learner that explores does press

        Raises
        ------
        SolverError
            If an equilibrium was not found within the iterations.
        """
        theta = _rows(theta)
        batch = len(theta)
        forces = (
            np.zeros((batch, 3)) if force is None else np.ascontiguousarray(np.broadcast_to(force, (batch, 3)), float)
        )
        if force is None and plane is None:
            tip, quaternion, _ = grouped_poses(theta, self.chain)
            joints = np.tile(theta, (1, len(self.chain.below)))
            return TwinState(tip, quaternion, np.zeros(batch), np.zeros((batch, 3)), joints, np.ones(batch, dtype=bool))
        normal, point = (np.zeros(3), np.zeros(3)) if plane is None else plane
        normal, points = np.ascontiguousarray(normal, dtype=float), np.array(np.broadcast_to(point, (batch, 3)))
        grips = np.array(np.broadcast_to(np.asarray(friction, dtype=float), batch))
        before = self.tip(theta) if start is None else _rows(start)
        state = TwinState(
            *_equilibria(theta, forces, normal, points, grips, before, self.chain, self.springs, self.contact_stiffness)
        )
        if refuse and not state.found.all():
            raise SolverError(
                f"{(~state.found).sum()} of {batch} equilibria of the twin were not found in {ITERATIONS} iterations; "
                f"expected loads near the tip's range, the largest force here is {np.abs(forces).max():.3g} N"
            )
        return state


def _rows(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.atleast_2d(values), dtype=float)


@nb.njit(cache=True)
def _equilibria(
    theta: np.ndarray,
    force: np.ndarray,
    normal: np.ndarray,
    point: np.ndarray,
    friction: np.ndarray,
    start: np.ndarray,
    chain: Chain,
    springs: Springs,
    contact_stiffness: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    batch, joints = len(theta), 3 * len(chain.below)
    tips, quaternions, reactions = np.empty((batch, 3)), np.empty((batch, 4)), np.zeros((batch, 3))
    contact, coordinates = np.zeros(batch), np.empty((batch, joints))
    command, q, forward = np.empty(joints), np.empty(joints), np.empty(joints)
    rotation, jacobian, compliance = np.empty((3, 3)), np.empty((3, joints)), np.empty((3, 3))
    load, expected, grip, torque = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    touching = normal @ normal > 0.0
    found = np.ones(batch, dtype=np.bool_)
    for b in range(batch):
        for j in range(joints):
            command[j] = theta[b, j % 3]
            q[j] = command[j]
        soft = softness_at(theta[b], springs)
        press, change = 0.0, 1.0
        grip[:] = 0.0
        for turn in range(ITERATIONS):
            share = 1.0 if turn < CALM_AFTER else (0.5 if turn < CALMER_AFTER else 0.15)
            pose(q, chain, tips[b], rotation, jacobian)
            for i in range(3):
                load[i] = force[b, i] + press * normal[i] + grip[i]
                expected[i] = tips[b, i]
            move = 0.0
            for k in range(joints // 3):
                for a in range(3):
                    torque[a] = 0.0
                    for i in range(3):
                        torque[a] += springs.share[k] * jacobian[i, 3 * k + a] * load[i]
                for a in range(3):
                    j = 3 * k + a
                    yielded = soft[a, 0] * torque[0] + soft[a, 1] * torque[1] + soft[a, 2] * torque[2]
                    forward[j] = share * (command[j] + yielded - q[j])
                    move = max(move, abs(forward[j]))
                    for i in range(3):
                        expected[i] += jacobian[i, j] * forward[j]
            change = 0.0
            if touching:
                tip_compliance(jacobian, soft, springs.share, compliance)
                before = press
                press = _press(press, expected, normal, point[b], compliance, contact_stiffness)
                for i in range(3):  # what the new normal force moves, friction answers to
                    expected[i] += (press - before) * (compliance[i] @ normal)
                change = abs(press - before)
                if friction[b] > 0.0:
                    change += _grip(grip, expected, start[b], normal, compliance, friction[b] * press)
            for j in range(joints):
                q[j] += forward[j]
            if move < 1e-12 and change < TOLERANCE_N:
                break
        else:
            found[b] = False
        pose(q, chain, tips[b], rotation, jacobian)
        quaternion_of(rotation, quaternions[b])
        contact[b], coordinates[b] = press, q
        for i in range(3):
            reactions[b, i] = press * normal[i] + grip[i]
    return tips, quaternions, contact, reactions, coordinates, found


@nb.njit(cache=True)
def tip_compliance(jacobian: np.ndarray, soft: np.ndarray, share: np.ndarray, compliance: np.ndarray) -> None:
    """Fill d tip / d force (3, 3) m/N: the sum of share J S J' over the gaps, J their (3, 3) parts of ``jacobian``."""
    compliance[:] = 0.0
    turned = np.empty(3)
    for k in range(len(share)):
        for i in range(3):
            for a in range(3):
                turned[a] = 0.0
                for c in range(3):
                    turned[a] += share[k] * jacobian[i, 3 * k + c] * soft[c, a]
            for n in range(3):
                for a in range(3):
                    compliance[i, n] += turned[a] * jacobian[n, 3 * k + a]


@nb.njit(cache=True)
def chain_compliance(theta: np.ndarray, chain: Chain, springs: Springs) -> np.ndarray:
    """Return d tip / d force (B, 3, 3) m/N of the unloaded chain at grouped commands (B, 3)."""
    jacobians, found = joint_jacobians(theta, chain), np.empty((len(theta), 3, 3))
    for b in range(len(theta)):
        tip_compliance(jacobians[b], softness_at(theta[b], springs), springs.share, found[b])
    return found


@nb.njit(cache=True)
def _press(
    press: float, expected: np.ndarray, normal: np.ndarray, point: np.ndarray, compliance: np.ndarray, stiffness: float
) -> float:
    """Return the normal force with which penetration times contact stiffness equals the force, the tip yielding meanwhile."""
    depth = -(normal @ (expected - point))
    return max(0.0, press + (depth - press / stiffness) / (normal @ (compliance @ normal) + 1.0 / stiffness))


@nb.njit(cache=True)
def _grip(
    grip: np.ndarray, expected: np.ndarray, start: np.ndarray, normal: np.ndarray, compliance: np.ndarray, limit: float
) -> float:
    """Change the friction force so that the tip sticks, within ``limit`` N; return by how much it changed."""
    softness = compliance[0, 0] + compliance[1, 1] + compliance[2, 2] - normal @ (compliance @ normal)
    slip = expected - start
    slip = slip - (normal @ slip) * normal
    wanted = grip - slip / softness
    wanted = wanted - (normal @ wanted) * normal
    size = np.sqrt(wanted @ wanted)
    if size > limit:
        wanted = wanted * (limit / size)
    change = np.sqrt((wanted - grip) @ (wanted - grip))
    grip[:] = wanted
    return change
