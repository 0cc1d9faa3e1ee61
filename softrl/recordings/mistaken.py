"""Columns that cannot hold what they are called: exchanged, mirrored, ahead of their cause, in another unit."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from softrl.recordings.check import EXCITED_SHARE
from softrl.recordings.frame import axis_vector, rotate
from softrl.recordings.recording import Recording
from softrl.recordings.scale import FOLLOWS, MIN_SHARE, UNIT_FACTOR, correlation, scale_of
from softrl.robots.robot import Robot

STEP_S = 0.05  # of the even times on which channels are compared
FOREIGN = 0.5  # correlation of a pressure with a command that it does not follow
PSI, LAGGING = 6.89, FOLLOWS**2  # kPa, and no unit is nearer; what lags moves less than what it follows, by so much at most
NO_GAIN = 15.0  # another size than this no regulator has
TURNED_RAD = 0.7  # a tip at rest this far off the robot's axis is told in a turned frame
EXPLAINED = 0.5  # share of the sideways motion that a mirror image must explain to be one
MIRROR_GAIN = 0.3  # by which it must explain more than the motion itself, in every turn of the frame
LEAD_S = 0.1  # an effect that comes earlier than its cause by less may be a matter of clocks and filters
LONGEST_S = 2.0  # leads and delays that are compared
OPPOSED = 0.7  # correlation of a bend angle with the other way of the simulated one, or with its size: its sign is wrong, or lost
AS_WELL = 0.05  # a command that may be delayed explains a pressure as well as another if its correlation is less by no more
LEAD_GAIN = 0.7  # a lead must leave less than this share of what the best delay leaves


def mistaken(runs: Sequence[Recording], simulated: Sequence[Recording], robot: Robot) -> str | None:
    """Return why the columns of ``runs`` cannot be what they are called, or None.

    Parameters
    ----------
    runs : as recorded
    simulated : what the simulator does under the same commands, run by run
    robot : whose runs they are
    """
    told = _exchanged(runs, robot) or _unlike(runs, robot)
    told = told or _rescaled(runs, simulated, robot) or _early(runs, simulated, robot)
    return told or _mirrored(runs, simulated, robot) or _opposed(runs, simulated, robot)


def _exchanged(runs: Sequence[Recording], robot: Robot) -> str | None:
    """Return which measured pressure follows another chamber's command instead of its own, and its own no better if delayed.

    Chambers driven in a ring one after another, behind slow regulators, seem exchanged until each is given its delay.
    """
    for run, cmd, meas in _pressures(runs, robot):
        moved = np.flatnonzero(np.ptp(cmd, axis=0) > MIN_SHARE * (robot.pressure_max_pa - robot.pressure_min_pa))
        alike = np.array([[correlation(meas[:, i], cmd[:, j]) for j in moved] for i in moved])
        for i, row in enumerate(alike):
            j = int(np.argmax(row))
            if row[j] > FOLLOWS and row[i] < FOREIGN:
                own, foreign = (_delayed(cmd[:, moved[k]], meas[:, moved[i]]) for k in (i, j))
                if own > foreign - AS_WELL:
                    continue
                return (
                    f"run {run.name}: the measured pressure of chamber {moved[i] + 1} follows the command of chamber "
                    f"{moved[j] + 1} (correlation {row[j]:.2f}) and not its own ({row[i]:.2f}): columns exchanged"
                )
    return None


def _delayed(cause: np.ndarray, effect: np.ndarray) -> float:
    """Return the correlation of ``effect`` (steps,) with ``cause`` (steps,), delayed as suits best, by up to ``LONGEST_S``."""
    delays = range(min(round(LONGEST_S / STEP_S) + 1, len(cause) // 2))
    return max(correlation(cause[: len(cause) - k], effect[k:]) for k in delays)


def _unlike(runs: Sequence[Recording], robot: Robot) -> str | None:
    """Return by how much measured pressures that follow their commands differ from them in size, as another unit does.

    That is in all chambers alike. What is wrong in one chamber alone may be its hose or regulator, unless it is beyond either.
    """
    if robot.command != "pressure":
        return None
    pairs = [pair[1:] for pair in _pressures(runs, robot)]
    scales = {}
    for chamber in range(robot.chambers if pairs else 0):
        x, y = (np.concatenate([pair[side][:, chamber] for pair in pairs]) for side in (0, 1))
        if np.ptp(x) >= MIN_SHARE * (robot.pressure_max_pa - robot.pressure_min_pa) and correlation(x, y) >= FOLLOWS:
            scales[chamber] = scale_of(x, y, robot)
    far = {c: scale for c, scale in scales.items() if not 1.0 / NO_GAIN < scale < NO_GAIN}
    least, most = min(scales.values(), default=1.0), max(scales.values(), default=1.0)
    if not far and most > 1.1 / PSI and least < LAGGING * PSI:
        return None
    chamber, scale = next(iter((far or scales).items()))
    return (
        f"the measured pressure of chamber {chamber + 1} follows its command but is {scale:.3g} times as large: "
        "a wrong unit of one of them (psi is 6.89 kPa, bar 100 kPa)?"
    )


def _early(runs: Sequence[Recording], simulated: Sequence[Recording], robot: Robot) -> str | None:
    """Return by how long a measured pressure, or the motion, comes before the command that brings it about."""
    pairs = {"the measured pressure comes before its command": [p[1:] for p in _pressures(runs, robot)]}
    pairs["the motion comes before the command that brings it about"] = [
        (_even(run, _motion(made, robot)), _even(run, _motion(run, robot)))
        for run, made in zip(runs, simulated, strict=True)
    ]
    for what, series in pairs.items():
        if series and (lead := _lead(series)) is not None:
            return f"{what}, by {lead:.2g} s: columns exchanged, or clocks that differ"
    return None


def _lead(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> float | None:
    """Return by how long, s, the second series of every pair (steps, n) comes before the first, if it does.

    What a linear map of the first, shifted in time, leaves of the second is compared for leads and for delays.
    """
    shifts = np.arange(-round(LONGEST_S / STEP_S), round(LONGEST_S / STEP_S) + 1)
    left = np.array([_left(pairs, int(shift)) for shift in shifts])
    best = int(np.argmin(left))
    if shifts[best] * STEP_S > -LEAD_S or left[best] > LEAD_GAIN * left[shifts >= 0].min():
        return None
    return float(-shifts[best] * STEP_S)


def _left(pairs: Sequence[tuple[np.ndarray, np.ndarray]], shift: int) -> float:
    """Return the share of the second series' variance that the first, ``shift`` steps later, does not explain."""
    margin = round(LONGEST_S / STEP_S)
    causes, effects = [], []
    for cause, effect in pairs:
        if len(cause) > 4 * margin:
            middle = slice(margin, len(cause) - margin)
            causes.append(cause[margin - shift : len(cause) - margin - shift])
            effects.append(effect[middle] - effect[middle].mean(axis=0))
    if not causes:
        return 1.0
    x = np.concatenate([c - c.mean(axis=0) for c in causes])
    y = np.concatenate(effects)
    if not y.any():  # of what stands still nothing comes early
        return 1.0
    rest = y - x @ np.linalg.lstsq(x, y, rcond=1e-6)[0]
    return float(np.sum(rest**2) / np.sum(y**2))


def _mirrored(runs: Sequence[Recording], simulated: Sequence[Recording], robot: Robot) -> str | None:
    """Return where the tip's sideways motion is the mirror image of what the pressures bring about.

    A frame that is turned, and a motion of another size, explain no mirror image. Exchanging two chambers mirrors the
    motion, and so does exchanging two columns of the tip, or the sign of one.
    """
    if robot.output == "bend_angle" or robot.chambers < 2:
        return None
    pairs = [(_sideways(run, robot), _sideways(made, robot)) for run, made in zip(runs, simulated, strict=True)]
    largest = max(float(np.std(seen)) for seen, _ in pairs)
    groups = {"all runs together": list(range(len(runs)))} | {f"run {run.name}": [k] for k, run in enumerate(runs)}
    for where, mine in groups.items():
        seen, made = (np.concatenate([pairs[k][side] for k in mine]) for side in (0, 1))
        size = float(np.sum(np.abs(seen) ** 2) * np.sum(np.abs(made) ** 2))
        if size == 0.0 or np.std(seen) < MIN_SHARE * largest:
            continue
        itself, image = (float(np.abs(np.sum(way * seen)) ** 2 / size) for way in (np.conj(made), made))
        if image > EXPLAINED and image > itself + MIRROR_GAIN:
            return (
                f"{where}: the tip moves as the mirror image of what the pressures bring about ({image:.0%} of its "
                f"sideways motion, against {itself:.0%} unmirrored): columns of two chambers or of the tip are "
                "exchanged, or a sign is wrong"
            )
    return None


def _opposed(runs: Sequence[Recording], simulated: Sequence[Recording], robot: Robot) -> str | None:
    """Return where the bend angle falls while pressures raise it, or has no sign though pressures bend the tip both ways."""
    if robot.output != "bend_angle":
        return None
    driven = MIN_SHARE * float(np.std(np.concatenate([_motion(made, robot) for made in simulated])))
    for where in ("", *dict.fromkeys(run.session for run in runs)):
        pairs = [(run, made) for run, made in zip(runs, simulated, strict=True) if where in ("", run.session)]
        seen, made = (np.concatenate([_motion(run, robot)[:, 0] for run in side]) for side in zip(*pairs, strict=True))
        if np.std(made) < driven:
            continue
        alike, place = correlation(seen, made), f"session {where}: " if where else ""
        if alike < -OPPOSED:
            return (
                f"{place}the angle falls where pressure bends the tip (correlation {alike:.2f} with what is simulated): expected "
                "positive there; change its sign, or robot.chamber_angle_deg"
            )
        if correlation(seen, np.abs(made)) > max(OPPOSED, alike + MIRROR_GAIN):
            return (
                f"{place}the angle has no sign, though pressures bend the tip both ways: expected positive where pressure in "
                "chamber 1 bends it, and negative the other way"
            )
    return None


def _sideways(run: Recording, robot: Robot) -> np.ndarray:
    """Return the tip's motion (samples,) across the backbone as complex numbers, about its mean.

    Where the run shows the tip at rest somewhere else than the robot's axis leads, it is turned there the shortest way.
    """
    tip, axis = np.asarray(run.position), axis_vector(robot.axis)
    rest = np.median(tip[still(run, robot)], axis=0) if still(run, robot).any() else robot.length_m * axis
    length = float(np.linalg.norm(rest))
    if 1.0 / UNIT_FACTOR < length / robot.length_m < UNIT_FACTOR and rest @ axis < np.cos(TURNED_RAD) * length:
        tip = rotate(_shortest(rest / length, axis), tip)
    across = rotate(_shortest(axis, np.array([0.0, 0.0, 1.0])), tip)
    moved = across - across.mean(axis=0)
    return np.asarray(moved[:, 0] + 1j * moved[:, 1])


def _shortest(start: np.ndarray, end: np.ndarray) -> Rotation:
    """Return the shortest rotation of the unit vector ``start`` onto ``end``; half a turn about x or y if opposite."""
    normal = np.cross(start, end)
    if np.linalg.norm(normal) < 1e-6:
        other = np.array([1.0, 0.0, 0.0]) if abs(end[0]) < 0.5 else np.array([0.0, 1.0, 0.0])
        return Rotation.from_rotvec(np.pi * other if start @ end < 0.0 else np.zeros(3))
    angle = np.arctan2(np.linalg.norm(normal), start @ end)
    return Rotation.from_rotvec(angle * normal / np.linalg.norm(normal))


def still(run: Recording, robot: Robot) -> np.ndarray:
    """Return which samples (steps,) are under no pressure."""
    span = robot.pressure_max_pa - robot.pressure_min_pa
    return np.all(np.abs(run.pressure_cmd) < EXCITED_SHARE * span, axis=1)


def _rescaled(runs: Sequence[Recording], simulated: Sequence[Recording], robot: Robot) -> str | None:
    """Return by how much both the tip's place at rest and its motion are too large or too small."""
    if robot.output == "bend_angle":
        return None
    rests = [np.median(np.asarray(run.position)[still(run, robot)], axis=0) for run in runs if still(run, robot).any()]
    if not rests:
        return None
    reach = float(np.median(np.linalg.norm(rests, axis=1))) / robot.length_m
    seen, made = (np.concatenate([np.asarray(r.position) for r in side]) for side in (runs, simulated))
    moved = float(np.linalg.norm(seen.std(axis=0)) / max(np.linalg.norm(made.std(axis=0)), 1e-300))
    for small, large in ((reach, moved), (1.0 / max(reach, 1e-9), 1.0 / max(moved, 1e-9))):
        if max(small, large) < 1.0 / UNIT_FACTOR:
            return (
                f"at rest the tip is {1e3 * reach * robot.length_m:.3g} mm from the origin where robot {robot.name} is "
                f"{1e3 * robot.length_m:.3g} mm long, and it moves {moved:.3g} times as far as the simulator: another unit "
                "(m, cm, mm)?"
            )
    return None


def _pressures(runs: Sequence[Recording], robot: Robot) -> Iterator[tuple[Recording, np.ndarray, np.ndarray]]:
    """Yield (run, commanded, measured) on even times, for the runs with measured pressure."""
    for run in runs:
        if run.pressure_meas is not None:
            yield run, _even(run, run.pressure_cmd), _even(run, run.pressure_meas)


def _even(run: Recording, values: np.ndarray) -> np.ndarray:
    """Return ``values`` (samples, n) at times ``STEP_S`` apart."""
    time = np.arange(run.time[0], run.time[-1], STEP_S)
    return np.stack([np.interp(time, run.time, column) for column in values.T], axis=1)


def _motion(run: Recording, robot: Robot) -> np.ndarray:
    if robot.output == "bend_angle":
        return np.asarray(run.bend_angle)[:, None]
    return np.asarray(run.position)
