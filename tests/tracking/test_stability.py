"""Mapping matrices, closed-form stability regions, best gains and the check of a user's gains."""

import math

import numpy as np
import pytest
from folders import read_data

from ik_toolkit.errors import InvalidOption
from ik_toolkit.tracking import stability as st

ORACLE = read_data("tracking")["stability"]


def test_published_gain_sets():
    for row in ORACLE["published"]:
        h = row["h"]
        cv = st.check_gains("cv", h, kappa=row["kappa"])
        ca = st.check_gains("ca", h, kp=row["kp"], kd=row["kd"])
        assert cv.radius == pytest.approx(row["cv_rho"], abs=1e-9)
        assert ca.radius == pytest.approx(row["ca_rho"], abs=1e-9)
        assert (cv.verdict, ca.verdict) == (row["cv_verdict"], row["ca_verdict"])
        assert st.p_limit(row["kd"] * h) == pytest.approx(row["p_limit"], abs=1e-9)


def test_the_contradiction_of_the_rr_set():
    """The RR set the paper calls unstable: cv exactly on the border, ca inside the region by 0.9 %."""
    A = st.mapping_matrix("cv", 0.2, kappa=5.0, dof=2)
    assert abs(st.spectral_radius(A) - 1.0) < 1e-12
    ca = st.check_gains("ca", 0.2, kp=61.0, kd=3.8)
    assert ca.stable and ca.radius == pytest.approx(0.990976596748, abs=1e-9)
    assert not st.check_gains("ca", 0.2, kp=61.6, kd=3.8).stable


def test_random_points_of_the_oracle():
    for row in ORACLE["random_cv"]:
        assert st.check_gains("cv", row["h"], kappa=row["kappa"]).radius == pytest.approx(row["rho"], abs=1e-9)
        assert st.cv_stable(row["kappa"] * row["h"]) == row["stable"]
    for row in ORACLE["random_ca"]:
        got = st.check_gains("ca", row["h"], kp=row["kp"], kd=row["kd"])
        assert got.radius == pytest.approx(row["rho"], abs=1e-9)
        assert got.stable == row["stable"]


def test_closed_form_agrees_with_eigenvalues_on_100000_points():
    rng = np.random.default_rng(5)
    p, d, k = rng.uniform(-0.5, 4.0, 100_000), rng.uniform(-0.2, 1.4, 100_000), rng.uniform(-0.5, 1.5, 100_000)
    ca = np.zeros((100_000, 3, 3))
    ca[:, 0] = np.stack([1 - 0.75 * p, 1 - 0.75 * d, np.full_like(p, -0.25)], 1)
    ca[:, 1] = np.stack([-1.5 * p, 1 - 1.5 * d, np.full_like(p, -0.5)], 1)
    ca[:, 2, 0], ca[:, 2, 1] = -p, -d
    assert np.array_equal(ca[0], st.mapping_matrix("ca", 1.0, kp=p[0], kd=d[0]))  # the vectorised copy is the real one
    rho = np.abs(np.linalg.eigvals(ca)).max(1)
    clear = np.abs(rho - 1.0) > 1e-9
    assert clear.mean() > 0.999
    assert np.array_equal(st.ca_stable(p, d)[clear], rho[clear] < 1.0)
    cv = np.zeros((100_000, 2, 2))
    cv[:, 0, 0], cv[:, 0, 1], cv[:, 1, 0] = 1 - 1.5 * k, -0.5, -k
    rho = np.abs(np.linalg.eigvals(cv)).max(1)
    assert np.array_equal(st.cv_stable(k), rho < 1.0)


def test_several_joints_repeat_the_eigenvalues():
    """Eqs (39)-(42), with kd in entry (3,3) of (41): twice the eigenvalues of the single joint."""
    one = st.mapping_matrix("ca", 0.0628, kp=365.0, kd=12.5)
    two = st.mapping_matrix("ca", 0.0628, kp=365.0, kd=12.5, dof=2)
    assert two.shape == (6, 6)
    assert two[2, 2] == two[3, 3] == pytest.approx((2 - 3 * 12.5 * 0.0628) / 2)
    assert st.spectral_radius(two) == pytest.approx(st.spectral_radius(one), abs=1e-12)
    misprint = two.copy()
    misprint[2, 2] = (2 - 3 * 365.0 * 0.0628) / 2
    assert st.spectral_radius(misprint) > 30.0


def test_best_gains_are_the_minimum():
    best = st.best_gains("ca", 0.01)
    radius = st.check_gains("ca", 0.01, **best).radius
    assert radius == pytest.approx(0.195800350656, abs=1e-4)  # a triple root: eigenvalues are good to eps^(1/3)
    assert best["kd"] * 0.01 == pytest.approx(0.869973567565, abs=1e-9)
    assert best["kp"] * 0.01**2 == pytest.approx(1.70992093416, abs=1e-9)
    rng = np.random.default_rng(0)
    for dp, dd in rng.normal(0.0, 0.05, (200, 2)):
        if math.hypot(dp, dd) > 0.01:
            assert st.check_gains("ca", 0.01, kp=best["kp"] * (1 + dp), kd=best["kd"] * (1 + dd)).radius > radius + 1e-3
    assert st.check_gains("cv", 0.01, **st.best_gains("cv", 0.01)).radius == pytest.approx(1 / math.sqrt(3), abs=1e-7)
    for k in (0.6, 0.64, 0.7, 0.75):
        assert st.spectral_radius(st.mapping_matrix("cv", 1.0, kappa=k)) > 1 / math.sqrt(3) + 1e-3


def test_methods_without_gains():
    assert st.spectral_radius(st.mapping_matrix("av", 0.1)) == 0.0
    assert sorted(np.linalg.eigvals(st.mapping_matrix("aa", 0.1)).real) == [-1.0, 0.0]
    assert st.check_gains("aa", 0.1).verdict == "marginal"
    assert "aad" in st.check_gains("aa", 0.1).message
    assert st.spectral_radius(st.mapping_matrix("aad", 0.1, gamma=0.6)) == pytest.approx(2 / 3)
    assert st.check_gains("aad", 0.1, gamma=0.45).verdict == "unstable"


@pytest.mark.parametrize("method, gains", [("cv", {"kappa": 17.0}), ("ca", {"kp": 400.0, "kd": 6.0})])
def test_unstable_gains_get_a_sentence_and_a_way_out(method, gains):
    h = 0.0628
    found = st.check_gains(method, h, **gains)
    assert found.verdict == "unstable" and found.radius > 1.0
    assert "unstable" in found.message and "Hz" in found.message
    assert st.check_gains(method, h, **found.suggestion).stable
    assert st.check_gains(method, found.longest_step * 0.999, **gains).stable
    assert not st.check_gains(method, found.longest_step * 1.001, **gains).stable


def test_mistakes_are_typed():
    with pytest.raises(InvalidOption, match="kp and kd"):
        st.mapping_matrix("ca", 0.1, kp=1.0)
    with pytest.raises(InvalidOption, match="Did you mean 'aad'"):
        st.mapping_matrix("aadd", 0.1)
    with pytest.raises(InvalidOption, match=r"no gain 'kapa'\. Did you mean 'kappa'"):
        st.check_gains("cv", 0.1, kapa=1.0)
    with pytest.raises(InvalidOption, match="sample time"):
        st.check_gains("cv", 0.0, kappa=1.0)
