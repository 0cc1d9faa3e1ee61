"""Read a dataset folder, ``dataset.yaml`` and one CSV a run, into recordings in SI units."""

import itertools
import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from softrl.core.errors import RecordingError
from softrl.recordings.columns import Columns, match_columns
from softrl.recordings.frame import continuous_quaternion, rotate, rotation_between, turn
from softrl.recordings.lost import LOST_MOST, lost
from softrl.recordings.run import Recording
from softrl.recordings.store import DATASET, OF_SESSIONS
from softrl.recordings.validate import require_values
from softrl.robots.robot import AXES, Robot

log = logging.getLogger(__name__)

EPOCH_S = 1e8  # a later time counts from an epoch, as Unix time does: no session goes on for three years
SAME_ROW_S = 1e-3  # by which a run may begin before the end of another: the row at which a log was cut stands in both
NAMING = ("disturbed", "out_of_distribution")  # notes that hold names of runs or sessions, as they are written


@dataclass(frozen=True)
class Session:
    """One entry of ``sessions`` in dataset.yaml: its runs, the backbone's direction, and free notes."""

    name: str
    runs: tuple[str, ...]
    axis: str | None = None
    notes: dict[str, Any] = field(default_factory=dict)


def load_runs(folder: Path | str, robot: Robot | None) -> tuple[str, tuple[Recording, ...], dict[str, Any]]:
    """Return the robot's name, its runs, and the notes of a dataset folder; see ``recordings.read``."""
    folder = Path(folder)
    head, sessions = _dataset(folder)
    if robot is not None and head["robot"] != robot.name:
        raise RecordingError(
            f"{folder / DATASET}: robot '{head['robot']}' made these recordings, but '{robot.name}' is chosen; "
            f"choose robot={head['robot']}"
        )
    recorded = [_read_run(folder / f"{run}.csv", run, session, robot) for session in sessions for run in session.runs]
    _require_order(recorded, folder / DATASET)
    recordings = _since_each_session(recorded)
    if not recordings:
        raise RecordingError(f"{folder} names no runs; expected one CSV file a run beside {DATASET}")
    extras = {s.name: s.notes for s in sessions if s.notes}
    notes = head["notes"] | ({OF_SESSIONS: extras} if extras else {})
    return head["robot"], recordings, notes


class _Names(yaml.BaseLoader):
    """Reads plain strings, and refuses what is named twice: of a session's runs the first would be forgotten."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Return the mapping of ``node``."""
        named = [self.construct_object(key, deep=True) for key, _ in node.value]
        for key in {key for key in named if named.count(key) > 1}:
            raise yaml.YAMLError(f"key '{key}' is there {named.count(key)} times; expected each once")
        return dict(super().construct_mapping(node, deep=deep))


def _dataset(folder: Path) -> tuple[dict[str, Any], list[Session]]:
    path = folder / DATASET
    if not folder.is_dir():
        raise RecordingError(f"{folder} is no folder; expected a dataset folder with {DATASET} and one CSV a run")
    if not path.is_file():
        raise RecordingError(f"{path} is missing; expected a file with at least the line 'robot: <name>'")
    text = _text(path)
    try:
        # plain strings for names: YAML would turn a run called 2020_0908 into the number 20200908
        names, typed = yaml.load(text, Loader=_Names), yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise RecordingError(f"{path} is no YAML: {' '.join(str(error).split())}") from error
    if not isinstance(names, dict) or not isinstance(names.get("robot"), str):
        raise RecordingError(f"{path}: key 'robot' is missing; expected the name of the robot, as in conf/robot")
    notes = {key: value for key, value in typed.items() if key not in ("robot", "sessions", "units", "frame")}
    notes |= {key: names[key] for key in NAMING if key in notes}
    return {"robot": names["robot"], "notes": notes}, _sessions(names.get("sessions"), folder)


def _sessions(entry: Any, folder: Path) -> list[Session]:
    path = folder / DATASET
    present = sorted((file.stem for file in folder.glob("*.csv")), key=_counted)
    if entry is None or entry == "":
        return [Session(run, (run,)) for run in present]
    if not isinstance(entry, dict):
        raise RecordingError(f"{path}: sessions must map a name to {{runs: [...]}}, got {type(entry).__name__}")
    sessions = [_session(name, value, path) for name, value in entry.items()]
    named = [run for session in sessions for run in session.runs]
    for run in named:
        if named.count(run) > 1:
            raise RecordingError(f"{path}: run '{run}' is named {named.count(run)} times; each run has one session")
        if run not in present:
            raise RecordingError(
                f"{path}: run '{run}' is named, but {folder / f'{run}.csv'} does not exist; "
                f"found {', '.join(present) or 'no CSV file'}"
            )
    left_out = sorted(set(present) - set(named))
    if left_out:
        log.warning("%s names no session for %s: left out", path, ", ".join(left_out))
    return sessions


def _counted(name: str) -> list[tuple[int, str]]:
    """Return what sorts names as people count them, run_2 before run_10: their order says what came later."""
    return [(int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", name)]


def _session(name: str, value: Any, path: Path) -> Session:
    value = {"runs": value} if isinstance(value, list) else value
    if not isinstance(value, dict) or not isinstance(value.get("runs"), list) or not value["runs"]:
        raise RecordingError(f"{path}: session '{name}' needs 'runs: [...]' with at least one run, got {value!r}")
    axis = value.get("axis")
    if axis is not None and axis not in AXES:
        raise RecordingError(f"{path}: session '{name}' has axis '{axis}'; expected one of {', '.join(AXES)}")
    runs = tuple(re.sub(r"\.csv$", "", str(run)) for run in value["runs"])
    return Session(name, runs, axis, {k: v for k, v in value.items() if k not in ("runs", "axis")})


def _read_run(path: Path, name: str, session: Session, robot: Robot | None) -> Recording:
    header, lines = _table(path)
    columns = match_columns(header, robot, path)
    if columns.others:
        log.warning("%s: columns of other names are left out: %s", path, ", ".join(columns.others))
    table, unseen = _with_lost_motion(path, _values(path, header, lines, columns), columns)
    require_values(path, header, table, columns, robot)
    arrays = {channel: _channel(table, place) for channel, place in columns.channels.items()}
    arrays = _in_base_frame(arrays, session.axis, robot.axis if robot is not None else "+z")
    markers = {marker: arrays.pop(marker) for marker in columns.markers}
    for flat in ("time", "bend_angle", "temperature"):
        if flat in arrays:
            arrays[flat] = arrays[flat][:, 0]
    run = Recording(name=name, session=session.name, markers=markers, **arrays)
    return lost(run, unseen) if unseen.any() else run


def _with_lost_motion(path: Path, table: np.ndarray, columns: Columns) -> tuple[np.ndarray, np.ndarray]:
    """Return the table with motion that is missing (nan) held from the sample before, and in which rows (samples,) it was.

    Where more than ``LOST_MOST`` of them lack some of it nothing is held.
    """
    moved = columns.motion
    unseen = np.isnan(table[:, moved]).any(axis=1)
    if not unseen.any() or np.mean(unseen) > LOST_MOST:
        return table, np.zeros(len(table), dtype=bool)
    log.warning("%s: %d rows without motion (nan): what was commanded then acts, and nothing is compared", path, unseen.sum())
    last = np.maximum.accumulate(np.where(unseen, np.argmin(unseen), np.arange(len(table))))
    held = table.copy()
    held[:, moved] = table[last][:, moved]
    return held, unseen


def _require_order(recordings: Sequence[Recording], path: Path) -> None:
    """Refuse runs of a session that by a clock were recorded before the one listed before them ended; warn of such sessions.

    What drifts, fails or begins at a moment is dated by the order of runs. A clock may be set back between two sessions.
    """
    timed = [run for run in recordings if run.time[0] >= EPOCH_S]
    for before, run in itertools.pairwise(timed):
        early_s = float(before.time[-1] - run.time[0])
        if early_s <= SAME_ROW_S:
            continue
        if run.session == before.session:
            raise RecordingError(
                f"{path}: session '{run.session}': run '{run.name}' begins {early_s:g} s before the end of run '{before.name}', "
                "which is listed before it; list runs in the order of recording"
            )
        log.warning(
            "%s: session '%s' begins %g s before the end of session '%s', which counts as recorded before it; list sessions in "
            "the order of recording (without the key sessions it is that of the names)",
            path, run.session, early_s, before.session,
        )  # fmt: skip


def _since_each_session(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Return the runs, those whose times count from an epoch counted from the earliest such sample of their session.

    One offset for all runs of a session keeps the pauses between them. Times as large as Unix time are known to 2e-7 s only,
    and what is made of steps between them goes wrong by as much with every step.
    """
    begins: dict[str, float] = {}
    for run in recordings:
        if run.time[0] >= EPOCH_S:
            begins[run.session] = min(float(run.time[0]), begins.get(run.session, np.inf))
    return tuple(
        replace(run, time=run.time - begins[run.session]) if run.time[0] >= EPOCH_S else run for run in recordings
    )


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"{path}: byte {error.start} is no UTF-8; expected a text file: save it as CSV or YAML in UTF-8"
        ) from error


def _table(path: Path) -> tuple[list[str], list[str]]:
    """Return the header, and all lines with it, of as many cells each."""
    lines = _text(path).splitlines()
    if not lines or not lines[0].strip():
        raise RecordingError(f"{path} is empty; expected a header line and one line a sample")
    header = [cell.strip().strip('"') for cell in lines[0].split(",")]
    _require_commas(path, lines)
    samples = sum(bool(line.strip()) for line in lines[1:])
    if samples < 2:
        raise RecordingError(f"{path} holds {samples} samples; expected at least 2")
    _require_equal_width(path, header, lines)
    return header, lines


def _values(path: Path, header: list[str], lines: list[str], columns: Columns) -> np.ndarray:
    """Return the table (samples, columns), read where the columns are ours, nan where motion is missing, and zero elsewhere."""
    used, moved = columns.used, columns.motion
    try:
        full = [_with_nan(line, moved) for line in lines[1:] if line.strip()]
        read = np.loadtxt(full, delimiter=",", ndmin=2, comments=None, usecols=used)
    except ValueError as error:
        raise RecordingError(_bad_cell(path, header, lines, used)) from error
    table = np.zeros((len(read), len(header)))
    table[:, used] = read
    return table


def _with_nan(line: str, moved: list[int]) -> str:
    """Return a ``line`` with nan in the empty ones of its cells ``moved``."""
    if ",," not in f",{line.replace(' ', '').rstrip()},":
        return line
    cells = line.split(",")
    return ",".join("nan" if k in moved and not cell.strip() else cell for k, cell in enumerate(cells))


def _require_commas(path: Path, lines: list[str]) -> None:
    for sign, name in ((";", "semicolons"), ("\t", "tabs")):
        if sign in lines[0]:
            decimals = ", and points in decimals" if any("," in line for line in lines[1:]) else ""
            raise RecordingError(
                f"{path}, line 1: columns are separated by {name} ('{lines[0][:40]}'); expected commas{decimals}: "
                "save it as comma-separated values"
            )


def _require_equal_width(path: Path, header: list[str], lines: list[str]) -> None:
    for number, line in enumerate(lines[1:], start=2):
        width = line.count(",") + 1
        if width == len(header) or not line.strip():
            continue
        cure = "add or remove values"
        if width > len(header) and "." not in line:
            cure = "are decimals written with a comma? write them with a point"
        raise RecordingError(
            f"{path}, line {number}: {width} values for {len(header)} columns ('{line[:40]}'); expected "
            f"{len(header)}: {cure}"
        )


def _bad_cell(path: Path, header: list[str], lines: list[str], used: list[int]) -> str:
    """Return the message for the first cell of the ``used`` columns that is no number."""
    for number, line in enumerate(lines[1:], start=2):
        for place, (column, cell) in enumerate(zip(header, line.split(","), strict=False)):
            if place not in used or not line.strip():
                continue
            try:
                float(cell)
            except ValueError:
                where = f"{path}, line {number}, column '{column}'"
                return f"{where}: '{cell.strip()}' is no number; expected one such as -1.5; correct or drop the row"
    return f"{path} cannot be read as comma-separated numbers; expected a header line and one line a sample"


def _channel(table: np.ndarray, place: dict[int, tuple[int, float]]) -> np.ndarray:
    """Return (steps, components) in SI units."""
    return np.stack([table[:, place[i][0]] * place[i][1] for i in range(len(place))], axis=1)


def _in_base_frame(arrays: dict[str, np.ndarray], axis: str | None, wanted: str) -> dict[str, np.ndarray]:
    if "quaternion" in arrays:
        arrays["quaternion"] = continuous_quaternion(arrays["quaternion"])
    if axis is None or axis == wanted:
        return arrays
    rotation = rotation_between(axis, wanted)
    for channel, values in arrays.items():
        if channel in ("position", "tip_force") or channel.startswith("marker"):
            arrays[channel] = rotate(rotation, values)
        elif channel == "quaternion":
            arrays[channel] = turn(rotation, values)
    return arrays
