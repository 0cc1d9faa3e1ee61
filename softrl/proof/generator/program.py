"""What is commanded in a session, and when the device ticks."""

from dataclasses import dataclass

import numpy as np

TICK_S = 0.02
BLOCKS = ("holds", "waves", "stairs", "ramps")


@dataclass(frozen=True)
class Range:
    """Pressures that may be commanded, Pa, and their fastest change, Pa/s."""

    low_pa: float
    high_pa: float
    slew_pa_per_s: float
    chambers: int


@dataclass(frozen=True)
class Session:
    """Commands of one session.

    Attributes
    ----------
    time : (ticks,) s, uneven
    command : (ticks, chambers) Pa, each row held until its time
    tip_force : (ticks, 3) N, known and recorded; zero but out of distribution
    """

    time: np.ndarray
    command: np.ndarray
    tip_force: np.ndarray


def sessions(limits: Range, count: int, length_s: float, share: float, rng: np.random.Generator) -> list[Session]:
    """Return ``count`` sessions, each with programs of its own within ``share`` of the pressures.

    Every session mixes three blocks between rests; over the sessions every kind of block comes up, and every
    chamber is driven alone.
    """
    deck: list[tuple[str, int]] = []
    made = []
    for _ in range(count):
        while len(deck) < 3:
            deck += [(str(kind), int(c)) for kind, c in zip(rng.permutation(BLOCKS), rng.permutation(4), strict=True)]
        blocks = [deck.pop(0) for _ in range(3)]
        made.append(_session(limits, blocks, length_s, share, rng))
    return made


def outside(limits: Range, length_s: float, force_n: float, rng: np.random.Generator) -> Session:
    """Return a session of larger pressures and faster motion than any other, with a known force on the tip at last."""
    one = _session(limits, [("fast", 0), ("holds", 0), ("fast", 0)], length_s, 1.0, rng)
    force = np.zeros((len(one.time), 3))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    force[int(0.7 * len(force)) :, :2] = force_n * np.array([np.cos(angle), np.sin(angle)])
    return Session(one.time, one.command, force)


def _session(
    limits: Range, blocks: list[tuple[str, int]], length_s: float, share: float, rng: np.random.Generator
) -> Session:
    rest_s = 1.0
    span = (length_s - rest_s * (len(blocks) + 1)) / len(blocks)
    pause = np.zeros((round(rest_s / TICK_S), limits.chambers))
    parts = [pause]
    for kind, chamber in blocks:
        parts += [_block(limits, kind, chamber % limits.chambers, round(span / TICK_S), share, rng), pause]
    wanted = np.concatenate(parts)
    command, last = np.empty_like(wanted), np.zeros(limits.chambers)
    for k, row in enumerate(wanted):
        reach = limits.slew_pa_per_s * TICK_S
        last = last + np.clip(row - last, -reach, reach)
        command[k] = last
    time = np.cumsum(
        TICK_S * (1.0 + 2e-4 * rng.standard_normal()) + np.clip(1e-3 * rng.standard_normal(len(wanted)), -4e-3, 4e-3)
    )
    return Session(time, command, np.zeros((len(time), 3)))


def _block(limits: Range, kind: str, chamber: int, ticks: int, share: float, rng: np.random.Generator) -> np.ndarray:
    low, high = share * limits.low_pa, share * limits.high_pa
    phase = np.arange(1, ticks + 1) / ticks
    made = np.zeros((ticks, limits.chambers))
    if kind == "holds":
        edges = np.sort(rng.choice(np.arange(1, 10), 5, replace=False)) / 10.0
        levels = rng.uniform(low, high, (6, limits.chambers))
        levels[rng.integers(6)] *= np.eye(limits.chambers)[rng.integers(limits.chambers)]
        return np.asarray(levels[np.searchsorted(edges, phase)])
    if kind in ("waves", "fast"):
        top = 3.0 if kind == "fast" else 1.5
        tones = rng.uniform(0.0, 1.0, (limits.chambers, 5))
        hertz = 0.1 * (top / 0.1) ** tones
        turn = rng.uniform(0.0, 2.0 * np.pi, hertz.shape)
        seconds = (phase * ticks * TICK_S)[:, None, None]
        wave = np.sin(2.0 * np.pi * hertz * seconds + turn).sum(axis=2)
        wave /= np.abs(wave).max(axis=0)
        ease = np.minimum(1.0, np.minimum(phase, 1.0 - phase) / 0.1)[:, None]
        return np.asarray((0.5 * (low + high) + 0.5 * (high - low) * wave) * ease)
    if kind == "stairs":
        peaks = high * np.array([0.4, 0.4, 0.7, 0.7, 1.0, 1.0])
        place = phase * len(peaks) * (1.0 - 1e-9)
        made[:, chamber] = peaks[place.astype(int)] * (1.0 - np.abs(2.0 * (place % 1.0) - 1.0))
        return made
    period = np.array([0.55, 0.25, 0.12, 0.08])  # triangles at four rates
    start = np.r_[0.0, np.cumsum(period)]
    which = np.clip(np.searchsorted(start, phase, side="left") - 1, 0, 3)
    local = np.clip((phase - start[which]) / period[which], 0.0, 1.0)
    made[:, chamber] = rng.uniform(0.8, 1.0) * high * (1.0 - np.abs(2.0 * local - 1.0))
    if limits.chambers > 1:
        made[:, (chamber + 1) % limits.chambers] = rng.uniform(0.0, 0.4) * high * np.minimum(1.0, 5.0 * phase)
    return made
