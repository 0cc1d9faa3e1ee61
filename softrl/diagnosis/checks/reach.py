"""How far the tip is from the base at rest, beside the length that the robot's file gives."""

from collections.abc import Sequence

import numpy as np

from softrl.core.simulator import Simulator
from softrl.diagnosis.fitting.hypothesis import Choice
from softrl.pcc.simulator import LENGTH, PccSimulator
from softrl.recordings.mistaken import still
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

OTHER_LENGTH = 0.03  # of the length, by which the tip may be nearer or farther: weight and pressure left over do as much
ALIKE = 0.02  # of the length: sessions that differ by more differ in something else
AT_FIRST_S = 0.2
LEAST, MOST = 0.005, 0.15  # of the length, by which a straight tip tells another one
STRAIGHT, STEADY = 0.25, 0.25  # of that: a tip that rests aside, or now here and now there, tells of something else
RUNS = 2  # that tell
SAGS, FORM = 0.6, 0.1  # a rod that weight, a force at its tip or a moment bends ends 4/7, 3/5, 2/3 of sag^2 / length nearer
MOST_SAG = 0.3  # of the length, up to which that holds
NOISY = 2.0  # times what the tip seems to move along at rest, by which rests that are the same may differ
SHIFTS = ("marker_offset", "frame", "offset", "pressure_sensor")


def stands_for_length(choice: Choice) -> bool:
    """Return whether an effect may be a shift of the tip along the body, in all chambers and sessions.

    One that begins in every run may be, too: what the tip at rest shows was there before.
    """
    above = choice.gate is not None and choice.gate.field != "since_s"
    everywhere = choice.chamber < 0 and not (choice.sessions or choice.lasting or above)
    return everywhere and choice.name in SHIFTS


def as_it_stands(simulator: Simulator, runs: Sequence[Recording], robot: Robot) -> Simulator:
    """Return the lumped body as long as its tip at rest tells: what a robot's file says wrongly is no physics.

    Any other simulator, and one whose tip rests where it should, aside but where weight bends it, or not always in the same
    place, is returned as it is.
    """
    tips = _resting(runs, robot)
    rests = _places(tips)
    if not isinstance(simulator, PccSimulator) or len(rests) < RUNS:
        return simulator
    along, (sag, aside) = rests[:, 2], _sag(np.median(rests[:, :2], axis=0), robot)
    shorter = sag**2 / robot.length_m
    length = float(np.median(along)) + SAGS * shorter
    off = abs(length - simulator.length_m)
    plain = LEAST * robot.length_m + FORM * shorter < off < MOST * robot.length_m and sag < MOST_SAG * robot.length_m
    if not plain or aside > STRAIGHT * off or np.ptp(along) > STEADY * off + NOISY * _trembles(tips):
        return simulator
    return simulator.with_parameters(**{LENGTH: length / robot.length_m})


def of_other_length(
    runs: Sequence[Recording], robot: Robot, simulator: Simulator, named: Sequence[Choice] = ()
) -> str | None:
    """Return in a sentence that the tip at rest is not where a robot of this length has it, or None; see ``told_of_length``.

    By runs that begin without pressure, if they agree. A marker beyond the tip shows so, too: which of both it is no recording
    of the tip can tell. Where a shift along the body is ``named`` a smaller difference is told as well.
    """
    reach = np.linalg.norm(_places(_resting(runs, robot)), axis=1)
    if taken_length(simulator) or not len(reach) or np.ptp(reach) > ALIKE * robot.length_m:
        return None
    found = float(np.median(reach))
    least = LEAST if any(map(stands_for_length, named)) else OTHER_LENGTH
    if abs(found - robot.length_m) <= least * robot.length_m:
        return None
    return (
        f"at rest the tip is {1e3 * found:.4g} mm from the base, and length_m of robot {robot.name} is "
        f"{1e3 * robot.length_m:.4g} mm: measure it again. If it is right, the marker sits before or beyond the tip, or the "
        "camera's scale is wrong; if it is not, marker_offset, or an offset of all chambers, may be named for it"
    )


def told_of_length(simulator: Simulator, robot: Robot) -> list[str]:
    """Return in a sentence which length the lumped body was taken to have, if it is not the robot's."""
    return [
        f"The body was taken to be {1e3 * scale * robot.length_m:.4g} mm long, as its tip at rest tells, where length_m is "
        f"{1e3 * robot.length_m:.4g} mm: measure it again. A marker beyond the tip, a camera shifted along it, or pressure that "
        "stays in all chambers would show so, too."
        for scale in taken_length(simulator).values()
    ]


def taken_length(simulator: Simulator) -> dict[str, float]:
    """Return the length of a lumped body, in those of its robot, where it is another; else nothing."""
    scale = simulator.length_scale if isinstance(simulator, PccSimulator) else 1.0
    return {LENGTH: scale} if scale != 1.0 else {}


def _places(tips: Sequence[np.ndarray]) -> np.ndarray:
    """Return where the tip rests (runs, 3) m."""
    return np.array([np.median(tip, axis=0) for tip in tips]).reshape(-1, 3)


def _sag(rest: np.ndarray, robot: Robot) -> tuple[float, float]:
    """Return how far a tip that rests at ``rest`` (2,) m across the axis is where weight draws it, and how far beside that, m."""
    across = np.array(robot.gravity_m_s2[:2], dtype=float)
    pull = float(np.linalg.norm(across))
    sag = max(float(rest @ across) / pull, 0.0) if pull > 0.0 else 0.0
    return sag, float(np.linalg.norm(rest - sag * across / max(pull, 1e-300)))


def _trembles(tips: Sequence[np.ndarray]) -> float:
    """Return by how much the tip's place along the base's axis varies within a rest, m rms."""
    return float(np.sqrt(np.mean([np.var(tip[:, 2]) for tip in tips])))


def _resting(runs: Sequence[Recording], robot: Robot) -> list[np.ndarray]:
    """Return the tip's places (samples, 3) m before anything acts, of every run that begins without pressure."""
    if robot.output == "bend_angle":
        return []
    quiet = [run for run in runs if still(run, robot)[_at_first(run)].all()]
    tips = [np.asarray(run.position)[_at_first(run)] for run in quiet]
    seen = [tip[np.isfinite(tip).all(axis=1)] for tip in tips]
    return [tip for tip in seen if len(tip)]


def _at_first(run: Recording) -> np.ndarray:
    return np.asarray(run.time <= run.time[0] + AT_FIRST_S)
