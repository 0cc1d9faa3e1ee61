"""The effects that a search is offered: where, for which chambers, sessions, pressures and times."""

from collections.abc import Sequence

from softrl.diagnosis.fitting.hypothesis import Choice, Gate, has_chamber
from softrl.effects.library import effect_class
from softrl.robots.robot import Robot

BEGINS = (0.3, 0.6)  # shares of the run and of its highest pressure at which searches for a gate begin
BEGIN_ALONE = (0.45,)  # the same for one chamber alone, of which there are many
# what may change from one day to the next: warmth, rest and age of the wall; what it carries; how it is mounted, and how seen
BY_SESSION = ("stiffness_scale", "strain_softening", "payload", "mount_tilt", "base_tilt", "frame", "marker_offset")
ALONE_BY_SESSION = ("gain",)  # the same of one chamber: another hose, a leak, a torn layer; before its gauge a regulator


def candidates(
    names: Sequence[str],
    sites: Sequence[str],
    robot: Robot,
    excited: Sequence[int],
    layers: bool = False,
    varied: Sequence[str] = (),
    gauges_only: bool = False,
) -> list[Choice]:
    """Return every effect out of ``names`` at ``sites``: for all chambers, and for each that was driven.

    ``layers`` says whether the body has layers, and ``varied`` which surroundings were recorded and changed, without which
    some effects cannot be shown. ``gauges_only`` says that measured pressures are what is compared: what happens to a
    chamber before its gauge is considered, too. Where the valve is not among the ``sites``, pressures were measured behind it:
    then the line from gauge to chamber is.
    """
    found = []
    for name in names:
        effect = effect_class(name)
        ahead = effect.gauged and gauges_only
        behind = effect.piped and "valve" not in sites
        if effect.site not in sites and not ahead and not behind:
            continue
        if not effect.suits(robot) or (effect.together and len(excited) < robot.chambers):
            continue
        if (effect.layered and not layers) or (effect.needs and effect.needs not in varied):
            continue
        found.append(Choice(name, before_gauge=ahead, behind_gauge=behind))
        if has_chamber(name) and robot.chambers > 1 and len(excited) > 1:
            found += [Choice(name, chamber, before_gauge=ahead, behind_gauge=behind) for chamber in excited]
    return found


def in_some_sessions(
    names: Sequence[str],
    training: Sequence[str],
    heldout: Sequence[str],
    order: Sequence[str],
    excited: Sequence[int] = (),
    gauges_only: bool = False,
) -> list[Choice]:
    """Return the effects out of ``names`` that may act in some sessions alone, for all periods that can show them.

    Of periods that act in the same fitted runs the longest is offered; see ``alike`` for the others. What acts in one chamber is
    offered for each that was ``excited``; where that is one alone, for all. ``gauges_only`` says that measured pressures are
    what is compared: what a regulator does, in one chamber or in all, shows there alone.

    Parameters
    ----------
    training, heldout : session of every run; only a period with two runs to fit and one to judge can show such an effect,
        beside two to fit in which it does not act
    order : sessions in the order of recording
    """
    alone = [Choice(name, before_gauge=gauges_only) for name in names if name in ALONE_BY_SESSION]
    forms = [] if gauges_only else [Choice(name) for name in names if name in BY_SESSION]
    if gauges_only or len(excited) == 1:
        forms += alone
    if len(excited) > 1:
        forms += [form._replace(chamber=chamber) for form in alone for chamber in excited]
    found: dict[tuple[Choice, frozenset[str]], Choice] = {}
    for form in forms:
        for period in _periods_of(form, order):
            inside = sum(session in period for session in training)
            if 1 < inside < len(training) - 1 and any(session in period for session in heldout):
                found.setdefault((form, frozenset(training) & set(period)), form._replace(sessions=period))
    return list(found.values())


def alike(choice: Choice, training: Sequence[str], order: Sequence[str]) -> list[Choice]:
    """Return the forms of ``choice`` that act in the same of the sessions in ``training``, in others or not."""
    acts = [session in choice.sessions for session in training]
    same = [p for p in _periods_of(choice, order) if [session in p for session in training] == acts]
    return [choice._replace(sessions=period) for period in same] if choice.sessions and not choice.lasting else [choice]


def periods(order: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the periods out of ``order`` in which something may have been otherwise: from a session on, up to one, or one.

    The longest come first.
    """
    each = range(1, len(order))
    found = [tuple(order[k:]) for k in each] + [tuple(order[:k]) for k in each] + [(s,) for s in order if each]
    return sorted(dict.fromkeys(found), key=lambda period: -len(period))


def _periods_of(choice: Choice, order: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the periods in which the effect may act, in all chambers or in one.

    What retuning does shows as a difference between sessions only: of what goes on to the last one the others tell.
    """
    retunes = effect_class(choice.name).retunes and choice.chamber < 0
    return [period for period in periods(order) if not (retunes and period[-1] == order[-1])]


def that_last(choices: Sequence[Choice], training: Sequence[str], heldout: Sequence[str]) -> list[Choice]:
    """Return the forms of ``choices`` whose time goes on from run to run: for ever, or through a session.

    Parameters
    ----------
    choices : for all chambers, or for one
    training, heldout : session of every run; what no run after another shows is not offered
    """
    able = [choice for choice in choices if effect_class(choice.name).lasts]
    sessions = list(dict.fromkeys(training))
    several = [s for s in sessions if training.count(s) > 1]
    found = [choice._replace(lasting="ever") for choice in able if len(training) > 1]
    for choice in able:
        if several and len(sessions) > 1 and choice.chamber < 0:
            found.append(choice._replace(lasting="session"))
        # of the last session nothing tells what lasts for ever from what lasts until its end; a wall that is another on one
        # day is another stiffness there
        if effect_class(choice.name).site == "chamber":
            found += [choice._replace(lasting="session", sessions=(s,)) for s in several if s in heldout and s != sessions[-1]]
    return found


def may_be_gated(choice: Choice) -> list[str]:
    """Return the fields of the gates that ``choice`` may have: a time, and a pressure where that acts and the law has none."""
    effect = effect_class(choice.name)
    if effect.together or effect.layered:
        return []
    times = [] if effect.clock is not None else ["since_s"]
    return times + ["above_share"] * (effect.site in ("valve", "chamber", "body") and not effect.above_own)


def gated(choice: Choice, duration_s: float, highest_share: float) -> list[Choice]:
    """Return the forms of ``choice`` that act above a pressure or from a time on only, begun at several places.

    Parameters
    ----------
    duration_s : of the runs
    highest_share : pressure that they reach, as a share of the robot's largest; under suction alone none is above another
    """
    begins = BEGINS if choice.chamber < 0 else BEGIN_ALONE
    whole = {"since_s": duration_s, "above_share": highest_share}
    able = [field for field in may_be_gated(choice) if whole[field] > 0.0]
    gates = [Gate(field, share * whole[field]) for field in able for share in begins]
    return [choice._replace(gate=gate) for gate in gates]
