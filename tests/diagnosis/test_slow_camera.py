"""A slow camera that runs freely is named as what it is, not as a delay."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from softrl.core.tracking import NullTracker
from softrl.diagnosis.stage import run
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording
from tests.diagnosis.conftest import configured, made

PERIOD_S = 0.08


def test_a_camera_that_is_in_mid_period_when_a_run_begins_is_named(body: PccSimulator) -> None:
    rng = np.random.default_rng(11)

    def seen_slowly(seen: Recording) -> Recording:
        phase_s, since = PERIOD_S * rng.uniform(), seen.time - seen.time[0]
        taken = phase_s + PERIOD_S * np.floor((since - phase_s) / PERIOD_S)
        position = np.stack([np.interp(taken, since, column) for column in np.asarray(seen.position).T], axis=1)
        quaternion = np.stack([np.interp(taken, since, column) for column in np.asarray(seen.quaternion).T], axis=1)
        turn = Rotation.from_quat(quaternion, scalar_first=True).as_quat(scalar_first=True)
        return replace(seen, position=position, quaternion=turn)

    recordings = made(body, (), seed=6, sessions=3, measured=True, process=seen_slowly)
    found = run(configured(candidates=["hold", "delay", "lag"]), body.robot, recordings, body, tracker=NullTracker())
    assert found.verdict == "named", found.sentences
    assert [effect["name"] for effect in found.effects] == ["hold"], found.sentences
    value = found.effects[0]["parameters"]["period_s"]["value"]
    assert abs(value - PERIOD_S) < 1e-4
    held = found.errors_mm["heldout"]
    assert held["corrected"] < 1.3 * held["noise_floor"], held
