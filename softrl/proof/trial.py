"""One blind trial: a robot with hidden physics, recorded; what was hidden goes into the key, not beside the recordings."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from softrl.core.errors import ConfigError
from softrl.pcc.simulator import PccSimulator
from softrl.proof.generator import laws
from softrl.proof.generator.catalogue import SAME_MEANING, Hidden, answers, draw
from softrl.proof.generator.plan import Case
from softrl.proof.generator.plant import Body
from softrl.proof.generator.program import Range, Session, outside, sessions
from softrl.proof.generator.sensing import Noise, Sensed, sensed
from softrl.proof.signal import StaticMap, Truth, calibrated, left_over, same, to_level
from softrl.recordings.acting import ACTS, UNTIL
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.write import write
from softrl.robots.robot import Robot

SHORTEST_S = 7.0  # a session: four pauses of a second, and three blocks
PROBES = 4  # sessions on which a hidden effect's size is measured
OF_OWN_MASS = ("payload.mass",)  # hidden as a share of the mass that the body has, named as one of the robot's in its data
RECORDINGS, OUTSIDE, TRUTH = "recordings", "outside", "truth"


@dataclass(frozen=True)
class Generator:
    """The numbers of the generator.

    Attributes
    ----------
    links : rigid links of the body
    step_s : longest step of its integrator
    sessions, session_s : recordings that the diagnosis gets, and how long each is
    share : of the pressure range that they use; the session out of distribution uses all of it
    tip_force_n : known force on the tip in the session out of distribution
    orientation : whether orientations are recorded, or positions of the tip alone
    position_noise_m, orientation_noise_rad, pressure_noise_pa : standard deviation of one component
    coloured_share, noise_memory_s : share of the noise's variance that is coloured, and its correlation time
    dropped_share, late_share : of the samples
    says_when : whether the dataset says that commands act until their row's time, as they do
    """

    links: int
    step_s: float
    sessions: int
    session_s: float
    share: float
    tip_force_n: float
    orientation: bool
    position_noise_m: float
    orientation_noise_rad: float
    pressure_noise_pa: float
    coloured_share: float
    noise_memory_s: float
    dropped_share: float
    late_share: float
    says_when: bool

    def __post_init__(self) -> None:
        said = "stage.generator."
        if self.links < 1 or not self.session_s >= SHORTEST_S:
            raise ConfigError(
                f"{said}links={self.links}, session_s={self.session_s:g}; expected 1 or more, and {SHORTEST_S:g} s or more, of "
                "which the pauses take 4"
            )
        for name in ("step_s", "share", "position_noise_m", "noise_memory_s"):  # effects are hidden as multiples of the noise
            if getattr(self, name) <= 0.0:
                raise ConfigError(f"{said}{name}={getattr(self, name):g} must be positive")
        for name in ("orientation_noise_rad", "pressure_noise_pa"):
            if getattr(self, name) < 0.0:
                raise ConfigError(f"{said}{name}={getattr(self, name):g} must not be negative")
        for name in ("share", "coloured_share", "late_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigError(f"{said}{name}={getattr(self, name):g} must lie between 0 and 1")
        if not 0.0 <= self.dropped_share < 1.0:
            raise ConfigError(f"{said}dropped_share={self.dropped_share:g}; expected 0 or more, and below 1")


@dataclass(frozen=True)
class Nuisance:
    """What differs from the nominal robot without being missing physics: factors on its numbers and on the noise."""

    stiffness: float = 1.0
    axial: float = 1.0
    damping: float = 1.0
    mass: float = 1.0
    gain: float = 1.0
    noise: float = 1.0
    colour: float | None = None


def nuisance_of(stratum: str, rng: np.random.Generator) -> Nuisance:
    """Return large nuisances for the nuisance-only stratum, none for the null one, mild ones elsewhere."""
    u = rng.uniform
    if stratum == "null":
        return Nuisance()
    if stratum == "nuisance":
        return Nuisance(u(0.7, 1.4), u(0.85, 1.15), u(0.5, 2.0), u(0.85, 1.15), u(0.9, 1.1), u(0.7, 2.0), u(0.2, 0.9))
    return Nuisance(u(0.85, 1.15), u(0.95, 1.05), u(0.8, 1.25), u(0.95, 1.05))


def make(case: Case, generator: Generator, robot: Robot, nominal: PccSimulator, folder: Path) -> dict[str, Any]:
    """Record one case under ``folder`` and return its entry of the key.

    Below ``folder`` the recordings stand under a random name in ``recordings/``, the session kept for judging in
    ``outside/``, and the truth without noise in ``truth/``.
    """
    rng = np.random.default_rng(case.seed)
    nuisance = nuisance_of(case.stratum, rng)
    limits = Range(robot.pressure_min_pa, robot.pressure_max_pa, robot.slew_pa_per_s, robot.chambers)
    runs = sessions(limits, generator.sessions, generator.session_s, generator.share, rng)
    last = outside(limits, generator.session_s, generator.tip_force_n, rng)
    noise = _noise(generator, nuisance)
    floor = float(np.sqrt(3.0) * noise.position_m)
    bare = Truth(_body(robot, nominal, nuisance, generator.links), nuisance.gain, (), (), case.seed, generator.step_s)
    drawn = tuple(draw(name, place, generator.session_s, robot.chambers, rng) for name, place in case.entries)
    probes = runs[:PROBES]
    sizes = tuple(to_level(nominal, bare, law, probes, floor, case.level) for law in drawn)
    truth = replace(bare, hidden=drawn, amplitudes=sizes)
    mapped: Any = calibrated(nominal, truth, probes[-2:]) if case.stratum == "concealed" else same
    own = left_over(nominal, bare, probes, same)
    loud = [_ratio(nominal, replace(bare, hidden=(law,), amplitudes=(size,)), probes, mapped, own, floor)
            for law, size in zip(drawn, sizes, strict=True)]  # fmt: skip
    name = rng.bytes(8).hex()
    record(truth, runs, last, noise, mapped, case.measured_pressure, generator, robot, folder, name, rng)
    return {
        "case": case.number,
        "folder": name,
        "files_sha256": of_case(folder, name),
        "stratum": case.stratum,
        "measured_pressure": case.measured_pressure,
        "hidden": [_entry(law, size, case, level, nuisance.mass)
                   for law, size, level in zip(drawn, sizes, loud, strict=True)],
        "places": [place for _, place in case.entries],
        "signal_to_noise": min(loud, default=0.0),
        "noise_floor_mm": 1e3 * floor,
        "body_discrepancy_mm": 1e3 * own,
        "nuisance": vars(nuisance),
    }


def record(
    truth: Truth,
    runs: list[Session],
    last: Session,
    noise: Noise,
    mapped: Any,
    measured_pressure: bool,
    generator: Generator,
    robot: Robot,
    folder: Path,
    name: str,
    rng: np.random.Generator,
) -> None:
    """Write the recordings, the session out of distribution, and the clean truth of all."""
    taken, clean = [], {}
    notes = {ACTS: UNTIL} if generator.says_when else {}
    for number, session in enumerate([*runs, last]):
        seen = sensed(truth.table, session.time, truth.moved(session, number), robot.length_m, noise, rng)
        label = rng.bytes(6).hex()
        made = _recording(label, rng.bytes(6).hex(), session, seen, mapped, measured_pressure, number == len(runs))
        taken.append(made if generator.orientation else replace(made, quaternion=None))
        clean[label] = seen.clean
    for part, chosen in ((RECORDINGS, taken[:-1]), (OUTSIDE, taken[-1:])):
        write(folder / part / name, RecordingSet(robot.name, tuple(chosen), notes))
    (folder / TRUTH).mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / TRUTH / f"{name}.npz", allow_pickle=False, **clean)


def of_case(folder: Path, name: str) -> str:
    """Return the SHA-256 of all that one case is diagnosed from and judged by, by name and content."""
    found = hashlib.sha256()
    for path in (*sorted((folder / RECORDINGS / name).iterdir()), *sorted((folder / OUTSIDE / name).iterdir()),
                 folder / TRUTH / f"{name}.npz"):  # fmt: skip
        found.update(path.name.encode() + b"\0" + path.read_bytes())
    return found.hexdigest()


def _recording(
    label: str, session_name: str, session: Session, seen: Sensed, mapped: Any, pressure: bool, with_force: bool
) -> Recording:
    return Recording(
        name=label,
        session=session_name,
        time=seen.time,
        pressure_cmd=mapped(session.command)[seen.kept],
        pressure_meas=seen.pressure if pressure else None,
        position=seen.position,
        quaternion=seen.quaternion,
        tip_force=session.tip_force[seen.kept] if with_force else None,
    )


def _body(robot: Robot, nominal: PccSimulator, nuisance: Nuisance, links: int) -> Body:
    """Return the hidden body from the nominal one's numbers."""
    bending, _, axial = nominal.stiffness
    return Body(
        direction=robot.chamber_direction,
        radius_m=robot.chamber_radius_m,
        area_m2=robot.chamber_area_m2,
        length_m=robot.length_m,
        mass_kg=nuisance.mass * robot.mass_kg,
        pressure_pa=robot.pressure_max_pa,
        bending_j=nuisance.stiffness * bending,
        axial_j=nuisance.stiffness * nuisance.axial * axial,
        damping_s=nuisance.damping * nominal.damping_s,
        gravity=np.array(robot.gravity_m_s2),
        links=links,
    )


def _noise(generator: Generator, nuisance: Nuisance) -> Noise:
    return Noise(
        nuisance.noise * generator.position_noise_m,
        nuisance.noise * generator.orientation_noise_rad,
        nuisance.noise * generator.pressure_noise_pa,
        generator.coloured_share if nuisance.colour is None else nuisance.colour,
        generator.noise_memory_s,
        generator.dropped_share,
        generator.late_share,
    )


def _ratio(
    nominal: PccSimulator, alone: Truth, probes: list[Session], mapped: StaticMap | Any, own: float, floor: float
) -> float:
    return float(np.sqrt(max(left_over(nominal, alone, probes, mapped) ** 2 - own**2, 0.0)) / floor)


def _entry(law: Hidden, size: float, case: Case, level: float, mass: float) -> dict[str, Any]:
    """Return one hidden law of the key; ``mass`` is the factor on the robot's, of which the library's shares are taken."""
    table = laws.neutral_table()
    law.into(table, size)
    row = table[law.law]
    shared = SAME_MEANING.get(law.name, {}) if case.stratum != "concealed" else {}
    return {
        "name": law.name,
        "right": list(answers(law, case.measured_pressure)),
        "chamber": law.chamber,
        "amplitude": size,
        "row": row.tolist(),
        "signal_to_noise": level,
        "parameters": {
            name: (constant + factor * row[column]) * (mass if name in OF_OWN_MASS else 1.0)
            for name, (column, factor, constant) in shared.items()
        },
    }
