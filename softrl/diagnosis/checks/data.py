"""What the recordings can carry: checks, the split into runs that fits see and runs that judge, the noise floor."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from softrl.core.errors import RecordingError
from softrl.diagnosis.checks.dead import without_dead_gauges
from softrl.diagnosis.checks.floor import LEAST, floor_of
from softrl.diagnosis.checks.gaps import mend_all
from softrl.diagnosis.checks.quality import motion_of, torn, unusable
from softrl.diagnosis.checks.spikes import without_spikes
from softrl.diagnosis.checks.stamps import evened
from softrl.diagnosis.checks.within import within
from softrl.recordings.acting import is_known
from softrl.recordings.check import DataCheck, RunCheck, check, driven
from softrl.recordings.gone import Now, in_order, now_after, sessions_in_order
from softrl.recordings.marked import DISTURBED, OUTSIDE, named, without
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.repeatability import repeatability
from softrl.recordings.split import split
from softrl.robots.robot import Robot

MIN_RUN_S = 3.0  # a shorter run says nothing about dynamics
MIN_SIGNAL = 3.0  # travel over noise below which nothing can be told
CHANGED_K = 1.0  # a temperature that changes less tells nothing
ENOUGH_RUNS = 3  # of a session that is not held out as a whole: two to fit, and one to judge
FEW_SESSIONS = 2  # with this many sessions or fewer, runs are held out within each instead


@dataclass(frozen=True)
class Data:
    """Recordings sorted by use.

    Attributes
    ----------
    check : findings
    shown : of them those of the runs that are fitted or judge
    training : runs that fits see; left out in turn, they choose between hypotheses
    heldout : whole runs that judge once
    outside : runs that the dataset marks as out of distribution (``out_of_distribution`` in its notes: names of runs or
        sessions); they are neither fitted nor do they decide anything; a session of such runs alone goes by the name of the
        one before it, since what acted then did so in it
    pressure : whether every run has measured pressure
    orientation : whether orientations are recorded and can be trusted
    noise : rms of the noise of one sample of the motion, m over all its components
    turn_noise : the same of the orientation, rad
    pressure_noise : the same of the measured pressure, Pa
    rounding, pressure_rounding : how much of both is a coarse sensor's last digit, of which no mean of samples gets rid
    travel, pressure_travel : rms about the mean of what the training runs measured, m and Pa
    mended : what was done about wrong samples and pauses, a sentence each
    now : where recording had come to when the last run ended, whatever fits see of it; its session is the last one that they
        know of
    punctual : whether the dataset says when a row's command acts, so that its log is late by nothing
    at_most : whether the noise of the motion may be less: rows were too slow to tell it from motion
    """

    check: DataCheck
    shown: tuple[RunCheck, ...]
    training: tuple[Recording, ...]
    heldout: tuple[Recording, ...]
    outside: tuple[Recording, ...]
    pressure: bool
    orientation: bool
    noise: float
    turn_noise: float
    pressure_noise: float
    travel: float
    pressure_travel: float
    now: Now
    rounding: float = 0.0
    pressure_rounding: float = 0.0
    mended: tuple[str, ...] = ()
    punctual: bool = False
    at_most: bool = False

    @property
    def splits(self) -> dict[str, tuple[Recording, ...]]:
        """Runs by the name of their split."""
        parts = {"train": self.training, "heldout": self.heldout, "ood": self.outside}
        return {name: runs for name, runs in parts.items() if runs}

    @property
    def used(self) -> tuple[Recording, ...]:
        """The runs that are fitted or judge."""
        return (*self.training, *self.heldout)

    @property
    def varied(self) -> tuple[str, ...]:
        """Surroundings that every run recorded and that changed while fits look on."""
        runs = [run for part in self.splits.values() for run in part]
        if any(run.temperature is None for run in runs):
            return ()
        seen = np.concatenate([np.asarray(run.temperature) for run in self.training])
        return ("temperature",) if np.ptp(seen) >= CHANGED_K else ()

    @property
    def misplaced(self) -> bool:
        """Whether any run that is fitted or judges shows the tip at rest far from where the base frame has it."""
        return any(run.misplaced for run in self.shown)

    @property
    def period_s(self) -> float:
        """Median time between the samples of these runs."""
        return float(np.median([run.period_s for run in self.shown]))

    def shortened(self, fit_s: float) -> "Data":
        """Return the data with fits limited to ``fit_s`` of recordings."""
        return replace(self, training=within(self.training, fit_s))


class Refusal(NamedTuple):
    """Why nothing can be told, and what was ``mended`` before, a sentence each: runs that were left out may be the reason."""

    check: DataCheck
    reason: str
    mended: tuple[str, ...] = ()


def prepare(
    recordings: RecordingSet, robot: Robot, heldout_share: float, seed: int, few_sessions: int = FEW_SESSIONS
) -> Data | Refusal:
    """Return the recordings sorted by use, or the reason why they cannot tell anything.

    Runs in which the robot was interfered with (``disturbed`` in the notes: names of runs or sessions) are not used. With
    ``few_sessions`` or fewer no session is held out whole.
    """
    timed, clock = evened(in_order(recordings.recordings))
    recordings = replace(recordings, recordings=timed)
    found = check(recordings, robot)
    channel = "bend_angle" if robot.output == "bend_angle" else "position"
    seen, copies = _without_copies(_seen_undisturbed(recordings, channel), channel)
    seen, dead = without_dead_gauges(seen, robot)
    usable, spiked = without_spikes(seen)
    marked = named(recordings, OUTSIDE)
    apart = tuple(r for r in usable if marked & {r.name, r.session})
    usable = tuple(r for r in usable if not marked & {r.name, r.session})
    found = replace(found, repeatability=_repeatability(seen, usable))
    parts, bridged = mend_all([*usable, *apart], found)
    mended = (*clock, *_too_short(recordings), *copies, *dead, *spiked, *bridged)
    intact = tuple(run for run in usable if parts[run.name])
    names = {run.name for run in intact}
    shown = tuple(told for told in found.runs if told.name in names)
    whole = [part for run in intact for part in parts[run.name]]
    any_marked = bool(marked | named(recordings, DISTURBED))
    reason = _refuse(usable, found, robot, channel, any_marked) or torn(usable, intact, whole, found, robot)
    reason = reason or unusable(whole, robot)
    if reason:
        return Refusal(found, reason, mended)
    moving = tuple(run for run in intact if np.ptp(run.pressure_cmd, axis=0).any())
    still = [run for run in intact if not np.ptp(run.pressure_cmd, axis=0).any()]
    if len(moving) < 2:
        told = f"commands change in {len(moving)} of {len(intact)} runs only; a held-out error needs two"
        return Refusal(found, told, mended)
    sides = hold_out(replace(recordings, recordings=moving), heldout_share, seed, few_sessions)
    training, heldout = (tuple(part for run in side.recordings for part in parts[run.name]) for side in sides)
    training += tuple(part for run in _beside(still, training, heldout) for part in parts[run.name])
    floor, pressure_floor = floor_of(found, usable, robot, channel), floor_of(found, usable, robot, "pressure_meas")
    travel = _travel(training, lambda run: motion_of(run, robot))
    if travel < MIN_SIGNAL * floor.noise:
        said = f"the motion ({1e3 * travel:.3g} mm rms) hardly exceeds its noise ({1e3 * floor.noise:.3g} mm)"
        slow = "rows are slow, and commands do not foretell the motion: check their columns and command_acts, or record faster"
        return Refusal(found, f"{said}; {slow if floor.at_most else 'drive harder'}", mended)
    return Data(
        replace(found, excited=driven(whole, robot)),
        shown,
        training,
        heldout,
        _dated(tuple(part for run in apart for part in parts[run.name]), (*training, *heldout)),
        all(r.pressure_meas is not None for r in whole),
        _orientation_trusted(usable, shown, robot),
        floor.noise,
        floor_of(found, usable, robot, "quaternion").noise,
        pressure_floor.noise,
        travel,
        _travel([r for r in training if r.pressure_meas is not None], lambda run: np.asarray(run.pressure_meas)),
        now_after(recordings.recordings)._replace(session=sessions_in_order((*training, *heldout))[-1]),
        floor.rounding,
        pressure_floor.rounding,
        mended,
        is_known(recordings),
        floor.at_most,
    )


def _beside(still: Sequence[Recording], training: Sequence[Recording], heldout: Sequence[Recording]) -> list[Recording]:
    """Return the runs ``still`` that fits may see: they would judge nothing, but of a session held out whole fits know nothing.

    Where every session is placed by itself, what a robot at rest shows leaves any turn open.
    """
    unseen = {run.session for run in heldout} - {run.session for run in training}
    return [run for run in still if run.session not in unseen]


def _dated(outside: tuple[Recording, ...], known: Sequence[Recording]) -> tuple[Recording, ...]:
    """Return the runs ``outside``, those of sessions without ``known`` ones as of the known session before them, or the first."""
    sessions = sessions_in_order(known)
    found = []
    for run in outside:
        before = [other for other in known if other.gone_s[-1] <= run.gone_s[-1]]
        session = sessions_in_order(before)[-1] if before else sessions[0]
        found.append(run if run.session in sessions else replace(run, session=session))
    return tuple(found)


def _seen_undisturbed(recordings: RecordingSet, channel: str) -> list[Recording]:
    """Return the runs that are long enough, show ``channel``, and in which nobody interfered with the robot."""
    runs = without(recordings, DISTURBED).recordings
    return [run for run in runs if np.ptp(run.time) >= MIN_RUN_S and getattr(run, channel) is not None]


def _without_copies(runs: Sequence[Recording], channel: str) -> tuple[list[Recording], list[str]]:
    """Return the runs that measured something of their own, and a sentence for every copy of an earlier one.

    A copy among the runs that judge would be known to the fits.
    """
    first: dict[bytes, str] = {}
    kept, lines = [], []
    for run in runs:
        measured = getattr(run, channel).tobytes()
        if measured in first:
            lines.append(f"{run.name}: measured the same as {first[measured]} to the last digit, a copy, left out")
        else:
            first[measured] = run.name
            kept.append(run)
    return kept, lines


def _repeatability(runs: Sequence[Recording], usable: Sequence[Recording]) -> dict[str, float]:
    """Return how well those of the ``runs`` that are ``usable`` repeat: a copy does so exactly, what tracking mistook never."""
    names = {run.name for run in usable}
    return repeatability([run for run in runs if run.name in names], usable)


def _too_short(recordings: RecordingSet) -> list[str]:
    """Return the runs that are too short to be used, a sentence each."""
    return [
        f"{run.name}: {np.ptp(run.time):.2g} s, left out: a run says something about dynamics from {MIN_RUN_S:g} s on"
        for run in recordings.recordings
        if np.ptp(run.time) < MIN_RUN_S
    ]


def hold_out(
    recordings: RecordingSet, share: float, seed: int, few_sessions: int = FEW_SESSIONS
) -> tuple[RecordingSet, RecordingSet]:
    """Return (training, heldout): whole sessions if there are more than ``few_sessions``, else whole runs out of each session.

    Of every other session of enough runs one is held out, too: what acted in that session alone shows nowhere else.
    """
    sessions = recordings.sessions()
    if len(sessions) > few_sessions:
        training, heldout = split(recordings, share, seed, by="session")
        names = {s: [r.name for r in training.recordings if r.session == s] for s in training.sessions()}
        rng = np.random.default_rng(seed)
        judges = {str(rng.choice(runs)) for runs in names.values() if len(runs) >= ENOUGH_RUNS}
        parts = [tuple(r for r in training.recordings if (r.name in judges) == held) for held in (False, True)]
        return replace(training, recordings=parts[0]), replace(heldout, recordings=(*heldout.recordings, *parts[1]))
    parts = [
        replace(recordings, recordings=tuple(r for r in recordings.recordings if r.session == session))
        for session in sessions
    ]
    if any(len(part.recordings) < 2 for part in parts):
        return split(recordings, share, seed, by="run")
    halves = [split(part, share, seed, by="run") for part in parts]
    training, heldout = (tuple(r for half in halves for r in half[side].recordings) for side in (0, 1))
    return replace(recordings, recordings=training), replace(recordings, recordings=heldout)


def rms_about_mean(series: Sequence[np.ndarray]) -> float:
    """Return the rms of the rows' distance from their common mean."""
    rows = np.concatenate(series) if series else np.zeros((1, 1))
    return float(np.sqrt(np.mean(np.sum((rows - rows.mean(axis=0)) ** 2, axis=1))))


def _travel(runs: Sequence[Recording], seen: Callable[[Recording], np.ndarray]) -> float:
    """Return the rms of what is ``seen`` about the mean of each session: a camera that was moved is no travel."""
    series = []
    for session in dict.fromkeys(run.session for run in runs):
        rows = np.concatenate([seen(run) for run in runs if run.session == session])
        series.append(rows - rows.mean(axis=0))
    return rms_about_mean(series)


def _orientation_trusted(usable: Sequence[Recording], shown: Sequence[RunCheck], robot: Robot) -> bool:
    jumped = any(run.turns_jump for run in shown)
    return robot.output == "tip_pose" and not jumped and all(r.quaternion is not None for r in usable)


def _refuse(usable: Sequence[Recording], found: DataCheck, robot: Robot, channel: str, any_marked: bool) -> str | None:
    if not usable and any_marked:
        return "every run that could be used is marked as disturbed or out of distribution: none is left to be fitted"
    if not usable:
        return f"no run of {MIN_RUN_S:g} s or more holds {channel}, which robot {robot.name} is said to report"
    if max(len(run.time) for run in usable) < LEAST:
        return f"no run has {LEAST} rows or more, without which motion and noise are one; join rows to longer runs"
    if not found.excited:
        return "no chamber is driven in any run"
    if len(usable) < 2:
        return f"only one run ({usable[0].name}) can be used; a held-out error needs a second one"
    return None


def require_robot(recordings: RecordingSet, robot: Robot) -> None:
    """Raise ``RecordingError`` if the recordings belong to another robot."""
    if recordings.robot_name != robot.name:
        raise RecordingError(
            f"the recordings are of robot {recordings.robot_name}, but robot={robot.name}; choose "
            f"robot={recordings.robot_name}"
        )
