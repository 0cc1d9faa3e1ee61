"""A gauge at the chamber that does not report what acts."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.core.span import Span
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def pressure_sensor_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Scale and shift the reported pressures."""
    chamber = int(parameters[2])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            value[i] = parameters[0] * value[i] + parameters[1]


@dataclass(frozen=True)
class PressureSensor(Effect):
    """Reported chamber pressure ``gain * p + offset``; ``offset`` is a share of the robot's largest pressure.

    Notes
    -----
    Static calibration error of a gauge (no equation number checked). The motion does not change under the same
    commands; in a replay that puts the measured pressure behind the valve, what acted is what the gauge must have seen.
    """

    site: ClassVar[str] = "sensor"
    channel: ClassVar[str] = "pressure"
    title: ClassVar[str] = "calibration error of the pressure gauge"
    kernel: ClassVar = pressure_sensor_kernel

    gain: float = parameter("1", 0.5, 2.0, 1.0, typical=1.1)
    offset: float = parameter("1", -0.3, 0.3, 0.0, typical=0.03, of="pressure")
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (gain, offset Pa, chamber)."""
        return super().pack(robot) * [1.0, robot.largest_pa, 1.0]

    def undo(self, robot: Robot, reported: Span, share: np.ndarray, dt_s: float) -> Span:
        """Return the pressures that the gauge saw where it ``reported`` these."""
        seen = Span(*(np.array(part, dtype=float) for part in reported))
        mine = slice(None) if self.chamber < 0 else slice(self.chamber, self.chamber + 1)
        for part in seen:
            part[:, mine] = (part[:, mine] - share * self.offset * robot.largest_pa) / (1.0 + share * (self.gain - 1.0))
        return seen
