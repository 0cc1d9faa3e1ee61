"""Laws of the disturbance, of the bandwidth, and of sessions that break off."""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from omegaconf import OmegaConf

from softrl.core.config import build
from softrl.core.driver import Sample
from softrl.core.errors import ConfigError, DriverError
from softrl.core.simulator import Simulator
from softrl.core.tracking import NullTracker
from softrl.effects.chain import Plant, chain_of
from softrl.effects.lag import Lag
from softrl.recordings.keep import keeping
from softrl.recordings.program import recording_of
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot
from softrl.sim2real.bandwidth import Bandwidth, measure, predict, response, sweep
from softrl.sim2real.course import Course
from softrl.sim2real.disturbance import Disturbance, recovery
from softrl.sim2real.drivers.rig import Hardware, Noise, Rig, sample_of
from softrl.sim2real.identification import record_sessions
from softrl.sim2real.report import report_bandwidth, report_recovery
from softrl.sim2real.rollout import Rollout
from softrl.sim2real.stage import Config
from softrl.simulate.stage import coloured_noise
from tests.sim2real.conftest import CONF, BenchDriver

TONES = Bandwidth((0.2, 0.5, 1.0, 2.0, 4.0), 12.0, 4.0, 1, 1.0, 0.01)


def test_a_slow_valve_has_the_bandwidth_of_its_time_constant(tripod: Robot, body: Simulator, silence: Noise) -> None:
    lag = Lag(fill_s=0.16, vent_s=0.16)
    _, measured = measure(BenchDriver(tripod, body, silence, (lag,)), tripod, TONES)
    predicted = predict(tripod, Plant(body, chain_of(tripod, [lag])), TONES)
    assert measured.knee_hz == pytest.approx(predicted["predicted"].knee_hz, rel=0.05)
    low, high = 0.5 / (2 * np.pi * 0.16), 1.4 / (2 * np.pi * 0.16)
    assert low < measured.knee_hz < high, "the valve's, lowered by the body's"
    assert predicted["without_lag"].knee_hz > 1.5 * measured.knee_hz


def test_effects_of_one_name_are_left_out_together_whatever_their_order(tripod: Robot, body: Simulator) -> None:
    lags = [Lag(0.16, 0.16, chamber=0), Lag(0.08, 0.08, chamber=1)]
    without = predict(tripod, Plant(body, chain_of(tripod, [])), TONES)["predicted"]
    for order in (lags, lags[::-1]):
        found = predict(tripod, Plant(body, chain_of(tripod, order)), TONES)
        assert found["predicted"].knee_hz < 0.7 * without.knee_hz
        np.testing.assert_allclose(found["without_lag"].ratio, without.ratio)


@pytest.mark.parametrize("noise_mm", [(0.0, 0.0), (0.05, 0.0), (0.05, 0.05)])
def test_a_chamber_that_does_not_move_has_no_bandwidth(
    tripod: Robot, noise_mm: tuple[float, float], caplog: pytest.LogCaptureFixture
) -> None:
    settings, tracker = replace(TONES, cycles=2), NullTracker()
    time, _ = sweep(tripod, settings)
    for seed, height in enumerate(2 * [0.0, 0.1765]):
        rng = np.random.default_rng(seed)
        white, coloured = (1e-3 * size for size in noise_mm)
        still = [0.0, 0.0, height] + white * rng.normal(size=(len(time), 3))
        still += coloured * coloured_noise(time, still.shape, 1.0, rng)
        found = response(settings, time, still)
        assert np.isnan(found.knee_hz) and np.isnan(found.ratio).all()
    report_bandwidth(found, {}, tracker)
    assert tracker.metrics == {"bandwidth/found_share": 0.0} and "cannot be told from noise; look at the air line" in caplog.text


def test_a_bandwidth_beyond_the_last_tone_is_told_as_such(
    tripod: Robot, body: Simulator, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    slow, tracker = replace(TONES, frequencies_hz=(0.2, 0.3, 0.4)), NullTracker()
    beyond = predict(tripod, Plant(body, chain_of(tripod, [])), slow)["predicted"]
    report_bandwidth(beyond, {}, tracker)
    assert np.isinf(beyond.knee_hz) and tracker.metrics == {"bandwidth/found_share": 0.0} and "above 0.4 Hz" in caplog.text


def test_a_sweep_that_takes_longer_than_meant_is_told(
    tripod: Robot, body: Simulator, silence: Noise, caplog: pytest.LogCaptureFixture
) -> None:
    class Stretching(BenchDriver):
        def advance(self, dt_s: float) -> list[Sample]:
            return super().advance(self.share * dt_s)

    driver, told = Stretching(tripod, body, silence), {}
    for driver.share in (1.0, 1.1):
        caplog.clear()
        measure(driver, tripod, TONES)
        told[driver.share] = "the measured bandwidth is wrong" in caplog.text
    assert told == {1.0: False, 1.1: True}


def test_the_sweep_keeps_the_limits(tripod: Robot) -> None:
    _, pressure = sweep(tripod, TONES)
    assert pressure.max() <= tripod.pressure_max_pa
    assert np.abs(np.diff(pressure, axis=0)).max() <= 0.01 * tripod.slew_pa_per_s * (1 + 1e-9)
    with pytest.raises(ConfigError, match="frequencies_hz"):
        Bandwidth((1.0, 0.5, 2.0), 12.0, 4.0, 1, 1.0, 0.01)


@pytest.mark.parametrize(
    ("changed", "told"),
    [({"amplitude_kpa": 8.0}, r"amplitude_kpa=8 at 4 Hz asks for 201062 Pa/s; expected at most slew_pa_per_s=200000"),
     ({"dt_s": 0.125}, r"frequencies_hz=\[.*4.0\] at dt_s=0.125; .*below 4 Hz"),
     ({"middle_kpa": 32.0}, r"leaves the range of robot tripod, -20 to 35 kPa")],
)  # fmt: skip
def test_tones_that_the_robot_cannot_follow_are_refused(tripod: Robot, changed: dict[str, float], told: str) -> None:
    TONES.require_fit(tripod)
    with pytest.raises(ConfigError, match=told) as error:
        replace(TONES, **changed).require_fit(tripod)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("profile", ["", "tiny", "paper"])
def test_at_the_highest_tone_of_every_profile_the_slew_does_not_bind(tripod: Robot, profile: str) -> None:
    parts = [CONF / "stage/sim2real.yaml", *([CONF / f"profile/{profile}/sim2real.yaml"] if profile else [])]
    node = OmegaConf.merge(*(OmegaConf.load(part) for part in parts)).bandwidth
    tones = build(cast(dict[str, Any], OmegaConf.to_container(node)), Bandwidth, "stage.bandwidth")
    tones.require_fit(tripod)
    _, pressure = sweep(tripod, tones)
    last = np.diff(pressure[-round(1.0 / tones.frequencies_hz[-1] / tones.dt_s) :, 0])
    assert np.abs(last).max() < 0.999 * tripod.slew_pa_per_s * tones.dt_s


def test_a_line_that_is_off_vents_its_chamber_alone(tripod: Robot, body: Simulator, silence: Noise) -> None:
    rig = Rig(Hardware(body, chain_of(tripod, []), silence, 100.0, 100.0, 10.0), (0, 0))
    rig.advance(50, np.full((1, 3), 10e3))
    rig.cut(1)
    off = sample_of(rig.advance(100, np.empty((0, 3)))[0][-1]).pressure
    np.testing.assert_allclose(off, [10e3, 0.0, 10e3], atol=1.0)
    rig.cut(None)
    on = sample_of(rig.advance(100, np.empty((0, 3)))[0][-1]).pressure
    np.testing.assert_allclose(on, 10e3, atol=1.0)


def rollout_with(error_mm: list[float], samples: Recording) -> Rollout:
    target = np.zeros((len(error_mm), 3))
    reached = target + [1e-3, 0.0, 0.0] * np.array(error_mm)[:, None]
    return Rollout(samples, Course.free("line", target), reached, np.zeros(len(target)), np.zeros(len(target)))


@pytest.fixture
def recorded(tripod: Robot, body: Simulator, silence: Noise) -> Recording:
    with BenchDriver(tripod, body, silence) as driver:
        return recording_of(driver.advance(0.1), tripod, "short", "short")


def test_recovery_counts_from_the_reconnection_to_the_end_of_the_first_quiet_step(recorded: Recording) -> None:
    found = recovery(rollout_with([1, 1, 1, 9, 9, 4, 1.2, 5, 1.4, 1, 1, 1], recorded), 3, 5, 0.5)
    assert (found.before_mm, found.worst_mm) == pytest.approx((1.0, 9.0))
    assert found.back_s == pytest.approx(2.0), "a step that is near by chance does not count"
    assert found.each_s == pytest.approx(2.0) and found.near_s == pytest.approx(2.0)
    assert recovery(rollout_with([1, 1, 9, 9, 9, 9, 9], recorded), 2, 3, 0.5)[2:] == (np.inf, np.inf, np.inf)


def test_whether_a_controller_recovered_is_logged(recorded: Recording) -> None:
    cut, tracker = Disturbance("line", 0, 0.25, 1.0), NullTracker()
    back = rollout_with([1, 1, 1, 9, 9, 1, 1, 1, 1, 1, 1, 1], recorded)
    never = rollout_with([1, 1, 1, 9, 9, 9, 9, 9, 9, 9, 9, 9], recorded)
    report_recovery({"policy": back, "planned": never}, cut, 0.5, tracker)
    assert tracker.metrics["recovery/recovered_share"] == 1.0 and tracker.metrics["recovery_s"] > 0.0
    assert tracker.metrics["recovery_planned/recovered_share"] == 0.0 and "recovery_planned_s" not in tracker.metrics


def test_noise_does_not_pass_for_a_robot_that_is_not_back(recorded: Recording) -> None:
    found, cut, back = [], 40, 50
    for seed in range(200):
        rng = np.random.default_rng(seed)
        noise = np.linalg.norm(rng.normal(size=(100, 3)), axis=1)
        noise[cut:back] += 90.0
        found.append(recovery(rollout_with(list(noise), recorded), cut, back, 0.5))
    late = {name: np.mean([getattr(f, name) > 0.5 for f in found]) for name in ("back_s", "each_s")}
    assert late["back_s"] < 0.05 < 0.1 < late["each_s"], f"a robot that is back at once counts as late in {late}"


def test_a_line_that_comes_back_too_late_is_refused() -> None:
    with pytest.raises(ConfigError, match="cut_s"):
        Disturbance("circle", 0, 0.5, 5.0).steps(12, 0.5)


def test_a_line_that_comes_back_leaves_enough_to_see_a_recovery_in(recorded: Recording) -> None:
    with pytest.raises(ConfigError, match="cut_s=2 leave 2 of the course's 100 commands"):
        Disturbance("circle", 0, 0.94, 2.0).steps(100, 0.5)
    cut, back = Disturbance("circle", 0, 0.93, 2.0).steps(100, 0.5)
    found = recovery(rollout_with([1.0] * 100, recorded), cut, back, 0.5)
    assert (back, found.back_s) == (97, 0.5)


def test_what_was_recorded_before_a_lost_link_is_kept(
    tripod: Robot, body: Simulator, silence: Noise, recorded: Recording, tmp_path: Path
) -> None:
    class Folder(NullTracker):
        def text(self, name: str, content: str) -> None:
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_text(content)

    driver = BenchDriver(tripod, body, silence)
    with pytest.raises(DriverError, match="cable; 2 recordings so far are kept"):
        with keeping([recorded], driver, tripod, Folder()), driver:
            driver.command(np.full(3, 5e3))
            driver.advance(0.3)
            raise DriverError("cable")
    kept = RecordingSet.read(tmp_path / "interrupted", {})
    assert [len(r.time) for r in kept.recordings] == [10, 30]
    np.testing.assert_allclose(kept.recordings[1].position[-1], driver.samples[-1].position, atol=1e-9)


def test_a_server_that_is_gone_costs_no_recording_that_is_written_beside_it(
    tripod: Robot, body: Simulator, silence: Noise, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    class Gone(NullTracker):
        def text(self, name: str, content: str) -> None:
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_text(content)
            raise ConnectionError("no server")

    driver, runs = BenchDriver(tripod, body, silence), []
    with pytest.raises(DriverError, match="cable"), keeping(runs, driver, tripod, Gone()):
        for name in ("one", "two"):
            with driver:
                runs.append(recording_of(driver.advance(0.1), tripod, name, name))
        raise DriverError("cable")
    assert [run.name for run in RecordingSet.read(tmp_path / "interrupted", {}).recordings] == ["one", "two"]
    assert "not in the run: no server" in caplog.text


def test_the_robot_is_vented_while_a_session_is_looked_at(
    tripod: Robot, body: Simulator, silence: Noise, config: Config
) -> None:
    driver = BenchDriver(tripod, body, silence)
    sessions = record_sessions(driver, tripod, config.identification, np.random.default_rng(0))
    assert [driver.connected for _ in sessions] == [False] * config.identification.sessions
