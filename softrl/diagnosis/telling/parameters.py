"""A named effect in words: where it acts, its parameters, and what they are of this robot's."""

from typing import Any

from softrl.diagnosis.telling.entries import command_in
from softrl.effects.gate import WIDTHS
from softrl.effects.library import effect_class
from softrl.robots.robot import Robot

WORDS = {
    "valve": "between command and chamber pressure",
    "chamber": "in the chamber",
    "body": "in the body",
    "load": "in the load on the tip",
    "sensor": "in the sensor",
}
MOST_DIGITS = 6
SUDDEN_S = 0.1  # what begins within this time is told to begin at once
SHARES = {"pressure": "largest_pa", "ceiling": "pressure_max_pa", "length": "length_m", "mass": "mass_kg"}
UNITS = {"length_m": (1e3, "mm"), "mass_kg": (1e3, "g")}  # of pressures it depends on what is commanded


def effect_sentence(effect: dict[str, Any], robot: Robot, gauged: bool = False) -> str:
    """Return what a named ``effect`` is: name, place, the parameters worth a word with their intervals, and its evidence.

    ``gauged`` says that a gauge stood between valve and body: what is behind it is a pressure, whatever is commanded.
    """
    pressure = (1e-3, "kPa") if gauged and _behind_gauge(effect) else command_in(robot)
    values = ", ".join(
        f"{name} {_with_interval(p)}{'' if p['unit'] == '1' else ' ' + p['unit']}"
        f"{_of_the_robot(effect['name'], name, p['value'], robot, pressure)}{_at_an_end(name, p)}"
        for name, p in _telling(effect).items()
    )
    return f"{effect['name']} {WORDS[effect['site']]}, {effect['where']}: {values}. {effect['evidence']}."


def _with_interval(p: dict[str, Any]) -> str:
    """Return a value with its interval, in as many digits, three or more, as tell the interval's ends apart."""
    low, high = p["low"], p["high"]
    digits = next((n for n in range(3, MOST_DIGITS + 1) if f"{low:.{n}g}" != f"{high:.{n}g}"), 3)
    form = f"{'#' * (digits > 3)}.{digits}g"
    return f"{p['value']:{form}} ({low:{form}} to {high:{form}})"


def _at_an_end(name: str, p: dict[str, Any]) -> str:
    """Return that a parameter is at an end of its range; what begins within the shortest time begins at once."""
    if not p["at_bound"]:
        return ""
    return ", at once" if name in WIDTHS.values() and p["value"] < SUDDEN_S else ", at the end of its range"


def _behind_gauge(effect: dict[str, Any]) -> bool:
    return effect["site"] != "valve" or "behind_gauge" in effect["pinned"]


def _of_the_robot(effect: str, name: str, value: float, robot: Robot, pressure: tuple[float, str]) -> str:
    """Return what a share of the largest pressure, the length or the mass is of this ``robot``'s, or nothing.

    ``pressure`` is factor and unit in which pressures are told.
    """
    known = _known(effect)[name]
    if not known["of"]:
        return ""
    attribute = SHARES[known["of"]]
    factor, unit = UNITS.get(attribute, pressure)
    each = "/s" if known["unit"] == "1/s" else ""
    return f" = {factor * value * getattr(robot, attribute):.3g} {unit}{each}"


def _known(effect: str) -> dict[str, Any]:
    """Return what is known of each parameter of the effect of that name, and of its gates'."""
    cls = effect_class(effect)
    return {field.name: field.metadata for field in (*cls.parameter_fields(), *cls.gate_fields())}


def _telling(effect: dict[str, Any]) -> dict[str, Any]:
    """Return the parameters worth a word, or all if none is.

    Not those that came to rest where they do nothing, those that may be anything, and of many that stand together those
    whose interval holds zero.
    """
    known, together = _known(effect["name"]), effect_class(effect["name"]).together

    def tells(name: str, p: dict[str, Any]) -> bool:
        m = known[name]
        idle = p["at_bound"] and p["value"] == m["neutral"]
        anything = p["low"] <= m["low"] and p["high"] >= m["high"]
        return not (idle or anything or (together and p["low"] <= 0.0 <= p["high"]))

    found: dict[str, Any] = effect["parameters"]
    return {name: p for name, p in found.items() if tells(name, p)} or found
