"""A line to a device in the same process, which misbehaves on purpose."""

import time
from collections.abc import Callable

import numpy as np

from softrl.robots.robot import Robot
from softrl.sim2real.drivers.protocol import Decoder, Kind, State
from softrl.sim2real.drivers.regulator import Regulator
from softrl.sim2real.drivers.transport import Transport
from softrl.sim2real.drivers.wire import WireDriver

LEVEL = np.array([20e3, 10e3, -5e3])
Spoil = Callable[[list[bytes]], list[bytes]]


class Line:
    """A line to a device in the same process; ``up`` and ``down`` spoil what goes to it and what comes back.

    The device lives one period with each look at the line.
    """

    def __init__(self, device: Regulator) -> None:
        self.device, self.decoder = device, Decoder()
        self.up: Spoil = list
        self.down: Spoil = list
        self.states: list[State] = []

    def send(self, data: bytes) -> None:
        for piece in self.up([data]):
            for frame in self.decoder.feed(piece):
                answer = self.device.take(frame)
                self.answers = [answer] if answer else []

    def receive(self) -> bytes:
        time.sleep(0.001)
        data, self.answers = self.answers, []
        state = self.device.tick()
        if state is not None:
            self.states.append(State.decode(Decoder().feed(state)[0].payload, 3))
            data.append(state)
        return b"".join(self.down(data))

    def close(self) -> None:
        pass


def driver_on(line: Transport, robot: Robot, link_timeout_s: float = 0.3) -> WireDriver:
    return WireDriver(robot, lambda: line, 1e3, link_timeout_s, 0.1, 10.0)


def silent(pieces: list[bytes]) -> list[bytes]:
    return []


def loses(*kinds: Kind) -> Spoil:
    """Return a spoiler that loses all frames of these kinds."""
    return lambda pieces: [piece for piece in pieces if Decoder().feed(piece)[0].kind not in kinds]
