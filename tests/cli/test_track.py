"""`ik track`: its tables, what it refuses and what it doubts."""

import numpy as np


def figures(out):
    """Numbers of the tables of a run, by the name and the unit of their row."""
    rows = [line.partition("]") for line in out.splitlines() if line.startswith(" ") and "]" in line]
    return {f"{name.strip()}]": [float(x) for x in numbers.split()[:3]] for name, _, numbers in rows if "." in numbers}


def test_tables_of_a_run_follow_deg_and_lengths_stay_in_metres(run):
    words = ("track", "inspection_7dof", "--path", "line", "--duration", "2")
    (code, plain, _), (_, degrees, _) = run(*words), run(*words, "--deg")
    assert code == 0 and "[rad]" not in degrees and "[rad]" in plain and "[deg]" not in plain
    wanted, found = figures(plain), figures(degrees)
    for name in ("orientation", "arm_pitch"):
        np.testing.assert_allclose(np.radians(found[f"{name} [deg]"]), wanted[f"{name} [rad]"], rtol=0.02)
    assert found["lift [m]"] == wanted["lift [m]"] and found["position [m]"] == wanted["position [m]"]
    assert "[deg/s]" in run("track", "planar_2r", "--duration", "2", "--deg")[1]
