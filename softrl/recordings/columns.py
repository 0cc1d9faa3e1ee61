"""The columns a recording file may have, and which array each of them belongs to."""

import difflib
import re
from dataclasses import dataclass, field
from pathlib import Path

from softrl.core.errors import RecordingError
from softrl.core.units import FACTORS
from softrl.recordings.lost import MOTION
from softrl.robots.robot import Robot

EXPECTED = (
    "time_s, p1_cmd_kpa.. (or <robot.command>_cmd), p1_meas_kpa.., tip_x_mm tip_y_mm tip_z_mm, "
    "tip_qw tip_qx tip_qy tip_qz, bend_angle_deg, marker1_x_mm.., force_x_n.., temp_c"
)

# pattern -> (channel key, index within the channel, SI unit or "" for none)
_PATTERNS: tuple[tuple[str, str, str], ...] = (
    (r"time_(?P<unit>[a-z]+)", "time", "s"),
    (r"p(?P<number>\d+)_cmd_(?P<unit>[a-z]+)", "pressure_cmd", "Pa"),
    (r"p(?P<number>\d+)_meas_(?P<unit>[a-z]+)", "pressure_meas", "Pa"),
    (r"tip_(?P<xyz>[xyz])_(?P<unit>[a-z]+)", "position", "m"),
    (r"tip_q(?P<wxyz>[wxyz])", "quaternion", ""),
    (r"bend_angle_(?P<unit>[a-z]+)", "bend_angle", "rad"),
    (r"force_(?P<xyz>[xyz])_(?P<unit>[a-z]+)", "tip_force", "N"),
    (r"(?P<marker>marker[a-z0-9]+)_(?P<xyz>[xyz])_(?P<unit>[a-z]+)", "markers", "m"),
    (r"temp_c", "temperature", ""),
)
MARKERS = [f"marker{number}_{axis}_mm" for number in range(1, 33) for axis in "xyz"]  # usual names
MARKER_ALIKE = 0.85  # similarity, of 1, from which a column is a marker's misspelt: marker_id and such are the user's own
_WIDTH = {"time": 1, "position": 3, "quaternion": 4, "bend_angle": 1, "tip_force": 3, "temperature": 1}


@dataclass
class Columns:
    """Where each channel's components are found.

    Attributes
    ----------
    channels : channel -> {component index: (column number, factor to SI)}; a marker's channel is its name
    markers : names of the marker channels
    others : columns that are nothing of ours
    """

    channels: dict[str, dict[int, tuple[int, float]]] = field(default_factory=dict)
    markers: list[str] = field(default_factory=list)
    others: list[str] = field(default_factory=list)

    @property
    def used(self) -> list[int]:
        """Numbers of the columns that are read."""
        return sorted(number for place in self.channels.values() for number, _ in place.values())

    @property
    def motion(self) -> list[int]:
        """Numbers of the columns that hold motion, of which samples may be lost."""
        shown = (self.channels.get(channel, {}) for channel in (*MOTION, *self.markers))
        return sorted(number for place in shown for number, _ in place.values())


def match_columns(header: list[str], robot: Robot | None, path: Path) -> Columns:
    """Return where the channels of ``path`` stand in its ``header``.

    Raises
    ------
    RecordingError
        If a column is nearly one of ours, named twice, in a unit of another quantity, or if a channel is incomplete.
    """
    found = Columns()
    for number, name in enumerate(header):
        hit = _match(name, number, robot, path)
        if hit is None:
            found.others.append(name)
            continue
        channel, component, factor = hit
        if channel.startswith("marker") and channel not in found.markers:
            found.markers.append(channel)
        place = found.channels.setdefault(channel, {})
        if component in place:
            raise RecordingError(f"{path}, line 1: column '{name}' names {channel} a second time; remove one")
        place[component] = (number, factor)
    _require_complete(found, header, robot, path)
    return found


def _match(name: str, number: int, robot: Robot | None, path: Path) -> tuple[str, int, float] | None:
    """Return channel, component and factor to SI of a column; None if its name is like none of ours."""
    for pattern, channel, unit in _PATTERNS:
        hit = re.fullmatch(pattern, name)
        if hit is None:
            continue
        parts = hit.groupdict()
        factor = _factor(name, parts.get("unit"), unit, path)
        return parts.get("marker") or channel, _component(parts), factor
    if robot is not None and robot.command != "pressure":
        hit = re.fullmatch(rf"{re.escape(robot.command)}(?P<number>\d*)_cmd", name)
        if hit is not None:
            return "pressure_cmd", int(hit["number"] or 1) - 1, robot.command_to_pa
    hint = ""
    if re.fullmatch(r"[a-z_]+\d*_cmd", name) and robot is not None:
        hint = f"; robot.command={robot.command} of {robot.name}: set it to '{name[:-4]}' if this is its command"
    if not hint and (near := _near(name.lower(), robot)):
        hint = f"; did you mean '{near}'?"
    if not hint:
        return None
    raise RecordingError(f"{path}, line 1, column {number + 1}: unknown column '{name}'; expected {EXPECTED}{hint}")


def _near(name: str, robot: Robot | None) -> str:
    """Return the usual name that ``name`` is nearly; empty if there is none."""
    usual = _names(robot)
    short = (whole for whole in (*usual, *MARKERS) if whole.startswith(f"{name}_"))
    marker = max(MARKERS, key=lambda whole: _alike(whole, name))
    near = (*short, *difflib.get_close_matches(name, usual, n=1), *([marker] if _alike(marker, name) >= MARKER_ALIKE else []))
    return next(iter(near), "")


def _alike(one: str, other: str) -> float:
    return difflib.SequenceMatcher(None, one, other).ratio()


def _names(robot: Robot | None) -> list[str]:
    """Return the usual names of columns, to guess which one was meant."""
    chambers = range(1, 1 + (robot.chambers if robot is not None else 3))
    return [
        "time_s", *(f"p{i}_{kind}_kpa" for i in chambers for kind in ("cmd", "meas")), *(f"tip_{i}_mm" for i in "xyz"),
        *(f"tip_q{i}" for i in "wxyz"), "bend_angle_deg", *(f"force_{i}_n" for i in "xyz"), "temp_c",
    ]  # fmt: skip


def _component(parts: dict[str, str]) -> int:
    if parts.get("xyz"):
        return "xyz".index(parts["xyz"])
    if parts.get("wxyz"):
        return "wxyz".index(parts["wxyz"])
    return int(parts.get("number") or 1) - 1


def _factor(name: str, suffix: str | None, unit: str, path: Path) -> float:
    if suffix is None:
        return 1.0
    known = [s for s, (si, _) in FACTORS.items() if si == unit]
    if suffix not in known:
        raise RecordingError(
            f"{path}, line 1: column '{name}' is in '{suffix}', which is no unit of {unit}; expected {', '.join(known)}"
        )
    return FACTORS[suffix][1]


def _require_complete(found: Columns, header: list[str], robot: Robot | None, path: Path) -> None:
    for needed in ("time", "pressure_cmd"):
        if needed not in found.channels:
            wanted = "time_s" if needed == "time" else _command_columns(robot)
            raise RecordingError(f"{path}, line 1: column '{wanted}' is missing; found {', '.join(header)}")
    chambers = robot.chambers if robot is not None else len(found.channels["pressure_cmd"])
    for channel, place in found.channels.items():
        width = chambers if channel.startswith("pressure") else _WIDTH.get(channel, 3)
        if sorted(place) != list(range(width)):
            have = ", ".join(header[number] for number, _ in place.values())
            who = f" for robot {robot.name}" if robot is not None and channel.startswith("pressure") else ""
            raise RecordingError(
                f"{path}, line 1: {channel} needs {width} column(s){who}, without a hole, found {have}; "
                "add or rename columns, or choose the robot that made the recording"
            )


def _command_columns(robot: Robot | None) -> str:
    if robot is None or robot.command == "pressure":
        return "p1_cmd_kpa"
    return f"{robot.command}_cmd" if robot.chambers == 1 else f"{robot.command}1_cmd"
