"""Where a wire driver's device is: at a serial port, at an address that takes datagrams, or a rig of its own behind either."""

from collections.abc import Callable

from softrl.core.errors import ConfigError
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.regulator import RunningRig, WiredRig
from softrl.sim2real.drivers.transport import SerialTransport, Transport, UdpTransport
from softrl.sim2real.drivers.wire import WireDriver

RECEIVE_S = 0.01


class _OnWire(WireDriver):
    """A wire driver that may own the rig at its far end."""

    def __init__(
        self, robot: Robot, medium: str, address: str | None, rig: WiredRig | None,
        open_at: Callable[[str], Transport], watchdog_s: float, link_timeout_s: float, vent_s: float,
        start_timeout_s: float,
    ) -> None:
        if (address is None) == (rig is None):
            raise ConfigError(f"driver={medium} needs the address of a device, or a rig of its own: one of the two")
        self._address, self._rig, self._medium, self._open_at = address, rig, medium, open_at
        self._far_end: RunningRig | None = None
        super().__init__(robot, self._open, watchdog_s, link_timeout_s, vent_s, start_timeout_s)

    def _open(self) -> Transport:
        if self._rig is None:
            return self._open_at(str(self._address))
        if self._far_end is not None and not self._far_end.process.is_alive():
            self._far_end.close()
            self._far_end = None
        if self._far_end is None:
            self._far_end = self._rig.start(self._medium)
        return self._open_at(self._far_end.address)

    @property
    def far_end(self) -> RunningRig | None:
        """The own rig, None before the first entry and with a real device."""
        return self._far_end


class SerialDriver(_OnWire):
    """A device on a serial port.

    Parameters
    ----------
    port : its path, such as /dev/ttyUSB0 or COM3; None with a rig of its own, which brings a pseudo terminal
    baud : bits per second; 100 STATEs a second of three chambers take 92 000
    rig : put at the far end, in a process of its own
    """

    def __init__(
        self, robot: Robot, port: str | None, baud: int, watchdog_s: float, link_timeout_s: float, vent_s: float,
        start_timeout_s: float, rig: WiredRig | None = None,
    ) -> None:  # fmt: skip
        super().__init__(
            robot, "serial", port, rig, lambda at: SerialTransport(at, baud, RECEIVE_S), watchdog_s, link_timeout_s,
            vent_s, start_timeout_s,
        )  # fmt: skip


class UdpDriver(_OnWire):
    """A device that takes datagrams.

    Parameters
    ----------
    host, port : its address; both None with a rig of its own, which listens on this machine only
    rig : put at the far end, in a process of its own
    """

    def __init__(
        self, robot: Robot, host: str | None, port: int | None, watchdog_s: float, link_timeout_s: float,
        vent_s: float, start_timeout_s: float, rig: WiredRig | None = None,
    ) -> None:  # fmt: skip
        address = None if host is None or port is None else f"{host}:{port}"
        super().__init__(robot, "udp", address, rig, _open_udp, watchdog_s, link_timeout_s, vent_s, start_timeout_s)


def _open_udp(address: str) -> Transport:
    host, _, port = address.rpartition(":")
    return UdpTransport(host, int(port), RECEIVE_S)
