"""Laws of the wire: what arrives is what was sent, or nothing; and what a device does with it."""

from collections.abc import Iterator

import numpy as np
import pytest

from softrl.core.simulator import Simulator
from softrl.effects.chain import chain_of
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.protocol import PRESSURE_PA, Decoder, Flag, Frame, Kind, State, Welcome, counts
from softrl.sim2real.drivers.regulator import Regulator
from softrl.sim2real.drivers.rig import Hardware, Noise

FRAME = Frame(Kind.SETPOINT, 7, 41, counts(np.array([20e3, -5e3, 1e3]), PRESSURE_PA))
LEVEL = np.array([20e3, 10e3, -5e3])
WATCHDOG_S = 0.08


def test_a_state_arrives_as_it_was_sent() -> None:
    rng = np.random.default_rng(0)
    quaternion = rng.normal(size=4)
    state = State(
        12.345678, Flag.WATCHDOG, 99, rng.uniform(-2e4, 3.5e4, 3), rng.uniform(-2e4, 3.5e4, 3),
        rng.uniform(-0.5, 0.5, 3), quaternion / np.linalg.norm(quaternion), np.full(3, np.nan),
    )  # fmt: skip
    again = State.decode(state.encode(), 3)
    assert (again.clock_s, again.flags, again.taken) == (pytest.approx(12.345678), Flag.WATCHDOG, 99)
    np.testing.assert_allclose(again.setpoint, state.setpoint, atol=0.5e-3)
    np.testing.assert_allclose(again.position, state.position, atol=0.5e-9)
    np.testing.assert_allclose(again.quaternion, state.quaternion, atol=1e-9)
    assert np.isnan(again.tip_force).all(), "what is not measured stays not measured"


@pytest.mark.parametrize("length", [0, 6, 8])
def test_a_welcome_of_another_length_is_refused(length: int) -> None:
    with pytest.raises(ValueError, match=f"a WELCOME of {length} bytes; expected 7"):
        Welcome.decode(bytes(length))


def test_every_single_flipped_bit_is_noticed_and_the_next_frame_is_found() -> None:
    good, follower = FRAME.encode(), Frame(Kind.VENT, 7, 42).encode()
    for bit in range(8 * len(good)):
        damaged = bytearray(good)
        damaged[bit // 8] ^= 1 << bit % 8
        decoder = Decoder()
        # a damaged length makes the decoder wait for more, so several frames follow
        found = decoder.feed(bytes(damaged) + follower * 30)
        assert all(frame.kind == Kind.VENT for frame in found), f"bit {bit}"
        assert len(found) > 0, f"bit {bit}"


def test_frames_are_found_in_noise_and_in_pieces() -> None:
    rng = np.random.default_rng(1)
    stream, sent = b"", []
    for number in range(50):
        frame = Frame(Kind.SETPOINT, 3, number + 1, rng.bytes(12))
        sent.append(frame)
        stream += rng.bytes(rng.integers(0, 30)).replace(b"\xa5", b"\x00") + frame.encode()
    decoder = Decoder()
    found = [frame for k in range(0, len(stream), 7) for frame in decoder.feed(stream[k : k + 7])]
    assert found == sent


class Bench:
    """A device without a wire; ``tick`` returns its STATEs."""

    def __init__(self, robot: Robot, body: Simulator, noise: Noise) -> None:
        hardware = Hardware(body, chain_of(robot, []), noise, 100.0, 100.0, WATCHDOG_S)
        self.device, self.number, self.session = Regulator(hardware, 0), 0, 5
        answer = self.send(Kind.HELLO, b"\x03")
        assert answer is not None
        self.welcome = Welcome.decode(Decoder().feed(answer)[0].payload)

    def send(self, kind: Kind, payload: bytes = b"", number: int | None = None) -> bytes | None:
        self.number += 1
        return self.device.take(Frame(kind, self.session, self.number if number is None else number, payload))

    def set(self, level: np.ndarray, number: int | None = None) -> None:
        self.send(Kind.SETPOINT, counts(level, PRESSURE_PA), number)

    def reach(self, level: np.ndarray) -> State:
        """Return the state after enough commands to get there at the slew limit."""
        for _ in range(12):
            self.set(level)
            state = self.tick()[0]
        return state

    def tick(self, count: int = 1) -> list[State]:
        return list(self._states(count))

    def _states(self, count: int) -> Iterator[State]:
        for _ in range(count):
            data = self.device.tick()
            if data is not None:
                yield State.decode(Decoder().feed(data)[0].payload, 3)


@pytest.fixture
def bench(tripod: Robot, body: Simulator, silence: Noise) -> Bench:
    return Bench(tripod, body, silence)


def test_it_vents_within_100_ms_of_the_last_command(bench: Bench) -> None:
    assert bench.welcome.watchdog_ms < 100
    last = bench.reach(LEVEL)
    np.testing.assert_array_equal(last.setpoint, LEVEL)
    silent = bench.tick(20)
    vented = next(state for state in silent if not state.setpoint.any())
    assert vented.clock_s - last.clock_s <= 0.1
    assert vented.flags & Flag.WATCHDOG
    bench.set(LEVEL)
    assert not bench.tick()[0].setpoint.any(), "a setpoint that comes too late does not fill it again"


def test_a_device_at_zero_needs_no_command(bench: Bench) -> None:
    assert not bench.tick(50)[-1].flags


def test_what_is_repeated_late_or_foreign_is_not_obeyed(bench: Bench) -> None:
    first = bench.number + 1
    assert bench.reach(0.5 * LEVEL).taken == bench.number
    bench.set(LEVEL, number=first)
    bench.set(LEVEL, number=first + 1)
    bench.session = 6
    bench.set(LEVEL, number=first + 99)
    np.testing.assert_array_equal(bench.tick()[0].setpoint, 0.5 * LEVEL)


def test_a_far_setpoint_is_approached_at_the_slew_limit(bench: Bench, tripod: Robot) -> None:
    reached = []
    for _ in range(12):
        bench.set(LEVEL)
        reached.append(bench.tick()[0].setpoint[0])
    assert np.diff(reached, prepend=0.0).max() <= 0.01 * tripod.slew_pa_per_s * (1 + 1e-9)
    assert reached[-1] == LEVEL[0]


def test_an_emergency_stop_lasts_over_sessions_until_it_is_released(bench: Bench) -> None:
    bench.set(LEVEL)
    bench.tick()
    bench.send(Kind.STOP)
    bench.set(LEVEL)
    state = bench.tick()[0]
    assert state.flags & Flag.STOPPED and not state.setpoint.any()
    bench.session = 9
    bench.send(Kind.HELLO, b"\x03")
    bench.set(LEVEL)
    assert not bench.tick()[0].setpoint.any()
    bench.send(Kind.RELEASE)
    np.testing.assert_array_equal(bench.reach(LEVEL).setpoint, LEVEL)


@pytest.mark.parametrize("payload", [b"", counts(np.full(3, 36e3), PRESSURE_PA), counts(np.full(3, np.nan), 1.0)])
def test_impossible_setpoints_are_refused_and_told(bench: Bench, payload: bytes) -> None:
    bench.send(Kind.SETPOINT, payload)
    state = bench.tick()[0]
    assert state.flags & Flag.REFUSED and not state.setpoint.any()
