"""A driver whose robot is a rig: another process with physics of its own. What a real driver has to do, it does."""

import logging
import multiprocessing
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from softrl.core.driver import ANY_STREAM, Sample, Stream
from softrl.core.errors import ConfigError, DriverError
from softrl.core.simulator import Simulator
from softrl.effects.chain import EffectChain
from softrl.effects.effect import Effect
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.limits import Setpoint, require_times
from softrl.sim2real.drivers.rig import Hardware, Noise, sample_of, serve
from softrl.sim2real.surface import Surface

log = logging.getLogger(__name__)
# device time in one message, so that an answer is due soon however long the wait that was asked for
MESSAGE_S = 1.0
CLOSE_S = 5.0


@dataclass(frozen=True)
class Ground:
    """The surface of a rig: what no task knows.

    Attributes
    ----------
    stiffness_n_per_m, friction : of the surface
    misplaced_mm : by which it stands nearer to the robot than it should
    """

    stiffness_n_per_m: float
    friction: float
    misplaced_mm: float

    def __post_init__(self) -> None:
        if self.stiffness_n_per_m <= 0 or self.friction < 0:
            raise ConfigError(
                f"driver.surface: stiffness_n_per_m={self.stiffness_n_per_m:g} must be positive and "
                f"friction={self.friction:g} not negative"
            )

    def mounted(self, normal: np.ndarray, point: np.ndarray) -> Surface:
        """Return the surface where it really stands."""
        where = np.asarray(point) + 1e-3 * self.misplaced_mm * np.asarray(normal)
        x, y, z = (float(value) for value in normal)
        a, b, c = (float(value) for value in where)
        return Surface((x, y, z), (a, b, c), self.stiffness_n_per_m, self.friction)


class RigLink:
    """A rig's process and the line to it; the process ends when the line is closed or forgotten."""

    def __init__(self, hardware: Hardware) -> None:
        context = multiprocessing.get_context("spawn")
        self._line, far_end = context.Pipe()
        self.process = context.Process(target=serve, args=(far_end, hardware), name="softrl-rig", daemon=True)
        self.process.start()
        far_end.close()
        self._number = 0

    def ask(self, timeout_s: float, *message: Any) -> tuple[list[Sample], str | None]:
        """Return the rig's samples and fault in answer to ``message``.

        Samples of answers that an interrupt left unread come first.

        Raises
        ------
        DriverError
            If the rig's process has ended or does not answer in time.
        """
        self._number += 1
        samples: list[Sample] = []
        number = -1
        try:
            self._line.send((self._number, *message))
            while number != self._number:
                if not self._line.poll(timeout_s):
                    self.process.kill()
                    raise DriverError(f"the rig did not answer within {timeout_s:g} s and was stopped")
                number, rows, fault = self._line.recv()
                samples += map(sample_of, rows)
        except (EOFError, OSError) as error:
            raise self._lost() from error
        return samples, fault

    def _lost(self) -> DriverError:
        self.process.join(CLOSE_S)
        code = self.process.exitcode
        ended = f"was killed by signal {-code}" if code is not None and code < 0 else f"ended with exit code {code}"
        return DriverError(f"lost the link to the rig: its process {ended}; what it had sent is kept")

    def close(self) -> None:
        """End the rig's process; one that does not end by itself is killed."""
        self._line.close()
        self.process.join(CLOSE_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


class StubDriver:
    """The driver contract over a rig with hidden physics. Each entry switches the rig on anew, with other noise.

    The rig's process outlives an entry, since starting one takes a second, and ends with the driver.

    Parameters
    ----------
    robot : its limits are enforced here, before anything is sent
    body : what moves in the rig
    hidden : effects in the rig by name; nothing of them leaves it but motion
    noise : of the rig's sensors
    rate_hz : rate of setpoints and samples
    physics_rate_hz : rate at which the rig integrates, a multiple of ``rate_hz``
    watchdog_s : longest device time under pressure without a command
    vent_s : device time that the driver stays connected after it has vented
    start_timeout_s, answer_timeout_s : real time after which a silent rig counts as lost
    seed, stream : of the rig's noise, the second of the stage that drives it
    surface : how a surface that is mounted differs from what the task says of it

    Attributes
    ----------
    samples : all that arrived since the last entry; they outlive a lost link
    stale_s : device time for which a reading of the tip may be acted on, the watchdog's
    """

    def __init__(
        self,
        robot: Robot,
        body: Simulator,
        hidden: dict[str, Effect],
        noise: Noise,
        rate_hz: float,
        physics_rate_hz: float,
        watchdog_s: float,
        vent_s: float,
        start_timeout_s: float,
        answer_timeout_s: float,
        seed: int,
        surface: Ground | None = None,
        stream: Stream = ANY_STREAM,
    ) -> None:
        if rate_hz <= 0 or physics_rate_hz < rate_hz or physics_rate_hz % rate_hz:
            raise ConfigError(
                f"driver.physics_rate_hz={physics_rate_hz:g} is no multiple of driver.rate_hz={rate_hz:g}"
            )
        require_times(
            watchdog_s=watchdog_s, vent_s=vent_s, start_timeout_s=start_timeout_s, answer_timeout_s=answer_timeout_s
        )
        self._robot, self._seed, self._stream = robot, seed, stream
        self._rate_hz, self._vent_s, self.stale_s = rate_hz, vent_s, watchdog_s
        self._start_timeout_s, self._answer_timeout_s = start_timeout_s, answer_timeout_s
        chain = EffectChain(robot, tuple(hidden.values()))
        self._hardware = Hardware(body, chain, noise, rate_hz, physics_rate_hz, watchdog_s)
        self._ground, self._surface = surface, None
        self._link: RigLink | None = None
        self._entries = 0
        self._entered = self._stopped = False
        self._setpoint = Setpoint(robot, 1.0 / rate_hz)
        self._due = 0.0
        self._fault: str | None = None
        self.samples: list[Sample] = []

    def __enter__(self) -> Self:
        """Switch the rig on and connect; it is vented and at rest."""
        if self._entered:
            raise DriverError(f"the driver of {self._robot.name} is connected already; leave the first 'with' block")
        self._refuse_if_stopped()
        self._setpoint.vent()
        self._due, self._fault, self.samples = 0.0, None, []
        if self._link is None:
            self._link = RigLink(self._hardware)
        self._ask(self._start_timeout_s, "start", (self._seed, self._entries, self._stream), self._surface)
        self._entries += 1
        self._entered = True
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Vent and disconnect, whatever happened; a failure to vent never hides the error that led here."""
        self._entered = False
        self._setpoint.vent()
        try:
            self._ask(self._answer_timeout_s, "vent", round(self._vent_s * self._rate_hz))
        except DriverError as failure:
            if error is None:
                raise
            log.error("could not vent %s: %s", self._robot.name, failure)

    def command(self, pressure: np.ndarray) -> np.ndarray:
        """Return the first setpoint (chambers,) Pa on the way to ``pressure``.

        The rest of the way, as far as the slew asks for more than one period, is sent while time advances;
        ``Sample.commanded`` tells what was sent when.
        """
        self._require_entry()
        self._raise_fault()
        return self._setpoint.request(pressure)

    def advance(self, dt_s: float) -> list[Sample]:
        """Let ``dt_s`` pass on the device's clock and return the samples that arrived.

        Raises
        ------
        DriverError
            If the rig was lost or its watchdog vented it; ``samples`` keeps what had arrived.
        """
        self._require_entry()
        before = len(self.samples)
        self._due += dt_s * self._rate_hz
        # a period counts as over despite the rounding of many small dt_s
        ticks = int(self._due + 1e-6)
        self._due -= ticks
        most = max(round(MESSAGE_S * self._rate_hz), 1)
        for start in range(0, ticks, most):
            self._raise_fault()
            share = min(most, ticks - start)
            self._ask(self._answer_timeout_s, "advance", share, self._setpoint.advance(share))
        return self.samples[before:]

    def mount(self, normal: np.ndarray, point: np.ndarray) -> None:
        """Put a surface before the tip, as exactly as a hand would; from the next entry on."""
        if self._ground is None:
            raise ConfigError("driver.surface is missing: the rig has no surface to mount; see conf/driver/_rig.yaml")
        self._surface = self._ground.mounted(normal, point)

    def cut(self, chamber: int | None) -> None:
        """Pull a chamber's air line off; None puts all lines back on."""
        self._require_entry()
        self._ask(self._answer_timeout_s, "cut", chamber)

    def stop(self) -> None:
        """Stop in an emergency: the caller's next call raises, which vents; nothing is commanded until ``release``."""
        self._stopped = True
        self._setpoint.vent()

    def release(self) -> None:
        """End an emergency stop."""
        if self._entered:
            raise DriverError(f"the driver of {self._robot.name} is connected; leave the 'with' block to release it")
        self._stopped = False

    def _refuse_if_stopped(self) -> None:
        if self._stopped:
            raise DriverError(f"emergency stop of {self._robot.name}; driver.release() ends it")

    def _raise_fault(self) -> None:
        """Refuse to go on in a session that a stop or a fault has ended, though the caller may have swallowed that."""
        self._refuse_if_stopped()
        if self._fault is not None:
            raise DriverError(self._fault)

    @property
    def rig_pid(self) -> int | None:
        """Process id of the rig, None before the first entry and after it was lost."""
        return self._link.process.pid if self._link is not None else None

    def _require_entry(self) -> None:
        if not self._entered:
            raise DriverError(f"the driver of {self._robot.name} is not connected; use it in a 'with' block")

    def _ask(self, timeout_s: float, *message: Any) -> None:
        """Keep the samples that answer ``message``; a rig that was lost or reports a fault raises."""
        if self._link is None:
            raise DriverError(f"the rig of {self._robot.name} was lost; enter a new 'with' block to start it")
        try:
            samples, fault = self._link.ask(timeout_s, *message)
        except DriverError:
            self._link.close()
            self._link = None
            raise
        self.samples += samples
        if fault is not None:
            self._fault = f"rig of {self._robot.name} after {len(self.samples)} samples: {fault}"
            raise DriverError(self._fault)
