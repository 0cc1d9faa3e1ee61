"""Faults of the link: on a line that misbehaves on purpose, and on real ones whose far end dies, hangs or stays silent."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from softrl.core.errors import ConfigError, DriverError
from softrl.core.simulator import Simulator
from softrl.effects.chain import chain_of
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.ports import SerialDriver, UdpDriver
from softrl.sim2real.drivers.protocol import PRESSURE_PA, Decoder, Flag, Frame, Kind, State, Welcome, counts
from softrl.sim2real.drivers.regulator import PtyEnd, Regulator, WiredRig
from softrl.sim2real.drivers.rig import Hardware, Noise
from softrl.sim2real.drivers.transport import SerialTransport, Transport, UdpTransport
from tests.sim2real.line import LEVEL, Line, Spoil, driver_on, silent


def test_a_clean_line_loses_nothing(line: Line, tripod: Robot) -> None:
    with driver_on(line, tripod) as driver:
        driver.command(LEVEL)
        driver.advance(0.5)
        np.testing.assert_array_equal(driver.samples[-1].commanded, LEVEL)
    clock = np.array([sample.time_s for sample in driver.samples])
    np.testing.assert_allclose(np.diff(clock), 0.01, atol=1e-9)
    assert not driver.samples[-1].commanded.any() and driver.dropped == 0


class SlowLine(Line):
    """A line whose samples are far enough apart that a caller in the same process is prompt."""

    def receive(self) -> bytes:
        time.sleep(0.01)
        return super().receive()


@pytest.mark.parametrize("rate_hz", [20.0, 30.0])
def test_a_program_takes_as_long_as_it_says_though_samples_are_seldom(
    tripod: Robot, body: Simulator, silence: Noise, rate_hz: float
) -> None:
    line = SlowLine(Regulator(Hardware(body, chain_of(tripod, []), silence, rate_hz, rate_hz, 0.08), 0))
    with driver_on(line, tripod, link_timeout_s=5.0) as driver:
        began_s = driver.samples[-1].time_s
        for _ in range(100):
            driver.command(LEVEL)
            driver.advance(0.01)
        took_s = driver.samples[-1].time_s - began_s
    assert took_s == pytest.approx(1.0, abs=2.0 / rate_hz)


def spoilers(rng: np.random.Generator) -> dict[str, Spoil]:
    held: list[bytes] = []

    def reorder(pieces: list[bytes]) -> list[bytes]:
        held.extend(pieces)
        if len(held) < 3:
            return []
        out = [held[k] for k in rng.permutation(len(held))]
        held.clear()
        return out

    def corrupt(pieces: list[bytes]) -> list[bytes]:
        return [bytes([p[0] ^ (rng.random() < 0.3), *p[1:]]) for p in pieces]

    return {
        "dropped": lambda pieces: [p for p in pieces if rng.random() > 0.3],
        "repeated": lambda pieces: [p for p in pieces for _ in range(rng.integers(1, 4))],
        "reordered": reorder,
        "corrupted": corrupt,
    }


@pytest.mark.parametrize("fault", ["dropped", "repeated", "reordered", "corrupted"])
def test_a_bad_line_delays_but_never_deceives(line: Line, tripod: Robot, fault: str) -> None:
    with driver_on(line, tripod, link_timeout_s=5.0) as driver:
        line.up, line.down = (spoilers(np.random.default_rng(seed))[fault] for seed in (0, 1))
        driver.command(LEVEL)
        driver.advance(1.0)
        line.up = line.down = list
        acted = np.stack([state.setpoint for state in line.states])
    clock = [sample.time_s for sample in driver.samples]
    assert (np.diff(clock) > 0.0).all()
    moves = np.diff(acted, axis=0) * np.sign(LEVEL)
    assert moves.min() >= 0.0, "never back to an older setpoint"
    assert moves.max() <= 0.01 * tripod.slew_pa_per_s * (1 + 1e-9)
    np.testing.assert_array_equal(acted[-1], LEVEL)


@pytest.mark.parametrize(("way", "told"), [("down", "no fresh sample"), ("up", "watchdog|has taken nothing")])
def test_a_line_that_is_cut_one_way_ends_in_a_vented_robot(line: Line, tripod: Robot, way: str, told: str) -> None:
    with pytest.raises(DriverError, match=told) as error, driver_on(line, tripod) as driver:
        driver.command(LEVEL)
        driver.advance(0.3)
        before = len(driver.samples)
        cut = len(line.states)
        setattr(line, way, silent)
        driver.advance(5.0)
    assert "\n" not in str(error.value)
    assert len(driver.samples) >= before, "what had arrived is kept"
    assert not line.states[-1].setpoint.any()
    if way == "up":
        under_pressure = [s.clock_s for s in line.states[cut:] if s.setpoint.any()]
        assert under_pressure[-1] - line.states[cut - 1].clock_s <= 0.1


def test_frozen_readings_are_not_taken_for_fresh_ones(line: Line, tripod: Robot) -> None:
    with pytest.raises(DriverError, match="no fresh sample"), driver_on(line, tripod) as driver:
        driver.command(LEVEL)
        driver.advance(0.2)
        last = line.down
        frozen: list[bytes] = []
        line.down = lambda pieces: (frozen.extend(pieces), last(frozen[:1]))[1]
        driver.advance(5.0)


def test_another_robot_is_refused(line: Line, tripod: Robot) -> None:
    finger = Robot(**{**vars(tripod), "name": "finger", "chamber_angle_deg": (0.0,)})
    with pytest.raises(DriverError, match="3 chambers"), driver_on(line, finger):
        pass


def test_pressures_that_no_frame_holds_are_refused(line: Line, tripod: Robot) -> None:
    hydraulic = replace(tripod, pressure_max_pa=5e6)
    with pytest.raises(DriverError, match=r"up to 5e\+06 Pa; expected at most 2.14748e\+06 Pa"), driver_on(line, hydraulic):
        pass


@pytest.mark.parametrize(
    ("rate_hz", "watchdog_ms", "told"),
    [(100, 0, "watchdog is 0 ms; expected above 0 and at most 100"), (100, 101, "watchdog is 101 ms"),
     (0, 80, "sends 0 samples a second; expected 1 or more")],
)  # fmt: skip
def test_a_device_that_would_not_vent_by_itself_is_refused(
    line: Line, tripod: Robot, rate_hz: int, watchdog_ms: int, told: str
) -> None:
    def boast(pieces: list[bytes]) -> list[bytes]:
        frames = [frame for piece in pieces for frame in Decoder().feed(piece)]
        welcome = Welcome(3, rate_hz, watchdog_ms, Flag(0)).encode()
        answers = [replace(frame, payload=welcome) if frame.kind == Kind.WELCOME else frame for frame in frames]
        return [frame.encode() for frame in answers]

    line.down = boast
    with pytest.raises(DriverError, match=told) as error, driver_on(line, tripod):
        pass
    assert "\n" not in str(error.value)


def test_a_device_that_answers_in_another_protocol_is_told_in_one_line(line: Line, tripod: Robot) -> None:
    def cut_short(pieces: list[bytes]) -> list[bytes]:
        frames = [frame for piece in pieces for frame in Decoder().feed(piece)]
        return [replace(frame, payload=frame.payload[:5]).encode() for frame in frames]

    line.down = cut_short
    with pytest.raises(DriverError, match="a WELCOME of 5 bytes; expected 7: driver and device") as error:
        with driver_on(line, tripod):
            pass
    assert "\n" not in str(error.value)


def test_a_session_that_ends_vents_at_once_though_its_first_frame_is_lost(line: Line, tripod: Robot) -> None:
    lost: list[bytes] = []

    def lose_the_first_vent(pieces: list[bytes]) -> list[bytes]:
        vents = [piece for piece in pieces if Decoder().feed(piece)[0].kind == Kind.VENT]
        if vents and not lost:
            lost.extend(vents)
            return []
        return pieces

    with driver_on(line, tripod) as driver:
        driver.command(LEVEL)
        driver.advance(0.3)
        line.up = lose_the_first_vent
        before = len(line.states)
    assert lost
    fallen = [state.setpoint[0] for state in line.states[before:] if 0.0 < state.setpoint[0] < LEVEL[0]]
    assert not fallen, f"it fell at the slew: {fallen} Pa"
    assert not line.states[-1].setpoint.any()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("error", [RuntimeError, SystemExit])
def test_whatever_ends_the_thread_is_told(line: Line, tripod: Robot, error: type[BaseException]) -> None:
    def break_down(pieces: list[bytes]) -> list[bytes]:
        raise error("odd")

    told: list[BaseException] = []

    def use() -> None:
        try:
            with driver_on(line, tripod) as driver:
                driver.command(LEVEL)
                driver.advance(0.2)
                line.down = break_down
                driver.advance(60.0)
        except DriverError as found:
            told.append(found)

    user = threading.Thread(target=use, daemon=True)
    user.start()
    user.join(10.0)
    assert not user.is_alive(), "it waits for ever"
    assert len(told) == 1 and "lost the link" in str(told[0])
    assert not line.device.tick() or not line.device._setpoint.sent.any()


@pytest.fixture(scope="module")
def rig(tripod: Robot, body: Simulator, silence: Noise) -> WiredRig:
    return WiredRig(tripod, body, {}, silence, 100.0, 100.0, 0.08, 1.0, 120.0, 0)


@pytest.fixture(scope="module", params=["serial", "udp"])
def driver(request: pytest.FixtureRequest, tripod: Robot, rig: WiredRig) -> Iterator[SerialDriver | UdpDriver]:
    """Return a driver over a real transport, its rig in another process; a rig that a test kills is started anew."""
    common = {"watchdog_s": 1e3, "link_timeout_s": 1.0, "vent_s": 0.1, "start_timeout_s": 120.0, "rig": rig}
    made = (
        SerialDriver(tripod, None, 460800, **common)
        if request.param == "serial"
        else UdpDriver(tripod, None, None, **common)
    )
    yield made
    if made.far_end is not None:
        made.far_end.close()


def fill_and_signal(driver: SerialDriver | UdpDriver, sign: signal.Signals) -> str:
    """Return the error of a session in which the rig gets a signal while the robot is under pressure."""
    kept = 0
    with pytest.raises(DriverError) as error, driver:
        driver.command(LEVEL)
        driver.advance(0.2)
        kept = len(driver.samples)
        assert driver.far_end is not None and driver.far_end.process.pid is not None
        os.kill(driver.far_end.process.pid, sign)
        driver.advance(60.0)
    assert len(driver.samples) >= kept > 10, f"what had arrived is kept: {error.value}"
    return str(error.value)


def test_a_rig_that_hangs_is_told_and_comes_back_vented(driver: SerialDriver | UdpDriver) -> None:
    told = fill_and_signal(driver, signal.SIGSTOP)
    assert "lost the link" in told and "\n" not in told
    assert driver.far_end is not None and driver.far_end.process.pid is not None
    os.kill(driver.far_end.process.pid, signal.SIGCONT)
    with driver:
        assert not driver.advance(0.1)[-1].commanded.any()


def test_a_device_whose_driver_falls_silent_vents_itself(driver: SerialDriver | UdpDriver) -> None:
    with driver:
        pass
    assert driver.far_end is not None
    address, decoder = driver.far_end.address, Decoder()
    states: list[State] = []
    transport: Transport
    if isinstance(driver, SerialDriver):
        transport = SerialTransport(address, 460800, 0.01)
    else:
        host, port = address.split(":")
        assert host == "127.0.0.1", "nobody outside this machine may reach it"
        transport = UdpTransport(host, int(port), 0.01)

    def listen() -> None:
        for frame in decoder.feed(transport.receive()):
            if frame.kind == Kind.STATE and frame.session == 77:
                states.append(State.decode(frame.payload, 3))

    number, give_up = 1, time.monotonic() + 60.0
    transport.send(Frame(Kind.HELLO, 77, number, b"\x03").encode())
    while not (states and states[-1].setpoint.any()) and time.monotonic() < give_up:
        if states:
            number += 1
            transport.send(Frame(Kind.SETPOINT, 77, number, counts(LEVEL, PRESSURE_PA)).encode())
        listen()
    while states[-1].setpoint.any() and time.monotonic() < give_up:
        listen()
    transport.close()
    taken = max(state.taken for state in states)
    last = next(state.clock_s for state in states if state.taken == taken)
    assert states[-1].clock_s - last <= 0.1, "by the device's own clock"


def test_a_rig_that_dies_is_told(driver: SerialDriver | UdpDriver) -> None:
    told = fill_and_signal(driver, signal.SIGKILL)
    assert "lost the link" in told and "\n" not in told


def test_an_address_or_a_rig_not_both(tripod: Robot, rig: WiredRig) -> None:
    with pytest.raises(ConfigError, match="one of the two"):
        SerialDriver(tripod, None, 460800, 1.0, 0.1, 0.1, 1.0)
    with pytest.raises(DriverError, match="cannot open serial port /dev/nothing"), SerialDriver(
        tripod, "/dev/nothing", 460800, 1.0, 0.1, 0.1, 1.0
    ):
        pass


def test_a_serial_port_is_for_one_program_alone() -> None:
    end = PtyEnd()
    first = SerialTransport(end.address, 460800, 0.01)
    with pytest.raises(DriverError, match="does no other program hold it"):
        SerialTransport(end.address, 460800, 0.01)
    first.close()
    SerialTransport(end.address, 460800, 0.01).close()


@pytest.mark.parametrize("port", [-1, 99999])
def test_a_port_that_cannot_be_is_told_in_one_line(tripod: Robot, port: int) -> None:
    driver = UdpDriver(tripod, "127.0.0.1", port, 1.0, 0.1, 0.1, 1.0)
    with pytest.raises(DriverError, match=f"cannot reach 127.0.0.1:{port}: .*0-65535"), driver:
        pass
