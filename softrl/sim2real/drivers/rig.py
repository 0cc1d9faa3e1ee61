"""A rig: hardware that is simulated in a process of its own, on its own clock, with physics that nobody is told.

Messages to the rig: ``(number, "start", seed, surface)``, ``(number, "advance", ticks, setpoints)``,
``(number, "vent", ticks)`` and ``(number, "cut", chamber)``, None for no chamber. It answers each by
``(number, rows, fault)``: samples as rows of numbers, and None or one line. It ends with its link.
"""

import logging
import signal
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np

from softrl.core.driver import Sample
from softrl.core.errors import ConfigError, SoftrlError
from softrl.core.simulator import Simulator, of_steps
from softrl.core.span import Span, held
from softrl.effects.chain import EffectChain, SignalFilter
from softrl.sim2real.surface import Surface, force_on_tip

log = logging.getLogger(__name__)
LINE_S = 0.05  # in which a line that is pulled off or put on comes to its pressure


@dataclass(frozen=True)
class Noise:
    """What the rig's sensors add to the truth.

    Attributes
    ----------
    position_white_mm : standard deviation per axis and sample
    position_coloured_mm, colour_s : standard deviation and correlation time of a slow wander per axis
    orientation_white_deg : standard deviation about each axis
    pressure_white_kpa : standard deviation per chamber and sample
    force_white_n : standard deviation per axis and sample of the force sensor, which a rig with a surface has
    dropped_share : share of the samples that never arrive, in [0, 1)
    """

    position_white_mm: float
    position_coloured_mm: float
    colour_s: float
    orientation_white_deg: float
    pressure_white_kpa: float
    force_white_n: float
    dropped_share: float

    def __post_init__(self) -> None:
        for name in (
            "position_white_mm", "position_coloured_mm", "orientation_white_deg", "pressure_white_kpa", "force_white_n",
        ):  # fmt: skip
            if getattr(self, name) < 0:
                raise ConfigError(f"driver.noise.{name}={getattr(self, name):g} must not be negative")
        if self.colour_s <= 0:
            raise ConfigError(f"driver.noise.colour_s={self.colour_s:g} must be positive")
        if not 0 <= self.dropped_share < 1:
            raise ConfigError(f"driver.noise.dropped_share={self.dropped_share:g} is outside 0..1 (1 excluded)")


class Sensors:
    """The running noise of one rig."""

    def __init__(self, noise: Noise, chambers: int, period_s: float, rng: np.random.Generator) -> None:
        self._rng, self._n, self._dropped = rng, chambers, noise.dropped_share
        self._pressure_pa = 1e3 * noise.pressure_white_kpa
        self._white_m, self._coloured_m = 1e-3 * noise.position_white_mm, 1e-3 * noise.position_coloured_mm
        self._force_n = noise.force_white_n
        self._turn_rad = np.deg2rad(noise.orientation_white_deg)
        self._keep = float(np.exp(-period_s / noise.colour_s))
        self._fresh_m = self._coloured_m * np.sqrt(1.0 - self._keep**2)
        self._wander_m = self._coloured_m * rng.standard_normal(3)

    def read(
        self, pressure: np.ndarray, position: np.ndarray, quaternion: np.ndarray, force: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
        """Return the four with noise, or None for a sample that never arrives."""
        draw, lost = self._rng.standard_normal(12 + self._n), self._rng.random() < self._dropped
        self._wander_m = self._keep * self._wander_m + self._fresh_m * draw[:3]
        if lost:
            return None
        return (
            pressure + self._pressure_pa * draw[12:],
            position + self._wander_m + self._white_m * draw[3:6],
            turned(quaternion, self._turn_rad * draw[6:9]),
            force + self._force_n * draw[9:12],
        )


def turned(quaternion: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return the quaternion (4,) w x y z after a small rotation vector ``turn`` (3,) rad in the base frame."""
    w, x, y, z = quaternion
    a, b, c = 0.5 * turn
    product = np.array(
        [w - a * x - b * y - c * z, x + a * w + b * z - c * y, y + b * w + c * x - a * z, z + c * w + a * y - b * x]
    )
    return np.asarray(product / np.sqrt(product @ product))


@dataclass(frozen=True)
class Hardware:
    """All that a rig is made of.

    Attributes
    ----------
    body : the moving part, advanced at ``physics_rate_hz``
    hidden : the effects around and inside it
    rate_hz : rate of setpoints and samples; ``physics_rate_hz`` is a multiple of it
    watchdog_s : longest time under pressure without a setpoint
    """

    body: Simulator
    hidden: EffectChain
    noise: Noise
    rate_hz: float
    physics_rate_hz: float
    watchdog_s: float


class Rig:
    """The hardware in motion: valves, chambers, body, load and sensors, one physics step after the other.

    It begins vented and at rest, its clock at zero; ``seed`` is that of its noise, ``surface`` what its tip may touch.
    """

    def __init__(self, hardware: Hardware, seed: Sequence[int], surface: Surface | None = None) -> None:
        rng = np.random.default_rng(seed)
        hidden = hardware.hidden
        self._body = hidden.body(hardware.body)
        self._substeps = round(hardware.physics_rate_hz / hardware.rate_hz)
        self._period_s = 1.0 / hardware.rate_hz
        self._watchdog_s = hardware.watchdog_s
        sites = ("valve", "chamber", "sensor", "gauge")
        self._valve, self._chamber, self._sensor, self._gauge = (SignalFilter(hidden, s) for s in sites)
        self._sensors = Sensors(hardware.noise, hidden.robot.chambers, self._period_s, rng)
        self._setpoint = np.zeros(hidden.robot.chambers)
        self._ticks = self._silent_ticks = 0
        self._robot, self._surface = hidden.robot, surface
        self._line, self._line_goal = np.ones(hidden.robot.chambers), np.ones(hidden.robot.chambers)
        self._body_hooks, self._load_hooks = hidden.hooks("body"), hidden.hooks("load")
        if surface is not None:  # its hook is the last of those that load the tip
            self._load_hooks += EffectChain(hidden.robot, (surface,)).hooks("load")
        # under its loads the robot hangs elsewhere than without; it has come to rest before it is switched on
        self._state = hidden.at_rest(self._body, self._load_hooks)
        # what takes long at a first step only is done before it is switched on, too
        self._body.observe(self._body.step(self._state, self._setpoint, self._period_s / self._substeps))

    def _step(self, acting: np.ndarray, dt_s: float) -> None:
        self._state = self._body.step(self._state, acting, dt_s, None, body=self._body_hooks, load=self._load_hooks)

    def advance(self, ticks: int, setpoints: np.ndarray) -> tuple[np.ndarray, str | None]:
        """Return the samples of ``ticks`` periods as rows (see ``sample_of``), and what the watchdog says.

        ``setpoints`` (sent, chambers) Pa arrive one per period from the first; then the last one is held.
        """
        rows, fault = [], None
        for tick in range(ticks):
            self._silent_ticks = 0 if tick < len(setpoints) else self._silent_ticks + 1
            if tick < len(setpoints) and fault is None:
                self._setpoint = setpoints[tick].copy()
            if self._silent_ticks * self._period_s > self._watchdog_s and self._setpoint.any():
                self._setpoint = np.zeros_like(self._setpoint)
                fault = (
                    f"the watchdog vented the robot: no command for more than {self._watchdog_s:g} s; command it more often, "
                    "or raise driver.watchdog_s"
                )
            row = self._tick()
            if row is not None:
                rows.append(row)
        return np.array(rows), fault

    def vent(self, ticks: int) -> tuple[np.ndarray, str | None]:
        """Return the samples of ``ticks`` periods after all chambers were vented."""
        return self.advance(ticks, np.zeros((1, len(self._setpoint))))

    def cut(self, chamber: int | None) -> tuple[np.ndarray, str | None]:
        """Pull one chamber's air line off, so that it vents whatever the valve does; None puts all lines back on."""
        self._line_goal = np.ones_like(self._line)
        if chamber is not None:
            self._line_goal[chamber] = 0.0
        return np.empty((0, 0)), None

    def _lines(self, supplied: Span, dt_s: float) -> Span:
        """Return the pressures behind the air lines."""
        if (self._line == 1.0).all() and (self._line_goal == 1.0).all():
            return supplied
        let_through = np.empty_like(supplied.mean)
        for row in let_through:
            self._line += (self._line_goal - self._line) * min(dt_s / LINE_S, 1.0)
            row[:] = self._line
        near = np.abs(self._line - self._line_goal) < 1e-6
        self._line[near] = self._line_goal[near]
        return Span(*(let_through * part for part in supplied))

    def _felt(self) -> np.ndarray:
        """Return the force (3,) N of the surface on the tip; not a number without one."""
        if self._surface is None:
            return np.full(3, np.nan)
        position, _ = self._body.observe(self._state)
        return force_on_tip(self._surface, self._robot, self._load_hooks[-1].state, position)

    def _tick(self) -> np.ndarray | None:
        """Return the sample at the end of one period, the setpoint held throughout; None if it is lost."""
        dt_s = self._period_s / self._substeps
        command = held(np.tile(self._setpoint, (self._substeps, 1)))
        supplied = self._lines(self._valve.lead(command, dt_s), dt_s)
        poses = np.empty((self._substeps, 7))
        for pose, acting in zip(poses, of_steps(self._body, self._chamber.lead(supplied, dt_s)), strict=True):
            self._step(acting, dt_s)
            pose[:3], pose[3:] = self._body.observe(self._state)
        pose = self._sensor.advance(poses, dt_s)[-1]
        self._ticks += 1
        reported = self._gauge.lead(supplied, dt_s).end[-1]
        sensed = self._sensors.read(reported, pose[:3], pose[3:], self._felt())
        if sensed is None:
            return None
        return np.concatenate([[self._ticks * self._period_s], self._setpoint, *sensed])


def sample_of(row: np.ndarray) -> Sample:
    """Return the sample that a row holds: time, setpoint, measured pressure, position, quaternion, force."""
    n = (len(row) - 11) // 2
    return Sample(row[0].item(), row[1 : n + 1], row[n + 1 : -10], row[-10:-7], row[-7:-3], row[-3:])


def serve(line: Connection, hardware: Hardware) -> None:
    """Run rigs, one after the other, until the driver is gone; the body of the rig's process."""
    # an interrupt from the terminal is for the driver, which then vents; the rig must live to do so
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    rig: Rig | None = None
    number, nothing = 0, np.empty((0, 0))
    try:
        while True:
            number, kind, *content = line.recv()
            if kind == "start":
                rig = Rig(hardware, *content)
                line.send((number, nothing, None))
            elif rig is not None:
                answer = {"advance": rig.advance, "vent": rig.vent, "cut": rig.cut}[kind]
                line.send((number, *answer(*content)))
    except (EOFError, OSError):
        log.debug("the driver is gone; the rig vents and ends")
    except (SoftrlError, ArithmeticError, ValueError, TypeError) as error:
        line.send((number, nothing, f"it stopped: {type(error).__name__}: {error}"))
