"""One session between a driver and a device: its frames, counted both ways, and what the device has not taken yet."""

import secrets
import time
from collections import deque

from softrl.core.errors import DriverError
from softrl.sim2real.drivers.protocol import Decoder, Frame, Kind, Welcome
from softrl.sim2real.drivers.transport import Transport

HELLO_EVERY_S = 0.2
FOREIGN = "driver and device do not speak the same protocol"


class Session:
    """The driver's end of an open line.

    Attributes
    ----------
    sent : sequence of the last frame that was sent;  sent_s : real time of that
    heard : sequence of the last frame from the device that counted
    """

    def __init__(self, transport: Transport) -> None:
        self._transport, self._decoder = transport, Decoder()
        self._number = secrets.randbelow(1 << 16)
        self._pending: deque[tuple[int, float]] = deque()
        self.sent = self.heard = 0
        self.sent_s = time.monotonic()

    @property
    def damaged(self) -> int:
        """Number of frames that arrived damaged."""
        return self._decoder.damaged

    def hello(self, chambers: int, timeout_s: float) -> Welcome:
        """Begin, and return the device's answer.

        Raises
        ------
        DriverError
            If no device of this protocol answers within ``timeout_s``.
        """
        give_up = time.monotonic() + timeout_s
        while time.monotonic() < give_up:
            self.send(Kind.HELLO, bytes([chambers]))
            again = time.monotonic() + HELLO_EVERY_S
            while time.monotonic() < again:
                for frame in self.receive():
                    if frame.kind == Kind.WELCOME:
                        self.heard = frame.sequence
                        self._pending.clear()
                        return _welcome(frame)
        raise DriverError(
            f"no device answered within {timeout_s:g} s; is it on, and does it speak softrl's protocol?"
        )

    def send(self, kind: Kind, payload: bytes = b"") -> None:
        """Send one frame, or raise DriverError if the line is dead."""
        self.sent, self.sent_s = self.sent + 1, time.monotonic()
        self._pending.append((self.sent, self.sent_s))
        self._transport.send(Frame(kind, self._number, self.sent, payload).encode())

    def receive(self) -> list[Frame]:
        """Return the frames of this session that have arrived, after a short wait at most."""
        return [frame for frame in self._decoder.feed(self._transport.receive()) if frame.session == self._number]

    def took(self, sequence: int) -> None:
        """Note that the device has taken the frames up to ``sequence``."""
        while self._pending and self._pending[0][0] <= sequence:
            self._pending.popleft()

    def unheard_s(self) -> float:
        """Return the real time since the first frame was sent that the device has not taken."""
        return time.monotonic() - self._pending[0][1] if self._pending else 0.0

    def close(self) -> None:
        """Close the line."""
        self._transport.close()


def _welcome(frame: Frame) -> Welcome:
    try:
        return Welcome.decode(frame.payload)
    except ValueError as error:
        raise DriverError(f"{error}: {FOREIGN}") from error
