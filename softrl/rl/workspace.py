"""Where the tip can go: reach through the joint limits and the pressures together, and curves that fit into it."""

from functools import cached_property

import numpy as np

from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ArtifactError, ConfigError
from softrl.surrogate.maps import PressureToJoints
from softrl.surrogate.twin import Twin

TOLERANCE_M = 3e-4  # a point is reached if pressures within their range bring the tip this near
BISECTIONS = 12
SMALLEST_SHARE = 0.05  # of the scale: curves must have this size, and a slope must leave it to move in


class Workspace:
    """Reachable tips of a surrogate."""

    def __init__(self, surrogate: Surrogate) -> None:
        self.surrogate = surrogate
        self.twin = Twin(surrogate)
        self._maps = PressureToJoints(surrogate)
        if ((self.rest < surrogate.joint_low) | (self.rest > surrogate.joint_high)).any():
            raise ArtifactError(
                f"surrogate of {surrogate.robot_name}: its joint limits {surrogate.joint_low} .. {surrogate.joint_high} "
                f"(rad, rad, m) leave out rest, {self.rest}; expected them to hold it: rerun stage=surrogate"
            )

    @cached_property
    def centre(self) -> np.ndarray:
        """Mean (3,) m of the sampled tips."""
        return self.surrogate.sample_tip.mean(axis=0)

    @cached_property
    def scale(self) -> float:
        """Root mean square distance in m of the sampled tips from the centre: scales observations."""
        return float(np.sqrt(np.mean(np.sum((self.surrogate.sample_tip - self.centre) ** 2, axis=1))))

    @cached_property
    def rest(self) -> np.ndarray:
        """Grouped command (3,) at zero pressure."""
        return self._maps.joints(np.zeros((1, self.surrogate.chambers)))[0]

    def tip_at_share(self, share: np.ndarray) -> np.ndarray:
        """Return the tips (B, 3) m at shares (B, n) in 0 .. 1 of the pressure range."""
        low, high = self.surrogate.pressure_low, self.surrogate.pressure_high
        return self.twin.tip(self._maps.joints(low + share * (high - low)))

    def reachable(self, tip: np.ndarray) -> np.ndarray:
        """Return whether pressures in range reach each of the tips (B, 3) m."""
        joints = self._maps.joints(self._maps.pressure(self.twin.joints_for_tip(tip)))
        return np.linalg.norm(self.twin.tip(joints) - tip, axis=1) < TOLERANCE_M

    def require(self, tip: np.ndarray, name: str) -> None:
        """Raise ``ConfigError`` unless all tips (B, 3) m of the trajectory ``name`` are within reach."""
        reached = self.reachable(np.asarray(tip, dtype=float))
        if not reached.all():
            first = int(np.argmin(reached))
            away = 1e3 * (tip[first] - self.centre)
            raise ConfigError(
                f"trajectory {name}: {int((~reached).sum())} of {len(tip)} points are out of reach, the first (number "
                f"{first}) {np.round(away, 1).tolist()} mm from the workspace's centre; expected points that pressures "
                f"bring the tip to within {1e3 * TOLERANCE_M:g} mm: make it smaller or move it"
            )

    def fitted(self, shape: np.ndarray, centre: np.ndarray, share: float, name: str) -> np.ndarray:
        """Return the points (points, 3) m of ``shape`` about ``centre`` (3,) m, at a share of the largest reachable size.

        Raises
        ------
        ConfigError
            If that size is nothing beside the workspace's: a tip that moves on a surface or a line comes within the
            tolerance of a curve as small as the tolerance, and a policy would be judged on that.
        """
        size, least = self.largest(shape, centre), SMALLEST_SHARE * self.scale
        if size < least:
            raise ConfigError(
                f"trajectory {name}: about {np.round(1e3 * centre, 1).tolist()} mm the tip of robot {self.surrogate.robot_name} "
                f"reaches its points up to a size of {1e3 * size:.2g} mm; expected {1e3 * least:.2g} mm or more: the tasks "
                "need a tip that moves in three directions; move the trajectory, or rerun stage=surrogate if its joints are "
                "kept from moving"
            )
        return centre + share * size * shape

    def largest(self, shape: np.ndarray, centre: np.ndarray) -> float:
        """Return the largest scale in m at which ``shape`` (points, 3), put about ``centre`` (3,) m, is reachable."""
        low, high = 0.0, 4.0 * self.scale
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.reachable(centre + middle * shape).all() else (low, middle)
        return low


def told_as_joints(space: Workspace, tip: np.ndarray) -> np.ndarray:
    """Return tips (..., 3) m as the actions (..., 3) in -1 .. 1 that would lead there on the twin.

    Between commands and tips that are told so, a plant with a memory is nearly linear.
    """
    theta = space.twin.joints_for_tip(tip.reshape(-1, 3))
    low, high = space.surrogate.joint_low, space.surrogate.joint_high
    return np.clip(2.0 * (theta - low) / (high - low) - 1.0, -1.0, 1.0).reshape(tip.shape)
