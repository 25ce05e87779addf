"""Tuning and workspace of several tips solved together."""

import json

import numpy as np
import pytest
from folders import csv_rows

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidOption, UnknownSolver
from ik_toolkit.study.targets import sample_targets
from ik_toolkit.study.tune import score, tune
from ik_toolkit.study.workspace import envelope, workspace

TIPS = ["--tip", "left_tip", "--tip", "right_tip"]
SMALL = dict(method="pso", targets=30, held_out=1, generations=2, population=4, max_iterations=200, tolerance=1e-2)


@pytest.fixture(scope="module")
def brokk():
    return ik.Tree.load("brokk_hydrolek")


# `pid` takes 4 s to compile for several tips.
@pytest.mark.parametrize("solver", ["dls", pytest.param("pid", marks=pytest.mark.slow)])
def test_a_tuned_rule_solves_both_tips(brokk, solver, tmp_path):
    found = tune(brokk, solver, seed=3, **SMALL)
    again = tune(brokk, solver, seed=3, **SMALL)
    assert found.rule == again.rule or repr(found.rule) == repr(again.rule)
    assert found.held_out.to_dict() == again.held_out.to_dict() and found.held_out.total == 1000
    sets = [sample_targets(brokk, 1000, [3, 3, 0], position_only=True)]
    assert sets[0].shape == (1000, 2, 3)
    best = score(brokk, found.rule, sets, tolerance=1e-2, max_iterations=200)
    assert best.successes == found.scores[found.kept].successes and best.share > 0.5
    preset = found.save(tmp_path / "mine.toml")
    if type(found.rule).preset is not None:
        solved = [ik.solve(brokk, list(T), type(found.rule).preset(preset)).success for T in sets[0][:40]]
        assert sum(solved) > 20


def test_a_search_goes_on_from_its_record_for_the_same_tips_only(brokk, tmp_path):
    record = tmp_path / "search.npz"
    first = tune(brokk, "dls", seed=1, checkpoint=record, **SMALL)
    assert tune(brokk, "dls", seed=1, checkpoint=record, **SMALL).history.tolist() == first.history.tolist()
    turned = ik.Tree.load("brokk_hydrolek", ["right_tip", "left_tip"])
    with pytest.raises(InvalidOption, match="another search"):
        tune(turned, "dls", seed=1, checkpoint=record, **SMALL)


def test_solvers_for_one_tip_say_so(brokk):
    for call in (
        lambda: tune(brokk, "state-space", **SMALL),
        lambda: workspace(brokk, ["state-space"], tip="left_tip", targets=10),
    ):
        with pytest.raises((InvalidOption, UnknownSolver), match="one tip"):
            call()


@pytest.mark.parametrize("how", ["joints", "volume"])
def test_the_workspace_of_one_tip_with_the_other_free(brokk, how, tmp_path):
    file = tmp_path / "targets.csv"
    found = workspace(brokk, ["lm", "dls"], tip="right_tip", targets=300, how=how, tolerance=1e-3, file=file)
    low, high, radius = envelope(brokk, tip="right_tip")
    assert (found.low == low).all() and (found.high == high).all() and found.radius == radius
    assert found.outcomes["lm"].solved == 300 and 0 < found.outcomes["dls"].solved
    assert found.tip == found.to_dict()["tip"] == "right_tip"
    rows = csv_rows(file)
    assert len(rows) == 300 and {row["lm success"] for row in rows} == {"1"}
    assert np.allclose([[float(row[k]) for k in "xyz"] for row in rows], found.points)
    assert max(float(row["lm position_error"]) for row in rows) <= 1e-3
    alone = workspace(brokk.arms[1], ["lm"], targets=300, how=how, tolerance=1e-3)
    assert np.abs(alone.high - found.high).max() < 0.1 and alone.outcomes["lm"].solved == 300


def test_the_other_arm_makes_way(brokk):
    """What one arm alone cannot reach for the other, resting one, both together can."""
    targets = dict(tip="right_tip", targets=40, seed=4, tolerance=1e-3)
    free = workspace(brokk, ["lm"], avoid_collisions=True, **targets).outcomes["lm"]
    assert free.solved + free.statuses.get("COLLISION", 0) == 40 and free.solved >= 38


def test_the_tip_has_to_be_one(brokk):
    with pytest.raises(InvalidOption, match="tip=: left_tip, right_tip"):
        workspace(brokk, targets=10)
    with pytest.raises(FrameNotFound, match="Did you mean 'left_tip'"):
        workspace(brokk, tip="left_tp", targets=10)
    with pytest.raises(FrameNotFound, match="right_tip"):
        workspace(brokk.arms[1], tip="left_tip", targets=10)
    with pytest.raises(InvalidOption, match="tip="):
        tune(brokk, "dls", how="volume", **SMALL)


def test_commands(told, tmp_path):
    few = "-m pso --targets 20 --held-out 1 --generations 1 --population 3 --max-iterations 100".split()
    told("tune", "brokk_hydrolek", "dls", *TIPS, *few, "-o", tmp_path / "mine.toml")
    assert (tmp_path / "mine.toml").exists()
    found = told("workspace", "brokk_hydrolek", *TIPS, "-n", 50, "-o", tmp_path / "w.json")
    assert found == json.loads((tmp_path / "w.json").read_text(encoding="utf-8"))
    assert found["tip"] == "left_tip" and found["solvers"]["lm"]["solved"] == 50
