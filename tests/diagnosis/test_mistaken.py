"""Columns that cannot be what they are called are told in one line with the evidence; robots that only differ are not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from softrl.effects.chain import Plant, chain_of
from softrl.effects.library import effect_class
from softrl.effects.replay import replay
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.check import check_run
from softrl.recordings.mistaken import mistaken
from softrl.recordings.recording import Recording
from tests.diagnosis.conftest import made

Spoil = Callable[[Recording], Recording]
HIDDEN = (
    effect_class("lag")(fill_s=0.2, vent_s=0.4),
    effect_class("hysteresis")(height=0.1, yield_strain=0.02),
    effect_class("payload")(mass=0.1),
)


def moved(r: Recording, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    assert r.position is not None
    return replace(r, position=change(r.position))


def columns(values: np.ndarray, order: list[int]) -> np.ndarray:
    return values[:, order]


def measured(r: Recording, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    assert r.pressure_meas is not None
    return replace(r, pressure_meas=change(r.pressure_meas))


def chambers_exchanged(r: Recording) -> Recording:
    assert r.pressure_meas is not None
    order = [1, 0, 2]
    return replace(r, pressure_cmd=r.pressure_cmd[:, order], pressure_meas=r.pressure_meas[:, order])


def measured_for_commanded(r: Recording) -> Recording:
    assert r.pressure_meas is not None
    return replace(r, pressure_cmd=r.pressure_meas, pressure_meas=r.pressure_cmd)


def early(r: Recording) -> Recording:
    return moved(r, lambda tip: np.vstack([tip[30:], np.tile(tip[-1], (30, 1))]))


@pytest.fixture(scope="module")
def recorded(body: PccSimulator) -> tuple[Recording, ...]:
    return made(body, HIDDEN, sessions=3, measured=True).recordings


def told(body: PccSimulator, runs: tuple[Recording, ...]) -> str | None:
    plant = Plant(body, chain_of(body.robot, ()))
    return mistaken(runs, [replay(plant, run, 0.01) for run in runs], body.robot)


@pytest.mark.parametrize(
    ("spoil", "evidence"),
    [
        (chambers_exchanged, "mirror image"),
        (measured_for_commanded, "comes before its command"),
        (early, "the motion comes before"),
        (lambda r: measured(r, lambda p: columns(p, [1, 0, 2])), "follows the command of chamber"),
        (lambda r: measured(r, lambda p: p / 6.895), "a wrong unit"),
        (lambda r: measured(r, lambda p: 6.895 * p), "a wrong unit"),
        (lambda r: measured(r, lambda p: p * [1.0, 0.01, 1.0]), "chamber 2 follows its command but is 0.00"),
        (lambda r: moved(r, lambda tip: columns(tip, [1, 0, 2])), "mirror image"),
        (lambda r: moved(r, lambda tip: columns(tip, [2, 1, 0])), "mirror image"),
        (lambda r: moved(r, lambda tip: tip * [1.0, 1.0, -1.0]), "mirror image"),
        (lambda r: moved(r, lambda tip: 0.1 * tip), "another unit"),
    ],
)
def test_a_mistaken_column_is_told(
    body: PccSimulator, recorded: tuple[Recording, ...], spoil: Spoil, evidence: str
) -> None:
    said = told(body, tuple(spoil(run) for run in recorded))
    assert said is not None and evidence in said


def test_one_exchanged_run_among_sound_ones_is_told(body: PccSimulator, recorded: tuple[Recording, ...]) -> None:
    said = told(body, (*recorded[:2], chambers_exchanged(recorded[2])))
    assert said is not None and recorded[2].name in said


def test_chambers_in_a_ring_behind_slow_regulators_are_not_exchanged(body: PccSimulator) -> None:
    """A third of a turn apart, each is behind its own command by about as much as the next one's is."""
    slow, time = (effect_class("dead_time")(delay_s=0.2), effect_class("lag")(fill_s=0.3, vent_s=0.5)), 0.02 * np.arange(1500)
    rounds = 1.0 + np.cos(np.pi * time[:, None] - np.deg2rad([0.0, 120.0, 240.0]))
    run = Recording("ring", "day", time, 0.4 * body.robot.pressure_max_pa * rounds * np.minimum(time, 1.0)[:, None])
    ring = replay(Plant(body, chain_of(body.robot, slow)), run, 0.01)
    assert told(body, (ring,)) is None
    level = np.random.default_rng(1).uniform(0.0, 0.8 * body.robot.pressure_max_pa, (8, 3))
    steps = replace(run, pressure_cmd=level.repeat(200, axis=0)[:1500])
    exchanged = measured(replay(Plant(body, chain_of(body.robot, slow)), steps, 0.01), lambda p: columns(p, [1, 0, 2]))
    assert "follows the command of chamber" in str(told(body, (ring, exchanged)))


def behind(body: PccSimulator, name: str, **parameters: float) -> Recording:
    """Return 30 s of chambers that are filled ever faster, each by its own clock, and what they do behind an effect."""
    time = 0.02 * np.arange(1500)
    run = Recording("run", "day", time, body.robot.pressure_max_pa * ((time[:, None] / [5.0, 7.0, 9.0]) % 1.0) ** 2)
    return replay(Plant(body, chain_of(body.robot, (effect_class(name)(**parameters),))), run, 0.01)


def test_a_hose_that_gives_too_little_is_no_other_unit_but_warned_of(body: PccSimulator) -> None:
    run = behind(body, "gain", gain=0.3, chamber=0, before_gauge=True)
    assert told(body, (run,)) is None
    warned = [line for line in check_run(run, body.robot).warnings if "times as large" in line]
    assert len(warned) == 1 and "chamber 1 follows its command but is 0.3 times" in warned[0]


def test_a_supply_that_gives_too_little_is_no_other_unit(body: PccSimulator) -> None:
    """It bends the line, whose lower half is sound."""
    run = behind(body, "supply_limit", ceiling=0.25, floor=1.0)
    assert told(body, (run,)) is None
    assert not any("times as large" in line for line in check_run(run, body.robot).warnings)


@pytest.mark.parametrize(
    "change",
    [
        lambda r: r,
        lambda r: moved(r, lambda tip: columns(tip, [2, 0, 1])),
        lambda r: moved(r, lambda tip: np.array([0.3, -0.2, 0.5]) + tip),
        lambda r: moved(r, lambda tip: tip[:1] + 2.5 * (tip - tip[:1])),
        lambda r: replace(r, pressure_meas=None),
    ],
)
def test_another_frame_or_another_body_is_no_mistake(
    body: PccSimulator, recorded: tuple[Recording, ...], change: Spoil
) -> None:
    assert told(body, tuple(change(run) for run in recorded)) is None


def test_nothing_comes_early_in_a_run_in_which_all_stands_still(body: PccSimulator) -> None:
    """A gauge's last digit is coarser than its noise: at rest it reads zero throughout. Other runs are too short to tell."""
    short = [replace(run, **run.part(run.time < 7.0)) for run in made(body, sessions=3, measured=True).recordings]
    still = np.zeros((1000, body.robot.chambers))
    rest = Recording("rest", "s", 0.02 * np.arange(1000), still, still, np.tile([0.0, 0.0, body.robot.length_m], (1000, 1)))
    assert told(body, (rest,)) is None and told(body, (rest, *short)) is None


def test_motion_in_one_plane_is_no_mirror_image(body: PccSimulator, recorded: tuple[Recording, ...]) -> None:
    plant = Plant(body, chain_of(body.robot, HIDDEN))
    alone = [replay(plant, replace(r, pressure_cmd=r.pressure_cmd * [1.0, 0.0, 0.0]), 0.01) for r in recorded]
    assert told(body, tuple(moved(run, lambda tip: columns(tip, [1, 0, 2])) for run in alone)) is None


@pytest.fixture(scope="module")
def bent(body: PccSimulator) -> tuple[PccSimulator, tuple[Recording, ...]]:
    """Return a finger of two opposite chambers, and what an angle sensor shows of it, with something hidden."""
    robot = replace(body.robot, chamber_angle_deg=(0.0, 180.0), output="bend_angle")
    finger = PccSimulator(robot, 0.8, 0.0, 1.0, 1.0, 0.05, 1.0)
    return finger, made(finger, HIDDEN, sessions=2).recordings


@pytest.mark.parametrize(
    ("spoil", "evidence"),
    [
        (lambda angle, session: angle, None),
        (lambda angle, session: 0.5 * angle + 0.3, None),
        (lambda angle, session: -angle, "the angle falls where pressure bends the tip"),
        (lambda angle, session: 0.2 - 0.5 * angle, "the angle falls where pressure bends the tip"),
        (lambda angle, session: np.abs(angle), "the angle has no sign"),
        (lambda angle, session: angle if session == 0 else -angle, "falls where pressure bends the tip"),
    ],
)
def test_an_angle_of_the_other_sign_is_told(
    bent: tuple[PccSimulator, tuple[Recording, ...]], spoil: Callable[[np.ndarray, int], np.ndarray], evidence: str | None
) -> None:
    finger, runs = bent
    first = runs[0].session
    spoilt = [replace(run, bend_angle=spoil(np.asarray(run.bend_angle), int(run.session != first))) for run in runs]
    said = told(finger, tuple(spoilt))
    assert said is None if evidence is None else said is not None and evidence in said
