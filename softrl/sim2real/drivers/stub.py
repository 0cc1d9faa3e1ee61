"""A driver whose robot is a rig: another process with physics of its own. What a real driver has to do, it does."""

import logging
import multiprocessing
from typing import Any, Self

import numpy as np

from softrl.core.driver import Sample
from softrl.core.errors import ConfigError, DriverError
from softrl.core.simulator import Simulator
from softrl.effects.chain import EffectChain
from softrl.effects.effect import Effect
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.limits import Setpoint
from softrl.sim2real.drivers.rig import Hardware, Noise, sample_of, serve

log = logging.getLogger(__name__)
# device time in one message, so that an answer is due soon however long the wait that was asked for
MESSAGE_S = 1.0


class RigLink:
    """A rig's process and the line to it."""

    def __init__(self, hardware: Hardware, start_timeout_s: float, answer_timeout_s: float) -> None:
        context = multiprocessing.get_context("spawn")
        self._line, far_end = context.Pipe()
        self.process = context.Process(target=serve, args=(far_end, hardware), name="softrl-rig", daemon=True)
        self.process.start()
        far_end.close()
        self._timeout_s = answer_timeout_s
        self._number = 0
        _, fault = self._answer(start_timeout_s)
        if fault is not None:
            raise DriverError(fault)

    def ask(self, *message: Any) -> tuple[list[Sample], str | None]:
        """Return the rig's samples and fault in answer to ``message``.

        Raises
        ------
        DriverError
            If the rig's process has ended or does not answer in time.
        """
        self._number += 1
        try:
            self._line.send((self._number, *message))
        except OSError as error:
            raise self._lost() from error
        return self._answer(self._timeout_s)

    def _answer(self, timeout_s: float) -> tuple[list[Sample], str | None]:
        """Return the answer to the last message, with the samples of answers that an interrupt left unread."""
        samples: list[Sample] = []
        number = -1
        while number != self._number:
            try:
                if not self._line.poll(timeout_s):
                    self.process.kill()
                    raise DriverError(f"the rig did not answer within {timeout_s:g} s and was stopped")
                number, arrived, fault = self._line.recv()
            except (EOFError, OSError) as error:
                raise self._lost() from error
            samples += map(sample_of, arrived)
        return samples, fault

    def _lost(self) -> DriverError:
        self.process.join(self._timeout_s)
        code = self.process.exitcode
        ended = f"was killed by signal {-code}" if code is not None and code < 0 else f"ended with exit code {code}"
        return DriverError(f"lost the link to the rig: its process {ended}; what it had sent is kept")

    def close(self) -> None:
        """End the rig's process; a rig that does not end by itself is killed."""
        try:
            self._line.send((-1, "close"))
        except OSError:
            log.debug("the rig had ended before it was told to")
        self._line.close()
        self.process.join(self._timeout_s)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


class StubDriver:
    """The driver contract over a rig with hidden physics. Each entry starts the rig anew, with other noise.

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
    seed : of the rig's noise

    Attributes
    ----------
    samples : all that arrived since the last entry; they outlive a lost link
    """

    def __init__(
        self, robot: Robot, body: Simulator, hidden: dict[str, Effect], noise: Noise, rate_hz: float,
        physics_rate_hz: float, watchdog_s: float, vent_s: float, start_timeout_s: float, answer_timeout_s: float,
        seed: int,
    ) -> None:
        if rate_hz <= 0 or physics_rate_hz < rate_hz or physics_rate_hz % rate_hz:
            raise ConfigError(
                f"driver.physics_rate_hz={physics_rate_hz:g} is no multiple of driver.rate_hz={rate_hz:g}"
            )
        self._robot, self._seed = robot, seed
        self._rate_hz, self._vent_s = rate_hz, vent_s
        self._timeouts_s = (start_timeout_s, answer_timeout_s)
        chain = EffectChain(robot, tuple(hidden.values()))
        self._hardware = (body, chain, noise, rate_hz, physics_rate_hz, watchdog_s)
        self._entries = 0
        self._link: RigLink | None = None
        self._setpoint = Setpoint(robot, 1.0 / rate_hz)
        self._due = 0.0
        self.samples: list[Sample] = []

    def __enter__(self) -> Self:
        """Start the rig and connect; it is vented and at rest."""
        if self._link is not None:
            raise DriverError(f"the driver of {self._robot.name} is connected already; leave the first 'with' block")
        hardware = Hardware(*self._hardware, seed=(self._seed, self._entries))
        self._entries += 1
        self._setpoint.vent()
        self._due, self.samples = 0.0, []
        self._link = RigLink(hardware, *self._timeouts_s)
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Vent and disconnect, whatever happened; a failure to vent never hides the error that led here."""
        link = self._connected()
        self._setpoint.vent()
        try:
            self._keep(link.ask("vent", round(self._vent_s * self._rate_hz)))
        except DriverError as failure:
            if error is None:
                raise
            log.error("could not vent %s: %s", self._robot.name, failure)
        finally:
            link.close()
            self._link = None

    def command(self, pressure: np.ndarray) -> np.ndarray:
        """Return the first setpoint (chambers,) Pa on the way to ``pressure``.

        The rest of the way, as far as the slew asks for more than one period, is sent while time advances;
        ``Sample.commanded`` tells what was sent when.
        """
        self._connected()
        return self._setpoint.request(pressure)

    def advance(self, dt_s: float) -> list[Sample]:
        """Let ``dt_s`` pass on the device's clock and return the samples that arrived.

        Raises
        ------
        DriverError
            If the rig was lost or its watchdog vented it; ``samples`` keeps what had arrived.
        """
        link, before = self._connected(), len(self.samples)
        self._due += dt_s * self._rate_hz
        # a period counts as over despite the rounding of many small dt_s
        ticks = int(self._due + 1e-6)
        self._due -= ticks
        for start in range(0, ticks, self._per_message):
            share = min(self._per_message, ticks - start)
            self._keep(link.ask("advance", share, self._setpoint.advance(share)))
        return self.samples[before:]

    @property
    def rig_pid(self) -> int | None:
        """Process id of the connected rig."""
        return self._connected().process.pid

    @property
    def _per_message(self) -> int:
        return max(round(MESSAGE_S * self._rate_hz), 1)

    def _connected(self) -> RigLink:
        if self._link is None:
            raise DriverError(f"the driver of {self._robot.name} is not connected; use it in a 'with' block")
        return self._link

    def _keep(self, answer: tuple[list[Sample], str | None]) -> None:
        samples, fault = answer
        self.samples += samples
        if fault is not None:
            raise DriverError(f"rig of {self._robot.name} after {len(self.samples)} samples: {fault}")
