"""A device that does not measure everything, or not always: its sessions are recorded, and followed while the tip is seen."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.core.driver import Sample
from softrl.core.errors import ArtifactError, DriverError
from softrl.core.simulator import Simulator
from softrl.core.tracking import NullTracker
from softrl.effects.chain import chain_of
from softrl.recordings.keep import keeping
from softrl.recordings.program import recording_of
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot
from softrl.sim2real import stage
from softrl.sim2real.course import Course
from softrl.sim2real.drivers.rig import Noise
from softrl.sim2real.rollout import Pace, Rollout, follow
from tests.sim2real.conftest import BenchDriver

PERIOD_S = 0.1
NOTHING = np.full(3, np.nan)


class Blinking(BenchDriver):
    """A bench whose camera sees nothing at some times, with neither pressure gauge nor orientation."""

    blind: Callable[[float], bool] = staticmethod(lambda time_s: False)

    def advance(self, dt_s: float) -> list[Sample]:
        def seen(sample: Sample) -> Sample:
            position = NOTHING if self.blind(sample.time_s) else sample.position
            return replace(sample, pressure=NOTHING, quaternion=np.full(4, np.nan), position=position)

        arrived = [seen(sample) for sample in super().advance(dt_s)]
        self.samples[len(self.samples) - len(arrived) :] = arrived
        return arrived


class Asked:
    """A controller that sends one pressure and remembers what it was shown."""

    def __init__(self) -> None:
        self.shown: list[np.ndarray] = []

    def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
        self.shown.append(position)
        return np.full(3, 10e3)


class Folder(NullTracker):
    """Texts in a folder, as a run stores them."""

    def __init__(self, place: Path) -> None:
        super().__init__()
        self.place = place

    def text(self, name: str, content: str) -> None:
        (self.place / name).parent.mkdir(exist_ok=True)
        (self.place / name).write_text(content)


@pytest.fixture
def driver(tripod: Robot, body: Simulator, silence: Noise) -> Blinking:
    return Blinking(tripod, body, silence)


def led(driver: Blinking, controller: Asked) -> Rollout:
    course = Course.free("still", np.zeros((5, 3)))
    return follow(driver, driver.robot, controller, course, Pace(PERIOD_S, 1, 1), "still", "still")


def test_a_decision_rests_on_the_last_sample_that_shows_the_tip(driver: Blinking) -> None:
    driver.blind = lambda time_s: round(100 * time_s) % 10 == 0  # just the one before each command
    controller = Asked()
    rollout = led(driver, controller)
    assert np.isfinite(controller.shown).all() and np.isfinite(rollout.reached).all()
    np.testing.assert_array_equal(controller.shown[-1], driver.samples[-12].position)
    recording = rollout.recording
    assert recording.pressure_meas is None and recording.quaternion is None
    assert len(recording.time) == len(driver.samples) - 7
    RecordingSet("tripod", (recording,)).validate()


@pytest.mark.parametrize("since_s", [0.0, 0.3])
def test_a_tip_that_stays_out_of_sight_ends_the_session(driver: Blinking, tmp_path: Path, since_s: float) -> None:
    driver.blind = lambda time_s: time_s > since_s
    with pytest.raises(DriverError, match=r"no position for more than 0.2 s.*kept in interrupted/"):
        with keeping([], driver, driver.robot, Folder(tmp_path)):
            led(driver, Asked())
    assert not driver.connected
    assert driver.samples[-1].time_s < since_s + 0.4
    kept = RecordingSet.read(tmp_path / "interrupted", {}).recordings
    assert len(kept) == 1
    if since_s > 0.0:
        assert kept[0].position is not None and kept[0].time[-1] == pytest.approx(since_s)


class Frozen(BenchDriver):
    """A bench whose camera goes on telling what it saw at ``since_s``."""

    since_s = np.inf

    def advance(self, dt_s: float) -> list[Sample]:
        before = [sample for sample in self.samples if sample.time_s <= self.since_s]
        arrived = super().advance(dt_s)
        if arrived[0].time_s > self.since_s:
            arrived = [replace(sample, position=before[-1].position) for sample in arrived]
            self.samples[len(self.samples) - len(arrived) :] = arrived
        return arrived


class Swinging:
    """A controller that sends more and less of ``size_pa``, or always as much."""

    def __init__(self, size_pa: float) -> None:
        self.size_pa = size_pa

    def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
        return np.full(3, 10e3 + self.size_pa * (step % 2))


@pytest.mark.parametrize(("since_s", "size_pa", "told"), [(1.5, 5e3, True), (np.inf, 5e3, False), (1.5, 0.0, False)])
def test_a_camera_that_stands_still_while_commands_move_ends_the_session(
    tripod: Robot, body: Simulator, silence: Noise, since_s: float, size_pa: float, told: bool
) -> None:
    driver, course = Frozen(tripod, body, silence), Course.free("swing", np.zeros((40, 3)))
    driver.since_s = since_s
    with pytest.raises(DriverError, match="at the very same place for 1 s") if told else nullcontext():
        follow(driver, tripod, Swinging(size_pa), course, Pace(PERIOD_S, 1, 1), "swing", "swing")
    assert not driver.connected
    assert driver.samples[-1].time_s == pytest.approx(2.6 if told else 4.2, abs=0.15)


def test_a_finished_run_is_kept_once_even_without_positions(driver: Blinking, tmp_path: Path) -> None:
    driver.blind = lambda time_s: True
    with driver:
        finished = recording_of(driver.advance(0.2), driver.robot, "done", "done")
        driver.advance(0.1)
    with pytest.raises(KeyboardInterrupt), keeping([finished], driver, driver.robot, Folder(tmp_path)):
        raise KeyboardInterrupt
    assert [run.name for run in RecordingSet.read(tmp_path / "interrupted", {}).recordings] == ["done"]


def test_what_fails_the_last_check_is_kept(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, driver: Blinking, config: stage.Config, tripod: Robot,
    body: Simulator, policy: Policy, surrogate: Surrogate, calibration: Calibration,
) -> None:  # fmt: skip
    with driver:
        sound = recording_of(driver.advance(0.2), tripod, "identification_1", "identification_1")
    unfit = replace(sound, position=np.full_like(sound.position, np.inf))

    def identify(*arguments: Any) -> None:
        recordings: list[Recording] = arguments[3]
        recordings.append(unfit)

    monkeypatch.setattr(stage, "courses", lambda task, space: iter(()))
    monkeypatch.setattr(stage, "_disturb", lambda *arguments: None)
    monkeypatch.setattr(stage, "_sweep", lambda *arguments: None)
    monkeypatch.setattr(stage, "_identify", identify)
    with pytest.raises(ArtifactError, match="not finite"):
        stage.run(
            config, tripod, policy, surrogate, calibration, body, chain_of(tripod, []), driver, tracker=Folder(tmp_path)
        )
    assert (tmp_path / "interrupted" / "identification_1.csv").is_file()
