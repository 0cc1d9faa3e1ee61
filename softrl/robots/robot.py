"""A robot as data: chambers, geometry, limits and what its sensors report."""

from dataclasses import dataclass

import numpy as np

from softrl.core.errors import ConfigError

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
OUTPUTS = ("tip_position", "tip_pose", "bend_angle")
AT_REST_SHARE = 0.02  # of the largest pressure
ON_A_LINE = 1e-6  # sine of the angle between directions that are opposite or equal


@dataclass(frozen=True)
class Robot:
    """One pneumatic robot.

    Attributes
    ----------
    name : used in artifacts and tracking; artifacts of different robots never mix
    chamber_angle_deg : angle of each chamber around the z axis, from +x
    chamber_radius_m : distance of the chambers from the backbone
    chamber_area_m2 : effective area on which a chamber's pressure pushes along the backbone
    length_m : backbone length at rest, base to tip
    mass_kg : moving mass
    pressure_min_pa, pressure_max_pa : gauge pressures a driver will send
    slew_pa_per_s : fastest change of a commanded pressure
    tip_force_max_n : load that the tip is made for
    axis : direction of the backbone at rest in the base frame, one of +x -x +y -y +z -z
    output : what the sensors report of the motion: tip_position, tip_pose or bend_angle, see ``bends_in_a_plane``
    command : name of the command channels in recordings ("pressure", or another such as "pump_pwm")
    command_to_pa : Pa per unit of the command channel (1 for pressure)
    gravity_m_s2 : (3,) in the base frame
    """

    name: str
    chamber_angle_deg: tuple[float, ...]
    chamber_radius_m: float
    chamber_area_m2: float
    length_m: float
    mass_kg: float
    pressure_min_pa: float
    pressure_max_pa: float
    slew_pa_per_s: float
    tip_force_max_n: float
    axis: str
    output: str
    command: str
    command_to_pa: float
    gravity_m_s2: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.pressure_min_pa >= self.pressure_max_pa:
            raise ConfigError(
                f"robot.pressure_min_pa={self.pressure_min_pa:g} is not below pressure_max_pa={self.pressure_max_pa:g}"
            )
        for name in ("chamber_radius_m", "chamber_area_m2", "length_m", "mass_kg", "slew_pa_per_s", "tip_force_max_n"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"robot.{name}={getattr(self, name):g} must be positive")
        if self.command_to_pa == 0.0:
            raise ConfigError("robot.command_to_pa=0 turns every command into no pressure; expected Pa per unit of the command")
        if not self.chamber_angle_deg:
            raise ConfigError("robot.chamber_angle_deg=[] names no chamber; expected one angle a chamber")
        if len(self.gravity_m_s2) != 3:
            raise ConfigError(f"robot.gravity_m_s2={list(self.gravity_m_s2)}; expected three numbers, m/s^2 along x, y, z")
        if self.axis not in AXES:
            raise ConfigError(f"robot.axis={self.axis} is unknown; expected one of {', '.join(AXES)}")
        if self.output not in OUTPUTS:
            raise ConfigError(f"robot.output={self.output} is unknown; expected one of {', '.join(OUTPUTS)}")

    @property
    def chambers(self) -> int:
        """Number of pressure chambers."""
        return len(self.chamber_angle_deg)

    @property
    def largest_pa(self) -> float:
        """Gauge pressure largest in size, of suction or above the room's: what shares of a pressure are shares of."""
        return max(abs(self.pressure_min_pa), abs(self.pressure_max_pa))

    def is_at_rest(self, pressure: np.ndarray) -> bool:
        """Return whether a robot under ``pressure`` Pa, of any shape, is taken to be at rest: next to none acts."""
        return bool(np.abs(pressure).max() <= AT_REST_SHARE * self.largest_pa)

    @property
    def bends_in_a_plane(self) -> bool:
        """Whether all chambers lie on one line through the backbone: a bend angle then has a sign, that of chamber 1."""
        x, y = self.chamber_direction.T
        return bool(np.abs(x * y[0] - y * x[0]).max() < ON_A_LINE)

    @property
    def lowest_pa(self) -> float:
        """Gauge pressure below which nothing gets a chamber: that of its suction, or of the room."""
        return min(self.pressure_min_pa, 0.0)

    def check_upright(self, who: str) -> None:
        """Raise ``ConfigError`` unless the backbone points along +z, as ``who`` takes it."""
        if self.axis != "+z":
            raise ConfigError(f"robot.axis={self.axis}: {who} needs +z; turn chambers and gravity instead")

    @property
    def chamber_direction(self) -> np.ndarray:
        """Unit vectors (chambers, 2) from the backbone to each chamber in the x-y plane."""
        angle = np.deg2rad(self.chamber_angle_deg)
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
