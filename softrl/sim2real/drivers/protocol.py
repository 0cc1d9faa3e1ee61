"""The wire protocol between a driver and a device, which is a pressure regulator with its sensors: its one definition.

Frame, little endian, the same on a serial line and in a datagram::

    A5 5A | version u8 | kind u8 | length u8 | session u16 | sequence u32 | payload | crc u16

``length`` counts the payload; the CRC is CRC-16/CCITT-FALSE (polynomial 1021, start FFFF) over version .. payload. A frame
whose CRC or version is wrong is dropped; the receiver looks for the next A5 5A. Each side counts its own ``sequence``
up by at least one a frame, from 1 in each session; a frame that is not newer than the last one taken is dropped: it
came twice, or too late. Frames of another session are dropped.

From the driver:

=========  ====  ==========================  =====================================================================
kind       code  payload                     meaning
=========  ====  ==========================  =====================================================================
HELLO      01    chambers u8                 a new session begins: the device vents, answers WELCOME, then streams STATE
SETPOINT   02    chambers x i32, mPa gauge   hold these pressures; outside the device's range it is refused (flag 4)
VENT       03    none                        all chambers to 0 gauge at once; stays open for setpoints
STOP       04    none                        emergency stop: vent at once and take no setpoint until RELEASE
RELEASE    05    none                        ends an emergency stop
=========  ====  ==========================  =====================================================================

From the device:

=========  ====  ================================================================================================
WELCOME    81    chambers u8, rate of STATE in Hz u16, watchdog in ms u16, flags u16
STATE      82    clock u64 us, flags u16, sequence u32 of the last frame taken, then i32 each: setpoints (chambers)
                 mPa, measured pressures (chambers) mPa, tip x y z nm, quaternion w x y z in 1e-9, force on the tip
                 x y z uN; -2147483648 stands for what is not measured
=========  ====  ================================================================================================

Flags: 1 vented by the watchdog, 2 emergency stop, 4 a setpoint was refused. All three last until the next HELLO, the
second until RELEASE.

Watchdog: a device under pressure that has taken no SETPOINT for its watchdog time vents by itself and takes no setpoint until
the next HELLO. That time is above 0 and at most 100 ms, or a driver refuses the device. A driver repeats its setpoint on every
STATE, and three times in that time where STATE is seldom. It sends VENT before its first setpoint and once a session ends, and
from an emergency stop on STOP in place of all. Both keep the slew: after lost frames a setpoint may be far from the last one
taken, and the device then moves by no more than its own limit a frame.
"""

import binascii
import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

import numpy as np

SYNC = b"\xa5\x5a"
VERSION = 1
PRESSURE_PA, LENGTH_M, SHARE, FORCE_N = 1e-3, 1e-9, 1e-9, 1e-6
WIDEST_PA = PRESSURE_PA * np.iinfo(np.int32).max
_HEADER = struct.Struct("<BBBHI")
_CRC = struct.Struct("<H")
_WELCOME = struct.Struct("<BHHH")
_STATE = struct.Struct("<QHI")
_NOT_MEASURED = np.iinfo(np.int32).min


class Kind(IntEnum):
    """What a frame is."""

    HELLO, SETPOINT, VENT, STOP, RELEASE = 1, 2, 3, 4, 5
    WELCOME, STATE = 0x81, 0x82


class Flag(IntFlag):
    """What a device has to say beside its readings."""

    WATCHDOG, STOPPED, REFUSED = 1, 2, 4


@dataclass(frozen=True)
class Frame:
    """One message."""

    kind: int
    session: int
    sequence: int
    payload: bytes = b""

    def encode(self) -> bytes:
        """Return the bytes on the wire."""
        head = _HEADER.pack(VERSION, self.kind, len(self.payload), self.session, self.sequence)
        body = head + self.payload
        return SYNC + body + _CRC.pack(binascii.crc_hqx(body, 0xFFFF))


class Decoder:
    """Finds frames in a stream of bytes, whatever lies between them.

    Attributes
    ----------
    damaged : starts of frames that were dropped for their version or CRC
    """

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.damaged = 0

    def feed(self, received: bytes) -> list[Frame]:
        """Return the frames that are complete now."""
        self._bytes += received
        frames = []
        while (frame := self._next()) is not None:
            frames.append(frame)
        return frames

    def _next(self) -> Frame | None:
        while True:
            start = self._bytes.find(SYNC)
            # the last byte may be the first of the next frame
            del self._bytes[: start if start >= 0 else max(len(self._bytes) - 1, 0)]
            if start < 0 or len(self._bytes) < len(SYNC) + _HEADER.size:
                return None
            version, kind, length, session, sequence = _HEADER.unpack_from(self._bytes, len(SYNC))
            end = len(SYNC) + _HEADER.size + length
            if version == VERSION:
                if len(self._bytes) < end + _CRC.size:
                    return None
                body = bytes(self._bytes[len(SYNC) : end])
                if _CRC.unpack_from(self._bytes, end)[0] == binascii.crc_hqx(body, 0xFFFF):
                    del self._bytes[: end + _CRC.size]
                    return Frame(kind, session, sequence, body[_HEADER.size :])
            self.damaged += 1
            del self._bytes[:1]


@dataclass(frozen=True)
class Welcome:
    """A device's answer to HELLO."""

    chambers: int
    rate_hz: int
    watchdog_ms: int
    flags: Flag

    def encode(self) -> bytes:
        """Return the payload."""
        return _WELCOME.pack(self.chambers, self.rate_hz, self.watchdog_ms, self.flags)

    @classmethod
    def decode(cls, payload: bytes) -> "Welcome":
        """Return the content of a payload; a payload of another length is a ValueError."""
        if len(payload) != _WELCOME.size:
            raise ValueError(f"a WELCOME of {len(payload)} bytes; expected {_WELCOME.size}")
        chambers, rate_hz, watchdog_ms, flags = _WELCOME.unpack(payload)
        return cls(chambers, rate_hz, watchdog_ms, Flag(flags))


@dataclass(frozen=True)
class State:
    """A device's readings.

    Attributes
    ----------
    clock_s : of the device;  taken : sequence of the last frame that it took
    setpoint, pressure : (chambers,) Pa;  position : (3,) m;  quaternion : (4,);  tip_force : (3,) N
    """

    clock_s: float
    flags: Flag
    taken: int
    setpoint: np.ndarray
    pressure: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    tip_force: np.ndarray

    def encode(self) -> bytes:
        """Return the payload."""
        parts = (
            (self.setpoint, PRESSURE_PA), (self.pressure, PRESSURE_PA), (self.position, LENGTH_M),
            (self.quaternion, SHARE), (self.tip_force, FORCE_N),
        )  # fmt: skip
        head = _STATE.pack(round(1e6 * self.clock_s), self.flags, self.taken)
        return head + b"".join(counts(values, unit) for values, unit in parts)

    @classmethod
    def decode(cls, payload: bytes, chambers: int) -> "State":
        """Return the content of a payload; a payload of another length is a ValueError."""
        if len(payload) != _STATE.size + 4 * (2 * chambers + 10):
            raise ValueError(f"a STATE of {len(payload)} bytes does not belong to {chambers} chambers")
        clock_us, flags, taken = _STATE.unpack_from(payload)
        n, number = chambers, np.frombuffer(payload, "<i4", offset=_STATE.size)
        quaternion = values_of(number[2 * n + 3 : 2 * n + 7], SHARE)
        return cls(
            1e-6 * clock_us, Flag(flags), taken, values_of(number[:n], PRESSURE_PA),
            values_of(number[n : 2 * n], PRESSURE_PA), values_of(number[2 * n : 2 * n + 3], LENGTH_M),
            quaternion / np.sqrt(quaternion @ quaternion), values_of(number[2 * n + 7 :], FORCE_N),
        )  # fmt: skip


def counts(values: np.ndarray, unit: float) -> bytes:
    """Return values as 32-bit counts of ``unit``; what is not a number becomes "not measured"."""
    limit = np.iinfo(np.int32).max
    known = np.isfinite(values)
    rounded = np.clip(np.rint(np.where(known, values, 0.0) / unit), -limit, limit)
    return np.where(known, rounded, _NOT_MEASURED).astype("<i4").tobytes()


def values_of(number: np.ndarray, unit: float) -> np.ndarray:
    """Return the values of 32-bit counts of ``unit``."""
    # a quotient rather than a product, so that 30000000 mPa are 30000 Pa exactly
    return np.where(number == _NOT_MEASURED, np.nan, number / round(1.0 / unit))
