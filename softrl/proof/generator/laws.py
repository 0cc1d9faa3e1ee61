"""The physics that is hidden: supply, chambers, walls, loads. Other equations than anybody's hypotheses need.

Every law owns one row of a table ``P`` (laws, 8): columns 0 to 4 are its parameters, the first of which is zero
where the law is absent; 5 the chamber that it acts on (-1 all), 6 the share of the largest pressure above which
it acts (-9 always), 7 the time from which it acts, s (-1 always). Pressures are in units of the largest pressure.
"""

import math

import numba as nb
import numpy as np

LAWS = (
    "spool", "choke", "line", "relay", "ceiling", "stick",
    "orifice", "gain", "offset", "coupling", "balloon", "warmth", "product",
    "powerlaw", "slip", "bristle", "damage", "fung", "soften", "wall", "relax", "braid", "fold", "rubber", "joint",
    "mass", "tilt", "rebound", "string", "buckle",
    "frame", "marker", "latency", "sampling", "twist", "jolt",
)  # fmt: skip
(
    SPOOL, CHOKE, LINE, RELAY, CEILING, STICK,
    ORIFICE, GAIN, OFFSET, COUPLING, BALLOON, WARMTH, PRODUCT,
    POWERLAW, SLIP, BRISTLE, DAMAGE, FUNG, SOFTEN, WALL, RELAX, BRAID, FOLD, RUBBER, JOINT,
    MASS, TILT, REBOUND, STRING, BUCKLE,
    FRAME, MARKER, LATENCY, SAMPLING, TWIST, JOLT,
) = range(len(LAWS))  # fmt: skip
COLUMNS, CHAMBER, ABOVE, LATE = 8, 5, 6, 7
STAGES = 16  # of the line: a delay spread by a quarter of itself
RELAY_FLOW = 25.0  # full pressures a second of its open valves: at 5, a small band was a limited rate and nothing else
MODES = 7  # of the power law, from 0.05 to 50 s
SLIPS = 8  # elements that slip one after the other
SUPPLY_SLOTS = 6 + STAGES
WALL_SLOTS = 2 + SLIPS + MODES


def neutral_table() -> np.ndarray:
    """Return the table (laws, 8) in which no law acts."""
    table = np.zeros((len(LAWS), COLUMNS))
    table[:, CHAMBER], table[:, ABOVE], table[:, LATE] = -1.0, -9.0, -1.0
    return table


@nb.njit(cache=True)
def gate(P: np.ndarray, law: int, c: int, t: float, p: float) -> float:
    """Return how far a law acts on chamber ``c`` at time ``t`` under pressure ``p``, 0 to 1."""
    if P[law, CHAMBER] >= 0.0 and int(P[law, CHAMBER]) != c:
        return 0.0
    share = 1.0
    if P[law, ABOVE] > -5.0:
        share *= min(max((p - P[law, ABOVE]) / 0.1, 0.0), 1.0)
    if P[law, LATE] >= 0.0:
        share *= min(max((t - P[law, LATE]) / 2.0, 0.0), 1.0)
    return share


@nb.njit(cache=True)
def supply(P: np.ndarray, c: int, t: float, h: float, u: float, state: np.ndarray, sticking: np.ndarray) -> float:
    """Return the pressure behind the valve of chamber ``c``; ``state`` (6 + stages,) is advanced."""
    p = u
    if P[LINE, 0] > 0.0:
        stage = P[LINE, 0] / STAGES
        for k in range(STAGES):
            state[6 + k] += h / (h + stage) * (p - state[6 + k])
            p = state[6 + k]
        p = u + gate(P, LINE, c, t, u) * (p - u)
    if P[RELAY, 0] > 0.0:
        gap = p - state[0]
        if abs(gap) > P[RELAY, 0]:
            state[1] = 1.0
        if state[1] > 0.0:  # they close within the step in which the gap comes to 0.4 of the band, not at its end
            beyond = max(abs(gap) - 0.4 * P[RELAY, 0], 0.0)
            state[0] += math.copysign(min(beyond, RELAY_FLOW * h), gap)
            state[1] = 1.0 if beyond > RELAY_FLOW * h else 0.0
        p += gate(P, RELAY, c, t, u) * (state[0] - p)
    if P[CHOKE, 0] > 0.0:
        gap = p - state[2]
        reach = h / P[CHOKE, 0] * (1.0 if gap > 0.0 else P[CHOKE, 1])
        flow = reach * min(math.sqrt(abs(gap) / 0.05), 1.0)
        state[2] += math.copysign(min(flow, abs(gap)), gap)
        p += gate(P, CHOKE, c, t, u) * (state[2] - p)
    if P[SPOOL, 0] > 0.0:
        tau = P[SPOOL, 0] * (1.0 if p >= state[3] else P[SPOOL, 1])
        quick = 0.15 * P[SPOOL, 0]
        x = (state[4] + h / quick * (p - state[3])) / (1.0 + h / quick + h * h / (quick * tau))
        state[4] = min(max(x, -P[SPOOL, 2]), P[SPOOL, 2])
        state[3] += h * state[4] / tau
        p += gate(P, SPOOL, c, t, u) * (state[3] - p)
    if P[CEILING, 0] > 0.0:
        width, top = 0.01, 1.0 - P[CEILING, 0]
        excess = (p - top) / width
        over = width * (excess if excess > 30.0 else math.log1p(math.exp(excess)))
        p -= gate(P, CEILING, c, t, 9.0) * over
    stuck = False
    if P[STICK, 0] > 0.0:
        for k in range(len(sticking)):
            if sticking[k, 0] <= t < sticking[k, 1] and int(sticking[k, 2]) == c:
                stuck = True
    if not stuck:
        state[5] = p
    return state[5]


@nb.njit(cache=True)
def inflate(P: np.ndarray, t: float, h: float, p: np.ndarray, state: np.ndarray, acting: np.ndarray) -> None:
    """Fill the pressures that act in the chambers; ``state`` (chambers, 2) is advanced."""
    n = len(p)
    total = 0.0
    for c in range(n):
        total += p[c]
    for c in range(n):
        a = p[c]
        if P[ORIFICE, 0] > 0.0:
            inside = p[c] - state[c, 0]
            flow = math.copysign(math.sqrt(abs(inside) + 1e-4) - 1e-2, inside)
            flow *= P[ORIFICE, 0] * gate(P, ORIFICE, c, t, p[c])
            state[c, 0] = (state[c, 0] + h * flow) / (1.0 + h / P[ORIFICE, 1])
            a -= state[c, 0]
        if P[COUPLING, 0] != 0.0:
            squeezed = P[COUPLING, 0] * gate(P, COUPLING, c, t, p[c]) * (total - p[c])
            state[c, 1] += h / (h + 0.02) * (squeezed - state[c, 1])
            a += state[c, 1]
        a *= 1.0 + P[GAIN, 0] * gate(P, GAIN, c, t, p[c])
        if P[BALLOON, 0] != 0.0:
            a *= 1.0 + P[BALLOON, 0] * gate(P, BALLOON, c, t, p[c]) * abs(p[c]) ** 1.5
        if P[WARMTH, 0] != 0.0:
            a *= 1.0 + P[WARMTH, 0] * math.sin(2.0 * math.pi * t / P[WARMTH, 1] + P[WARMTH, 2])
        if P[PRODUCT, 0] != 0.0:
            a += P[PRODUCT, 0] * p[c] * (p[(c + 1) % n] - p[(c + 2) % n])
        acting[c] = a + P[OFFSET, 0] * gate(P, OFFSET, c, t, p[c])
    if P[BUCKLE, 0] != 0.0:
        high = 0.0
        for c in range(n):
            high = max(high, p[c])
        share = P[BUCKLE, 0] * min(max((high - P[BUCKLE, 1]) / 0.2, 0.0), 1.0)
        mean = 0.0
        for c in range(n):
            mean += acting[c] / n
        kept = acting.copy()
        for c in range(n):  # the part that bends turns towards the next chamber; the part that lengthens stays
            acting[c] = mean + math.cos(share) * (kept[c] - mean)
            acting[c] += math.sin(share) * (kept[(c - 1) % n] - kept[(c + 1) % n]) / math.sqrt(3.0)


@nb.njit(cache=True)
def relaxed(share: float, h: float, change: float, modes: np.ndarray) -> float:
    """Return the overstress of a relaxation that falls as a power of time; ``modes`` are advanced."""
    total, weight = 0.0, 0.0
    for k in range(MODES):
        tau = 0.05 * 10.0 ** (0.5 * k)
        kept = tau / (tau + h)
        modes[k] = kept * (modes[k] + change)
        total += tau**-0.12 * modes[k]
        weight += tau**-0.12
    return share * total / weight


@nb.njit(cache=True)
def resist(
    P: np.ndarray, c: int, t: float, h: float, e: float, rate: float, p: float, spring: float, s: np.ndarray
) -> float:
    """Return the further pressure with which the wall of chamber ``c`` resists its elongation ``e``.

    ``spring`` is the wall's own stiffness in units of the largest pressure; ``s`` is advanced: (largest energy,
    bristle, slips, modes).
    """
    added = 0.0
    if P[SLIP, 0] > 0.0:
        share = 0.0
        for k in range(SLIPS):
            reach = P[SLIP, 1] * (k + 0.5) / (0.5 * SLIPS)
            s[2 + k] = min(max(s[2 + k] + rate * h, -reach), reach)
            share += s[2 + k] / reach / SLIPS
        added += P[SLIP, 0] * gate(P, SLIP, c, t, p) * share
    if P[BRISTLE, 0] > 0.0:
        height = 1.0 + P[BRISTLE, 2] * math.exp(-((rate / 0.02) ** 2))
        pull = abs(rate) / (height * P[BRISTLE, 1])
        settled = math.copysign(height * P[BRISTLE, 1], rate)
        s[1] = settled + (s[1] - settled) * math.exp(-pull * h)
        loaded = 1.0 + P[BRISTLE, 3] * abs(p)
        added += P[BRISTLE, 0] * loaded * gate(P, BRISTLE, c, t, p) * s[1] / P[BRISTLE, 1]
    if P[DAMAGE, 0] > 0.0 and gate(P, DAMAGE, c, t, p) >= 0.0:
        energy = e * e
        s[0] = max(s[0] * (1.0 - h / P[DAMAGE, 2]), energy)
        beyond = max(s[0] - max(energy, P[DAMAGE, 3] ** 2), 0.0)
        lost = P[DAMAGE, 0] * math.erf(beyond / (P[DAMAGE, 1] ** 2 + 0.1 * s[0]))
        if P[DAMAGE, CHAMBER] < 0.0 or int(P[DAMAGE, CHAMBER]) == c:
            added -= lost * spring * e
    if P[FUNG, 0] > 0.0:
        added += gate(P, FUNG, c, t, p) * spring * e * (math.exp(min(P[FUNG, 0] * e * e, 5.0)) - 1.0)
    if P[SOFTEN, 0] > 0.0:
        bent = P[SOFTEN, 0] * abs(e)
        added -= gate(P, SOFTEN, c, t, p) * spring * e * bent / (1.0 + bent)
    if P[RUBBER, 0] > 0.0:  # its part of the wall levels off from one strain on, to a tenth, and rises steeply about another
        grown = 0.3 * e * (math.exp(min((e / P[RUBBER, 2]) ** 2, 5.0)) - 1.0)
        level = 0.1 * e + 0.9 * P[RUBBER, 1] * math.tanh(e / P[RUBBER, 1])
        added += gate(P, RUBBER, c, t, p) * P[RUBBER, 0] * spring * (level + grown - e)
    if P[BRAID, 0] != 0.0:  # threads of one length: the section's area has a term in the square of the length
        added -= gate(P, BRAID, c, t, p) * P[BRAID, 0] * p * 0.5 * ((1.0 + e) * (1.0 + e) - 1.0)
    if P[FOLD, 0] != 0.0:
        added += gate(P, FOLD, c, t, p) * P[FOLD, 0] * spring * P[FOLD, 1] * math.log(math.cosh(e / P[FOLD, 1]))
    if P[WALL, 0] != 0.0:
        added += gate(P, WALL, c, t, p) * P[WALL, 0] * spring * e
    if P[POWERLAW, 0] > 0.0 and P[POWERLAW, CHAMBER] >= 0.0:
        if int(P[POWERLAW, CHAMBER]) == c:
            added += spring * relaxed(P[POWERLAW, 0], h, rate * h, s[2 + SLIPS :])
    return added


@nb.njit(cache=True)
def rub(P: np.ndarray, h: float, joints: int, rates: np.ndarray, s: np.ndarray) -> None:
    """Advance how far the fibres ``s`` (2,) of one of ``joints`` are drawn by its ``rates`` (2,) of turn, about 1 at most.

    Bouc and Wen's form of exponent 2 for a joint that turns any way: the way out levels off, the way back is straight.
    """
    reach = P[JOINT, 1] / joints
    x, y = rates[0] * h / reach, rates[1] * h / reach
    count = int(math.hypot(x, y) / 0.02) + 1
    for _ in range(count):
        outward = max(s[0] * x + s[1] * y, 0.0)
        s[0], s[1] = s[0] + (x - outward * s[0]) / count, s[1] + (y - outward * s[1]) / count


@nb.njit(cache=True)
def pull(P: np.ndarray, t: float, tip: np.ndarray, speed: np.ndarray, length: float, force: np.ndarray) -> None:
    """Add the forces of a wall that the tip strikes and of a string that it stretches, N; lengths in m."""
    if P[REBOUND, 0] > 0.0:
        depth, closing = -P[REBOUND, 1] * length, 0.0
        along = (math.cos(P[REBOUND, 2]), math.sin(P[REBOUND, 2]))
        for k in range(2):
            depth += along[k] * tip[k]
            closing += along[k] * speed[k]
        if depth > 0.0:
            push = P[REBOUND, 0] * depth * math.sqrt(depth / 1e-3) * max(1.0 + 2.0 * closing, 0.0)
            for k in range(2):
                force[k] -= push * along[k]
    if P[STRING, 0] > 0.0:
        x, y = tip[0] - length * P[STRING, 1], tip[1] - length * P[STRING, 2]
        z = tip[2] - length
        distance = math.sqrt(x * x + y * y + z * z)
        taut = max(distance - length * P[STRING, 3], 0.0)
        share = P[STRING, 0] * taut / max(distance, 1e-9)
        force[0] -= share * x
        force[1] -= share * y
        force[2] -= share * z
