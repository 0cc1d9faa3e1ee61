"""Data that cannot tell anything, each with its evidence in one line: too short, clipped, torn, in wrong units, mixed."""

from collections.abc import Sequence

import numpy as np

from softrl.diagnosis.checks.gaps import MIN_PART_S
from softrl.recordings.check import CLIPPED_SHARE, DataCheck, driven, moved_by_command
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

MIN_TOTAL_S = 12.0  # recordings of less than this together say nothing about dynamics
MAX_CLIPPED_SHARE = 0.25  # of the samples of the motion that sit at one extreme while the command moves
FEW_VALUES = 5  # that a coordinate shows at most because its sensor is coarse: there the extremes are no rare ones
PRESSURE_FACTOR = 20.0  # times the robot's largest pressure, or that part of it: another unit
MIN_PRESSURE_SHARE = 1.0 / 200.0
MAX_TRAVEL = 5.0  # lengths of the robot
MIN_TRAVEL = 1e-3
MAX_TURN_RAD = 4.0 * np.pi
WRAPPED_RAD, WRAPPED_S = 1.5 * np.pi, 0.2  # an angle that changes by more within less has not gone on beyond half a turn
MIXED_FACTOR = 3.0  # by which two sessions may differ in their response to pressures in the same chambers
HOSE_FACTOR = 10.0  # and to pressures in others: one chamber may have a loose hose


def unusable(runs: Sequence[Recording], robot: Robot) -> str | None:
    """Return why ``runs`` cannot tell anything, or None."""
    total = sum(float(np.ptp(run.time)) for run in runs)
    if total < MIN_TOTAL_S:
        return f"the recordings last {total:.1f} s together, expected {MIN_TOTAL_S:g} s or more; record longer"
    return _clipped(runs, robot) or _wrong_pressure(runs, robot) or _wrong_motion(runs, robot)


def torn(
    runs: Sequence[Recording],
    intact: Sequence[Recording],
    parts: Sequence[Recording],
    check: DataCheck,
    robot: Robot,
) -> str | None:
    """Return why what lies between pauses in the samples of ``runs`` cannot tell anything, or None.

    Parameters
    ----------
    runs : as recorded
    intact, parts : those of ``runs`` of which anything is left, and all that is left of them
    check : findings on ``runs``
    robot : whose runs they are
    """
    names = {run.name for run in runs}
    missing = sum(length for run in check.runs if run.name in names for _, length in run.gaps)
    total, kept = (sum(float(np.ptp(run.time)) for run in some) for some in (runs, parts))
    if kept == total or (kept >= MIN_TOTAL_S and len(intact) > 1 and driven(parts, robot)):
        return None
    return (
        f"samples are missing during {missing:.1f} s of {total:.1f} s ({missing / total:.0%}), and only {kept:.1f} s "
        f"in {len(parts)} parts of {MIN_PART_S:g} s or more out of {len(intact)} runs lie between"
        f"{'' if not parts or driven(parts, robot) else ', in which no chamber is driven'}; record without gaps"
    )


def mixed(runs: Sequence[Recording], simulated: Sequence[Recording], robot: Robot) -> str | None:
    """Return why ``runs`` cannot be of one robot: sessions that respond to pressure much more than others; or None.

    Where sessions drive other chambers, one chamber may do less than the others without being another robot's.
    """
    scales, chambers = {}, {}
    for session in dict.fromkeys(run.session for run in runs):
        mine = [k for k, run in enumerate(runs) if run.session == session]
        size = [_size(np.concatenate([motion_of(side[k], robot) for k in mine])) for side in (runs, simulated)]
        if min(size) > MIN_TRAVEL * robot.length_m:  # a session at rest has no size
            scales[session], chambers[session] = size[0] / size[1], driven([runs[k] for k in mine], robot)
    groups = [([s for s in scales if chambers[s] == some], MIXED_FACTOR) for some in dict.fromkeys(chambers.values())]
    for sessions, factor in (*groups, (list(scales), HOSE_FACTOR)):
        ordered = sorted(sessions, key=lambda s: scales[s])
        if len(ordered) > 1 and scales[ordered[-1]] > factor * scales[ordered[0]]:
            return (
                f"session {ordered[-1]} moves {scales[ordered[-1]]:.3g} times as far as the simulator and session {ordered[0]} "
                f"{scales[ordered[0]]:.3g} times, which no one robot does: mixed robots, or mixed units"
            )
    return None


def _clipped(runs: Sequence[Recording], robot: Robot) -> str | None:
    """Return which coordinate of the motion that ``robot`` reports sits at one extreme, or None.

    Measured pressures may: behind a supply that gives no more, a gauge that shows few values shows but one. ``check`` warns.
    So may a coordinate that shows few values, such as the one across the plane of a planar robot before a coarse camera.
    """
    channel = "bend_angle" if robot.output == "bend_angle" else "position"
    shares: dict[str, list[float]] = {}
    for run in runs:
        for k, series in enumerate(motion_of(run, robot).T):
            moves = moved_by_command(run, channel, k)
            if len(np.unique(series)) > FEW_VALUES and np.count_nonzero(moves) > 1.0 / CLIPPED_SHARE:
                ends = [_share_at(series == end, run.pressure_cmd, moves) for end in (series.max(), series.min())]
                shares.setdefault(f"{channel}[{k}]", []).append(max(ends))
    for coordinate, found in shares.items():
        if np.mean(found) > MAX_CLIPPED_SHARE:
            return f"{coordinate} sits at its largest or smallest value in {np.mean(found):.0%} of the samples: clipped"
    return None


def _share_at(there: np.ndarray, commands: np.ndarray, moves: np.ndarray) -> float:
    """Return the share ``there`` (steps,), at an extreme, of those ``moves`` picks, without the pose most frequent there.

    A coarse sensor shows a rest between poses as one value every time: clipped is what sits there under other ``commands`` too.
    """
    if not (there & moves).any():
        return 0.0
    poses, counts = np.unique(commands[there & moves], axis=0, return_counts=True)
    others = moves & np.any(commands != poses[np.argmax(counts)], axis=1)
    return float(np.mean(there[others])) if others.any() else 0.0


def _wrong_pressure(runs: Sequence[Recording], robot: Robot) -> str | None:
    limit = max(abs(robot.pressure_max_pa), abs(robot.pressure_min_pa))
    for name in ("pressure_cmd", "pressure_meas"):
        found = [np.abs(values).max() for run in runs if (values := getattr(run, name)) is not None]
        top = max(found, default=limit)
        if not MIN_PRESSURE_SHARE * limit <= top <= PRESSURE_FACTOR * limit:
            return (
                f"{name} reaches {1e-3 * top:.3g} kPa where robot {robot.name} takes {1e-3 * limit:.3g} kPa: "
                "a wrong unit (Pa, kPa, bar or psi)?"
            )
    return None


def _wrong_motion(runs: Sequence[Recording], robot: Robot) -> str | None:
    travel = max(float(np.ptp(motion_of(run, robot), axis=0).max()) for run in runs)
    if robot.output == "bend_angle":
        turn = travel / robot.length_m
        if turn == 0.0:
            return "the bend angle never changes: a sensor that stands still?"
        wrapped = [run.name for run in runs if _wraps(run.time, np.asarray(run.bend_angle))]
        if wrapped:
            return f"the bend angle of run {wrapped[0]} jumps by a turn at 180 deg; expected it to count on beyond half a turn"
        return f"the bend angle spans {turn:.3g} rad: degrees taken for rad?" if turn > MAX_TURN_RAD else None
    if MIN_TRAVEL * robot.length_m <= travel <= MAX_TRAVEL * robot.length_m:
        return None
    return (
        f"the tip travels {1e3 * travel:.3g} mm where robot {robot.name} is {1e3 * robot.length_m:.3g} mm long: "
        f"{'a sensor that stands still?' if travel == 0.0 else 'a wrong unit (m, mm or um)?'}"
    )


def _wraps(time: np.ndarray, angle: np.ndarray) -> bool:
    """Return whether ``angle`` (steps,) rad jumps from one end of a turn to the other."""
    jumps = (np.abs(np.diff(angle)) > WRAPPED_RAD) & (np.diff(time) < WRAPPED_S)
    return bool(jumps.any() and np.abs(angle).max() < np.pi + 0.1)


def motion_of(run: Recording, robot: Robot) -> np.ndarray:
    """Return what ``robot`` reports of its motion (steps, n) m: where the tip is, or its bend angle times its length."""
    if robot.output == "bend_angle":
        return robot.length_m * np.asarray(run.bend_angle)[:, None]
    return np.asarray(run.position)


def _size(motion: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum((motion - motion.mean(axis=0)) ** 2, axis=1))))
