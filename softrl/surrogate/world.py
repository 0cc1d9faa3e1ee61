"""The chain in PyBullet: springs and dampers of the joints as torques that see the step ahead, soft contact."""

import math
import tempfile
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import numpy as np
import pybullet as bullet
from scipy.optimize import root

from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import SolverError
from softrl.surrogate.springs import springs_of, stiffness_matrix

RATE_HZ = 240.0  # PyBullet's own
SOLVER_ITERATIONS = 100
FAR = 0.01  # rad or m from where the mass was taken: with an old one, what turning asks for would be taken for a load
FINER = (1, 4, 16)  # times PyBullet's rate
LONGEST = 0.05  # rad or m a joint may move in a step
FASTEST = 99.0  # rad/s or m/s, where PyBullet cuts speeds off
HALF_EXTENT_M = 0.2  # of the box whose upper face is the contact plane
BOX_THICKNESS_M = 0.05
TIP = "tip"


class SurrogateState(NamedTuple):
    """Single joints ``coordinates`` (3 gaps,) rad, rad, m, their ``velocity``, and what acts on them beside the springs.

    ``outside`` (3 gaps,) N m, N m, N is that of the last step: loads and contact, as the joints feel them.
    """

    coordinates: np.ndarray
    velocity: np.ndarray
    outside: np.ndarray | None = None


class Rayleigh(NamedTuple):
    """Damping of the joints: ``mass_per_s`` times their inertia and ``stiffness_s`` times their stiffness."""

    mass_per_s: float
    stiffness_s: float


class World:
    """One chain in one PyBullet server of its own; calls from several threads take turns.

    Notes
    -----
    The commands contain the weight of the body that they were fitted to. One of another stiffness or mass is bent by its
    weight by mass over stiffness as far: what that is more or less pulls at the links.

    Explicit springs of the slides would need a rate of 1 kHz. The torques are those of the springs and dampers at the end
    of the step instead, predicted with the joints' masses and with the loads of the step before; at rest the prediction
    is no motion, so that the springs yield exactly as they should.
    """

    def __init__(self, surrogate: Surrogate, stiffness_scale: float, damping: Rayleigh, mass_scale: float) -> None:
        self._client = bullet.connect(bullet.DIRECT)
        if self._client < 0:
            raise SolverError("PyBullet gave no server; it allows a limited number per process, close other simulators")
        # with the default threshold constraints stop half solved and the links creep
        bullet.setPhysicsEngineParameter(
            numSolverIterations=SOLVER_ITERATIONS, solverResidualThreshold=0.0, physicsClientId=self._client
        )
        self._surrogate = surrogate
        self.body = self._load(surrogate.urdf)
        names = [self._joint_name(i) for i in range(bullet.getNumJoints(self.body, physicsClientId=self._client))]
        self.tip = names.index("tip_mount")
        self.joints = [i for i, name in enumerate(names) if i != self.tip]
        self._springs, self._stiffness_scale = springs_of(surrogate), stiffness_scale
        self._damping, self.rate_hz, self._lock = damping, RATE_HZ, Lock()
        self._plane: int | None = None
        self._settle_dynamics(mass_scale)
        self._weighs = stiffness_scale != mass_scale and any(surrogate.gravity_m_s2)
        pull = (1.0 - stiffness_scale / mass_scale) * np.array(surrogate.gravity_m_s2)  # of the scaled mass
        bullet.setGravity(*pull.tolist(), physicsClientId=self._client)

    def close(self) -> None:
        """Give the server back."""
        if self._client >= 0:
            bullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def __del__(self) -> None:
        if getattr(self, "_client", -1) >= 0 and bullet.isConnected(self._client):
            self.close()

    def _load(self, urdf: str) -> int:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "surrogate.urdf"
            path.write_text(urdf)
            return int(bullet.loadURDF(str(path), useFixedBase=True, physicsClientId=self._client))

    def _joint_name(self, index: int) -> str:
        return bullet.getJointInfo(self.body, index, physicsClientId=self._client)[1].decode()

    def _settle_dynamics(self, mass_scale: float) -> None:
        client = self._client
        for link in range(-1, bullet.getNumJoints(self.body, physicsClientId=client)):
            mass, _, inertia = bullet.getDynamicsInfo(self.body, link, physicsClientId=client)[:3]
            bullet.changeDynamics(
                self.body, link, mass=mass * mass_scale, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0,
                localInertiaDiagonal=[mass_scale * i for i in inertia], physicsClientId=client,
            )  # fmt: skip

    def stiffness(self, theta: np.ndarray) -> np.ndarray:
        """Return K (3 gaps, 3 gaps) of the joints' springs under the grouped command (3,)."""
        return self._stiffness_scale * stiffness_matrix(theta, self._springs)

    def place_plane(self, normal: np.ndarray, point: np.ndarray, friction: float) -> None:
        """Put a plane before the tip's sphere so that the tip's centre touches at ``point`` (3,) m, facing ``normal`` (3,)."""
        client, s = self._client, self._surrogate
        radius = bullet.getCollisionShapeData(self.body, self.tip, physicsClientId=client)[0][3][0]
        shape = bullet.createCollisionShape(
            bullet.GEOM_BOX, halfExtents=[HALF_EXTENT_M, HALF_EXTENT_M, BOX_THICKNESS_M], physicsClientId=client
        )
        centre = np.asarray(point) - (BOX_THICKNESS_M + radius) * np.asarray(normal)
        self._plane = bullet.createMultiBody(
            0.0, shape, basePosition=centre.tolist(), baseOrientation=_turn_to(normal), physicsClientId=client
        )
        bullet.changeDynamics(
            self._plane, -1, lateralFriction=friction, contactStiffness=s.contact_stiffness_n_per_m,
            contactDamping=s.contact_damping_n_s_per_m, physicsClientId=client,
        )  # fmt: skip
        bullet.changeDynamics(self.body, self.tip, lateralFriction=1.0, physicsClientId=client)
        for link in range(-1, self.tip):  # only the tip's sphere touches; the discs are for looks and for other users
            bullet.setCollisionFilterPair(self.body, self._plane, link, -1, 0, physicsClientId=client)

    def advance(
        self, state: SurrogateState, theta: np.ndarray, dt_s: float, force: np.ndarray | None
    ) -> SurrogateState:
        """Return the state after ``dt_s`` under the grouped command ``theta`` (3,) and a tip ``force``, see ``_push``.

        Where a joint moves too far in one of PyBullet's steps, these are made shorter and the motion is made again.

        Raises
        ------
        SolverError
            If a joint is as fast as PyBullet lets it be in the shortest, too.
        """
        steps = max(1, math.ceil(dt_s * self.rate_hz - 1e-9))
        with self._lock:
            for finer in FINER:
                after, fastest = self._move(state, theta, dt_s / (finer * steps), finer * steps, force)
                if fastest < min(FASTEST, LONGEST * self.rate_hz * finer):
                    return after
        raise SolverError(
            f"simulator surrogate: a joint moves at {fastest:.0f} rad/s or m/s, with steps of {FINER[-1] * steps / dt_s:.0f} Hz; "
            f"expected less than {FASTEST:g}, where PyBullet cuts speeds off: let the pressures change more slowly, or raise "
            "simulator.damping_scale"
        )

    def at_rest(self, theta: np.ndarray) -> SurrogateState:
        """Return where the chain hangs under the grouped command ``theta`` (3,).

        Raises
        ------
        SolverError
            If it does not come to rest: a body that its weight is too much for.
        """
        command = np.tile(theta, len(self.joints) // 3)
        if not self._weighs:
            return SurrogateState(command, np.zeros_like(command))
        springs, still = self.stiffness(theta), [0.0] * len(command)

        def left(q: np.ndarray) -> np.ndarray:
            held = bullet.calculateInverseDynamics(self.body, q.tolist(), still, still, physicsClientId=self._client)
            return springs @ (q - command) + np.array(held)

        with self._lock:
            found = root(left, command)
        if not found.success:
            raise SolverError(
                "simulator surrogate finds no rest under its weight; expected a body that carries it: lower "
                "simulator.mass_scale or raise simulator.youngs_modulus_scale"
            )
        return SurrogateState(found.x, np.zeros_like(command))

    def _move(
        self, state: SurrogateState, theta: np.ndarray, step_s: float, steps: int, force: np.ndarray | None
    ) -> tuple[SurrogateState, float]:
        """Return the state after ``steps`` of PyBullet's, and the largest speed of a joint on the way."""
        client, body, joints = self._client, self.body, self.joints
        command = np.tile(theta, len(joints) // 3)
        for joint, value, speed in zip(joints, state.coordinates, state.velocity, strict=True):
            bullet.resetJointState(body, joint, value, speed, physicsClientId=client)
        bullet.setTimeStep(step_s, physicsClientId=client)
        # PyBullet gives every joint a motor towards rest, which would hold contact loads in the springs' place
        bullet.setJointMotorControlArray(
            body, joints, bullet.VELOCITY_CONTROL, forces=[0.0] * len(joints), physicsClientId=client
        )
        q, velocity, springs = state.coordinates, state.velocity, self.stiffness(theta)
        at, (mass, damper, ahead, foresee) = q, self._inertia(q, springs, step_s)
        outside, fastest = np.zeros_like(q) if state.outside is None else state.outside, 0.0
        for _ in range(steps):
            if np.abs(q - at).max() > FAR:
                at, (mass, damper, ahead, foresee) = q, self._inertia(q, springs, step_s)
            pull = springs @ (command - q - step_s * velocity) - damper @ velocity
            torque = pull - ahead @ (foresee @ (pull + outside))
            bullet.setJointMotorControlArray(
                body, joints, bullet.TORQUE_CONTROL, forces=torque.tolist(), physicsClientId=client
            )
            if force is not None:
                self._push(np.asarray(force, dtype=float))
            bullet.stepSimulation(physicsClientId=client)
            read = bullet.getJointStates(body, joints, physicsClientId=client)
            before, q, velocity = velocity, np.array([r[0] for r in read]), np.array([r[1] for r in read])
            outside = mass @ (velocity - before) / step_s - torque
            fastest = max(fastest, float(np.abs(velocity).max()))
        return SurrogateState(q, velocity, outside), fastest if np.isfinite(q).all() else np.inf

    def _inertia(self, q: np.ndarray, springs: np.ndarray, step_s: float) -> tuple[np.ndarray, ...]:
        """Return mass and damping at joints ``q``, what a step of acceleration adds to their pull, and the inverse of both."""
        mass = np.array(bullet.calculateMassMatrix(self.body, list(q), physicsClientId=self._client))
        damper = self._damping.mass_per_s * mass + self._damping.stiffness_s * springs
        ahead = step_s * damper + step_s**2 * springs
        return mass, damper, ahead, np.linalg.inv(mass + ahead)

    def _push(self, force: np.ndarray) -> None:
        """Let ``force`` (3,) N, or (6,) N and N m, act on the tip in the next step; a moment does as couples a metre wide."""
        at = np.array(bullet.getLinkState(self.body, self.tip, computeForwardKinematics=1, physicsClientId=self._client)[4])
        pushes = [(force[:3], at)]
        for axis, moment in zip(np.eye(3), force[3:], strict=False):
            arm, side = np.roll(axis, 1), np.roll(axis, 2)  # axis = arm x side
            pushes += [(0.5 * moment * side, at + arm), (-0.5 * moment * side, at - arm)]
        for push, where in pushes:
            bullet.applyExternalForce(
                self.body, self.tip, push.tolist(), where.tolist(), bullet.WORLD_FRAME, physicsClientId=self._client
            )

    def pose(self, state: SurrogateState) -> tuple[np.ndarray, np.ndarray]:
        """Return tip (3,) m and quaternion (4,) w x y z at ``state``."""
        with self._lock:
            for joint, value in zip(self.joints, state.coordinates, strict=True):
                bullet.resetJointState(self.body, joint, value, physicsClientId=self._client)
            read = bullet.getLinkState(self.body, self.tip, computeForwardKinematics=1, physicsClientId=self._client)
        x, y, z, w = read[5]
        return np.array(read[4]), np.array([w, x, y, z]) * (1.0 if w >= 0.0 else -1.0)

    def contact_force(self) -> float:
        """Return the normal force in N of the plane on the tip in the last step."""
        if self._plane is None:
            return 0.0
        points = bullet.getContactPoints(self.body, self._plane, physicsClientId=self._client)
        return float(sum(p[9] for p in points))


def _turn_to(normal: np.ndarray) -> list[float]:
    """Return the quaternion x y z w that turns +z to ``normal``."""
    n = np.asarray(normal, dtype=float)
    if n[2] < -1.0 + 1e-12:
        return [1.0, 0.0, 0.0, 0.0]
    q = np.array([-n[1], n[0], 0.0, 1.0 + n[2]])
    return (q / np.linalg.norm(q)).tolist()
