"""Recordings of other robots than the library's, that share no code with softrl: one, two and four chambers.

Each bend and the growth is a mass on a spring, in a horizontal plane or without weight. Commands are held between the rows
of the log, which are 20 to 100 ms apart; two of the robots have gauges behind a valve that lags by 60 ms.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softrl.robots.robot import Robot
from tests.diagnosis.foreign import DT, first_order

RUNS, USED, VALVE_S = 6, 0.8, 0.06
Physics = Callable[["Other", np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Other:
    """A robot and how it is recorded: bend (rad) and growth at full pressure, Hz and damping ratio, noise m or rad."""

    name: str
    chamber_angle_deg: tuple[float, ...]
    length_m: float
    mass_kg: float
    full_pa: float
    bend_rad: float
    growth: float
    hertz: float
    damping: float
    row_s: float
    lasts_s: float
    noise: float
    gauges: bool = True
    angle_only: bool = False

    @property
    def time(self) -> np.ndarray:
        """Times (steps,) s of a run."""
        return DT * np.arange(round(self.lasts_s / DT))

    def robot(self) -> Robot:
        """Return what a laboratory would write into the robot's YAML."""
        return Robot(
            name=self.name, chamber_angle_deg=self.chamber_angle_deg, chamber_radius_m=0.015, chamber_area_m2=2e-4,
            length_m=self.length_m, mass_kg=self.mass_kg, pressure_min_pa=-0.02 * self.full_pa, pressure_max_pa=self.full_pa,
            slew_pa_per_s=1e6, tip_force_max_n=2.0, axis="+z", output="bend_angle" if self.angle_only else "tip_pose",
            command="pressure", command_to_pa=1.0, gravity_m_s2=(0.0, 0.0, 0.0),
        )  # fmt: skip


DUO = Other("duo", (180.0, 0.0), 0.15, 0.12, 100e3, 0.8, 0.08, 6.0, 0.35, 0.02, 30.0, 2e-4, gauges=False)
QUAD = Other("quad", (45.0, 135.0, 225.0, 315.0), 0.25, 0.4, 80e3, 0.5, 0.06, 4.0, 0.5, 0.05, 40.0, 3e-4)
FINGER = Other("finger", (180.0,), 0.1, 0.04, 60e3, 1.2, 0.03, 8.0, 0.6, 0.1, 60.0, 5e-3, angle_only=True)
OTHERS = {other.name: other for other in (DUO, QUAD, FINGER)}


def program(other: Other, number: int, rng: np.random.Generator) -> np.ndarray:
    """Return steps, sums of sines, or triangles (steps, chambers) Pa, from rest, held between rows."""
    time, count, rows = other.time, len(other.chamber_angle_deg), round(other.row_s / DT)
    if number % 3 == 0:
        hold = rng.choice([1.0, 2.0, 3.0])
        levels = rng.uniform(0.0, USED, (int(other.lasts_s / hold) + 2, count))
        share = levels.repeat(int(hold / DT), axis=0)[: len(time)]
    elif number % 3 == 1:
        hertz, phase = rng.uniform(0.03, 0.8, (4, count)), rng.uniform(0.0, 6.28, (4, count))
        waves = [np.sin(2.0 * np.pi * f * time[:, None] + p) for f, p in zip(hertz, phase, strict=True)]
        share = np.clip(0.38 + 0.1 * sum(waves), 0.0, 0.85)
    else:
        period = rng.choice([4.0, 8.0, 12.0], size=count)
        share = USED * np.abs((time[:, None] / period + rng.uniform(0.0, 1.0, count)) % 1.0 * 2.0 - 1.0)
    share[time < 1.0] = 0.0
    return other.full_pa * np.asarray(share[::rows].repeat(rows, axis=0)[: len(time)])


def bends(other: Other, pressure: np.ndarray) -> np.ndarray:
    """Return (steps, 3): bend about two axes, rad, and growth, under the pressures (steps, chambers) Pa."""
    angle, share = np.deg2rad(other.chamber_angle_deg), pressure / other.full_pa
    across = [-other.bend_rad * share @ np.cos(angle), -other.bend_rad * share @ np.sin(angle)]
    drive = np.stack([*across, other.growth * share.mean(axis=1)], axis=1)
    w, q, rate, found = 2.0 * np.pi * other.hertz, np.zeros(3), np.zeros(3), np.empty_like(drive)
    for k, toward in enumerate(drive):
        rate = rate + DT * (w**2 * (toward - q) - 2.0 * other.damping * w * rate)
        q = q + DT * rate
        found[k] = q
    return found


def write(other: Other, folder: Path, seed: int, valve: Physics | None = None, act: Physics | None = None) -> Path:
    """Write two sessions of three runs; ``valve`` lies before the gauges, ``act`` behind them."""
    rng, names, rows = np.random.default_rng(seed), [], slice(None, None, round(other.row_s / DT))
    count = len(other.chamber_angle_deg)
    for number in range(RUNS):
        command = program(other, number, rng)
        supplied = command if valve is None else valve(other, command)
        supplied = first_order(supplied, VALVE_S) if other.gauges else supplied
        x, y, longer = bends(other, supplied if act is None else act(other, supplied)).T
        angle = np.hypot(x, y) + 1e-12
        columns = {"time_s": other.time} | {f"p{k + 1}_cmd_kpa": 1e-3 * command[:, k] for k in range(count)}
        if other.gauges:
            noisy = supplied + 2e-3 * other.full_pa * rng.standard_normal(supplied.shape)
            columns |= {f"p{k + 1}_meas_kpa": 1e-3 * noisy[:, k] for k in range(count)}
        noise = other.noise * rng.standard_normal((len(angle), 3))
        if other.angle_only:
            columns["bend_angle_deg"] = np.rad2deg(angle + noise[:, 0])
        else:
            reach = other.length_m * (1.0 + longer) / angle
            away = [reach * (1.0 - np.cos(angle)) * part / angle for part in (x, y)]
            tip = np.stack([*away, reach * np.sin(angle)], axis=1) + noise
            columns |= {f"tip_{axis}_mm": 1e3 * tip[:, k] for k, axis in enumerate("xyz")}
        table = np.stack(list(columns.values()), axis=1)[rows]
        names.append(f"rec{number}")
        np.savetxt(folder / f"{names[-1]}.csv", table, "%.6g", ",", header=",".join(columns), comments="")
    half = RUNS // 2
    days = [f"  day0: [{', '.join(names[:half])}]", f"  day1: [{', '.join(names[half:])}]"]
    (folder / "dataset.yaml").write_text("\n".join([f"robot: {other.name}", "sessions:", *days, ""]))
    return folder
