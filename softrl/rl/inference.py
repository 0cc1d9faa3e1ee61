"""A policy at full speed: from one observation to the pressures for the driver, in one compiled call (Fig. 6b)."""

from typing import NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.calibration import pressure_map
from softrl.calibration.pressure_map import TOLERANCE_PA, invert_pressure, refusal
from softrl.core.errors import ArtifactError
from softrl.rl.batch import OBSERVATION_LIMIT
from softrl.rl.workspace import Workspace, told_as_joints
from softrl.surrogate import maps
from softrl.surrogate.maps import MapTables, PressureToJoints, evaluate, invert_joints


class ActorTables(NamedTuple):
    """A ``Policy`` as compiled code reads it: layers (out, in), biases (out,), flags, scales of its observation."""

    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    tanh_between: bool
    tanh_last: bool
    centre: np.ndarray
    position: float
    force: float
    low: np.ndarray
    high: np.ndarray


class Decision(NamedTuple):
    """What was decided: ``pressure`` (n,) Pa at the driver, ``simulated`` (n,) Pa in the simulator, ``theta`` (3,)."""

    pressure: np.ndarray
    simulated: np.ndarray
    theta: np.ndarray


class Inference:
    """Observation -> policy -> joints -> inverse of f_SP -> P_S -> inverse of f_RS -> P_R, deterministic.

    Parameters
    ----------
    calibration : f_RS; None sends P_S as it is

    Raises
    ------
    ArtifactError
        If policy, surrogate and calibration do not belong to one robot, or the policy's joint limits are not the
        surrogate's.
    """

    def __init__(self, policy: Policy, surrogate: Surrogate, calibration: Calibration | None) -> None:
        require_match(policy, surrogate, calibration)
        self.horizon, self.memory, self.chambers = policy.horizon, policy.memory, surrogate.chambers
        self._actor, self._maps = actor_tables(policy), maps.tables_of(surrogate)
        self._calibration = None if calibration is None else pressure_map.tables_of(calibration)
        self._space = Workspace(surrogate) if policy.told_as == "joints" else None
        self._rest = PressureToJoints(surrogate).joints(np.zeros((1, surrogate.chambers)))[0]
        self.reset()

    def reset(self) -> None:
        """Forget the last command and what was seen: the robot is vented."""
        self.theta = self._rest.copy()
        self._past: np.ndarray | None = None

    def decide(
        self, tip: np.ndarray, contact_force: float, position: np.ndarray, force: np.ndarray | None = None
    ) -> Decision:
        """Return what to send next; the joints it stands for are the next observation's.

        Parameters
        ----------
        tip : (3,) m;  contact_force : N, as measured
        position : (horizon, 3) m and force : (horizon,) N of the targets, the one to reach next first; no force if None

        Raises
        ------
        ArtifactError
            If the targets are not as many as the policy was trained with.
        SolverError
            If f_RS cannot be inverted there.
        """
        targets = np.ascontiguousarray(position, dtype=np.float64)
        if targets.shape != (self.horizon, 3):
            raise ArtifactError(
                f"the policy looks at {self.horizon} targets (3,) m, not at an array {targets.shape}; "
                "give it the next targets, or train with another task.horizon"
            )
        wanted = np.zeros(self.horizon) if force is None else np.ascontiguousarray(force, dtype=np.float64)
        where = np.ascontiguousarray(tip, dtype=np.float64)
        if self._space is not None:
            where, *rows = told_as_joints(self._space, np.vstack([where, targets]))
            targets = np.stack(rows)
        past = self._remembered(where)
        theta, simulated = _joints_and_pressure(
            where, self.theta, float(contact_force), targets, wanted, past, self._actor, self._maps
        )
        if self.memory:
            past[1:] = past[:-1].copy()
            past[0, :3], past[0, 3:] = where, self.theta
            theta = _joints_of(simulated, self._maps)  # what pressures in range can ask for, as in training
        self.theta = theta
        if self._calibration is None:
            return Decision(simulated, simulated, theta)
        real, left = invert_pressure(simulated, self._calibration)
        if not left < TOLERANCE_PA:
            raise refusal(simulated, left)
        return Decision(real, simulated, theta)

    def _remembered(self, tip: np.ndarray) -> np.ndarray:
        """Return the readings before (memory, 6), the latest first; at the first one the robot has long been at rest."""
        if self._past is None:
            self._past = np.tile(np.concatenate([tip, self.theta]), (self.memory, 1))
        return self._past

    def pressure(
        self, tip: np.ndarray, contact_force: float, position: np.ndarray, force: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the pressures (n,) Pa that ``decide`` sends."""
        return self.decide(tip, contact_force, position, force).pressure


def require_match(policy: Policy, surrogate: Surrogate, calibration: Calibration | None) -> None:
    """Raise unless the three belong to one robot and one range of motion."""
    for other in (surrogate, calibration):
        if other is not None and other.robot_name != policy.robot_name:
            raise ArtifactError(
                f"the policy was trained for robot {policy.robot_name}, but the {other.kind()} is of robot "
                f"{other.robot_name}; rerun stage=rl"
            )
    if calibration is not None and surrogate.chambers != calibration.chambers:
        raise ArtifactError(
            f"Surrogate has {surrogate.chambers} chambers, Calibration {calibration.chambers}; "
            "run stage=calibration again"
        )
    span = surrogate.joint_high - surrogate.joint_low
    apart = np.abs(np.stack([policy.joint_low - surrogate.joint_low, policy.joint_high - surrogate.joint_high]) / span)
    if apart.max() > 1e-6:
        raise ArtifactError(
            f"the policy commands joints within {policy.joint_low} .. {policy.joint_high}, the surrogate within "
            f"{surrogate.joint_low} .. {surrogate.joint_high} (rad, rad, m); it was trained on another surrogate: "
            "rerun stage=rl, or name the one that belongs to it with inputs.surrogate=run:<id>"
        )


def actor_tables(policy: Policy) -> ActorTables:
    """Return the arrays of a policy as compiled code takes them, in double precision."""
    p, layers = policy, range(policy.layers)

    def plain(values: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(values, dtype=np.float64)

    return ActorTables(
        tuple(plain(p.weights[f"weight_{i}"]) for i in layers), tuple(plain(p.weights[f"bias_{i}"]) for i in layers),
        p.activation == "tanh", p.squash == "tanh", plain(p.position_centre), float(p.position_scale),
        float(p.force_scale), plain(p.joint_low), plain(p.joint_high),
    )  # fmt: skip


@nb.njit(cache=True)
def _joints_and_pressure(
    tip: np.ndarray,
    theta: np.ndarray,
    contact_force: float,
    position: np.ndarray,
    force: np.ndarray,
    past: np.ndarray,
    actor: ActorTables,
    tables: MapTables,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the grouped command (3,) that the policy answers, and P_S (n,) Pa that reaches it."""
    command = _command(_observation(tip, theta, contact_force, position, force, past, actor), actor)
    return command, invert_joints(command, tables)[0]


@nb.njit(cache=True)
def _joints_of(pressure: np.ndarray, tables: MapTables) -> np.ndarray:
    """Return the joints (3,) of P_S (n,) Pa."""
    scaled = (pressure - tables.pressure_mean) / tables.pressure_spread
    return evaluate(tables.forward, scaled, False)[0] * tables.joint_spread + tables.joint_mean


@nb.njit(cache=True)
def _observation(
    tip: np.ndarray,
    theta: np.ndarray,
    contact_force: float,
    position: np.ndarray,
    force: np.ndarray,
    past: np.ndarray,
    actor: ActorTables,
) -> np.ndarray:
    """Return the scaled observation (k,): see ``Policy`` and ``batch.observe``."""
    horizon, memory = position.shape[0], past.shape[0]
    seen = np.empty(7 + 4 * horizon + 6 * memory)
    for i in range(3):
        seen[i] = (tip[i] - actor.centre[i]) / actor.position
        seen[3 + i] = 2.0 * (theta[i] - actor.low[i]) / (actor.high[i] - actor.low[i]) - 1.0
    seen[6] = contact_force / actor.force
    for t in range(horizon):
        for i in range(3):
            seen[7 + 4 * t + i] = (position[t, i] - actor.centre[i]) / actor.position
        seen[10 + 4 * t] = force[t] / actor.force
    for t in range(memory):
        first = 7 + 4 * horizon + 6 * t
        for i in range(3):
            seen[first + i] = (past[t, i] - actor.centre[i]) / actor.position
            seen[first + 3 + i] = 2.0 * (past[t, 3 + i] - actor.low[i]) / (actor.high[i] - actor.low[i]) - 1.0
    return np.minimum(np.maximum(seen, -OBSERVATION_LIMIT), OBSERVATION_LIMIT)


@nb.njit(cache=True)
def _command(seen: np.ndarray, actor: ActorTables) -> np.ndarray:
    """Return the grouped command (3,) at a scaled observation (k,)."""
    layers = len(actor.weights)
    hidden = seen
    for i in range(layers):
        hidden = actor.weights[i] @ hidden + actor.biases[i]
        if i < layers - 1:
            hidden = np.tanh(hidden) if actor.tanh_between else np.maximum(hidden, 0.0)
    action = np.tanh(hidden) if actor.tanh_last else hidden
    share = 0.5 + 0.5 * np.minimum(np.maximum(action, -1.0), 1.0)
    return actor.low + share * (actor.high - actor.low)
