"""The device's side of the wire protocol, with a rig behind it: a process of its own, in real time, on a real transport."""

import logging
import multiprocessing
import os
import select
import signal
import socket
import time
import tty
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Protocol

import numpy as np

from softrl.core.driver import ANY_STREAM, Stream
from softrl.core.errors import ConfigError, DriverError
from softrl.core.simulator import Simulator
from softrl.effects.chain import EffectChain
from softrl.effects.effect import Effect
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.limits import Setpoint
from softrl.sim2real.drivers.protocol import PRESSURE_PA, Decoder, Flag, Frame, Kind, State, Welcome, values_of
from softrl.sim2real.drivers.rig import Hardware, Noise, Rig, sample_of

log = logging.getLogger(__name__)
MEDIA = ("serial", "udp")
CLOSE_S = 5.0
LOCAL = "127.0.0.1"


class Regulator:
    """What a device does with frames, and what it says at each tick of its clock.

    A rig is switched on by each HELLO: at rest, vented, its clock at zero.
    """

    def __init__(self, hardware: Hardware, seed: int, stream: Stream = ANY_STREAM) -> None:
        self._hardware, self._robot, self._seed, self._stream = hardware, hardware.hidden.robot, seed, stream
        self._rig: Rig | None = None
        self._session, self._entries = -1, 0
        self._taken = self._sent = 0
        self._flags = Flag(0)
        self._setpoint = Setpoint(self._robot, 1.0 / hardware.rate_hz)
        self._heard = False

    def take(self, frame: Frame) -> bytes | None:
        """Act on a frame; return the answer to a HELLO. What is old, foreign or malformed changes nothing."""
        if frame.kind == Kind.HELLO:
            return self._welcome(frame)
        if self._rig is None or frame.session != self._session or frame.sequence <= self._taken:
            return None
        self._taken = frame.sequence
        if frame.kind == Kind.SETPOINT:
            self._set(frame.payload)
        elif frame.kind in (Kind.VENT, Kind.STOP):
            self._setpoint.vent()
            self._heard = True
            self._flags |= Flag.STOPPED if frame.kind == Kind.STOP else Flag(0)
        elif frame.kind == Kind.RELEASE:
            self._flags &= ~Flag.STOPPED
        return None

    def _welcome(self, frame: Frame) -> bytes:
        if frame.session != self._session:
            self._rig = Rig(self._hardware, (self._seed, self._entries, self._stream))
            self._session, self._entries = frame.session, self._entries + 1
            self._taken, self._sent, self._heard = frame.sequence, 0, False
            self._setpoint.vent()
            self._flags &= Flag.STOPPED
        rate_hz, watchdog_ms = round(self._hardware.rate_hz), round(1e3 * self._hardware.watchdog_s)
        return self._frame(Kind.WELCOME, Welcome(self._robot.chambers, rate_hz, watchdog_ms, self._flags).encode())

    def _set(self, payload: bytes) -> None:
        if len(payload) != 4 * self._robot.chambers:
            self._flags |= Flag.REFUSED
            return
        wanted = values_of(np.frombuffer(payload, "<i4"), PRESSURE_PA)
        low, high = self._robot.pressure_min_pa - PRESSURE_PA, self._robot.pressure_max_pa + PRESSURE_PA
        # a setpoint that is "not measured" compares false, so it is refused as well
        if not ((wanted >= low) & (wanted <= high)).all():
            self._flags |= Flag.REFUSED
        elif not self._flags & (Flag.WATCHDOG | Flag.STOPPED):
            self._setpoint.request(wanted)
            self._heard = True

    def tick(self) -> bytes | None:
        """Let one period pass; return a STATE, or None before the first HELLO and for a sample that is lost."""
        if self._rig is None:
            return None
        if self._heard:
            # after lost frames the goal may be far away: the device keeps the slew by itself
            self._setpoint.advance(1)
        heard, self._heard = self._heard, False
        rows, fault = self._rig.advance(1, np.tile(self._setpoint.sent, (1 if heard else 0, 1)))
        if fault is not None:
            self._flags |= Flag.WATCHDOG
        if not len(rows):
            return None
        s = sample_of(rows[0])
        state = State(
            s.time_s, self._flags, self._taken, s.commanded, s.pressure, s.position, s.quaternion, s.tip_force
        )
        return self._frame(Kind.STATE, state.encode())

    def _frame(self, kind: Kind, payload: bytes) -> bytes:
        self._sent += 1
        return Frame(kind, self._session, self._sent, payload).encode()


class End(Protocol):
    """A device's end of a line, with the address that a driver connects to."""

    address: str

    def receive(self, wait_s: float) -> bytes:
        """Return what came within ``wait_s``."""
        ...

    def send(self, data: bytes) -> None:
        """Send, or drop what the line cannot take."""
        ...


class PtyEnd:
    """The far end of a pseudo terminal: a serial port without hardware."""

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        # the slave stays open here, so that the line survives a driver that leaves
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.address = os.ttyname(self._slave)

    def receive(self, wait_s: float) -> bytes:
        """Return the bytes that came."""
        ready = select.select([self._master], [], [], wait_s)[0]
        return os.read(self._master, 4096) if ready else b""

    def send(self, data: bytes) -> None:
        """Write; while nobody reads the line is full, and samples are lost as they are on a real one."""
        try:
            os.write(self._master, data)
        except BlockingIOError:
            log.debug("the serial line is full; %d bytes lost", len(data))


class UdpEnd:
    """A socket on this machine alone; it answers whoever spoke last."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((LOCAL, 0))
        self._peer: tuple[str, int] | None = None
        self.address = f"{LOCAL}:{self._socket.getsockname()[1]}"

    def receive(self, wait_s: float) -> bytes:
        """Return the next datagram."""
        if not select.select([self._socket], [], [], wait_s)[0]:
            return b""
        try:
            data, self._peer = self._socket.recvfrom(4096)
        except OSError:  # the driver's socket is closed
            return b""
        return data

    def send(self, data: bytes) -> None:
        """Send one datagram."""
        if self._peer is not None:
            self._socket.sendto(data, self._peer)


def serve(announce: Connection, medium: str, hardware: Hardware, seed: int, speed: float, stream: Stream) -> None:
    """Run a device until its owner is gone; the body of its process."""
    # an interrupt from the terminal is for the driver, which then vents; the device must live to do so
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end: End = PtyEnd() if medium == "serial" else UdpEnd()
    regulator, decoder = Regulator(hardware, seed, stream), Decoder()
    announce.send(end.address)
    period_s = 1.0 / (hardware.rate_hz * speed)
    due = time.monotonic() + period_s
    while not announce.poll():  # an end of file counts as something to read
        for frame in decoder.feed(end.receive(max(due - time.monotonic(), 0.0))):
            answer = regulator.take(frame)
            if answer is not None:
                end.send(answer)
        now = time.monotonic()
        if now >= due:
            state = regulator.tick()
            if state is not None:
                end.send(state)
            # a process that was held up does not hurry afterwards: its clock stood still
            due = max(due + period_s, now)


@dataclass(frozen=True)
class WiredRig:
    """A rig to be put behind a real transport.

    Attributes
    ----------
    body, hidden, noise : see ``StubDriver``
    rate_hz, physics_rate_hz : of setpoints and samples, and of the integration
    watchdog_s : time under pressure without a setpoint after which it vents by itself
    speed : its seconds per second
    start_timeout_s : longest wait for its process
    seed, stream : of its noise, the second of the stage that drives it
    """

    robot: Robot
    body: Simulator
    hidden: dict[str, Effect]
    noise: Noise
    rate_hz: float
    physics_rate_hz: float
    watchdog_s: float
    speed: float
    start_timeout_s: float
    seed: int
    stream: Stream = ANY_STREAM

    def __post_init__(self) -> None:
        if self.rate_hz <= 0 or self.physics_rate_hz < self.rate_hz or self.physics_rate_hz % self.rate_hz:
            raise ConfigError(
                f"driver.rig.physics_rate_hz={self.physics_rate_hz:g} is no multiple of rate_hz={self.rate_hz:g}"
            )
        for name in ("watchdog_s", "speed"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"driver.rig.{name}={getattr(self, name):g} must be positive")

    def start(self, medium: str) -> "RunningRig":
        """Return the rig in a process of its own, on a pseudo terminal (serial) or a local socket (udp)."""
        chain = EffectChain(self.robot, tuple(self.hidden.values()))
        hardware = Hardware(self.body, chain, self.noise, self.rate_hz, self.physics_rate_hz, self.watchdog_s)
        return RunningRig(medium, hardware, self.seed, self.speed, self.start_timeout_s, self.stream)


class RunningRig:
    """The process of a rig on a wire.

    Attributes
    ----------
    address : path of its serial port, or host:port
    process : its process; it ends with this object
    """

    def __init__(
        self, medium: str, hardware: Hardware, seed: int, speed: float, start_timeout_s: float, stream: Stream = ANY_STREAM
    ) -> None:
        if medium not in MEDIA:
            raise ConfigError(f"medium={medium} is unknown; expected one of {', '.join(MEDIA)}")
        context = multiprocessing.get_context("spawn")
        self._line, far_end = context.Pipe()
        self.process = context.Process(
            target=serve, args=(far_end, medium, hardware, seed, speed, stream), name="softrl-rig", daemon=True
        )
        self.process.start()
        far_end.close()
        try:
            if not self._line.poll(start_timeout_s):
                raise DriverError(f"the rig's process did not start within {start_timeout_s:g} s")
            self.address: str = self._line.recv()
        except (EOFError, DriverError) as error:
            self.close()
            raise DriverError(f"the rig's process did not start: {error or 'it ended'}") from error

    def close(self) -> None:
        """End the process; one that does not end by itself is killed."""
        self._line.close()
        self.process.join(CLOSE_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
