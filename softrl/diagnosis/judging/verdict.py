"""The verdict of a diagnosis: nothing missing, named, indistinguishable, or unknown."""

from collections.abc import Sequence

import numpy as np

from softrl.diagnosis.judging.examine import Finding

AS_GOOD = 1.05  # times the retuned error: nothing was gained
FAR_BETTER = 2.0  # times the error with a single lag: what was measured between valve and body is not what acts


def verdict_of(findings: Sequence[Finding], heldout: dict[str, float]) -> str:
    """Return the verdict of all parts together, and of the competitors' ``heldout`` errors from command to motion."""
    named = [effect for finding in findings for effect in finding.named]
    if findings[-1].unknown or (not named and any(finding.unknown for finding in findings)):
        return "unknown"
    if not named:
        return "nothing missing"
    if misleads(findings, heldout) or (findings[0].unknown and not explains(findings[0], heldout)):
        return "unknown"
    return "indistinguishable" if any(alternatives(finding) for finding in findings) else "named"


def misleads(findings: Sequence[Finding], heldout: dict[str, float]) -> bool:
    """Return whether the corrected simulator errs plainly more than one retuned, or one with a single lag, does.

    Whatever its parts do on their own, they do not serve together then. Where valve and body were both understood apart, a
    lag that is fitted from the command, with whatever else makes up for it, is no witness against them unless it is far better.
    """
    apart = len(findings) > 1 and not any(finding.unknown for finding in findings)
    plain = min(heldout["retuned"], (FAR_BETTER if apart else 1.0) * heldout.get("one_lag", np.inf))
    return heldout["corrected"] > AS_GOOD * max(plain, heldout["noise_floor"])


def explains(valve: Finding, heldout: dict[str, float]) -> bool:
    """Return whether the correction explains from the command what effects should, though its ``valve`` is not understood."""
    retuned, corrected = (max(heldout[name] ** 2 - heldout["noise_floor"] ** 2, 0.0) for name in ("retuned", "corrected"))
    return retuned - corrected >= valve.judge.thresholds.explained_share * retuned


def alternatives(finding: Finding) -> list[str]:
    """Return the alternatives, effects or chambers, that held-out data cannot tell apart from what is named."""
    return [rival.choice.label() for rival in finding.rivals if rival.contests]
