"""From frozen answers and the opened key to numbers: one row a case, then shares with Wilson intervals."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from softrl.effects.library import effect_class

Row = dict[str, Any]
CONFIDENCE = 1.959963984540054  # standard normal quantile of a two-sided 95 % interval
SILENT = ("nothing missing", "crashed", "cannot tell")  # verdicts that find nothing in a robot with hidden physics


class Share(NamedTuple):
    """A share of trials in per cent and its 95 % Wilson interval; NaN without trials."""

    pct: float
    low: float
    high: float
    hits: int
    trials: int


def wilson(hits: int, trials: int) -> Share:
    """Return the share ``hits / trials`` with its 95 % interval.

    Notes
    -----
    Wilson's score interval: ``(p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)``.
    """
    if trials == 0:
        return Share(np.nan, np.nan, np.nan, 0, 0)
    p, z2 = hits / trials, CONFIDENCE**2
    middle, reach = p + z2 / (2 * trials), CONFIDENCE * np.sqrt(p * (1 - p) / trials + z2 / (4 * trials**2))
    low, high = ((middle + sign * reach) / (1 + z2 / trials) for sign in (-1.0, 1.0))
    low, high = min(max(float(low), 0.0), p), max(min(float(high), 1.0), p)  # rounding must not put p outside
    return Share(100.0 * p, 100.0 * low, 100.0 * high, hits, trials)


def row_of(key: dict[str, Any], given: dict[str, Any], errors: dict[str, Any], detectable: float) -> Row:
    """Return one case scored: what was hidden, what was said, whether it is right, and the errors in mm."""
    named = [effect["name"] for effect in given.get("effects", [])]
    told = given["verdict"] in ("named", "indistinguishable")
    alike = [rival["name"].split()[0] for rival in given.get("rivals", []) if rival.get("equivalent")]
    rights = [set(hidden["right"]) for hidden in key["hidden"]]
    inside = bool(rights) and all(rights)
    hits = [bool(told and right & set(named)) for right in rights] if inside else []
    chambers = [
        (hidden["chamber"], effect["chamber"])
        for hidden in key["hidden"]
        for effect in given.get("effects", [])
        if effect["name"] in hidden["right"] and "chamber" in effect_class(effect["name"]).__dataclass_fields__
    ]
    alone = [said == true for true, said in chambers if true >= 0]
    covered, intervals = coverage(key, given)
    return {
        "case": key["case"],
        "stratum": key["stratum"],
        "truth": "+".join(hidden["name"] for hidden in key["hidden"]) or "none",
        "place": "+".join(key["places"]) or "none",
        "right": "|".join("/".join(sorted(right)) for right in rights),
        "signal_to_noise": round(key["signal_to_noise"], 3),
        "detectable": bool(rights) and key["signal_to_noise"] >= detectable,
        "measured_pressure": key["measured_pressure"],
        "verdict": given["verdict"],
        "named": "+".join(named),
        "equivalent": "+".join(alike),
        "located": _located(given),
        "top1": inside and told and bool(named) and any(named[0] in right for right in rights),
        "in_set": inside and told and any(right & (set(named) | set(alike)) for right in rights),
        "all_named": inside and all(hits),
        "wrong_named": sum(not any(name in right for right in rights) for name in named),
        "surplus": max(len(named) - len(rights), 0),
        "chamber_right": all(said == true for true, said in chambers) if chambers else None,
        "one_chamber_right": all(alone) if alone else None,
        "found_something": given["verdict"] != "nothing missing",
        "covered": covered,
        "intervals": intervals,
        "pinned": pinned(key, given),
        "body_discrepancy_mm": round(key["body_discrepancy_mm"], 4),
        **{f"{split}_{model}_mm": round(value, 4) for split in errors for model, value in errors[split].items()},
        "seconds": given["seconds"],
        "error": given.get("error", ""),
    }


def coverage(key: dict[str, Any], given: dict[str, Any]) -> tuple[int, int]:
    """Return (covered, counted) intervals of parameters that mean the same in both forms, of effects named rightly."""
    covered = counted = 0
    for parameter, value, effect in _told(key, given):
        entry = (effect["parameters"] | effect.get("pinned_intervals", {})).get(parameter)
        if entry is None or not np.isfinite([entry["low"], entry["high"]]).all():
            continue  # not free, or beyond what the data tell
        counted += 1
        covered += entry["low"] <= value <= entry["high"]
    return covered, counted


def pinned(key: dict[str, Any], given: dict[str, Any]) -> int:
    """Return how many such parameters were held where they do nothing: hidden, and told as neutral."""
    return sum(parameter in effect.get("pinned", {}) for parameter, _, effect in _told(key, given))


def _told(key: dict[str, Any], given: dict[str, Any]) -> Iterator[tuple[str, float, dict[str, Any]]]:
    """Yield (parameter, its true value, the effect as named) of what means the same in both forms and was named rightly."""
    for hidden in key["hidden"]:
        for name, value in hidden["parameters"].items():
            effect, parameter = name.split(".")
            told = [e for e in given.get("effects", []) if e["name"] == effect and e["chamber"] in (hidden["chamber"], -1)]
            if told:  # of one name in its own chamber and in all, the one that says where
                yield parameter, value, max(told, key=lambda e: int(e["chamber"]))


def metrics(rows: Sequence[Row], shuffled_finds: int, shuffled_cases: int) -> dict[str, float]:
    """Return the metrics of a whole proof."""
    singles = [r for r in rows if r["stratum"] == "single" and r["detectable"]]
    pairs = [r for r in rows if r["stratum"] == "pair"]
    nulls = [r for r in rows if r["stratum"] in ("null", "nuisance")]
    beyond = [r for r in rows if r["stratum"] == "outside" and r["detectable"]]
    known = [r for r in rows if r["stratum"] in ("single", "pair", "concealed") and r["detectable"]]
    top1 = wilson(sum(r["top1"] for r in singles), len(singles))
    covered, counted = (sum(r[name] for r in rows) for name in ("covered", "intervals"))
    return {
        "cases": len(rows),
        "detectable_singles": len(singles),
        "top1_pct": top1.pct,
        "top1_low_pct": top1.low,
        "top1_high_pct": top1.high,
        "pairs_both_pct": wilson(sum(r["all_named"] for r in pairs), len(pairs)).pct,
        "false_alarm_pct": wilson(sum(r["found_something"] for r in nulls), len(nulls)).pct,
        "unknown_flagged_pct": wilson(sum(r["verdict"] == "unknown" for r in beyond), len(beyond)).pct,
        "interval_coverage_pct": wilson(covered, counted).pct,
        "hidden_parameters_pinned": sum(r["pinned"] for r in rows),  # whose intervals count like others, if they have any
        **_gaps(known, "heldout", "heldout"),
        **_gaps(known, "outside", "ood"),
        "blackbox_ood_ratio": _median([_ratio(r, "blackbox") for r in known]),
        "retuned_ood_ratio": _median([_ratio(r, "retuned") for r in known]),
        "shuffled_finds": shuffled_finds,
        "shuffled_cases": shuffled_cases,
        "seconds_per_case": float(np.mean([r["seconds"] for r in rows])) if rows else np.nan,
    }


def shares(rows: Sequence[Row]) -> dict[str, Share]:
    """Return further shares with their intervals, by stratum, for the ledger."""
    groups = {
        "singles/top1": [(r["top1"]) for r in rows if r["stratum"] == "single" and r["detectable"]],
        "singles/right_in_set": [r["in_set"] for r in rows if r["stratum"] == "single" and r["detectable"]],
        "singles/nothing_wrong_named": [
            r["top1"] and not r["wrong_named"] for r in rows if r["stratum"] == "single" and r["detectable"]
        ],
        "singles/nothing_else_named": [  # nor a second name that would be right by itself
            r["top1"] and not r["surplus"] for r in rows if r["stratum"] == "single" and r["detectable"]
        ],
        "undetectable/named_wrongly": [
            bool(r["wrong_named"]) for r in rows if r["stratum"] == "single" and not r["detectable"]
        ],
        "pairs/both": [r["all_named"] for r in rows if r["stratum"] == "pair"],
        "pairs/one": [r["top1"] for r in rows if r["stratum"] == "pair"],
        "concealed/top1": [r["top1"] for r in rows if r["stratum"] == "concealed" and r["detectable"]],
        "null/false_alarm": [r["found_something"] for r in rows if r["stratum"] == "null"],
        "nuisance/false_alarm": [r["found_something"] for r in rows if r["stratum"] == "nuisance"],
        "outside/unknown": [r["verdict"] == "unknown" for r in rows if r["stratum"] == "outside" and r["detectable"]],
        "named/chamber_right": [r["chamber_right"] for r in rows if r["chamber_right"] is not None],
        "named/one_chamber_right": [r["one_chamber_right"] for r in rows if r["one_chamber_right"] is not None],
    }
    return {name: wilson(sum(hits), len(hits)) for name, hits in groups.items()}


def gap_closed(row: Row, split: str, model: str = "corrected") -> float:
    """Return the share, per cent, of the way from the nominal's rms error to the oracle's that ``model`` goes."""
    names = [f"{split}_{name}_mm" for name in ("nominal", model, "oracle")]
    if not all(name in row for name in names):
        return 0.0  # a crash, or a model that cannot run, closes nothing
    nominal, found, oracle = (row[name] for name in names)
    return 100.0 * (nominal - found) / (nominal - oracle) if nominal > oracle else np.nan


def _gaps(rows: Sequence[Row], split: str, short: str) -> dict[str, float]:
    """Return the gap closed over ``rows``, per cent: median and lower quartile of the correction, medians of its baselines."""
    found = {model: [gap_closed(row, split, model) for row in rows] for model in ("corrected", "retuned", "blackbox")}
    return {
        f"gap_closed_{short}_median_pct": _median(found["corrected"]),
        f"gap_closed_{short}_lower_quartile_pct": _lower_quartile(found["corrected"]),
        f"gap_closed_{short}_retuned_median_pct": _median(found["retuned"]),
        f"gap_closed_{short}_blackbox_median_pct": _median(found["blackbox"]),
    }


def misses(rows: Sequence[Row]) -> list[str]:
    """Return one sentence for every case that went wrong."""
    told = []
    for r in rows:
        said = (
            f"{r['verdict']}" + (f" ({r['named']})" if r["named"] else "") + (f": {r['error']}" if r["error"] else "")
        )
        if r["stratum"] in ("null", "nuisance"):
            wrong = r["found_something"]
        elif r["stratum"] == "outside":
            wrong = r["detectable"] and r["verdict"] != "unknown"
        elif r["stratum"] == "pair":
            wrong = not r["all_named"]
        else:
            wrong = r["detectable"] and not r["top1"]
        faint = r["stratum"] in ("single", "outside") and not r["detectable"]
        misnamed = faint and r["wrong_named"] and r["verdict"] != "unknown"  # it need not be named, but not as another
        if wrong or misnamed or r["verdict"] == "crashed":
            told.append(
                f"case {r['case']}, {r['stratum']}, {r['truth']} ({r['place']}) "
                f"at {r['signal_to_noise']:.1f} times the noise: {said}"
            )
    return told


def _ratio(row: Row, model: str) -> float:
    if "outside_corrected_mm" not in row:
        return 0.0  # no correction is worse than any other model
    if f"outside_{model}_mm" not in row:
        return np.inf
    return float(row[f"outside_{model}_mm"] / row["outside_corrected_mm"])


def _median(values: Sequence[float]) -> float:
    known = [v for v in values if not np.isnan(v)]
    return float(np.median(known)) if known else np.nan


def _lower_quartile(values: Sequence[float]) -> float:
    known = [v for v in values if not np.isnan(v)]
    return float(np.quantile(known, 0.25)) if known else np.nan


def _located(given: dict[str, Any]) -> str:
    if not given.get("located"):
        return ""
    first = given["located"][0]
    return " ".join(
        str(first.get(k, "")) for k in ("site", "channel", "chamber", "region") if first.get(k) not in (None, "")
    )
