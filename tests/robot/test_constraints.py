"""Ties of MJCF joints: what is linear becomes mimic, balls keep their range, loops are said; judged by MuJoCo."""

import logging
import pickle

import mujoco
import numpy as np
import pytest
from mjcf_models import Judge, random_mjcf

import ik_toolkit as ik

GEOM = '<geom size="0.02"/>'
FINGER = f"""<mujoco><worldbody><body name="p">{GEOM}<joint name="mcp" axis="0 1 0" range="0 60"/>
<body name="m" pos="0.04 0 0">{GEOM}<joint name="pip" axis="0 1 0" range="0 110"/><body name="d" pos="0.03 0 0">{GEOM}
<joint name="dip" axis="0 1 0" range="-20 90" ref="10"/><site name="tip" pos="0.02 0 0"/></body></body></body></worldbody>
<tendon><fixed name="t"><joint joint="mcp" coef="2"/><joint joint="pip" coef="-1"/></fixed>
<fixed name="u"><joint joint="dip" coef="0.5"/></fixed>
<fixed name="three"><joint joint="mcp" coef="1"/><joint joint="pip" coef="1"/><joint joint="dip" coef="-1"/></fixed></tendon>
<equality>{{}}</equality></mujoco>"""
BARS = f"""<mujoco><worldbody><body name="crank">{GEOM}<joint name="c" axis="0 1 0" range="-60 60"/>
<body name="hand" pos="0 0 0.1">{GEOM}<joint name="h" axis="1 0 0" range="-60 60"/><site name="tip" pos="0 0.1 0.1"/></body>
<body name="rod" pos="0 0 0.1">{GEOM}<joint name="r" axis="0 1 0" range="-120 120"/></body></body>
<body name="rocker" pos="0.3 0 0">{GEOM}<joint name="k" axis="0 1 0" range="-20 60"/></body></worldbody>
<equality><connect name="bar" body1="rod" body2="rocker" anchor="0.3 0 0"/></equality></mujoco>"""


def joint_tie(first, second, curve):
    other = f'joint2="{second}" ' if second else ""
    return f'<joint joint1="{first}" {other}polycoef="{curve}"/>'


def finger(*ties):
    return ik.Robot.load(FINGER.format("".join(ties)), tip="tip")


def check(robot, text, allowed=1e-12):
    """Random q keep what the file says, and the tip is where MuJoCo puts it."""
    judge = Judge(text)
    for q in robot.random_q(np.random.default_rng(0), 5):
        judge.put(robot.joint_names, q)
        assert np.abs(robot.fk(q).translation - judge.data.site("tip").xpos).max() < 1e-12
        assert judge.broken() < allowed


SLOW = pytest.mark.slow
FOLLOWERS = [joint_tie("pip", "mcp", "0 1.1 0 0 0"), joint_tie("dip", "pip", "0.05 0.7 0 0 0")]


@pytest.mark.parametrize(
    ("ties", "left"),
    [
        pytest.param(FOLLOWERS, ("mcp",), marks=SLOW),
        (FOLLOWERS[::-1], ("mcp",)),
        ([joint_tie("dip", "", "0.3 0 0 0 0")], ("mcp", "pip")),
        ([joint_tie("dip", "mcp", "0.3 0 0 0 0")], ("mcp", "pip")),
        pytest.param(['<tendon tendon1="t"/>'], ("mcp", "dip"), marks=SLOW),
        pytest.param(['<tendon tendon1="u" polycoef="0.1 0 0 0 0"/>'], ("mcp", "pip"), marks=SLOW),
        (
            ['<tendon tendon1="t" tendon2="u" polycoef="0.02 1.5 0 0 0"/>', joint_tie("dip", "mcp", "0.1 1 0 0 0")],
            ("mcp",),
        ),
        pytest.param(['<tendon tendon1="three"/>', joint_tie("dip", "mcp", "0.1 0.5 0 0 0")], ("mcp",), marks=SLOW),
        (['<tendon tendon1="three"/>', '<tendon tendon1="t"/>', joint_tie("dip", "", "0.5 0 0 0 0")], ()),
        ([joint_tie("dip", "mcp", "0 3 0 0 0").replace("/>", ' active="false"/>')], ("mcp", "pip", "dip")),
    ],
)
def test_what_is_linear_becomes_mimic(ties, left):
    if not left:  # every joint is held, so nothing is left to solve
        with pytest.raises(ik.errors.ModelError, match="no moving joint"):
            finger(*ties)
        return
    robot = finger(*ties)
    assert robot.joint_names == left and not robot.constraints
    check(robot, FINGER.format("".join(ties)))


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(2, 12), marks=pytest.mark.slow)])
def test_random_models_keep_what_mujoco_says(seeds):
    """The same models as scripts/break/robots.py --kind mjcf tries by the hundred."""
    for seed in seeds:
        text = random_mjcf(rng := np.random.default_rng([7, seed]))
        robot, judge = ik.Robot.load(text, tip="tip"), Judge(text)
        for q in robot.random_q(rng, 3):
            answer = ik.solve(robot, robot.fk(q))
            if answer.success:
                judge.put(robot.joint_names, answer.q, answer.notice)
                assert judge.broken() < (1e-5 if robot.constraints else 1e-9)


def test_contradictions_are_named():
    robot = finger(joint_tie("dip", "", "0.3 0 0 0 0"), joint_tie("dip", "", "0.4 0 0 0 0"))
    assert any("'joint dip' contradicts" in note for note in robot.notes) and "dip" in robot.joint_names
    assert ik.solve(robot, robot.fk(robot.home)).status == ik.Status.CONSTRAINT_OPEN
    far = finger(joint_tie("dip", "", "3 0 0 0 0"))
    assert any("'dip' would be held at 3.17" in note and "outside its range" in note for note in far.notes)


def test_a_ball_turns_no_further_than_its_range():
    text = FINGER.format("").replace('name="mcp" axis="0 1 0" range="0 60"', 'name="mcp" type="ball" range="0 40"')
    text = text.replace('<joint joint="mcp" coef="2"/>', "").replace('<joint joint="mcp" coef="1"/>', "")
    key = '<keyframe><key name="bent" qpos="-0.98 0.1 0 0.1 0 0"/><key name="bad" qpos="nan 0 0 0 0 0"/></keyframe>'
    robot = ik.Robot.load(text.replace("<tendon>", key + "<tendon>"), tip="tip")
    assert robot.joint_names == ("mcp_azimuth", "mcp_tilt", "mcp_angle", "pip", "dip")
    assert robot.upper[2] == -robot.lower[2] == pytest.approx(np.radians(40))
    assert any("its range is the limit of mcp_angle: +-40 degrees" in note for note in robot.notes)
    check(robot, text)
    assert "bad" not in robot.named and any("keyframe 'bad' is left out" in note for note in robot.notes)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:] = [-0.98, 0.1, 0, 0.1, 0, 0]
    mujoco.mj_forward(model, data)
    assert np.abs(robot.fk(robot.named["bent"]).translation - data.site("tip").xpos).max() < 1e-12


def test_the_range_of_a_tendon_is_that_of_its_only_joint():
    text = FINGER.format("").replace('<fixed name="u">', '<fixed name="u" limited="true" range="-0.1 0.2">')
    robot = ik.Robot.load(text, tip="tip")
    assert robot.lower[2] == pytest.approx(-0.2) and robot.upper[2] == pytest.approx(0.4) and not robot.constraints
    several = FINGER.format("").replace('<fixed name="three">', '<fixed name="three" limited="true" range="-0.1 0.1">')
    robot = ik.Robot.load(several, tip="tip")
    kept = ik.solve(robot, robot.fk([0.1, 0.1, 0.15]))
    assert kept.notice == "the range of tendon 'three' of the description is kept"
    bent = ik.solve(robot, robot.fk([0.5, 0.5, 0.2]))
    assert bent.status == ik.Status.CONSTRAINT_OPEN and "this q is 40.1 deg off" in bent.message


def test_reversed_ranges_are_no_limits_and_are_named(caplog):
    with caplog.at_level(logging.WARNING):
        robot = ik.Robot.load(FINGER.format("").replace("0 110", "60 0"), tip="tip")
    assert np.isinf(robot.upper[1]) and "joint 'pip' has no limits, as in MuJoCo: its range 60 0" in caplog.text
    with pytest.raises(ik.errors.ModelError, match=r"range\[0\] should be smaller than range\[1\]"):
        ik.Robot.load(FINGER.format("").replace('range="0 110"', 'limited="true" range="60 0"'), tip="tip")


def test_a_held_free_joint_is_noted():
    text = FINGER.format("").replace('<body name="p">', '<body><freejoint name="fr"/><geom size="0.1"/><body name="p">')
    robot = ik.Robot.load(text.replace("</worldbody>", "</body></worldbody>"), tip="tip")
    assert any("free joint 'fr'" in note and "held still" in note for note in robot.notes)


# ------------------------------------------------------------------------------------------------------------- loops
def test_a_loop_is_closed_by_the_joints_off_the_path_or_said_to_be_open():
    robot = ik.Robot.load(BARS, tip="tip")
    assert robot.joint_names == ("c", "h") and any("the loop 'bar' is left open" in note for note in robot.notes)
    kept = ik.solve(robot, robot.fk([0.4, 0.2]))
    assert kept.success and kept.notice == "the loop 'bar' of the description is kept with r = -0.4, k = 0.4"
    judge = Judge(BARS)
    judge.put(robot.joint_names, kept.q, kept.notice)
    assert judge.broken() < 1e-6
    target = robot.fk([-0.7, 0.2])  # the rocker stops at -20 degrees
    broken = ik.solve(robot, target)
    assert broken.status == ik.Status.CONSTRAINT_OPEN and not broken.success
    stop = np.radians(20.0)
    ends = (
        0.3 + 0.1 * (np.sin(0.7) - np.sin(stop)),
        0.1 * (np.cos(stop) - np.cos(0.7)),
    )  # from the crank's to the rocker's
    least = f"{1e3 * (np.hypot(*ends) - 0.3):.1f} mm"
    assert f"the loop 'bar' of the description is not kept: this q opens it by {least}, with" in broken.message
    assert "with r, k moved to close it" in broken.message and broken.to_dict()["status"] == "CONSTRAINT_OPEN"
    assert ik.Solver(robot)(target).status == ik.Status.CONSTRAINT_OPEN  # without check=True too
    many = ik.solve_batch(robot, np.array([robot.fk(q).homogeneous for q in ([0.4, 0.2], [-0.7, 0.2])]))
    assert many.success.tolist() == [True, False] and many.counts()["CONSTRAINT_OPEN"] == 1
    assert "not kept" in many[1].message
    again = pickle.loads(pickle.dumps(robot))
    assert ik.solve(again, target).status == ik.Status.CONSTRAINT_OPEN
    with pytest.raises(ik.errors.NotSolved, match="not kept"):
        broken.raise_for_status()
    none = ik.solve_all(robot, target, starts=50)
    assert not len(none) and "not kept" in none.message


def test_paths_and_runs_say_that_a_loop_opens():
    robot = ik.Robot.load(BARS, tip="tip")
    Q = np.linspace([-0.1, 0.2], [-0.7, 0.2], 7)
    poses = [robot.fk(q) for q in Q]
    path = ik.solve_path(robot, poses)
    assert path.status.name == "CONSTRAINT_OPEN" and not path.success and "but at pose 3" in path.message
    assert ik.solve_path(robot, poses[:2]).success
    ends = [robot.fk(q).translation for q in ([-0.1, 0.2], [-0.65, 0.2])]
    run = ik.track(robot, ik.line(*ends, duration=4.0), q0=Q[0], dt=0.05, position_tolerance=0.02, settle=0.5)
    assert run.status.name == "CONSTRAINT_OPEN" and not run.success and "s the loop 'bar' of" in run.message


def test_a_loop_apart_from_the_path_is_a_note_only():
    arm = f'<body name="arm"><joint name="a" range="-90 90"/>{GEOM}<site name="tip" pos="0.1 0 0"/></body></worldbody>'
    text = BARS.replace('<site name="tip"', '<site name="x"').replace("</worldbody>", arm)
    robot = ik.Robot.load(text, tip="tip")
    answer = ik.solve(robot, robot.fk([0.3]))
    assert answer.success and not answer.notice and any("'bar'" in note for note in robot.notes)


def test_residuals_are_those_of_mujoco():
    """Every kind of equality at random configurations, against MuJoCo's own."""
    text = BARS.replace(
        "</worldbody>",
        '<site name="s" pos="0.1 0.2 0.3" euler="10 20 30"/></worldbody><tendon><spatial name="line">'
        '<site site="s"/><site site="tip"/></spatial></tendon>',
    ).replace(
        "<equality>",
        '<equality><weld site1="tip" site2="s"/>'
        '<weld body1="hand" body2="rocker" anchor="0 0 0.2" relpose="0.1 0.2 0.3 0.5 0.5 0.5 0.5"/><tendon tendon1="line" '
        'polycoef="0.07 0 0 0 0"/><joint joint1="h" joint2="c" polycoef="0.1 2 0.5 0 0"/>',
    )
    robot, judge = ik.Robot.load(text, tip="tip"), Judge(text)
    from ik_toolkit.robot.constraints import Closure

    closure = Closure(robot)
    for q in robot.random_q(np.random.default_rng(1), 3):
        full = robot.to_pinocchio(q)
        mine = {one.name: closure.residual(one, full)[0] for one in robot.constraints}
        judge.data.qpos[:] = [q[0], q[1], 0.0, 0.0]
        off, ids = judge.equalities()[0], judge.data.efc_id[judge.data.efc_type == 0]
        for k, name in enumerate(("weld tip and s", "weld hand and rocker", "tendon line", "joint h and c", "bar")):
            his = off[ids == k]
            assert np.abs(mine[name][:3] - his[:3]).max() < 1e-12
            if len(his) == 6:  # MuJoCo's is the vector of half the angle's sine
                angle = np.linalg.norm(mine[name][3:])
                assert abs(np.sin(0.5 * angle)) == pytest.approx(np.linalg.norm(his[3:]), abs=1e-12)
