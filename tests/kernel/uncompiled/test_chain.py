"""The arrays of a chain: forward kinematics."""

import numpy as np
import pytest
import random_arms as arms

from ik_toolkit.kernel.chain import evaluate, levers, run

MIXES = ("tttstt", "tmtsnt", "stotmt", "tt")


@pytest.mark.parametrize("kinds", MIXES)
def test_poses_and_jacobians_of_a_chain(kinds):
    rng = np.random.default_rng(len(kinds))
    chain, rows, base, tip = arms.arm(rng, kinds)
    Q = rng.uniform(chain.lower, chain.upper, (4, chain.n))
    for way in (run, evaluate):
        T, J = way(chain.rows, chain.ends, Q, chain.unit, True)
        for q, pose, own in zip(Q, T, J, strict=True):
            np.testing.assert_allclose(pose, arms.fk(rows, base, tip, q)[0], atol=1e-13)
            np.testing.assert_allclose(own, arms.jacobian(rows, base, tip, q), atol=2e-9)
        assert way(chain.rows, chain.ends, Q, chain.unit)[1].shape[0] == 0
    D = np.empty((4, len(rows)))
    levers(chain.rows, chain.ends, Q, chain.unit, D)
    for q, row in zip(Q, D, strict=True):
        pose, frames = arms.fk(rows, base, tip, q)
        want = [np.linalg.norm(np.cross(F[:3, 2], pose[:3, 3] - F[:3, 3])) for F in frames]
        np.testing.assert_allclose(row, want, atol=1e-12)
