"""A driver for a device on a wire, in real time: a serial port or datagrams (see ``protocol``).

A thread of its own repeats the setpoint on every sample, and between samples that are seldom, so that neither a busy caller
nor a slow sensor starves the device's watchdog. It watches the link, and vents the robot at once when that is one-way, silent,
or speaks of a fault, and when the caller has been silent for too long. An emergency stop is remembered here as well: the
device may never hear of it.
"""

import logging
import threading
import time
from collections.abc import Callable
from typing import Self

import numpy as np

from softrl.core.driver import Sample
from softrl.core.errors import DriverError
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.limits import Setpoint, require_safe, require_times
from softrl.sim2real.drivers.protocol import PRESSURE_PA, Flag, Frame, Kind, State, counts
from softrl.sim2real.drivers.session import FOREIGN, Session
from softrl.sim2real.drivers.transport import Transport

log = logging.getLogger(__name__)
VENT_REPEATS = 3
REPEATS = 3  # setpoints at least in the time of the device's watchdog, of which one may be lost and one late


class WireDriver:
    """The driver contract over a transport. Time is the device's, as its samples tell it.

    Parameters
    ----------
    robot : its limits are enforced here, before anything is sent
    connect : opens a transport
    watchdog_s : longest device time under pressure without a command of the caller's
    link_timeout_s : longest real time without a fresh sample, or without the device taking what was sent
    vent_s : device time that the driver stays connected after it has vented
    start_timeout_s : longest wait for the device's first answer

    Attributes
    ----------
    samples : all that arrived since the last entry; they outlive a lost link
    stale_s : device time for which a reading of the tip may be acted on, as long as the link may be silent
    dropped : samples that were not newer than the one before, since the last entry
    """

    def __init__(
        self, robot: Robot, connect: Callable[[], Transport], watchdog_s: float, link_timeout_s: float, vent_s: float,
        start_timeout_s: float,
    ) -> None:
        require_times(
            watchdog_s=watchdog_s, link_timeout_s=link_timeout_s, vent_s=vent_s, start_timeout_s=start_timeout_s
        )
        self._robot, self._connect = robot, connect
        self._watchdog_s, self._link_timeout_s, self.stale_s = watchdog_s, link_timeout_s, link_timeout_s
        self._vent_s, self._start_timeout_s = vent_s, start_timeout_s
        self._entered = self._stopped = False
        self._emergency = f"emergency stop of {robot.name}; driver.release() ends it in a new session"
        self.samples: list[Sample] = []
        self.dropped = 0

    def __enter__(self) -> Self:
        """Connect and begin a session; the device is vented."""
        if self._entered:
            raise DriverError(f"the driver of {self._robot.name} is connected already; leave the first 'with' block")
        if self._stopped:
            raise DriverError(self._emergency)
        self.samples, self.dropped = [], 0
        self._session = Session(self._connect())
        self._fault: str | None = None
        self._taken = self._returned = 0
        self._fresh = threading.Condition()
        try:
            welcome = self._session.hello(self._robot.chambers, self._start_timeout_s)
            require_safe(welcome, self._robot, self._link_timeout_s)
        except BaseException:
            self._session.close()
            raise
        self._setpoint_period_s = 1.0 / welcome.rate_hz
        self._repeat_s = min(self._setpoint_period_s, 1e-3 * welcome.watchdog_ms / REPEATS)
        self._setpoint = Setpoint(self._robot, self._setpoint_period_s)
        self._clock_s = self._commanded_s = self._until_s = self._moved_s = 0.0
        self._running = self._entered = True
        self._last_fresh = time.monotonic()
        self._thread = threading.Thread(target=self._pump, name="softrl-link", daemon=True)
        self._thread.start()
        try:
            self._begin()
        except BaseException:  # an interrupt too: nobody else would leave what was not entered
            self._leave()
            raise
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Vent and disconnect, whatever happened; a failure to vent never hides the error that led here."""
        self._entered = False
        try:
            vented = self._vent()
        except BaseException:  # a second interrupt
            self._try(self._end)
            raise
        finally:
            self._leave()
        if self._session.damaged or self.dropped:
            log.warning(
                "link to %s: %d damaged frames and %d late or repeated samples were dropped",
                self._robot.name, self._session.damaged, self.dropped,
            )  # fmt: skip
        failure = None if vented else f"no word from {self._robot.name} that it is vented; its own watchdog has to"
        if error is None and (self._fault or failure):
            raise DriverError(self._fault or failure)
        if failure:
            log.error("%s", failure)

    def command(self, pressure: np.ndarray) -> np.ndarray:
        """Return the first setpoint (chambers,) Pa on the way to ``pressure``; the rest follows, one a sample."""
        self._require_entry()
        with self._fresh:
            self._raise_fault()
            self._commanded_s = self._clock_s
            return self._setpoint.request(pressure)

    def advance(self, dt_s: float) -> list[Sample]:
        """Wait until ``dt_s`` has passed on the device's clock and return the samples that arrived.

        Time that the caller took since the last call is part of it; a caller who took a sample longer is not caught up with.

        Raises
        ------
        DriverError
            If the link was lost or a watchdog vented the robot; ``samples`` keeps what had arrived.
        """
        self._require_entry()
        with self._fresh:
            before = self._returned
            self._until_s += dt_s
            if self._until_s <= self._clock_s - self._setpoint_period_s:  # a prompt one may be asked between two samples
                self._until_s = self._clock_s + dt_s
            half_s = 0.5 * self._setpoint_period_s
            while self._clock_s < self._until_s - half_s:
                self._raise_fault()
                if not self._alive:
                    raise DriverError(f"lost the link to {self._robot.name}: nothing listens to it any more")
                self._fresh.wait(self._link_timeout_s)
            self._raise_fault()
            self._returned = len(self.samples)
            return self.samples[before:]

    def stop(self) -> None:
        """Stop in an emergency: vent at once, refuse commands and entries until ``release``; from any thread, at any time."""
        self._stopped = True  # before all else, so that no entry that is under way gets past it
        if self._entered:
            with self._fresh:
                self._halt(self._emergency)

    def release(self) -> None:
        """End an emergency stop, an earlier program's too; not while connected, and it lasts if no device answers."""
        if self._entered:
            raise DriverError(f"the driver of {self._robot.name} is connected; leave the 'with' block to release it")
        session = Session(self._connect())
        stopped, self._stopped = self._stopped, False  # a stop from here on outlives this release
        try:
            session.hello(self._robot.chambers, self._start_timeout_s)
            for _ in range(VENT_REPEATS):
                session.send(Kind.RELEASE)
        except BaseException:
            self._stopped |= stopped
            raise
        finally:
            session.close()

    # ---- the session -------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Wait for the first sample, from which time counts."""
        with self._fresh:
            give_up = time.monotonic() + self._start_timeout_s
            while not self.samples and self._fault is None and time.monotonic() < give_up:
                self._fresh.wait(self._link_timeout_s)
            fault = self._broken or (None if self.samples else "the device sends no samples")
            self._until_s = self._commanded_s = self._clock_s
            self._returned = len(self.samples)
        if fault is not None:
            raise DriverError(fault)

    def _leave(self) -> None:
        """End the thread and close the line."""
        self._entered = self._running = False
        self._thread.join()
        self._session.close()

    def _vent(self) -> bool:
        """Vent, stay connected for ``vent_s`` and return whether the device said that it is vented."""
        with self._fresh:
            self._setpoint.vent()
            self._try(self._end)
            sent, until_s = self._session.sent, self._clock_s + self._vent_s
            give_up = time.monotonic() + self._vent_s + 2.0 * self._link_timeout_s
            while time.monotonic() < give_up and self._alive and (self._acted < sent or self._clock_s < until_s):
                self._fresh.wait(self._link_timeout_s)
            return self._acted >= sent

    @property
    def _end(self) -> Kind:
        """The frame that vents: STOP from an emergency on, for the device may have missed it."""
        return Kind.STOP if self._stopped else Kind.VENT

    @property
    def _broken(self) -> str | None:
        """Why nothing may be commanded in this session any more."""
        return self._emergency if self._stopped else self._fault

    @property
    def _alive(self) -> bool:
        return self._thread.is_alive()

    @property
    def _acted(self) -> int:
        """Sequence of the last frame that the device took, 0 if it is not vented."""
        return self._taken if self.samples and not self.samples[-1].commanded.any() else 0

    # ---- the thread --------------------------------------------------------------------------------------------

    def _pump(self) -> None:
        """Serve the device until the session ends or the line is dead; whatever else ends it vents and is told as well."""
        try:
            self._serve()
        except DriverError as error:
            fault = str(error)
        except Exception as error:  # the caller would wait for ever
            fault = f"lost the link to {self._robot.name}: {type(error).__name__}: {error}"
        else:
            return
        with self._fresh:
            self._fail(fault)

    def _serve(self) -> None:
        """Take samples, answer each by the setpoint, and watch, until the session ends."""
        while self._running:
            frames = self._session.receive()
            with self._fresh:
                fresh = sum(self._take(frame) for frame in frames)
                self._watch()
                # without a sample no time has passed, so the setpoint stays where it is
                self._repeat(move=fresh > 0)
                self._fresh.notify_all()

    def _take(self, frame: Frame) -> bool:
        """Keep the sample of a STATE and return whether it was one and new."""
        if frame.kind != Kind.STATE:
            return False
        try:
            state = State.decode(frame.payload, self._robot.chambers)
        except ValueError as error:
            self._fail(f"{error}: {FOREIGN}")
            return False
        if frame.sequence <= self._session.heard or state.clock_s <= self._clock_s:
            self.dropped += 1
            return False
        self._session.heard, self._clock_s, self._taken = frame.sequence, state.clock_s, state.taken
        self._last_fresh = time.monotonic()
        self._session.took(state.taken)
        self.samples.append(
            Sample(state.clock_s, state.setpoint, state.pressure, state.position, state.quaternion, state.tip_force)
        )
        self._heed(state.flags)
        return True

    def _heed(self, flags: Flag) -> None:
        if flags & Flag.STOPPED:
            self._fail(f"emergency stop at the device of {self._robot.name}")
        elif flags & Flag.WATCHDOG:
            self._fail(f"the device's watchdog vented {self._robot.name}: it had taken no setpoint for too long")
        elif flags & Flag.REFUSED:
            self._fail("the device refused a setpoint: its range is smaller than the robot's limits here")

    def _watch(self) -> None:
        if time.monotonic() - self._last_fresh > self._link_timeout_s:
            self._fail(f"lost the link: no fresh sample for {self._link_timeout_s:g} s; what had arrived is kept")
        elif self._session.unheard_s() > self._link_timeout_s:
            self._fail(f"lost the link: the device has taken nothing that was sent for {self._link_timeout_s:g} s")
        elif self._entered and self._setpoint.sent.any() and self._clock_s - self._commanded_s > self._watchdog_s:
            self._fail(
                f"the watchdog vented the robot: no command for more than {self._watchdog_s:g} s; command it more often, "
                "or raise driver.watchdog_s"
            )

    def _repeat(self, move: bool) -> None:
        """Send the setpoint, a period further at most if a sample has come; once the session ends, vent until the line closes."""
        # a VENT or a STOP may be lost, and a setpoint of zero would be reached at the slew only
        if self._stopped or self._fault is not None or not self._entered:
            self._session.send(self._end)
            return
        if move:
            # a device may sample more often than it says; after a gap the way is that of one period still
            self._setpoint.advance(1, min((self._clock_s - self._moved_s) / self._setpoint_period_s, 1.0))
            self._moved_s = self._clock_s
        if move or time.monotonic() - self._session.sent_s > self._repeat_s:
            self._hold()

    def _hold(self) -> None:
        """Send the setpoint; VENT before the first request, since a device refuses a zero that is out of its range."""
        if self._setpoint.vented:
            self._session.send(Kind.VENT)
        else:
            self._session.send(Kind.SETPOINT, counts(self._setpoint.sent, PRESSURE_PA))

    # ---- ends --------------------------------------------------------------------------------------------------

    def _fail(self, fault: str) -> None:
        """Vent at once, and let the caller know at the next call."""
        if self._fault is None:
            self._halt(fault)

    def _halt(self, fault: str) -> None:
        self._fault = fault
        self._setpoint.vent()
        for _ in range(VENT_REPEATS):
            self._try(self._end)
        self._fresh.notify_all()

    def _raise_fault(self) -> None:
        if self._broken is not None:
            raise DriverError(f"{self._broken} (after {len(self.samples)} samples)")

    def _try(self, kind: Kind) -> None:
        """Send if the line still takes it."""
        try:
            self._session.send(kind)
        except DriverError as error:
            log.error("could not send %s: %s", kind.name, error)

    def _require_entry(self) -> None:
        if not self._entered:
            raise DriverError(f"the driver of {self._robot.name} is not connected; use it in a 'with' block")
