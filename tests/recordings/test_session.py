"""The program of a session of identification: what cannot be drawn is refused before a robot moves."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from softrl.core.config import build
from softrl.core.errors import ConfigError
from softrl.recordings.session import Identification, session_program
from softrl.robots.robot import Robot

CONF = Path(__file__).parents[2] / "conf"


def plain(path: str) -> Any:
    return OmegaConf.to_container(OmegaConf.load(CONF / path), resolve=False)


def settings(profile: str | None = None) -> Identification:
    parts = ["stage/sim2real.yaml"] + ([f"profile/{profile}/sim2real.yaml"] if profile else [])
    merged = OmegaConf.merge(*(plain(part)["identification"] for part in parts))
    return build(OmegaConf.to_container(merged), Identification, "stage.identification")


@pytest.mark.parametrize("name", ["tripod", "three_chamber_segment", "single_chamber_finger"])
@pytest.mark.parametrize("profile", [None, "tiny", "paper"])
def test_every_profile_has_a_program_for_every_robot(name: str, profile: str | None) -> None:
    robot, mine = build(plain(f"robot/{name}.yaml"), Robot, "robot"), settings(profile)
    rng = np.random.default_rng(0)
    for number in range(robot.chambers):
        time, pressure = session_program(robot, mine, number, rng)
        np.testing.assert_allclose(np.diff(time), mine.dt_s)
        assert np.isfinite(pressure).all() and pressure.shape == (len(time), robot.chambers)


@pytest.mark.parametrize("limits_pa", [(-2e4, 3.5e4), (-3e4, 3e4), (-8e4, 5e3), (-8e4, 0.0)])
def test_each_part_of_a_session_goes_as_far_as_the_robot_may(limits_pa: tuple[float, float]) -> None:
    """The last two, of one chamber each, to the farther limit, of suction or above the room's pressure."""
    low, high = limits_pa
    robot = replace(build(plain("robot/tripod.yaml"), Robot, "robot"), pressure_min_pa=low, pressure_max_pa=high)
    mine = settings()
    time, pressure = session_program(robot, mine, 0, np.random.default_rng(0))
    begin = mine.step_count * mine.step_hold_s + mine.multisine_s + 3.0 * mine.rest_s
    end = begin + mine.triangle_cycles * sum(mine.triangle_periods_s)
    alone = {0: (time > begin) & (time <= end), 1: time > end}
    for chamber, there in alone.items():
        extreme = pressure[there, chamber][np.argmax(np.abs(pressure[there, chamber]))]
        assert extreme == pytest.approx(high if high >= -low else low) and not np.delete(pressure[there], chamber, axis=1).any()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"multisine_band_hz": (0.0, 3.0)}, r"multisine_band_hz=\[0.0, 3.0\]; expected a lowest tone above 0 Hz"),
        ({"multisine_band_hz": (3.0, 0.1)}, r"multisine_band_hz=\[3.0, 0.1\]; expected"),
        ({"multisine_band_hz": (0.1, 80.0)}, r"multisine_band_hz=\[0.1, 80.0\] at dt_s=0.02; .*below 25 Hz"),
        ({"multisine_band_hz": (0.1, 25.0)}, r"multisine_band_hz=.*below 25 Hz"),
        ({"multisine_s": 0.005}, r"multisine_s=0.005 is too short; expected one period of the highest tone"),
        ({"multisine_share": 0.0}, r"multisine_share=0; expected a share"),
        ({"multisine_share": 1.1}, r"multisine_share=1.1; expected a share"),
        ({"rest_s": -1.0}, r"rest_s=-1 must not be negative"),
        ({"triangle_periods_s": (0.0,)}, r"triangle_periods_s: 0 s is too short; expected two commands .* 0.04 s"),
        ({"triangle_periods_s": (8.0, -2.0)}, r"triangle_periods_s: -2 s is too short"),
        ({"staircase_period_s": 0.01}, r"staircase_period_s: 0.01 s is too short"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_its_key(changed: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=f"stage.identification.{told}") as error:
        replace(settings(), **changed)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "changed",
    [{"rest_s": 0.0}, {"multisine_band_hz": (2.0, 24.9)}, {"multisine_band_hz": (1.0, 1.0)}, {"multisine_share": 1.0},
     {"multisine_s": 0.34}, {"triangle_periods_s": (0.04,)}],
)  # fmt: skip
def test_what_is_just_allowed_can_be_drawn(changed: dict[str, Any]) -> None:
    tripod = build(plain("robot/tripod.yaml"), Robot, "robot")
    _, pressure = session_program(tripod, replace(settings(), **changed), 0, np.random.default_rng(0))
    assert np.isfinite(pressure).all() and (np.ptp(pressure, axis=0) > 0.0).all()
