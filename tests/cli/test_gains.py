"""`ik gains` along a path: the least rate that it names is that of `ik.least_rate`."""

import pytest

PATH = ("gains", "planar_2r", "--path", "circle", "--position-only", "--rate", "5")


def test_the_least_rate_is_named_for_people_and_for_programs(told, run):
    code, out, _ = run(*PATH, "--kappa", "4")
    assert code == 0 and "least rate" in out and "rates tried from 4.009 to 40" in " ".join(out.split())
    found = told(*PATH, "--kappa", "4")["rates"]
    assert found["most"] == 40.0 and found["bands"] == [[pytest.approx(4.009, abs=1e-3), 40.0]]


def test_gains_that_are_stable_at_no_rate_have_none(run):
    code, out, _ = run(*PATH, "--kappa", "-1")
    assert code == 1 and "least rate" not in out
