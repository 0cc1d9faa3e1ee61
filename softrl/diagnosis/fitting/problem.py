"""Recordings, a body and what is compared: the residual of any hypothesis, binned in time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrl.core.errors import SolverError
from softrl.core.simulator import Simulator
from softrl.diagnosis.fitting import effort
from softrl.diagnosis.fitting.bins import Bins
from softrl.diagnosis.fitting.bodies import tuned_body
from softrl.diagnosis.fitting.hypothesis import LASTING, LATE, Hypothesis, Space
from softrl.diagnosis.fitting.still_body import StillBody
from softrl.effects.chain import Plant, chain_of
from softrl.effects.driving import Supply
from softrl.effects.library import effect_class, names
from softrl.effects.replay import CHANNELS, replay
from softrl.recordings.placement import Registration, joined, place, place_nearby, turn_between
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

UNJUDGED_S, UNJUDGED_SHARE = 1.0, 0.05  # of a run that does not begin at rest, at most: its past is only guessed
MIN_FOLDS = 3  # parts of the data that are left out in turn, at least
FOLDS, FOLD_S = 8, 20.0  # with fewer runs than that: so many parts, where each is as long
SAME_RATE = 0.1  # relative difference of sampling intervals that is jitter
REPLAYS = 4  # the last ones, kept: what a fit ends with is asked for again by all that judges it
MOUNT_TURN_RAD, MOUNT_SHIFT_SHARE = math.radians(1.0), 0.01  # of a base mounted anew, the latter in lengths: more is no detail
ORIENTATION_LEVER = 0.5  # lengths of the robot: turns orientation errors into displacements


@dataclass(frozen=True)
class Numerics:
    """Steps and bounds that every replay shares; fields as in the stage's Config."""

    dt_s: float
    rough_dt_s: float
    bin_s: float
    settle_s: float
    tuned_factor: float
    mass_factor: float = np.inf


class Residual(NamedTuple):
    """Measured less simulated, run by run.

    Attributes
    ----------
    runs : one array (bins, channels) a run, m (Pa for pressures)
    registrations : session -> placement that was used; empty without registration
    """

    runs: list[np.ndarray]
    registrations: dict[str, Registration]

    @property
    def squares(self) -> np.ndarray:
        """Squared norm (bins,) over channels, runs joined."""
        return np.concatenate([np.sum(run**2, axis=1) for run in self.runs])

    @property
    def flat(self) -> np.ndarray:
        """All numbers (rows,)."""
        return np.concatenate([run.ravel() for run in self.runs])


@dataclass(frozen=True)
class Problem:
    """What is replayed and compared.

    Attributes
    ----------
    robot, simulator : the body
    runs : recordings
    numerics : steps
    target : "motion", or "pressure" to compare measured with supplied pressure
    drive : "command" or "measured", see ``effects.replay``
    register : place the simulator in each session's frame by the best rigid motion
    mounted : do so within what no one avoids who mounts a base anew
    stiffer : by session the share by which the wall is stiffer that day
    orientation : compare orientations too, not positions only
    before : by run the pressures (chambers,) Pa under which the body stood before the first sample, where they are known
        better than by the first pressures themselves, see ``prelude``
    late_max_s : how late a log may have it that rows act: an interval between its samples
    late_apart_s : the same where an effect shifts time that does so in a part examined apart: the other part has its own log
    interval_s : between samples, of most runs: where it is another a log is later or earlier as much
    supply : by run the valve, where it is understood, and what is measured beyond what it does
    later : by run (rows,) s by which each row's command acts later still, see ``clock``
    defect : by run what is added to the residual (bins, channels), see ``rough_about``
    """

    robot: Robot
    simulator: Simulator
    runs: tuple[Recording, ...]
    numerics: Numerics
    target: str
    drive: str
    register: bool
    orientation: bool
    before: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    late_max_s: float = 0.0
    late_apart_s: float = 0.0
    interval_s: float = 0.0
    supply: Mapping[str, Supply] = field(default_factory=dict)
    later: Mapping[str, np.ndarray] = field(default_factory=dict)
    defect: tuple[np.ndarray, ...] = ()
    mounted: bool = False
    stiffer: Mapping[str, float] = field(default_factory=dict)

    def on(self, runs: Sequence[Recording]) -> "Problem":
        """Return the same problem on other runs."""
        return replace(self, runs=tuple(runs), defect=())

    @property
    def rough(self) -> "Problem":
        """The same problem with the step of rough fits."""
        return replace(self, numerics=replace(self.numerics, dt_s=self.numerics.rough_dt_s))

    def rough_about(self, hypothesis: Hypothesis, point: np.ndarray) -> "Problem":
        """Return the problem with the step of rough fits whose residual is the true one at ``point``.

        What long steps do to a simulation then hides no small effect: they err in differences only (defect correction).
        """
        true, rough = (problem.residual(hypothesis, point).runs for problem in (self, self.rough))
        return replace(self.rough, defect=tuple(a - b for a, b in zip(true, rough, strict=True)))

    def space(self, hypothesis: Hypothesis) -> Space:
        """Return the free parameters of a hypothesis."""
        most = self.numerics
        return Space(hypothesis, self.simulator, most.tuned_factor, self.late_max_s, self.late_apart_s, most.mass_factor)

    @property
    def tuned(self) -> tuple[str, ...]:
        """What is refitted with every hypothesis: the simulator's parameters, and how late the log is."""
        body = () if self.target == "pressure" else tuple(self.simulator.parameters)
        return (*body, LATE) if self.late_max_s > 0.0 else body

    @cached_property
    def first(self) -> list[int]:
        """Sample of every run from which on it is compared: the first, or a little later if it does not begin at rest."""
        return [int(np.searchsorted(run.time, run.time[0] + self._unjudged(run))) for run in self.runs]

    @cached_property
    def _later(self) -> dict[str, np.ndarray]:
        """``later`` of the runs, which fits may see cut short."""
        longest = {run.name: len(run.time) for run in self.runs if run.name in self.later}
        return {name: np.pad(self.later[name], (0, rows))[:rows] for name, rows in longest.items()}

    @cached_property
    def bins(self) -> list[Bins]:
        """The bins of all samples that are compared, run by run."""
        gauges, bin_s = self.target == "pressure", self.numerics.bin_s  # which show what no camera sees
        pairs = zip(self.runs, self.first, strict=True)
        return [Bins(run.time, first, bin_s, run.seen | gauges) for run, first in pairs]

    @cached_property
    def spacing_s(self) -> float:
        """Time between bins: that between rows, where those are slower than bins."""
        return max(self.numerics.bin_s, float(np.median([np.median(np.diff(run.time)) for run in self.runs])))

    @cached_property
    def run_of_bin(self) -> np.ndarray:
        """Run number (bins,) of every bin, runs joined."""
        return np.repeat(np.arange(len(self.runs)), [len(bins) for bins in self.bins])

    @cached_property
    def seen(self) -> dict[tuple[str, str], list[dict[str, float]]]:
        """Values of effects' parameters that can be read off the runs, by the effect's name and how long it lasts."""
        gone = [dict(zip(("", *LASTING), run.gone_s, strict=True)) for run in self.runs]
        found = {}
        for name in names():
            for lasting in ("", *LASTING) if effect_class(name).lasts else ("",):
                longest_s = max(g[lasting] + float(np.ptp(run.time)) for g, run in zip(gone, self.runs, strict=True))
                found[name, lasting] = effect_class(name).seen_in(self.runs, longest_s)
        return {kind: values for kind, values in found.items() if values}

    @cached_property
    def folds(self) -> np.ndarray:
        """Fold (bins,) of every bin: one a run, or with fewer than ``MIN_FOLDS`` runs equal parts of each run.

        Leaving out half of a run would ask for more than the runs to come do: fits to them see all of it.
        """
        whole, runs = sum(run.time[-1] - run.time[0] for run in self.runs), len(self.runs)
        wanted = MIN_FOLDS if runs >= MIN_FOLDS else max(MIN_FOLDS, min(FOLDS, int(whole / FOLD_S)))
        parts = -(-wanted // runs)
        found = []
        for number, bins in enumerate(self.bins):
            found.append(number * parts + np.arange(len(bins)) * parts // len(bins))
        return np.concatenate(found)

    def floor(self, noise: float, rounding: float) -> float:
        """Return the rms that white ``noise`` leaves in the bins, or ``rounding``, which is the same in all samples of one."""
        left = np.average([bins.noise_left for bins in self.bins], weights=[len(bins) for bins in self.bins])
        return max(noise * float(np.sqrt(left)), rounding)

    def binned(self, number: int, values: np.ndarray) -> np.ndarray:
        """Return bin means (bins, n) of ``values`` (steps, n) of run ``number``."""
        return self.bins[number].mean(values)

    @cached_property
    def _steps(self) -> int:
        """Number of a body's steps that take as long as a replay."""
        share = effort.VALVE_STEP if self.target == "pressure" else 1.0
        return round(share * sum(np.ptp(run.time) for run in self.runs) / self.numerics.dt_s)

    @cached_property
    def _known(self) -> dict[tuple[Hypothesis, bytes, tuple[str, ...]], list[Recording]]:
        """The last replays, oldest first."""
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs."""
        return {name: value for name, value in self.__dict__.items() if name != "_known"}

    @property
    def _compared(self) -> tuple[str, ...]:
        """The channels that are compared."""
        if self.target == "pressure":
            return ("pressure_meas",)
        if self.robot.output == "bend_angle":
            return ("bend_angle",)
        return ("position", "quaternion") if self.orientation else ("position",)

    def replayed(
        self, hypothesis: Hypothesis, point: np.ndarray, channels: tuple[str, ...] = CHANNELS
    ) -> list[Recording]:
        """Return what the hypothesis predicts for every run, the ``channels`` that are wanted.

        Raises
        ------
        SolverError
            If the body diverges.
        """
        effort.note(self._steps)  # kept ones, too: what is kept depends on the process, and where a search ends must not
        key = hypothesis, point.tobytes(), channels
        if key not in self._known:
            self._known[key] = self._replayed(hypothesis, point, channels)
            if len(self._known) > REPLAYS:
                del self._known[next(iter(self._known))]
        return list(self._known[key])

    def _replayed(self, hypothesis: Hypothesis, point: np.ndarray, channels: tuple[str, ...]) -> list[Recording]:
        space = self.space(hypothesis)
        apart = {s for choice in hypothesis.effects for s in choice.sessions} | {*self.stiffer}  # all others share what acts
        lasts = any(choice.lasting for choice in hypothesis.effects)
        times = [
            (run.session if run.session in apart else "", run.gone_s if lasts else (run.gone_s[0], 0.0, 0.0))
            for run in self.runs
        ]
        tuned = space.tuned(point)
        bodies = {
            day: StillBody() if self.target == "pressure" else tuned_body(self.simulator, tuned, self.stiffer.get(day, 0.0))
            for day, _ in times
        }
        plants = {
            when: Plant(bodies[when[0]], chain_of(self.robot, space.effects(point, *when))) for when in dict.fromkeys(times)
        }
        pairs, late_s = zip(times, self.runs, strict=True), space.late(point)
        return [self._replay(plants[when], run, channels, late_s) for when, run in pairs]

    def _from_rest(self, run: Recording) -> bool:
        """Return whether nothing acts at the beginning of ``run``, nor did before."""
        first = run.pressure_cmd[0] if run.pressure_meas is None else run.pressure_meas[0]
        return self.robot.is_at_rest(np.array([first, self.before.get(run.name, first)]))

    @cached_property
    def _rows_apart(self) -> dict[str, float]:
        """By run how far apart its rows are, in intervals of most runs."""
        if self.interval_s <= 0.0:
            return dict.fromkeys((run.name for run in self.runs), 1.0)
        apart = {run.name: float(np.median(np.diff(run.time))) / self.interval_s for run in self.runs}
        return {name: times if abs(times - 1.0) > SAME_RATE else 1.0 for name, times in apart.items()}

    def late_in(self, run: Recording, late_s: float) -> float:
        """Return how late, s, the log of ``run`` has it that rows act, where that of most runs is ``late_s`` late."""
        return late_s * self._rows_apart[run.name]

    def _unjudged(self, run: Recording) -> float:
        return 0.0 if self._from_rest(run) else min(UNJUDGED_S, UNJUDGED_SHARE * float(np.ptp(run.time)))

    def _replay(self, plant: Plant, run: Recording, channels: tuple[str, ...], late_s: float) -> Recording:
        settle = 0.0 if self._from_rest(run) else self.numerics.settle_s
        before, supply, later = self.before.get(run.name), self.supply.get(run.name), self._later.get(run.name)
        late_s = self.late_in(run, late_s)
        made = replay(plant, run, self.numerics.dt_s, self.drive, settle, before, channels, late_s, supply, later)
        for name in self._compared:
            if not np.isfinite(_present(getattr(made, name))).all():
                raise SolverError(f"run {run.name}: the simulation did not stay finite; try a smaller dt_s")
        return made

    def residual(
        self, hypothesis: Hypothesis, point: np.ndarray, registrations: dict[str, Registration] | None = None
    ) -> Residual:
        """Return measured less predicted; ``registrations`` found elsewhere are kept, else they are fitted here."""
        return self.compare(self.replayed(hypothesis, point, self._compared), registrations)

    def compare(self, simulated: Sequence[Recording], registrations: dict[str, Registration] | None = None) -> Residual:
        """Return measured less ``simulated``."""
        placed: dict[str, Registration] = {}
        if self.target == "pressure":
            found = [self._pressure(k, simulated[k]) for k in range(len(self.runs))]
        elif self.robot.output == "bend_angle":
            found = [self._angle(k, simulated[k]) for k in range(len(self.runs))]
        else:
            placed = self._placements(simulated, registrations) if self.register or self.mounted else {}
            found = [self._motion(k, simulated[k], placed) for k in range(len(self.runs))]
        return Residual([a + b for a, b in zip(found, self.defect, strict=True)] if self.defect else found, placed)

    def _pressure(self, k: int, simulated: Recording) -> np.ndarray:
        difference = self.binned(k, _present(self.runs[k].pressure_meas) - _present(simulated.pressure_meas))
        return np.asarray(difference - difference.mean(axis=0))  # a sensor's constant offset is not the valve's

    def _angle(self, k: int, simulated: Recording) -> np.ndarray:
        difference = _present(self.runs[k].bend_angle) - _present(simulated.bend_angle)
        return self.robot.length_m * self.binned(k, difference[:, None])

    def _motion(self, k: int, simulated: Recording, placed: dict[str, Registration]) -> np.ndarray:
        run = self.runs[k]
        position = _present(simulated.position)
        if run.session in placed:
            turn, shift = placed[run.session]
            position = position @ turn.T + shift
        parts = [_present(run.position) - position]
        if self.orientation and run.quaternion is not None:
            turned = turn_between(_present(simulated.quaternion), run.quaternion)
            mount = placed[run.session].turn if run.session in placed else np.eye(3)  # a small one
            parts.append(ORIENTATION_LEVER * self.robot.length_m * (turned - Rotation.from_matrix(mount).as_rotvec()))
        return self.binned(k, np.hstack(parts))

    def _placements(
        self, simulated: Sequence[Recording], known: dict[str, Registration] | None
    ) -> dict[str, Registration]:
        placed = dict(known or {})
        for session in dict.fromkeys(run.session for run in self.runs):
            if session not in placed:
                mine = [k for k, run in enumerate(self.runs) if run.session == session]
                points, seen = joined([simulated[k] for k in mine], [self.runs[k] for k in mine])
                nearby = MOUNT_TURN_RAD, MOUNT_SHIFT_SHARE * self.robot.length_m
                placed[session] = place(points, seen) if self.register else place_nearby(points, seen, *nearby)
        return placed


def _present(values: np.ndarray | None) -> np.ndarray:
    if values is None:
        raise SolverError("a channel that is compared is missing from a run; record it, or drop the run")
    return values
