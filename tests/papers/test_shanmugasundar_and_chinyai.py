"""The reports on Shanmugasundar (2012) and Chinyai: their results against oracle numbers, and their claims."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from folders import read_data

from ik_toolkit.cli import main
from ik_toolkit.errors import MissingExtra
from ik_toolkit.papers import PAPERS
from ik_toolkit.papers.chinyai import formulas as planar
from ik_toolkit.papers.chinyai import paper
from ik_toolkit.papers.report import Report
from ik_toolkit.papers.shanmugasundar_2012 import formulas as printed
from ik_toolkit.papers.shanmugasundar_2012 import paper as shan
from ik_toolkit.papers.shanmugasundar_2012 import weld

DATA = read_data("closed_form")["sample"]


def column(report, key, name):
    table = report.data[key]
    return dict(
        zip(
            [row[0] for row in table["rows"]], [row[table["columns"].index(name)] for row in table["rows"]], strict=True
        )
    )


@pytest.fixture(scope="module")
def inspection_report():
    whole = weld.reachability
    with pytest.MonkeyPatch.context() as patch:  # a coarse map and few poses of the welds
        patch.setattr(weld, "reachability", lambda *given, **asked: whole(*given, **asked | {"resolution": 0.16}))
        few = {name: tuple(x[::5] if np.ndim(x) else x for x in seam) for name, seam in weld.SEAMS.items()}
        patch.setattr(weld, "SEAMS", few)
        return shan.reproduce(poses=40, turns=2)


@pytest.fixture(scope="module")
def planar_report():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper, "ROUNDS", 3)  # of the times, which no test looks at
        grid = paper.grid
        patch.setattr(paper, "grid", lambda count: grid(count // 3))
        return paper.reproduce(count=1000)


def test_all_twelve_numbers_of_the_target_are_explained(inspection_report):
    data = inspection_report.data
    assert data["target_equal_22_7"] == 12 and data["target_equal_true_pi"] < 12
    assert data["fk_difference_mm"] < 1e-9


def test_published_angles_miss_the_pose_as_computed_independently(inspection_report):
    position = column(inspection_report, "errors", "position error (mm)")
    rotation = column(inspection_report, "errors", "rotation error (deg)")
    for row, answer in zip(("manual, Table 3", "software, Table 4"), DATA["answers"], strict=True):
        assert position[row] == pytest.approx(1000 * answer["error_m"], abs=1e-9)
        assert rotation[row] == pytest.approx(math.degrees(answer["error_rad"]), abs=1e-9)
    assert [round(position[r], 2) for r in ("manual, Table 3", "software, Table 4")] == [1.23, 1.13]
    assert [round(rotation[r], 2) for r in ("manual, Table 3", "software, Table 4")] == [1.98, 1.85]


def test_fig4_reproduces_the_program(inspection_report):
    angles = printed.fig4(printed.pose_matrix(printed.PRINTED_POSE), printed.D2)
    expected = np.delete(DATA["fig4_angles"], 1)
    assert np.abs(angles - expected).max() < 1e-9
    assert inspection_report.data["software_angles_reproduced"] == 6
    assert inspection_report.data["lift_of_published_theta_1_mm"] == pytest.approx(220.440, abs=1e-3)


def test_only_corrected_and_complete_formulas_are_right(inspection_report):
    correct = [
        float(x.split()[0]) for x in column(inspection_report, "formulas", "correct (%, 95 % interval)").values()
    ]
    assert correct[:3] == [0.0, 0.0, 0.0]
    assert 0.0 < correct[3] == correct[4] < 50.0  # a second branch with the wrong sine gains nothing
    assert correct[5] > 99.0 and correct[6] == 100.0
    assert inspection_report.data["branches"] == {"8": 40} and inspection_report.data["origin_among_branches"] == 40


def test_sample_pose_reach_and_lifts(inspection_report):
    data = inspection_report.data
    assert data["out_of_reach_mm"] == pytest.approx(-1000 * DATA["margin_at_0_220"], abs=1e-6)
    assert np.abs(np.array(data["feasible_lifts_mm"]) - 1000 * np.array(DATA["lift_intervals"])).max() < 1e-6
    assert "projected" in data["sample_notice"]
    status = column(inspection_report, "sample", "status")
    assert status["lift 220 mm (as published)"] == "UNREACHABLE"
    assert sum(value == "CONVERGED" for value in status.values()) == 9


def test_both_welds_are_planned_and_their_torques_are_mostly_weight(inspection_report):
    assert set(column(inspection_report, "weld", "motion").values()) == {"FOLLOWED"}
    travel = list(column(inspection_report, "weld", "least lift travel (mm)").values())
    assert travel[0] == 0.0 and 10.0 < travel[1] < 600.0
    lift = [row[2] for row in inspection_report.data["torques"]["rows"]]  # all and by motion, for each weld
    carried = 9.81 * 32.03  # kg, all links above the lift
    assert lift[0] == pytest.approx(carried, rel=0.01) and carried < lift[2] < 1.3 * carried and lift[1] < 0.1 * carried


def test_closed_form_of_the_planar_arm_is_exact():
    rng = np.random.default_rng(0)
    for l1, l2 in ((1.0, 1.0), (1.0, 0.6), (0.3, 1.2)):
        for x, y in planar.targets(rng, 200, l1, l2):
            a, b, c, d = planar.closed_form(x, y, l1, l2)
            for t1, t2 in ((a, b), (c, d)):
                reached = l1 * np.exp(1j * t1) + l2 * np.exp(1j * (t1 + t2))
                assert abs(reached - complex(x, y)) < 1e-12
            t1, t2 = planar.closed_form_numpy(x, y, l1, l2)
            assert np.allclose([t1[0], t2[0], t1[1], t2[1]], [a, b, c, d], atol=1e-6)


def test_newton_kinds_end_where_they_should():
    start = np.radians((45.0, 90.0))
    for kind in (planar.PLAIN, planar.SEARCH, planar.LEVENBERG, planar.STEP):
        t1, t2, count, error = planar.newton(1.2, 0.7, 1.0, 1.0, *start, kind, planar.NO_CLIP, 1e-10, 50)
        assert count > 0 and error < 1e-10
        assert abs(np.exp(1j * t1) + np.exp(1j * (t1 + t2)) - (1.2 + 0.7j)) < 1e-9
        solved = planar.newton(1.2, 0.7, 1.0, 1.0, t1, t2, kind, planar.NO_CLIP, 1e-10, 50)
        assert solved[:3] == (t1, t2, 0)
    straight = planar.converge(np.array([[1.2, 0.7]]), 1.0, 1.0, (0.0, 0.0), planar.PLAIN)[0]
    assert straight[2] < 0 and (straight[:2] == 0.0).all()  # det J = 0: no step
    assert planar.converge(np.array([[1.2, 0.7]]), 1.0, 1.0, (0.0, 0.0), planar.LEVENBERG)[0, 2] > 0
    clipped = planar.converge(
        planar.targets(np.random.default_rng(1), 500, 1.0, 1.0), 1.0, 1.0, start, planar.PLAIN, 2.0
    )
    assert np.abs(clipped[:, :2]).max() <= 2.0


def test_convergence_map(planar_report):
    table = planar_report.data["convergence"]
    rows = {tuple(row[:2]): dict(zip(table["columns"][2:], row[2:], strict=True)) for row in table["rows"]}
    for (arm, start), row in rows.items():
        if start == "0, 0":
            assert row["plain"] == row["search"] == row["step"] == 0.0 and row["LM"] > 99.0
            continue
        assert 80.0 < row["plain"] < 99.0 and row["search"] > 99.0 and row["LM"] > 99.0
        assert row["plain + clip"] < row["plain"]
        assert (row["step"] > 99.0) == (arm == "1, 1")
    # Values of an independent computation with 200 000 targets; the sample here has a standard error of 1.1.
    assert rows["1, 1", "45, 90"]["plain"] == pytest.approx(86.2, abs=3.5)
    assert rows["1, 1", "0, 5.7"]["plain + clip"] == pytest.approx(47.2, abs=4.5)
    assert rows["1, 0.6", "0, 143"]["step"] == pytest.approx(83.1, abs=3.5)
    assert planar_report.data["closed_form_inside_limits_percent"] == pytest.approx(91.8, abs=2.5)
    assert planar_report.data["lm_unreachable_median_error"] == pytest.approx(0.4, abs=1e-3)


def test_printed_formulas(planar_report):
    reached = column(planar_report, "formulas", "targets reached (%)")
    assert [k for k, v in reached.items() if v == 100.0] == [
        "the same with atan2 for both arctan, upper signs",
        "corrected (always minus, signed sine, atan2), upper sign of theta_2",
        "corrected (always minus, signed sine, atan2), lower sign of theta_2",
    ]
    assert reached["(4), (5), lower signs, sin(theta_2) with its sign"] < 1.0


def test_what_is_proven_of_newton_is_true_and_not_much_beforehand(planar_report):
    rows = np.array(planar_report.data["certified"]["rows"])
    assert 2.0 < rows[0, 2] < 4.0 and (np.diff(rows[:, 2]) > 0.0).all() and 90.0 < rows[-1, 2] < 97.0
    assert planar_report.data["certified_exceptions"] == rows[:, 3].sum() == 0


def test_report_writes_markdown_json_and_pictures(planar_report, tmp_path):
    files = planar_report.write(tmp_path / "out")
    assert {file.name for file in files} == {"report.md", "report.json", "targets.png", "starts.png", "proven.png"}
    assert all(file.stat().st_size > 1000 for file in files)
    text = (tmp_path / "out" / "report.md").read_text()
    assert "targets.png" in text and "| implementation | published |" in text and "nan" not in text
    assert json.loads((tmp_path / "out" / "report.json").read_text())["paper"] == "chinyai"


def test_pictures_are_optional(tmp_path, monkeypatch):
    report = Report("none", "No pictures")
    report.figure("a.png", "a", lambda plt: None)
    monkeypatch.setattr("ik_toolkit.papers.report.importlib.util.find_spec", lambda name: None)
    files = report.write(tmp_path)
    assert [file.name for file in files] == ["report.md", "report.json"] and "pip install matplotlib" in files[
        0
    ].read_text()
    with pytest.raises(MissingExtra):
        report.write(tmp_path, pictures=True)


def test_command_line(tmp_path, monkeypatch, capsys):
    assert main(["reproduce", "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)["papers"]) == set(PAPERS)
    assert main(["reproduce", "chinyia"]) == 2
    assert "chinyai" in capsys.readouterr().err
    report = Report("chinyai", "Short")
    report.number("answer", 42)
    monkeypatch.setattr(paper, "reproduce", lambda: report)
    assert main(["reproduce", "chinyai", "-o", str(tmp_path / "r"), "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["answer"] == 42 and all(Path(file).exists() for file in out["files"])


def test_solve_all_on_the_command_line(capsys):
    assert main(["solve", "planar_2r", "--xyz", "1", "0.5", "0", "--all", "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["complete"] and len(out["solutions"]) == 2 and out["solver"] == "planar-2r"
    assert main(["solve", "planar_2r", "--xyz", "1", "0.5", "0", "--all"]) == 0
    assert "these are all" in capsys.readouterr().out
    assert main(["solve", "planar_2r", "--xyz", "5", "0.5", "0", "--all"]) == 1
