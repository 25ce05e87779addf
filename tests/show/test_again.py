"""A scene that is shown again: nothing of what was before is left, ghosts stay whole, and bad input changes nothing."""

import numpy as np
import pinocchio as pin
import pytest
from robots import BALLS_MIMIC, load

import ik_toolkit as ik
from ik_toolkit.errors import IKError, InvalidConfiguration, InvalidOption, InvalidTarget

pytest.importorskip("meshcat", reason="meshcat is not installed (extra 'view')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")

import itertools

from ik_toolkit.show.scene import Scene, view


@pytest.fixture
def arm():
    return load("hydrolek_7w")


def solved(arm, seed=3, **options):
    target = arm.fk(arm.random_q(np.random.default_rng(seed)))
    return ik.solve(arm, target, history=True, **options), target


def state(scene):
    """Everything that a page is given."""
    window = scene.window
    poses = {path: T.tolist() for path, T in window.transforms.items()}
    return dict(window.objects), dict(window.copies), poses, dict(window.about)


def test_a_second_show_leaves_nothing_of_the_first(arm):
    model = ik.CollisionModel(arm).add_box((0.1, 0.1, 0.1), (0.0, 0.9, 0.9), name="crate")
    result, target = solved(arm, avoid_collisions=model)
    scene = view(arm, result, target=target)
    told = scene.window.about
    assert {"target", "start", "trail", "obstacle/crate"} <= {*scene.names}
    assert told["animation"] and told["lines"]
    assert sorted(text for _, text in told["legend"])[-2:] == ["target", "tip path"]
    scene.frame(np.eye(4), "mine", label="mine")
    q = arm.random_q(np.random.default_rng(8))
    scene.show(q)
    assert {*scene.names} == {"robot", "tip", "mine"}
    assert told["animation"] is None and told["lines"] == [] and told["names"] == []
    assert [text for _, text in told["legend"]] == ["mine", "grid 200 mm"]
    assert np.allclose(scene.drawn()["tip"], scene.body.tips(q)[0], atol=1e-12)
    assert not [path for path in state(scene)[0] if path.split("/")[0] not in ("robot", "tip", "mine")]
    fresh = view(arm, q)
    fresh.frame(np.eye(4), "mine")
    assert state(fresh)[1] == state(scene)[1] and state(fresh)[2] == state(scene)[2]


def test_update_changes_robot_tip_target_and_caption_together(arm):
    first, target = solved(arm)
    scene = view(arm, first, target=target)
    second, other = solved(arm, 9)
    scene.update(second, other)
    drawn, expected = scene.drawn(), view(arm, second, target=other).drawn()
    assert np.allclose(drawn["target"], other.homogeneous, atol=1e-12)
    assert np.allclose(drawn["tip"], arm.fk(second.q).homogeneous, atol=1e-9)
    assert scene.window.about["lines"] == [f"{second.solver}: CONVERGED", second.message]
    assert drawn.keys() == expected.keys()
    assert all(np.allclose(drawn[one], expected[one], atol=1e-12) for one in drawn)
    assert {*scene.names} == {*view(arm, second, target=other).names}
    scene.update(arm.home)  # the target stays, and nothing else
    assert scene.window.about["animation"] is None
    assert {*scene.names} == {"robot", "tip", "target"} and scene.window.about["lines"] == []
    scene.update([arm.home, arm.lower, arm.upper])
    assert {"ghost_1", "ghost_2", "target"} <= {*scene.names}
    scene.update(arm.home, np.array([0.5, 0.0, 0.2]))
    assert {*scene.names} == {"robot", "tip", "target"} and scene.drawn()["target"][0, 3] == 0.5
    assert {path for path in scene.window.objects if path.startswith("target")} == {"target/0"}  # no axes
    assert [text for _, text in scene.window.about["legend"]] == ["target", "grid 100 mm"]


def whole(scene, q, robots):
    """Whether every copy has each part that no robot before it has in the same place."""
    body = scene.body
    scene.show(q)
    poses = {"robot": body.placements(q)} | {name: body.placements(one) for name, one in robots.items()}
    names = [*poses]
    for k, name in enumerate(names[1:], 1):
        for p, part in enumerate(body.parts):
            gaps = [np.abs(poses[name][p] - poses[other][p]).max() for other in names[:k]]
            hidden = min(gaps) < 1e-9
            if 1e-9 <= min(gaps) < 1e-3:  # not to be told apart by eye
                continue
            if (f"{name}/{part.name}/0" in scene.window.copies) is bool(hidden):
                return False
    return True


@pytest.mark.parametrize("name", ["hydrolek_7w", "mimic_mix"])
def test_ghosts_are_complete_at_every_q(name):
    robot = load(name)
    rng = np.random.default_rng(4)
    Q = robot.random_q(rng, 4)
    Q[1, :3] = robot.home[:3]  # shares its first parts with home
    scene = view(robot, [robot.home, robot.home, *Q, Q[0]])
    robots = {f"ghost_{k}": q for k, q in enumerate([robot.home, *Q, Q[0]], 1)}
    assert not [path for path in scene.window.copies if path.startswith("ghost_1/")]
    for q in (*Q, robot.home, *robot.random_q(rng, 20)):
        assert whole(scene, q, robots)


def test_fewer_ghosts_leave_none_of_those_before(arm):
    scene = view(arm, [arm.home, arm.lower, arm.upper])
    scene.ghosts([arm.lower])
    assert {name for name in scene.names if name.startswith("ghost")} == {"ghost_1"}


def test_a_ghost_is_complete_in_every_frame_of_an_animation(arm):
    """The robot moves in the page, so only what coincides in all frames may be left out."""
    scene = Scene(arm)
    scene.show(arm.home)
    scene.show(arm.home, "start", (0.3, 0.3, 0.4), 0.3)
    assert scene.window.copies == {}
    far = arm.home + 0.2
    scene.animate([arm.home, far, arm.home])
    apart = scene.body.apart(*map(scene.body.placements, (arm.home, far)))
    moving = {part.name for part, away in zip(scene.body.parts, apart, strict=True) if away}
    assert {path.split("/")[1] for path in scene.window.copies} == moving and len(moving) > 10
    scene.show(arm.home)
    assert scene.window.copies == {} and scene.window.about["animation"] is None


def colors(scene, name):
    told = [one for one in scene.window.snapshot(scene.window.paths) if one["path"].startswith(f"/meshcat/{name}/")]
    return {
        (one["color"], one["opacity"]) if one["type"] == "copy" else
        (one["object"]["materials"][0]["color"], one["object"]["materials"][0]["opacity"])
        for one in told if one["type"] != "set_transform"
    }  # fmt: skip


def test_a_new_colour_for_what_exists_counts(arm):
    scene = view(arm)
    before = colors(scene, "robot")
    scene.show(arm.home, color=(1.0, 0.0, 0.0))
    red = colors(scene, "robot")
    assert len(red) == 1 and red != before
    scene.show(arm.lower, opacity=0.5)  # moves it, and the colour stays
    assert {color for color, _ in colors(scene, "robot")} == {color for color, _ in red}
    assert {opacity for _, opacity in colors(scene, "robot")} == {0.5}
    for color, told in (((0.0, 1.0, 0.0), 0x00FF00), ((0.0, 0.0, 1.0), 0x0000FF)):
        scene.show(arm.upper, "other", color)
        assert colors(scene, "other") == {(told, 1.0)}
    scene.remove("robot")
    assert len(colors(scene, "other")) == 1 and scene.window.copies == {}  # it keeps its triangles without the robot
    assert "robot" not in scene.names and "</html>" in scene.html()


def test_robots_obstacles_and_frames_are_added_and_removed_by_name(arm):
    scene = view(arm)
    planar = load("planar_2r")
    T = ik.pose((0.5, 1.0, 0.1), rpy=(0.0, 0.0, 1.0))
    assert scene.add(planar, T_base=T) == "robot_2"
    assert scene.add(ik.Shape.box((0.1, 0.2, 0.3)), (0.4, 0.0, 0.1)) == "box_1"
    scene.frame(T, "grasp")
    q = planar.random_q(np.random.default_rng(1))
    scene.show(q, "robot_2")
    body = Scene(planar).body
    base = scene.body.T_world_base @ T @ np.linalg.inv(body.T_world_base)
    for part, M in zip(body.parts, body.placements(q), strict=True):
        assert np.allclose(scene.drawn()[f"robot_2/{part.name}"], base @ M, atol=1e-12)
    scene.move((0.1, 0.2, 0.3), "box_1")
    assert np.allclose(scene.drawn()["box_1"][:3, 3], (0.1, 0.2, 0.3))
    with pytest.raises(InvalidConfiguration, match="must have 2 values"):
        scene.show(arm.home, "robot_2")
    with pytest.raises(InvalidOption, match="Did you mean 'grasp'"):
        scene.remove("grsp")
    for name in ("robot_2", "box_1", "grasp"):
        scene.remove(name)
    assert [[*one] for one in state(scene)[:3]] == [[*one] for one in state(view(arm))[:3]]
    assert scene.names == ("robot", "tip")


@pytest.mark.parametrize("held", [False, True])
def test_obstacles_that_a_result_was_solved_with_are_drawn(tmp_path, held):
    robot = ik.Robot.load(BALLS_MIMIC)
    mesh = tmp_path / "wedge.obj"
    mesh.write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
    model = ik.CollisionModel(robot).add_sphere(0.1, (0.9, 0.9, 0.9), name="ball")
    model.add_mesh(mesh, (0, 1, 1), name="wedge")
    if held:
        model.attach(ik.Shape.box((0.05, 0.05, 0.05)), (0.0, 0.0, 0.05), name="part")
    target = robot.fk(robot.random_q(np.random.default_rng(2))).translation
    for result in (
        ik.solve(robot, target, avoid_collisions=model),
        [*ik.solve_all(robot, target, avoid_collisions=model, starts=9)],
    ):
        scene = view(robot, result, target=target, obstacles=model if isinstance(result, list) else None)
        drawn = scene.drawn()
        assert np.allclose(drawn["obstacle/ball"][:3, 3], 0.9)
        assert np.allclose(drawn["obstacle/wedge"][:3, 3], (0, 1, 1))
        q = result[0] if isinstance(result, list) else result.q
        if held:
            place = robot.fk(q).act(np.array([0.0, 0.0, 0.05]))
            assert np.allclose(drawn["tip/part"][:3, 3], place, atol=1e-9)


def test_names_with_a_slash_are_refused(arm):
    """In the viewer a path below another one moves and vanishes with it."""
    scene = view(arm)
    box = ik.Shape.box((0.1, 0.1, 0.1))
    for draw in (
        lambda: scene.add(box, name="a/b"), lambda: scene.frame(np.eye(4), "a/b"), lambda: scene.show(arm.home, "a/b"),
        lambda: scene.trail(np.eye(3), "a/b"), lambda: scene.cloud(np.eye(3), name="a/b"),
    ):  # fmt: skip
        with pytest.raises(InvalidOption, match=r"a name has no '/'.*got 'a/b'"):
            draw()
    assert {*scene.names} == {"robot", "tip"}


def test_the_shell_draws_obstacles(run, tmp_path, monkeypatch):
    drawn = []
    shape = Scene._shape
    monkeypatch.setattr(Scene, "_shape", lambda self, *args: (drawn.append(args), shape(self, *args))[1])
    command = ["hydrolek_7w", "--xyz", "0.6", "0.3", "0.1", "--obstacle", "sphere:0.9,0.9,0.9,0.05", "--html"]
    for words in (["solve"], ["solve", "--all"]):
        drawn.clear()
        assert run(*words, *command, tmp_path / "out.html")[0] == 0
        assert [args[0].kind for args in drawn] == ["sphere"] and np.allclose(drawn[0][1][:3, 3], 0.9)


NAN = float("nan")
BAD = [
    lambda s: s.show([NAN] * 6), lambda s: s.show([1.0]), lambda s: s.show("home?"), lambda s: s.show(s.robot.home, 5),
    lambda s: s.show(s.robot.home, ""), lambda s: s.show(s.robot.home, color=(255, 0, 0)), lambda s: s.show(None),
    lambda s: s.show(s.robot.home, color="red"), lambda s: s.show(s.robot.home, color=(0.1, NAN, 0.1)),
    lambda s: s.show(s.robot.home, color=(0.1, 0.1)), lambda s: s.show(s.robot.home, opacity=7),
    lambda s: s.show(s.robot.home, opacity="thin"), lambda s: s.show(s.robot.home, label=5),
    lambda s: s.ghosts([[1.0, 2.0]]), lambda s: s.ghosts([]), lambda s: s.ghosts(NAN),
    lambda s: s.frame(np.full((4, 4), NAN)), lambda s: s.frame([1.0, 2.0]), lambda s: s.frame("here"),
    lambda s: s.frame(np.eye(4), "robot"), lambda s: s.frame(np.eye(4), size=-1.0), lambda s: s.frame(np.eye(4), size=NAN),
    lambda s: s.move(np.eye(3)), lambda s: s.move([NAN, 0, 0]), lambda s: s.move(np.eye(4), "nothing"),
    lambda s: s.move(np.eye(4), "robot"), lambda s: s.name("nothing", "a"), lambda s: s.name("target", 4),
    lambda s: s.trail([[NAN, 0, 0]]), lambda s: s.trail(np.eye(2)), lambda s: s.trail(np.eye(3), radius=0.0),
    lambda s: s.trail(np.eye(3), color=(255, 0, 0)), lambda s: s.trail(np.eye(3), name=None),
    lambda s: s.cloud([]), lambda s: s.cloud([[NAN] * 3]), lambda s: s.cloud(np.eye(3), [1, 2]),
    lambda s: s.cloud(np.eye(3), ["yes"] * 3), lambda s: s.cloud(np.eye(3), size="big"),
    lambda s: s.animate([s.robot.home], [], 5.0), lambda s: s.animate([s.robot.home], fps=0.0),
    lambda s: s.animate([s.robot.home], first=3), lambda s: s.animate([[NAN] * 6]), lambda s: s.animate([]),
    lambda s: s.animate([s.robot.home], fps=NAN), lambda s: s.animate([s.robot.home], ["a"], name=3),
    lambda s: s.animate([s.robot.home], [5]),
    lambda s: s.look(eye=(NAN, 0, 0)), lambda s: s.look(eye=(1, 2)), lambda s: s.look((1, 1, 1), (1, 1, 1)),
    lambda s: s.look(target="there"), lambda s: s.say(5), lambda s: s.remove("nothing"), lambda s: s.remove(None),
    lambda s: s.add("box"), lambda s: s.add(ik.Shape.sphere(0.1), [NAN] * 3), lambda s: s.add(s.robot, [1.0]),
    lambda s: s.add(s.robot, T_base=[1.0]), lambda s: s.add(s.robot, name="robot"), lambda s: s.serve(-1),
    lambda s: s.serve("a"), lambda s: s.serve(70_000), lambda s: s.update([NAN] * 6),
    lambda s: s.update(s.robot.home, [1.0]), lambda s: s.update(None), lambda s: s.animate(None), lambda s: s.ghosts(None),
    lambda s: s.update(s.robot.home, {"tool": [NAN] * 3}),
    lambda s: s.update(s.robot.home, cloud=[1.0]), lambda s: s.update(s.robot.home, obstacles=4),
    lambda s: s.update(s.robot.home, 5), lambda s: s.update(object()),
    lambda s: s.controls("yes"), lambda s: s.save("x.png"), lambda s: s.save(5),
]  # fmt: skip


def test_bad_input_raises_our_errors_and_changes_nothing(arm):
    result, target = solved(arm)
    scene = view(arm, result, target=target, cloud=np.eye(3))
    before = state(scene)
    for k, call in enumerate(BAD):
        try:
            call(scene)
        except IKError as error:
            caught = error
        else:
            pytest.fail(f"call {k} was accepted")
        assert isinstance(caught, InvalidConfiguration | InvalidOption | InvalidTarget | LookupError), k
        assert state(scene) == before, (k, caught)
    with pytest.raises(InvalidOption, match=r"for 0 to 255 write \(1\.0, 0\.502, 0\.0\)"):
        scene.show(arm.home, color=(255, 128, 0))


def test_nothing_to_show_is_said(arm):
    with pytest.raises(InvalidOption, match=r"nothing to show: give a configuration q .* not None"):
        view(arm).update(None)
    with pytest.raises(InvalidOption, match=r"interact takes a solver .* not None"):
        ik.interact(arm, None)
    with pytest.raises(InvalidOption, match="the dict is empty"):
        ik.plot({}, arm)


def test_view_refuses_bad_input(arm):
    for bad in (
        dict(what=[NAN] * 6), dict(target=[NAN] * 3), dict(target=5), dict(cloud=5), dict(title=5), dict(obstacles="box"),
        dict(cloud=(np.eye(3), [1, 0])), dict(what="home?"), dict(what={}), dict(target={"nowhere": [1, 0, 0]}),
    ):  # fmt: skip
        with pytest.raises(IKError):
            view(arm, **bad)


def test_an_animation_needs_neither_labels_nor_a_rate(arm):
    scene = view(arm)
    scene.animate(np.linspace(arm.home, arm.home + 0.1, 30))
    made = scene.window.about["animation"]
    assert made["count"] == 30 and made["labels"][0] == "1 of 30" and made["fps"] == 25.0
    for draw in (scene.animate, scene.ghosts):
        for labels in (3, "one text", [3, 4]):
            with pytest.raises(InvalidOption, match="label"):
                draw(np.array([arm.home, arm.home]), labels=labels)


def test_two_robots_of_one_model_keep_their_places(arm):
    """pin.SE3 is taken for the base of an added robot, too."""
    scene = view(arm)
    name = scene.add(arm, arm.lower, T_base=pin.SE3(np.eye(3), np.array([0.0, 2.0, 0.0])), color=(0.2, 0.4, 0.8))
    scene.show(arm.upper)
    base = (
        scene.body.T_world_base @ ik.pose((0.0, 2.0, 0.0), rpy=(0.0, 0.0, 0.0)) @ np.linalg.inv(scene.body.T_world_base)
    )
    for part, M in zip(scene.body.parts, scene.body.placements(arm.lower), strict=True):
        assert np.allclose(scene.drawn()[f"{name}/{part.name}"], base @ M)


def test_screenshots_and_recordings_are_files(arm, tmp_path):
    """A picture of every frame that is recorded, in the animation's own time; the scene itself does not move."""
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'plots')")
    pytest.importorskip("ik_toolkit.show.picture")
    Image = pytest.importorskip("PIL.Image")
    scene = view(load("planar_2r"))
    with pytest.raises(InvalidOption, match="no animation to record"):
        scene.record(tmp_path / "a.gif")
    before = np.asarray(Image.open(scene.screenshot(tmp_path / "a.png", (300, 200))).convert("RGB"))
    assert before.shape == (200, 300, 3)
    scene.show([1.0, 0.5])
    after = np.asarray(Image.open(scene.screenshot(tmp_path / "a.png", (300, 200))).convert("RGB"))
    assert (before != after).any(axis=2).sum() > 1000
    scene.animate(np.linspace([0.0, 0.0], [1.0, 0.5], 31), fps=10.0)
    kept = state(scene)
    with Image.open(scene.record(tmp_path / "a.gif", (300, 200), pictures=4)) as film:
        frames, lasts = [], []
        for k in range(film.n_frames):
            film.seek(k)
            lasts.append(film.info["duration"])
            frames.append(np.asarray(film.convert("RGB")).astype(int))
    assert lasts == [1000, 1000, 1000, 1500] and state(scene) == kept
    assert all((np.abs(a - b) > 40).any(axis=2).sum() > 500 for a, b in itertools.pairwise(frames))
    for bad in (dict(path="a.jpg"), dict(path="a.png", size=(0, 5)), dict(path="a.png", size="big"), dict(path=4)):
        with pytest.raises(InvalidOption):
            scene.screenshot(**bad)
    with pytest.raises(InvalidOption, match="pictures must be a whole number"):
        scene.record(tmp_path / "a.gif", pictures=0)
    with pytest.raises(InvalidOption, match=r"written as \.gif or \.mp4, not 'a.webm'"):
        scene.record(tmp_path / "a.webm")


def test_a_scene_that_stands_still_in_a_cell_says_what_to_do(arm, caplog):
    scene = view(arm)
    scene.show(arm.lower)
    assert not caplog.messages
    assert "image/png" in scene._repr_mimebundle_()
    scene.show(arm.home)
    scene.show(arm.lower)
    (said,) = caplog.messages
    assert "live=True" in said and "end a cell with it again" in said
