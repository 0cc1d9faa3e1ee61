"""Bytes to a device and back: a serial port, or datagrams."""

import socket
from typing import Protocol

import serial

from softrl.core.errors import DriverError

DATAGRAM_BYTES = 2048
WRITE_S = 0.2  # a serial line that takes nothing for this long is stuck


class Transport(Protocol):
    """An open line."""

    def send(self, data: bytes) -> None:
        """Send, or raise DriverError if the line is dead."""
        ...

    def receive(self) -> bytes:
        """Return what has arrived, after a short wait at most; nothing is an answer. DriverError if the line is dead."""
        ...

    def close(self) -> None:
        """Close the line."""
        ...


class SerialTransport:
    """A serial port: eight bits, no parity, one stop bit.

    Parameters
    ----------
    wait_s : longest wait for a byte
    """

    def __init__(self, port: str, baud: int, wait_s: float) -> None:
        self._name = port
        try:
            # of two programs at one robot each would take half of the other's frames
            self._port = serial.Serial(port, baud, timeout=wait_s, write_timeout=WRITE_S, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise DriverError(
                f"cannot open serial port {port}: {error}; is the device plugged in, and does no other program hold it?"
            ) from error

    def send(self, data: bytes) -> None:
        """Write all of ``data``."""
        try:
            self._port.write(data)
        except (serial.SerialException, OSError) as error:
            raise DriverError(f"lost the link: serial port {self._name} takes no data: {error}") from error

    def receive(self) -> bytes:
        """Return the bytes that wait, or those that come first."""
        try:
            return self._port.read(max(self._port.in_waiting, 1))
        except (serial.SerialException, OSError, TypeError) as error:
            raise DriverError(f"lost the link: serial port {self._name} is gone: {error}") from error

    def close(self) -> None:
        """Close the port."""
        self._port.close()


class UdpTransport:
    """Datagrams to one address, one frame each."""

    def __init__(self, host: str, port: int, wait_s: float) -> None:
        self._name = f"{host}:{port}"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(wait_s)
        try:
            self._socket.connect((host, port))
        except (OSError, OverflowError) as error:  # the second for a port beyond 65535
            self._socket.close()
            raise DriverError(f"cannot reach {self._name}: {error}") from error

    def send(self, data: bytes) -> None:
        """Send one datagram."""
        try:
            self._socket.send(data)
        except OSError as error:
            raise DriverError(f"lost the link: {self._name} refuses datagrams: {error}") from error

    def receive(self) -> bytes:
        """Return the next datagram."""
        try:
            return self._socket.recv(DATAGRAM_BYTES)
        except TimeoutError:
            return b""
        except OSError as error:
            raise DriverError(f"lost the link: {self._name} refuses datagrams: {error}") from error

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
