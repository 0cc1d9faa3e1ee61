"""What may be hidden, how large, and which names count as the right answer: frozen before any result.

``RIGHT`` is part of what the answer key's hash covers. Where two of a library's members describe a hidden law
equally well, both count; ``INSEPARABLE`` says which and why.
"""

import hashlib
import inspect
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from softrl.proof.generator import laws

UP = -9.0


@dataclass(frozen=True)
class Hidden:
    """One hidden law.

    Attributes
    ----------
    name : of the entry
    law : its row in the table
    right : names that count
    largest : amplitude up to which it may be scaled; it starts at a third of it
    chamber : -1 if it acts on all chambers
    drawn : the other columns
    """

    name: str
    law: int
    right: tuple[str, ...]
    largest: float
    chamber: int = -1
    drawn: dict[int, float] = field(default_factory=dict)
    amplitude: float = 0.0

    def into(self, table: np.ndarray, amplitude: float) -> None:
        """Write the law with ``amplitude`` into ``table``; vector laws scale as one."""
        row = table[self.law]
        for column, value in self.drawn.items():
            row[column] = value * (amplitude if column in SCALED.get(self.law, ()) else 1.0)
        if 0 not in SCALED.get(self.law, ()):
            row[0] = amplitude
        row[laws.CHAMBER] = self.chamber


SCALED = {laws.TILT: (0, 1), laws.MARKER: (0, 1, 2), laws.FRAME: (0, 1, 2, 3, 4)}  # columns that amplitude multiplies

# entry -> (law, right names, largest amplitude); what else is drawn stands in ``draw``
RIGHT: dict[str, tuple[int, tuple[str, ...], float]] = {
    "spool": (laws.SPOOL, ("lag", "tube_line"), 0.8),
    "choke": (laws.CHOKE, ("orifice", "rate_limit", "flow_limit", "lag"), 3.0),
    "line": (laws.LINE, ("dead_time",), 0.4),
    "relay": (laws.RELAY, ("deadband",), 0.2),
    "ceiling": (laws.CEILING, ("supply_limit",), 0.7),
    "orifice": (laws.ORIFICE, ("leak",), 0.6),
    "gain": (laws.GAIN, ("gain", "asymmetry"), 0.4),
    "offset": (laws.OFFSET, ("offset",), 0.25),
    "coupling": (laws.COUPLING, ("crosstalk",), 0.4),
    "balloon": (laws.BALLOON, ("area_growth", "strain_softening", "knee"), 1.5),
    "powerlaw": (laws.POWERLAW, ("viscoelasticity", "power_creep"), 1.5),
    "slip": (laws.SLIP, ("hysteresis", "play"), 0.3),
    "bristle": (laws.BRISTLE, ("friction", "hysteresis", "play"), 0.2),
    "damage": (laws.DAMAGE, ("mullins",), 0.6),
    "fung": (laws.FUNG, ("strain_stiffening",), 150.0),
    "soften": (laws.SOFTEN, ("strain_softening", "area_growth", "knee"), 8.0),
    "rubber": (laws.RUBBER, ("locking", "strain_softening"), 1.0),
    "wall": (laws.WALL, ("stiffness_scale",), 1.5),
    "relax": (laws.RELAX, ("drift",), 0.4),
    "braid": (laws.BRAID, ("stretch_area",), 6.0),
    "fold": (laws.FOLD, ("bimodular",), 0.6),
    "joint": (laws.JOINT, ("bend_slip", "bend_rub"), 0.4),
    "mass": (laws.MASS, ("payload",), 1.5),
    "tilt": (laws.TILT, ("mount_tilt",), 0.5),
    "rebound": (laws.REBOUND, ("contact",), 2000.0),
    "string": (laws.STRING, ("tether",), 120.0),
    "frame": (laws.FRAME, ("frame",), 0.25),
    "marker": (laws.MARKER, ("marker_offset",), 0.15),
    "latency": (laws.LATENCY, ("delay",), 0.4),
    "sampling": (laws.SAMPLING, ("hold",), 0.4),
    "jolt": (laws.JOLT, ("frame",), 0.25),
}
OUTSIDE: dict[str, tuple[int, float]] = {
    "stick": (laws.STICK, 1.0),
    "warmth": (laws.WARMTH, 0.3),
    "product": (laws.PRODUCT, 0.8),
    "buckle": (laws.BUCKLE, 0.9),
    "twist": (laws.TWIST, 0.8),
}
# concealed: (entry, where it acts)
CONCEALED = (
    ("powerlaw", "chamber"),
    ("slip", "chamber"),
    ("orifice", "chamber"),
    ("spool", "chamber"),
    ("slip", "above"),
    ("choke", "above"),
    ("orifice", "above"),
    ("rebound", "above"),
    ("damage", "maximum"),
    ("orifice", "late"),
    ("relax", "late"),
    ("gain", "late"),
    ("jolt", "late"),
)
# what else is right where a law acts late: a change in time, whatever changes
LATE_TOO = {"gain": ("failure", "drift"), "orifice": ("failure",)}
# what else is right where the chambers' pressures are not recorded
UNMEASURED_TOO = {"line": ("delay",), "latency": ("dead_time",), "ceiling": ("knee",), "relay": ("play", "pressure_play")}
PAIRS = (
    ("spool", "powerlaw"),
    ("powerlaw", "slip"),
    ("mass", "powerlaw"),
    ("orifice", "spool"),
    ("tilt", "slip"),
    ("line", "gain"),
    ("rebound", "spool"),
    ("damage", "spool"),
    ("gain", "powerlaw"),
    ("latency", "powerlaw"),
    ("frame", "bristle"),
    ("coupling", "spool"),
    ("ceiling", "slip"),
    ("fung", "spool"),
    ("mass", "slip"),
    ("braid", "spool"),
    ("fold", "powerlaw"),
    ("joint", "spool"),
)
INSEPARABLE = (
    ("dead_time", "delay", "without measured pressure a delay before a time-invariant body equals one behind it"),
    ("supply_limit", "knee", "without measured pressure a ceiling is a knee beyond which nothing more acts"),
    ("deadband", "play", "without measured pressure play in the regulator equals play between pressure and strain"),
    ("deadband", "pressure_play", "without measured pressure play in the regulator equals play between pressure and what acts"),
    ("gain", "asymmetry", "three chambers' gains are a common one, which retuning takes, and a first harmonic"),
    ("hysteresis", "play", "a sum of slips lies between one slip with corners and Bouc-Wen without"),
    ("viscoelasticity", "power_creep", "a sum of modes is either, within a few decades of time"),
    ("area_growth", "knee", "a smooth and a broken form of the same static curve"),
    ("friction", "hysteresis", "a bristle that slips is Bouc-Wen hysteresis of exponent one with a short yield"),
    ("area_growth", "strain_softening", "a static softening response to pressure alone, no load, no force"),
    ("locking", "strain_softening", "a small share of a wall that gives way and locks, where it gives way"),
    ("bend_slip", "bend_rub", "a loop whose way out levels off and whose way back is straight lies between corners and none"),
    ("lag", "tube_line", "a well-damped second order beside a first"),
    ("rate_limit", "lag", "sub-sonic flow through an orifice falls with the pressure difference"),
)
# entry -> {library name.parameter: column of the amplitude vector}: same meaning in both forms
SAME_MEANING: dict[str, dict[str, tuple[int, float, float]]] = {
    # (column of the law's row, factor, constant): parameter = constant + factor * column
    "gain": {"gain.gain": (0, 1.0, 1.0)},
    "offset": {"offset.offset": (0, 1.0, 0.0)},
    "mass": {"payload.mass": (0, 1.0, 0.0)},
    "tilt": {"mount_tilt.about_x_rad": (0, 1.0, 0.0), "mount_tilt.about_y_rad": (1, 1.0, 0.0)},
    "marker": {
        "marker_offset.x": (0, 1.0, 0.0), "marker_offset.y": (1, 1.0, 0.0), "marker_offset.z": (2, 1.0, 0.0),
    },
    "frame": {
        "frame.turn_x_rad": (0, 1.0, 0.0), "frame.turn_y_rad": (1, 1.0, 0.0), "frame.turn_z_rad": (2, 1.0, 0.0),
        "frame.shift_x": (3, 1.0, 0.0), "frame.shift_y": (4, 1.0, 0.0),
    },
    "latency": {"delay.delay_s": (0, 1.0, 0.0)},
    "line": {"dead_time.delay_s": (0, 1.0, 0.0)},
    "sampling": {"hold.period_s": (0, 1.0, 0.0)},
    "wall": {},
}  # fmt: skip


def draw(name: str, place: str, session_s: float, chambers: int, rng: np.random.Generator) -> Hidden:
    """Return the entry ``name`` with its other numbers drawn; ``place`` is everywhere, chamber, above, maximum or late."""
    u, one = rng.uniform, int(rng.integers(chambers))
    sign = float(rng.choice([-1.0, 1.0]))
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    drawn: dict[int, float] = {}
    alone = name in ("gain", "offset", "wall", "coupling") or place == "chamber"
    if name in OUTSIDE:
        law, largest = OUTSIDE[name]
        right: tuple[str, ...] = ()
    else:
        law, right, largest = RIGHT[name]
    if name == "spool":
        drawn = {1: u(1.0, 2.0), 2: u(0.6, 1.5)}
    elif name == "choke":
        drawn = {1: u(0.6, 1.2)}
    elif name in ("gain", "coupling", "offset", "twist", "jolt", "warmth", "product", "buckle", "braid", "fold"):
        largest *= sign
    if name == "wall" and sign < 0.0:
        largest = -0.5
    if name == "orifice":
        drawn = {1: u(0.6, 6.0)}
    elif name == "slip":
        drawn = {1: u(0.008, 0.03)}
    elif name == "bristle":
        drawn = {1: u(0.001, 0.003), 2: u(0.1, 0.5), 3: u(0.0, 1.0)}
    elif name == "damage":
        drawn = {1: u(0.02, 0.06), 2: u(100.0, 400.0), 3: 0.08 if place == "maximum" else 0.0}
    elif name == "rubber":
        drawn = {1: u(0.02, 0.05), 2: u(0.12, 0.2)}
    elif name == "fold":
        drawn = {1: u(0.03, 0.15)}
    elif name == "joint":
        drawn = {1: u(0.04, 0.2)}
    elif name == "relax":
        drawn = {1: u(0.4, 1.5) * session_s}
    elif name == "tilt":
        drawn = {0: direction[0] / np.hypot(*direction[:2]), 1: direction[1] / np.hypot(*direction[:2])}
    elif name == "rebound":
        drawn = {1: u(0.02, 0.08), 2: u(-np.pi, np.pi)}
    elif name == "string":
        angle, far = u(-np.pi, np.pi), u(0.1, 0.4)
        drawn = {1: far * np.cos(angle), 2: far * np.sin(angle), 3: u(0.02, 0.08)}
    elif name == "marker":
        drawn = dict(enumerate(direction.tolist()))
    elif name == "frame":
        shift = rng.standard_normal(2)
        drawn = dict(enumerate([*direction.tolist(), *(0.3 * shift).tolist()]))
    elif name == "warmth":
        drawn = {1: u(0.3, 0.6) * session_s, 2: u(0.0, 2.0 * np.pi)}
    elif name == "buckle":
        drawn = {1: u(0.3, 0.5)}
    elif name == "jolt":
        drawn = dict(enumerate(direction.tolist(), start=1)) | {4: u(0.35, 0.65) * session_s}
    if place == "above":
        drawn[laws.ABOVE] = u(0.3, 0.45)
        if name == "rebound":
            drawn[1], drawn[laws.ABOVE] = u(0.09, 0.12), UP
    if place == "late":
        drawn[laws.LATE] = u(0.4, 0.6) * session_s
        right = right + LATE_TOO.get(name, ())
    return Hidden(name, law, right, largest, one if alone else -1, drawn)


def sticking(session_s: float, chambers: int, amplitude: float, rng: np.random.Generator) -> np.ndarray:
    """Return times (n, 3) at which a valve sticks: start s, end s, chamber; ``amplitude`` scales how long."""
    starts = np.cumsum(rng.exponential(5.0, int(session_s)))
    starts = starts[starts < session_s]
    return np.stack([starts, starts + amplitude * rng.uniform(0.5, 2.0, len(starts)),
                     rng.integers(chambers, size=len(starts)).astype(float)], axis=1)  # fmt: skip


def answers(hidden: Hidden, measured_pressure: bool) -> tuple[str, ...]:
    """Return the names that count as right for ``hidden``."""
    return hidden.right + (() if measured_pressure else UNMEASURED_TOO.get(hidden.name, ()))


def frozen() -> str:
    """Return the SHA-256 of this table: entries, right answers, equivalences, and how cases are drawn."""
    module: Any = inspect.getmodule(frozen)
    return hashlib.sha256(inspect.getsource(module).encode()).hexdigest()
