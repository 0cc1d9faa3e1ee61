"""The effects that a search is offered: where, for which chambers, sessions, pressures and times."""

from collections.abc import Sequence

from softrl.diagnosis.hypothesis import Choice, Gate, has_chamber
from softrl.effects.library import effect_class
from softrl.robots.robot import Robot

BEGINS = (0.3, 0.6)  # shares of the run and of its highest pressure at which searches for a gate begin
BEGIN_ALONE = (0.45,)  # the same for one chamber alone, of which there are many
# what may change from one day to the next: warmth, rest and age of the wall; what it carries; how it is mounted, and how seen
BY_SESSION = ("stiffness_scale", "strain_softening", "payload", "mount_tilt", "base_tilt", "frame", "marker_offset")


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


def in_one_session(names: Sequence[str], training: Sequence[str], heldout: Sequence[str]) -> list[Choice]:
    """Return the effects out of ``names`` that may act in one session alone, for every session that can show them.

    What retuning does shows as a difference between sessions only: of the last one it is told by the others.

    Parameters
    ----------
    training, heldout : session of every run; only a session with two runs to fit and one to judge can show such an effect
    """
    sessions = list(dict.fromkeys(training))
    shown = [s for s in sessions if training.count(s) > 1 and s in heldout]
    return [
        Choice(name, session=s)
        for name in names
        if name in BY_SESSION
        for s in shown
        if s != sessions[-1] or not effect_class(name).retunes
    ]


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
            found += [choice._replace(lasting="session", session=s) for s in several if s in heldout and s != sessions[-1]]
    return found


def may_be_gated(choice: Choice) -> list[str]:
    """Return the fields of the gates that ``choice`` may have: a time, and where pressure acts a pressure."""
    effect = effect_class(choice.name)
    if effect.together or effect.layered:
        return []
    times = [] if effect.clock is not None else ["since_s"]
    return times + ["above_share"] * (effect.site in ("valve", "chamber", "body"))


def gated(choice: Choice, duration_s: float, highest_share: float) -> list[Choice]:
    """Return the forms of ``choice`` that act above a pressure or from a time on only, begun at several places.

    Parameters
    ----------
    duration_s : of the runs
    highest_share : pressure that they reach, as a share of the robot's largest
    """
    begins = BEGINS if choice.chamber < 0 else BEGIN_ALONE
    whole = {"since_s": duration_s, "above_share": highest_share}
    gates = [Gate(field, share * whole[field]) for field in may_be_gated(choice) for share in begins]
    return [choice._replace(gate=gate) for gate in gates]
