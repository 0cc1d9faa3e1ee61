"""A rig: hardware that is simulated in a process of its own, on its own clock, with physics that nobody is told.

Messages to the rig: ``(number, "advance", ticks, setpoints)``, ``(number, "vent", ticks)``, ``(number, "close")``.
It answers the first two by ``(number, samples, fault)`` where ``fault`` is None or one line.
"""

import logging
import signal
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from softrl.core.driver import Sample
from softrl.core.errors import ConfigError, SoftrlError
from softrl.core.simulator import Simulator
from softrl.effects.chain import EffectChain, SignalFilter

log = logging.getLogger(__name__)
SETTLE_S = 5.0


@dataclass(frozen=True)
class Noise:
    """What the rig's sensors add to the truth.

    Attributes
    ----------
    position_white_mm : standard deviation per axis and sample
    position_coloured_mm, colour_s : standard deviation and correlation time of a slow wander per axis
    orientation_white_deg : standard deviation about each axis
    pressure_white_kpa : standard deviation per chamber and sample
    dropped_share : share of the samples that never arrive, in [0, 1)
    """

    position_white_mm: float
    position_coloured_mm: float
    colour_s: float
    orientation_white_deg: float
    pressure_white_kpa: float
    dropped_share: float

    def __post_init__(self) -> None:
        for name in ("position_white_mm", "position_coloured_mm", "orientation_white_deg", "pressure_white_kpa"):
            if getattr(self, name) < 0:
                raise ConfigError(f"driver.noise.{name}={getattr(self, name):g} must not be negative")
        if self.colour_s <= 0:
            raise ConfigError(f"driver.noise.colour_s={self.colour_s:g} must be positive")
        if not 0 <= self.dropped_share < 1:
            raise ConfigError(f"driver.noise.dropped_share={self.dropped_share:g} is outside 0..1 (1 excluded)")


class Sensors:
    """The running noise of one rig."""

    def __init__(self, noise: Noise, period_s: float, rng: np.random.Generator) -> None:
        self._noise, self._rng = noise, rng
        self._keep = float(np.exp(-period_s / noise.colour_s))
        self._wander_mm = noise.position_coloured_mm * rng.standard_normal(3)

    def read(self, truth: Sample) -> Sample | None:
        """Return what arrives of ``truth``, or None for a dropped sample."""
        noise, draw = self._noise, self._rng.standard_normal
        fresh = noise.position_coloured_mm * np.sqrt(1.0 - self._keep**2)
        self._wander_mm = self._keep * self._wander_mm + fresh * draw(3)
        position_mm = self._wander_mm + noise.position_white_mm * draw(3)
        turn = np.deg2rad(noise.orientation_white_deg) * draw(3)
        pressure_kpa = noise.pressure_white_kpa * draw(len(truth.pressure))
        if self._rng.random() < noise.dropped_share:
            return None
        return Sample(
            truth.time_s, truth.commanded, truth.pressure + 1e3 * pressure_kpa, truth.position + 1e-3 * position_mm,
            turned(truth.quaternion, turn), truth.tip_force,
        )


def turned(quaternion: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return the quaternion (4,) w x y z after a small rotation vector ``turn`` (3,) rad in the base frame."""
    w, v = quaternion[0], quaternion[1:]
    half = 0.5 * turn
    product = np.concatenate([[w - half @ v], v + w * half + np.cross(half, v)])
    return product / np.linalg.norm(product)


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
    seed: tuple[int, ...]


class Rig:
    """The hardware in motion: valves, chambers, body, load and sensors, one physics step after the other."""

    def __init__(self, hardware: Hardware) -> None:
        rng = np.random.default_rng(hardware.seed)
        hidden = hardware.hidden
        self._body = hardware.body
        self._substeps = round(hardware.physics_rate_hz / hardware.rate_hz)
        self._period_s = 1.0 / hardware.rate_hz
        self._watchdog_s = hardware.watchdog_s
        self._valve, self._chamber, self._sensor = (SignalFilter(hidden, s) for s in ("valve", "chamber", "sensor"))
        self._sensors = Sensors(hardware.noise, self._period_s, rng)
        self._setpoint = np.zeros(hidden.robot.chambers)
        self._ticks = self._silent_ticks = 0
        # under its loads the robot hangs elsewhere than without; it has come to rest before it is switched on
        self._state = hardware.body.reset(rng)
        self._body_hooks, self._load_hooks = hidden.hooks("body"), hidden.hooks("load")
        self._settle(SETTLE_S if self._load_hooks else self._period_s)
        self._body_hooks, self._load_hooks = hidden.hooks("body"), hidden.hooks("load")

    def _settle(self, duration_s: float) -> None:
        dt_s = self._period_s / self._substeps
        for _ in range(round(duration_s / dt_s)):
            self._step(np.zeros_like(self._setpoint), dt_s)

    def _step(self, acting: np.ndarray, dt_s: float) -> None:
        self._state = self._body.step(
            self._state, acting, dt_s, None, body=self._body_hooks, load=self._load_hooks
        )

    def advance(self, ticks: int, setpoints: np.ndarray) -> tuple[list[Sample], str | None]:
        """Return the samples of ``ticks`` periods, and what the watchdog says.

        ``setpoints`` (sent, chambers) Pa arrive one per period from the first; then the last one is held.
        """
        samples, fault = [], None
        for tick in range(ticks):
            self._silent_ticks = 0 if tick < len(setpoints) else self._silent_ticks + 1
            if tick < len(setpoints) and fault is None:
                self._setpoint = setpoints[tick].copy()
            if self._silent_ticks * self._period_s > self._watchdog_s and self._setpoint.any():
                self._setpoint = np.zeros_like(self._setpoint)
                fault = f"the watchdog vented the robot: no command for more than {self._watchdog_s:g} s"
            samples.append(self._tick())
        return [s for s in samples if s is not None], fault

    def vent(self, ticks: int) -> tuple[list[Sample], str | None]:
        """Return the samples of ``ticks`` periods after all chambers were vented."""
        return self.advance(ticks, np.zeros((1, len(self._setpoint))))

    def _tick(self) -> Sample | None:
        """Return the sample at the end of one period, the setpoint held throughout."""
        dt_s = self._period_s / self._substeps
        for _ in range(self._substeps):
            supplied = self._valve.advance(self._setpoint[None], dt_s)
            acting = self._chamber.advance(supplied, dt_s)
            self._step(acting[0], dt_s)
            position, quaternion = self._body.observe(self._state)
            pose = self._sensor.advance(np.concatenate([position, quaternion])[None], dt_s)[0]
        self._ticks += 1
        truth = Sample(
            self._ticks * self._period_s, self._setpoint, supplied[0], pose[:3], pose[3:], np.full(3, np.nan)
        )
        return self._sensors.read(truth)


def serve(line: Connection, hardware: Hardware) -> None:
    """Run a rig until it is told to close or loses its driver; the body of the rig's process."""
    # an interrupt from the terminal is for the driver, which then vents; the rig must live to do so
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    number = 0
    try:
        rig = Rig(hardware)
        line.send((number, [], None))
        while True:
            number, kind, *content = line.recv()
            if kind == "close":
                return
            line.send((number, *_run(rig, kind, content)))
    except (EOFError, OSError):
        log.warning("the rig lost its driver; it vents and ends")
    except (SoftrlError, ArithmeticError, ValueError, TypeError) as error:
        line.send((number, [], f"the rig stopped: {type(error).__name__}: {error}"))


def _run(rig: Rig, kind: str, content: list[Any]) -> tuple[list[Sample], str | None]:
    if kind == "vent":
        return rig.vent(*content)
    return rig.advance(*content)
