"""How fast the tip can follow: amplitude over frequency, measured, and as the simulator with its effects predicts."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from softrl.core.driver import Driver
from softrl.core.errors import ConfigError
from softrl.effects.chain import EffectChain, Plant
from softrl.recordings.program import limited, record
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
KNEE = 1.0 / np.sqrt(2.0)  # -3 dB
HEARD = 5.0  # times what moves at other frequencies: the slowest tone is noise below
LEAST_M = 1e-9  # what a tip that stands still moves by rounding
OFF_SHARE = 0.01  # of a sweep's duration: by more its tones were others than the ones that are fitted


@dataclass(frozen=True)
class Bandwidth:
    """A sweep of one chamber's pressure.

    Attributes
    ----------
    frequencies_hz : of the tones, one after the other, rising; the first is the reference
    middle_kpa, amplitude_kpa : of the pressure; at the highest tone the slew must not bind (see ``require_fit``)
    cycles, least_s : of a tone that count, at least so long; as many more go before
    dt_s : time between commands
    """

    frequencies_hz: tuple[float, ...]
    middle_kpa: float
    amplitude_kpa: float
    cycles: int
    least_s: float
    dt_s: float

    def __post_init__(self) -> None:
        if len(self.frequencies_hz) < 3 or (np.diff(self.frequencies_hz) <= 0).any() or self.frequencies_hz[0] <= 0:
            raise ConfigError(
                f"stage.bandwidth.frequencies_hz={list(self.frequencies_hz)}; expected three or more, positive and rising"
            )
        for name in ("amplitude_kpa", "cycles", "least_s", "dt_s"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.bandwidth.{name}={getattr(self, name):g} must be positive")

    def require_fit(self, robot: Robot) -> None:
        """Refuse tones that ``robot`` cannot be sent as they are meant: out of its range, above its slew, or aliased."""
        low, high, highest_hz = 1e-3 * robot.pressure_min_pa, 1e-3 * robot.pressure_max_pa, self.frequencies_hz[-1]
        if self.middle_kpa - self.amplitude_kpa < low or self.middle_kpa + self.amplitude_kpa > high:
            raise ConfigError(
                f"stage.bandwidth: middle_kpa={self.middle_kpa:g} with amplitude_kpa={self.amplitude_kpa:g} leaves the range "
                f"of robot {robot.name}, {low:g} to {high:g} kPa; expected both ends of the tone within it"
            )
        if highest_hz >= 0.5 / self.dt_s:
            raise ConfigError(
                f"stage.bandwidth.frequencies_hz={list(self.frequencies_hz)} at dt_s={self.dt_s:g}; expected more than two "
                f"commands a period, so tones below {0.5 / self.dt_s:g} Hz: lower the highest tone, or dt_s"
            )
        fastest_pa_per_s = 2.0 * np.pi * highest_hz * 1e3 * self.amplitude_kpa
        if fastest_pa_per_s > robot.slew_pa_per_s:
            raise ConfigError(
                f"stage.bandwidth: amplitude_kpa={self.amplitude_kpa:g} at {highest_hz:g} Hz asks for "
                f"{fastest_pa_per_s:.0f} Pa/s; expected at most slew_pa_per_s={robot.slew_pa_per_s:g} of robot "
                f"{robot.name}: lower the amplitude, or the highest tone"
            )


@dataclass(frozen=True)
class Response:
    """Amplitudes (tones,) relative to the first tone's, and the frequency of -3 dB.

    Attributes
    ----------
    knee_hz : infinite if the amplitude stays above; not a number if the slowest tone cannot be told from noise
    """

    frequency_hz: np.ndarray
    ratio: np.ndarray
    knee_hz: float


def sweep(robot: Robot, settings: Bandwidth, chamber: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return the program (time (steps,) s, pressure (steps, n) Pa)."""
    pressure = np.zeros((sum(count for _, count in _tones(settings)), robot.chambers))
    start = 0
    for frequency, count in _tones(settings):
        time = settings.dt_s * np.arange(1, count + 1)
        wave = settings.middle_kpa + settings.amplitude_kpa * np.sin(2.0 * np.pi * frequency * time)
        pressure[start : start + count, chamber] = 1e3 * wave
        start += count
    pressure = limited(robot, pressure, settings.dt_s)
    return settings.dt_s * np.arange(1, len(pressure) + 1), pressure


def _tones(settings: Bandwidth) -> Iterator[tuple[float, int]]:
    """Yield frequency and number of commands of each tone: a run-in and as much again that counts."""
    for frequency in settings.frequencies_hz:
        cycles = max(settings.cycles, int(np.ceil(settings.least_s * frequency)))
        yield frequency, 2 * round(cycles / frequency / settings.dt_s)


def response(settings: Bandwidth, time: np.ndarray, position: np.ndarray) -> Response:
    """Return the response in tips (samples, 3) m at ``time`` (samples,) s since the program began."""
    found, noise_m, start = list[float](), 0.0, 0.0
    for frequency, count in _tones(settings):
        middle, start = start + 0.5 * count * settings.dt_s, start + count * settings.dt_s
        mine = (time > middle) & (time <= start)
        trend = np.column_stack([np.ones(mine.sum()), time[mine] - middle])
        tone, left = _tone(frequency, time[mine], position[mine], trend)
        if not found:  # at whole numbers of cycles beside the slowest tone's, where noise is about as large, white or not
            beside = frequency + np.array([1.0, 2.0]) / (start - middle)
            noise_m = float(np.sqrt(np.mean([_tone(other, time[mine], left, trend)[0] ** 2 for other in beside])))
        found.append(tone)
    frequency_hz, amplitude = np.array(settings.frequencies_hz), np.array(found)
    if amplitude[0] <= HEARD * noise_m + LEAST_M:
        return Response(frequency_hz, np.full(len(amplitude), np.nan), float("nan"))
    ratio = amplitude / amplitude[0]
    return Response(frequency_hz, ratio, _knee(frequency_hz, ratio))


def _tone(frequency: float, time: np.ndarray, position: np.ndarray, trend: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the amplitude in m of a tone in tips (samples, 3) beside a ``trend`` (samples, n), and what is left of them."""
    phase = 2.0 * np.pi * frequency * time
    columns = np.column_stack([np.sin(phase), np.cos(phase), trend])
    fitted = np.linalg.lstsq(columns, position, rcond=None)[0]
    return float(np.sqrt(np.sum(fitted[:2] ** 2))), position - columns @ fitted


def _knee(frequency_hz: np.ndarray, ratio: np.ndarray) -> float:
    """Return where the amplitude first falls below -3 dB for good, on straight lines between the logarithms."""
    above = np.flatnonzero(ratio >= KNEE)
    k = int(above[-1])
    if k == len(ratio) - 1:
        return float("inf")
    share = np.log(ratio[k] / KNEE) / np.log(ratio[k] / ratio[k + 1])
    return float(frequency_hz[k] * (frequency_hz[k + 1] / frequency_hz[k]) ** share)


def measure(driver: Driver, robot: Robot, settings: Bandwidth) -> tuple[Recording, Response]:
    """Return what the robot did under the sweep."""
    time, pressure = sweep(robot, settings)
    with driver:
        recording = record(driver, robot, time, pressure, "bandwidth", "bandwidth")
    if recording.position is None:
        raise ConfigError("the bandwidth needs a tip position, which this robot does not report")
    _warn_of_other_tones(time, recording.time)
    began = recording.time[0] - settings.dt_s
    return recording, response(settings, recording.time - began, recording.position)


def _warn_of_other_tones(planned: np.ndarray, recorded: np.ndarray) -> None:
    """Tell of a sweep that took longer or shorter than meant, its times (steps,) s and (samples,) s.

    It does not end the session: what follows the sweep does not depend on it.
    """
    meant_s, took_s = float(np.ptp(planned)), float(np.ptp(recorded))
    if abs(took_s - meant_s) > OFF_SHARE * meant_s:
        log.warning(
            "the sweep took %.2f s, not %.2f s: its tones were others than meant and the measured bandwidth is wrong; raise "
            "stage.bandwidth.dt_s, or find out what holds the commands up", took_s, meant_s,
        )  # fmt: skip


def predict(robot: Robot, plant: Plant, settings: Bandwidth) -> dict[str, Response]:
    """Return what the simulator says: with all its effects, and without those of each name (``without_<effect>``).

    Effects of one name are one thing that acts in several places, as the lag of each chamber's valve.
    """
    time, pressure = sweep(robot, settings)

    def of(chain: EffectChain) -> Response:
        return response(settings, time, Plant(plant.simulator, chain).simulate(time, pressure).position)

    effects = plant.chain.effects
    names = dict.fromkeys(effect.name() for effect in effects)
    less = {name: EffectChain(robot, tuple(other for other in effects if other.name() != name)) for name in names}
    return {"predicted": of(plant.chain)} | {f"without_{name}": of(chain) for name, chain in less.items()}
