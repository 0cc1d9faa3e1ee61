"""The program that a session of identification runs by default."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.errors import ConfigError
from softrl.recordings.program import Program, farthest_pa, limited, multisine, random_steps, staircase, triangles
from softrl.robots.robot import Robot


@dataclass(frozen=True)
class Identification:
    """Sessions of steps, multisine, triangles and a staircase, from rest and with rests between.

    Attributes
    ----------
    sessions : number of sessions; each draws its own steps and phases and takes the next chamber for its triangles
    dt_s : time between commands
    rest_s : vented time before, between and after the parts; may be 0
    step_count, step_hold_s : random holds of all chambers, first and last at rest
    multisine_s, multisine_band_hz, multisine_share : duration, one period of the highest tone or more; lowest and highest
        tone; share of the pressure range
    triangle_periods_s, triangle_cycles : the same path at several rates, and how often each; a loop that stays when the
        rate falls is hysteresis
    staircase_levels, staircase_repeats, staircase_period_s : rising maxima, each repeated: shows softening
    """

    key: ClassVar[str] = "stage.identification"  # where it stands in the configuration

    sessions: int
    dt_s: float
    rest_s: float
    step_count: int
    step_hold_s: float
    multisine_s: float
    multisine_band_hz: tuple[float, float]
    multisine_share: float
    triangle_periods_s: tuple[float, ...]
    triangle_cycles: int
    staircase_levels: int
    staircase_repeats: int
    staircase_period_s: float

    def __post_init__(self) -> None:
        if self.sessions < 2:
            raise ConfigError(
                f"{self.key}.sessions={self.sessions}; expected 2 or more, so that one can be held out"
            )
        positive = (
            "dt_s", "step_count", "step_hold_s", "multisine_s", "triangle_cycles", "staircase_levels",
            "staircase_repeats", "staircase_period_s",
        )  # fmt: skip
        for name in positive:
            if getattr(self, name) <= 0:
                raise ConfigError(f"{self.key}.{name}={getattr(self, name):g} must be positive")
        if self.rest_s < 0:
            raise ConfigError(f"{self.key}.rest_s={self.rest_s:g} must not be negative")
        self._require_triangles()
        self._require_multisine()

    def _require_triangles(self) -> None:
        """Refuse periods at which a triangle would have no sample off zero, and be missing without a word."""
        if not self.triangle_periods_s:
            raise ConfigError(f"{self.key}.triangle_periods_s=[] is empty; expected one period or more")
        shortest_s = {"triangle_periods_s": min(self.triangle_periods_s), "staircase_period_s": self.staircase_period_s}
        for name, period_s in shortest_s.items():
            if round(period_s / self.dt_s) < 2:
                raise ConfigError(
                    f"{self.key}.{name}: {period_s:g} s is too short; expected two commands a triangle or more, "
                    f"{2.0 * self.dt_s:g} s at dt_s={self.dt_s:g}"
                )

    def _require_multisine(self) -> None:
        """Refuse tones that cannot be drawn, or would be others once they are sampled."""
        low_hz, high_hz = self.multisine_band_hz
        said = f"{self.key}.multisine_band_hz={list(self.multisine_band_hz)}"
        if not 0.0 < low_hz <= high_hz:
            raise ConfigError(f"{said}; expected a lowest tone above 0 Hz, and a highest one that is not below it")
        if high_hz >= 0.5 / self.dt_s:
            raise ConfigError(
                f"{said} at dt_s={self.dt_s:g}; expected more than two commands a period, so tones below "
                f"{0.5 / self.dt_s:g} Hz: lower the highest tone, or dt_s"
            )
        if self.multisine_s * high_hz < 1.0:
            raise ConfigError(
                f"{self.key}.multisine_s={self.multisine_s:g} is too short; expected one period of the highest "
                f"tone or more, {1.0 / high_hz:g} s"
            )
        if not 0.0 < self.multisine_share <= 1.0:
            raise ConfigError(
                f"{self.key}.multisine_share={self.multisine_share:g}; expected a share of the pressure range, above 0 "
                "and at most 1"
            )


def session_program(robot: Robot, settings: Identification, number: int, rng: np.random.Generator) -> Program:
    """Return the program of session ``number``: its parts one after the other, with rests."""
    s, dt_s = settings, settings.dt_s
    chamber, next_one = number % robot.chambers, (number + 1) % robot.chambers
    parts = [
        random_steps(robot, s.step_count, s.step_hold_s, dt_s, rng),
        multisine(robot, s.multisine_s, s.multisine_band_hz, s.multisine_share, dt_s, rng),
        triangles(robot, chamber, farthest_pa(robot), s.triangle_periods_s, s.triangle_cycles, dt_s),
        staircase(robot, next_one, s.staircase_levels, s.staircase_repeats, s.staircase_period_s, dt_s),
    ]
    rest = np.zeros((round(s.rest_s / dt_s), robot.chambers))
    rows = [rest, *(block for _, pressure in parts for block in (pressure, rest))]
    # the multisine ends away from rest: the way back keeps the slew as well
    pressure = limited(robot, np.concatenate(rows), dt_s)
    return dt_s * np.arange(1, len(pressure) + 1), pressure
