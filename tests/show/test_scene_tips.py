"""Scenes of several tips: every tip and target is drawn where it is, and named."""

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidTarget

pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")

from ik_toolkit.show.scene import Scene, view


@pytest.fixture(scope="module")
def brokk():
    return ik.Tree.load("brokk_hydrolek")


@pytest.fixture(scope="module")
def goal(brokk):
    T = brokk.fk(brokk.random_q(np.random.default_rng(2)))
    return {tip: pose.homogeneous for tip, pose in T.items()}


def names(scene):
    return {path: text for path, text, _ in scene.window.about["names"]}


def test_tips_and_targets_are_named_and_where_they_are(brokk, goal):
    found = ik.solve(brokk, goal)
    scene = view(brokk, found, target=goal)
    drawn = scene.drawn()
    for k, tip in enumerate(brokk.tips):
        number = str(k + 1) if k else ""
        world = scene.body.T_world_base @ goal[tip]
        assert np.allclose(drawn[f"target{number}"], world) and np.allclose(drawn[f"tip{number}"], world, atol=1e-5)
        assert names(scene)[f"target{number}"] == f"target of {tip}" and names(scene)[f"tip{number}"] == tip
    assert "span" in scene.html() and names(view(brokk.arms[0])) == {}


def test_the_second_of_two_targets_keeps_its_name(brokk, goal):
    scene = view(brokk, target={"right_tip": goal["right_tip"]})
    assert names(scene)["target"] == "target of right_tip"
    assert np.allclose(scene.drawn()["target"], scene.body.T_world_base @ goal["right_tip"])
    with pytest.raises(FrameNotFound, match="Did you mean 'left_tip'"):
        view(brokk, target={"left_tp": goal["left_tip"]})
    with pytest.raises(InvalidTarget, match="one target for each of left_tip, right_tip"):
        view(brokk, target=[goal["left_tip"]])


def test_an_animation_moves_every_tip_and_draws_its_way(brokk, goal):
    found = ik.solve(brokk, goal, history=True)
    scene = view(brokk, found, target=goal)
    about = scene.window.about["animation"]
    values = about["data"]
    for k, tip in enumerate(brokk.tips):
        path = about["paths"].index(f"/meshcat/tip{k + 1 if k else ''}")
        world = scene.body.T_world_base @ brokk.fk(found.q)[tip].homogeneous
        assert np.allclose(values[-1, path], world[:3], atol=1e-5)
    assert {"trail", "trail2"} <= scene.drawn().keys()
    legend = [text for _, text in scene.window.about["legend"]]
    assert [text for text in legend if text.startswith("path of")] == ["path of left_tip", "path of right_tip"]


def test_view_solves_for_several_tips(run, refused, brokk, goal, tmp_path, monkeypatch):
    drawn = {}
    frame = Scene.frame
    monkeypatch.setattr(
        Scene, "frame", lambda self, T, name="target", *a, **k: (drawn.update({name: T}), frame(self, T, name, *a, **k))
    )
    T, U = (goal[tip][:3, 3] for tip in brokk.tips)
    words = ["--target", f"left_tip:{T[0]},{T[1]},{T[2]}", "--target", f"right_tip:{U[0]},{U[1]},{U[2]}"]
    file = tmp_path / "a.html"
    code, _, err = run("view", "brokk_hydrolek", *words, "--html", file)
    assert code == 0 and "CONVERGED" in err and file.exists()
    assert np.allclose(drawn["target"], T) and np.allclose(drawn["target2"], U)
    relative = ["--target", "right_tip:0.1,-0.3,0.1", "--relative", "right_tip:left_tip"]
    asked = {"left_tip": T, "right_tip": [0.1, -0.3, 0.1]}
    found = ik.solve(brokk, asked, relative_to={"right_tip": "left_tip"})
    for command in ("view", "solve"):  # drawn where it is in the end, in the base frame
        drawn.clear()
        assert run(command, "brokk_hydrolek", *words[:2], *relative, "--html", file)[0] == 0
        assert np.allclose(drawn["target2"], brokk.fk(found.q)["right_tip"].translation, atol=1e-4)
    assert "choose one with --tip: left_tip, right_tip" in refused("view", "brokk_hydrolek", "--xyz", 1, 0, 1)
