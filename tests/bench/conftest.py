"""A small surrogate, a policy and a calibration, as the rollouts' tests have them."""

from tests.sim2real.conftest import body, calibration, policy, surrogate, tripod

__all__ = ["body", "calibration", "policy", "surrogate", "tripod"]
