"""Pauses in the samples: bridged where nothing much happened meanwhile, else the run is cut there into its parts."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from softrl.recordings.check import DataCheck
from softrl.recordings.lost import is_seen
from softrl.recordings.recording import Recording

BRIDGED_CHANGE_S = 0.25  # change across a pause, in shares of a channel's range, times its length: less is bridged
BRIDGED_S = 2.0  # a longer pause is never bridged: what was commanded meanwhile is anybody's guess
MIN_PART_S = 10.0  # a shorter part between two cuts begins in a state nobody knows, and ends before that is forgotten
BESIDE = 5  # samples on either side of a pause whose median is compared, against the noise


class Mended(NamedTuple):
    """A run without pauses in which something unknown happened.

    Attributes
    ----------
    parts : of the run, in order; the run itself where nothing had to be cut
    bridged_s, dropped_s : time in pauses that are bridged, and in pauses and parts that are left out
    """

    parts: tuple[Recording, ...]
    bridged_s: float
    dropped_s: float


def mend(run: Recording, gaps: Sequence[tuple[float, float]]) -> Mended:
    """Return ``run`` in parts, cut at every gap (start s, length s) across which it is not known what was done.

    What was commanded within a pause was not recorded. Where it is short, or command, measured pressure and motion come
    out of it nearly as they went in, it cannot have been much.
    """
    ends = [int(np.searchsorted(run.time, start, side="right")) for start, _ in gaps]
    bridged = [
        length <= BRIDGED_S and _change(run, end) * length <= BRIDGED_CHANGE_S
        for end, (_, length) in zip(ends, gaps, strict=True)
    ]
    cuts = [0, *(end for end, kept in zip(ends, bridged, strict=True) if not kept), len(run.time)]
    if len(cuts) == 2:
        return Mended((run,), sum(length for _, length in gaps), 0.0)
    parts = [rows(run, slice(a, b), f"{run.name}, part {k}") for k, (a, b) in enumerate(pairwise(cuts), 1)]
    parts = [part for part in parts if len(part.time) > 1 and np.ptp(part.time) >= MIN_PART_S and is_seen(part)]
    inside = [any(p.time[0] <= start <= p.time[-1] - length for p in parts) for start, length in gaps]
    spanned = sum(float(np.ptp(part.time)) for part in parts)
    crossed = sum(length for (_, length), kept in zip(gaps, inside, strict=True) if kept)
    return Mended(tuple(parts), crossed, float(np.ptp(run.time)) - spanned)


def mend_all(runs: Sequence[Recording], check: DataCheck) -> tuple[dict[str, tuple[Recording, ...]], list[str]]:
    """Return the parts of every run by the run's name, and what was bridged and left out, a sentence a run."""
    gaps = {run.name: run.gaps for run in check.runs}
    parts, lines = {}, []
    for run in runs:
        mended = mend(run, gaps[run.name])
        parts[run.name] = mended.parts
        kept = sum(float(np.ptp(part.time)) for part in mended.parts)
        if mended.dropped_s > 0.0:
            lines.append(
                f"{run.name}: cut where samples are missing while something happened; {kept:.1f} s in {len(mended.parts)} "
                f"parts of {MIN_PART_S:g} s or more are kept, {mended.dropped_s:.1f} s left out"
            )
        if mended.bridged_s > 0.0:
            lines.append(
                f"{run.name}: samples are missing during {mended.bridged_s:.1f} s of the {kept:.1f} s kept, across "
                "pauses so short, or with so little change, that they do no harm: the pressure is taken to change evenly "
                "there, and nothing is compared"
            )
    return parts, lines


def rows(run: Recording, which: slice | np.ndarray, name: str | None = None) -> Recording:
    """Return the samples ``which`` of a run, under another name if one is given."""
    changed = run.part(which)
    later = float(changed["time"][0] - run.time[0]) if len(changed["time"]) else 0.0
    in_run, in_session, ever = (gone + later for gone in run.gone_s)
    return replace(run, name=name or run.name, gone_s=(in_run, in_session, ever), **changed)


def _change(run: Recording, first: int) -> float:
    """Return the largest change across the pause before sample ``first`` of pressure and motion, in shares of their ranges.

    The measured pressure shows what acted; where there is none the command has to.
    """
    found = [0.0]
    acting = run.pressure_cmd if run.pressure_meas is None else run.pressure_meas
    for values in (acting, run.position, run.bend_angle):
        if values is not None:
            columns = values.reshape(len(values), -1)
            before, after = columns[max(first - BESIDE, 0) : first], columns[first : first + BESIDE]
            moved = float(np.linalg.norm(np.median(after, axis=0) - np.median(before, axis=0)))
            found.append(moved / max(float(np.linalg.norm(np.ptp(columns, axis=0))), 1e-300))
    return max(found)
