"""What a recording's numbers must satisfy before anything is computed from them."""

from pathlib import Path

import numpy as np

from softrl.core.errors import RecordingError
from softrl.recordings.columns import Columns
from softrl.robots.robot import Robot

UNIT_RATIO = 20.0  # times the pressure limit: no sensor error, another unit
REACH_LENGTHS = 5.0  # a tip farther from the base than this many lengths is in another unit
TINY_SHARE = 5e-3  # a command that never reaches this share of the limit is in another unit
RELATED = 0.3  # correlation of a gauge with its command, above which it shows something of it
MEASURED_MARGIN = 0.25  # measured pressures may pass the limits by this share of the range: offsets, overshoot
SLOWEST_PERIOD_S = 60.0  # a slower median sampling period means that time is in another unit, or that pauses count
SLOW_S = 5.0  # rows farther apart are a table of poses, each of which somebody waited for
LONGEST_S = 28800.0  # a run of those that lasts longer is in another unit, too
FASTEST_PERIOD_S = 5e-5  # and so does a faster one: nothing that air moves is recorded at 20 kHz
HOTTEST_C = 200.0  # no elastomer stands more: kelvin, or another quantity
LARGEST_BEND_RAD = 6.0 * np.pi  # a backbone that is coiled three times round
SIGNED_SHARE, SIGNED_ROWS = 0.1, 0.01  # so far below 0, of the largest angle, in so many rows: it has a sign, no noise


def require_values(path: Path, header: list[str], table: np.ndarray, columns: Columns, robot: Robot | None) -> None:
    """Raise ``RecordingError`` for the first value of ``table`` (steps, columns) that cannot be right."""
    _require_finite(path, header, table)
    _require_increasing(path, header, table, columns)
    _require_unit_quaternion(path, header, table, columns)
    if robot is not None:
        _require_pressure(path, header, table, columns, robot)
        _require_reach(path, header, table, columns, robot)
        _require_size(path, header, table, columns, "tip_force", "N", UNIT_RATIO * robot.tip_force_max_n)
        for marker in columns.markers:
            _require_size(path, header, table, columns, marker, "m", REACH_LENGTHS * robot.length_m)
        if robot.output == "bend_angle" and not robot.bends_in_a_plane:
            _require_unsigned(path, header, table, columns, robot)
    _require_size(path, header, table, columns, "bend_angle", "rad", LARGEST_BEND_RAD)
    _require_size(path, header, table, columns, "temperature", "degree Celsius", HOTTEST_C)


def _line(row: int) -> int:
    return row + 2  # one for the header, one because lines count from 1


def _require_finite(path: Path, header: list[str], table: np.ndarray) -> None:
    bad = np.argwhere(~np.isfinite(table))
    if len(bad):
        row, column = bad[0]
        raise RecordingError(
            f"{path}, line {_line(row)}, column '{header[column]}': {table[row, column]} "
            f"({len(bad)} such values); expected numbers, or nan where motion was lost, in half of a run's rows at most; drop "
            "the rows, or the column if the channel is optional"
        )


def _require_increasing(path: Path, header: list[str], table: np.ndarray, columns: Columns) -> None:
    number, factor = columns.channels["time"][0]
    time = table[:, number]
    step = np.diff(time)
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 1
        raise RecordingError(
            f"{path}, line {_line(row)}, column '{header[number]}': {time[row]:.15g} does not exceed "
            f"{time[row - 1]:.15g} of the line before; expected increasing time; sort the rows and drop repeated ones"
        )
    period, lasts_s = float(np.median(step)) * factor, float(np.ptp(time)) * factor
    too_long = period > SLOW_S and lasts_s > LONGEST_S
    if too_long or not FASTEST_PERIOD_S <= period <= SLOWEST_PERIOD_S:
        advice = "is the column in another unit (time_s)?"
        if too_long or period > SLOWEST_PERIOD_S:
            unit = f"if these are milliseconds, {1e-3 * period:g} s, name the column time_ms; else " if factor == 1.0 else ""
            advice = f"{unit}leave out pauses: count times as if rows were at most {SLOWEST_PERIOD_S:g} s apart"
            advice += f", and cut runs of more than {LONGEST_S / 3600.0:g} h" if too_long else ""
        raise RecordingError(
            f"{path}, column '{header[number]}': the median sampling period is {period:g} s; expected "
            f"{FASTEST_PERIOD_S:g} to {SLOWEST_PERIOD_S:g} s{f', in {lasts_s / 3600.0:.3g} h' if too_long else ''}; {advice}"
        )


def _require_unit_quaternion(path: Path, header: list[str], table: np.ndarray, columns: Columns) -> None:
    place = columns.channels.get("quaternion")
    if place is None:
        return
    norm = np.linalg.norm(table[:, [place[i][0] for i in range(4)]], axis=1)
    bad = np.abs(norm - 1.0) > 0.05
    if bad.any():
        row = int(np.argmax(bad))
        raise RecordingError(
            f"{path}, line {_line(row)}, column '{header[place[0][0]]}': the quaternion has norm "
            f"{norm[row]:g}; expected 1 (order w x y z)"
        )


def _require_pressure(path: Path, header: list[str], table: np.ndarray, columns: Columns, robot: Robot) -> None:
    low, high = robot.pressure_min_pa, robot.pressure_max_pa
    limit = max(abs(low), abs(high))
    largest = dict.fromkeys(("pressure_cmd", "pressure_meas"), 0.0)
    for channel, margin in (("pressure_cmd", 1e-3), ("pressure_meas", MEASURED_MARGIN)):
        for number, factor in columns.channels.get(channel, {}).values():
            pressure = table[:, number] * factor
            slack = margin * (high - low)
            outside = (pressure < low - slack) | (pressure > high + slack)
            largest[channel] = max(largest[channel], float(np.abs(pressure).max()))
            if not outside.any():
                continue
            row = int(np.argmax(outside))
            if np.abs(pressure).max() > UNIT_RATIO * limit:
                row = int(np.argmax(np.abs(pressure)))
                what = f"more than {UNIT_RATIO:g} times the robot's limit; is the column in another unit?"
            else:
                what = "clip the run, or correct robot.pressure_min_pa and pressure_max_pa if they are wrong"
            raise RecordingError(
                f"{path}, line {_line(row)}, column '{header[number]}': {table[row, number]:g} is "
                f"{pressure[row]:g} Pa; expected {low:g} to {high:g} Pa for robot {robot.name}; {what}"
            )
    commanded = largest["pressure_cmd"]
    for channel, found in largest.items():
        if not 0.0 < found < TINY_SHARE * limit:  # pressures that stay at zero are no matter of units
            continue
        # nor are measured ones where nothing was asked for, or the noise of dead gauges
        if channel == "pressure_cmd" or (commanded > 20.0 * found and not _only_noise(table, columns)):
            name = header[columns.channels[channel][0][0]]
            raise RecordingError(
                f"{path}, column '{name}': no {channel} exceeds {found:g} Pa, under {TINY_SHARE:.1%} of the limit "
                f"{limit:g} Pa of robot {robot.name}; is the column in another unit?"
            )


def _only_noise(table: np.ndarray, columns: Columns) -> bool:
    """Return whether measured pressures move, though with none of their commands; the file's units do not matter."""
    commands, measured = (columns.channels[channel] for channel in ("pressure_cmd", "pressure_meas"))
    both = [chamber for chamber in commands if chamber in measured]
    asked, seen = (table[:, [channel[chamber][0] for chamber in both]] for channel in (commands, measured))
    return bool(np.ptp(seen, axis=0).any()) and not follows(asked, seen)


def follows(commands: np.ndarray, measured: np.ndarray) -> bool:
    """Return whether any of the ``measured`` pressures (steps, chambers) goes with its command: those of a dead gauge do not."""
    for command, pressure in zip(commands.T, measured.T, strict=True):
        if np.ptp(command) > 0.0 and np.ptp(pressure) > 0.0 and abs(np.corrcoef(command, pressure)[0, 1]) > RELATED:
            return True
    return False


def _require_size(
    path: Path, header: list[str], table: np.ndarray, columns: Columns, channel: str, unit: str, largest: float
) -> None:
    """Refuse values of a channel that only another unit explains."""
    for number, factor in columns.channels.get(channel, {}).values():
        size = np.abs(table[:, number] * factor)
        row = int(np.argmax(size))
        if size[row] > largest:
            raise RecordingError(
                f"{path}, line {_line(row)}, column '{header[number]}': {table[row, number]:g} is "
                f"{size[row]:g} {unit}; expected at most {largest:g} {unit}; is the column in another unit?"
            )


def _require_unsigned(path: Path, header: list[str], table: np.ndarray, columns: Columns, robot: Robot) -> None:
    """Refuse bend angles below zero, but for noise, of a robot that bends in many planes."""
    for number, _ in columns.channels.get("bend_angle", {}).values():
        angle = table[:, number]
        if np.quantile(angle, SIGNED_ROWS) < -SIGNED_SHARE * np.abs(angle).max():
            row = int(np.argmin(angle))
            raise RecordingError(
                f"{path}, line {_line(row)}, column '{header[number]}': {angle[row]:g} is negative; expected 0 or more: the "
                f"chambers of robot {robot.name} bend it in more than one plane, where the angle of tip and base has no sign; "
                "record the tip's position, or correct robot.chamber_angle_deg"
            )


def _require_reach(path: Path, header: list[str], table: np.ndarray, columns: Columns, robot: Robot) -> None:
    place = columns.channels.get("position")
    if place is None:
        return
    tip = np.stack([table[:, place[i][0]] * place[i][1] for i in range(3)], axis=1)
    reach = np.linalg.norm(tip, axis=1)
    row, name = int(np.argmax(reach)), header[place[0][0]]
    if reach[row] > REACH_LENGTHS * robot.length_m:
        raise RecordingError(
            f"{path}, line {_line(row)}, column '{name}': the tip is {reach[row]:g} m from the base; "
            f"expected at most {REACH_LENGTHS * robot.length_m:g} m ({REACH_LENGTHS:g} lengths of robot {robot.name}); "
            "is it in another unit?"
        )
    if reach[row] < robot.length_m / 50.0:
        raise RecordingError(
            f"{path}, column '{name}': the tip never is farther than {reach[row]:g} m from the base of a robot "
            f"of {robot.length_m:g} m; expected positions from the base, in the unit that the column names"
        )
