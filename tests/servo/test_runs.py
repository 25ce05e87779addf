"""Whole runs: rules as trackers, saved files, the command, invalid input."""

import json
import warnings

import numpy as np
import pinocchio as pin
import pytest
from references import Q0, panda_reference

import ik_toolkit as ik
from ik_toolkit.errors import IKError, InvalidConfiguration, InvalidOption, InvalidTarget
from ik_toolkit.servo.run import TrackInterrupted
from ik_toolkit.servo.stepper import Stepper


@pytest.mark.parametrize(("rule", "position", "orientation"), [
    ("dls", 2e-5, 1e-5),
    pytest.param("state-space", 0.01, 0.02, marks=pytest.mark.slow),
    pytest.param("lm", 2e-6, 2e-6, marks=pytest.mark.slow),  # a loop to compile for each rule: 10 s
    pytest.param("pid", 0.01, 0.1, marks=pytest.mark.slow),
])  # fmt: skip
def test_solver_rules_as_trackers(panda, rule, position, orientation):
    run = ik.track(panda, panda_reference(panda, True, 6.0), rule, dt=0.005, q0=Q0)
    assert run.gain_check is None and len(run.t) == 1201
    assert run.figures["position"]["settled_max"] < position
    assert run.figures["orientation"]["settled_max"] < orientation


def test_wrong_options_of_a_rule_are_refused(panda):
    ref = panda_reference(panda, True, 1.0)
    with pytest.raises(InvalidOption, match="no option 'dampling'"):
        ik.track(panda, ref, "dls", dampling=1.0)


@pytest.mark.parametrize("method", ["cv", "lm"])
def test_wrong_names_are_refused_before_anything_runs(panda, method):
    """At construction, with what exists; not at the first update, or after the start has been solved for."""
    arms = ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])
    for call in (ik.Tracker, ik.Solver)[: 1 + (method == "lm")]:
        for option, value in (("relative_to", {"left_tip": "rigth_tip"}), ("mask", {"rigth_tip": [1, 1, 1, 0, 0, 0]})):
            wanted = f"{option}: 'rigth_tip' is not one .* Did you mean 'right_tip'.*left_tip, right_tip"
            with pytest.raises(InvalidOption, match=wanted):
                call(arms, method, **{option: value})
        with pytest.raises(InvalidOption, match="relative_to is circular: left_tip -> right_tip -> left_tip"):
            call(arms, method, relative_to={"left_tip": "right_tip", "right_tip": "left_tip"})
        with pytest.raises(InvalidOption, match="relative_to is for robots with several tips"):
            call(panda, method, relative_to={"left_tip": "right_tip"})
    ref = panda_reference(panda, True, 1.0)
    for wrong, meant in (("max_strech", "max_stretch"), ("positon_tolerance", "position_tolerance"), ("q_0", "q0")):
        with pytest.raises(InvalidOption, match=f"{method} has no option '{wrong}'. Did you mean '{meant}'"):
            ik.track(panda, ref, method, **{wrong: 1.0})
    with pytest.raises(InvalidOption, match=f"{method} has no option 'acceleration_limit'. .*'acceleration_limits'"):
        ik.Tracker(panda, method, acceleration_limit=1.0)


def test_an_option_of_another_method_is_named_with_it(panda):
    with pytest.raises(InvalidOption, match=r"cv has no option 'gama'. 'gamma' is an option of aad. Available: k"):
        ik.Tracker(panda, "cv", gama=0.7)
    with pytest.raises(InvalidOption, match=r"gamma is an option of aad, not of cv$"):
        ik.Tracker(panda, "cv", gamma=0.7)
    with pytest.raises(InvalidOption, match=r"aad has no option 'gama'\. Did you mean 'gamma'"):
        ik.Tracker(panda, "aad", gama=0.7)
    with pytest.raises(InvalidOption, match=r"cv has no option 'kap'\. Did you mean 'kappa'"):  # and not 'kp' of ca
        ik.Tracker(panda, "cv", kap=0.7)


@pytest.mark.parametrize("counting", ["pose", "position", "mask", "slack", "two tips"])
def test_errors_of_a_slowed_run_are_against_the_reference_itself(counting):
    """And not against the cubics through few samples of it, which the loop sees where the clock is between them."""
    arm = ik.Tree.load("brokk_hydrolek") if counting == "two tips" else ik.Robot.load("hydrolek_7w")
    mask, slack = (1, 0, 1, 1, 1, 0), np.array([0.0, 1e-3, 0.0, 0.0, 0.0, 0.01])
    starts = [one.fk(arm.home[at]).homogeneous for one, at in zip(arm.arms, arm.places, strict=True)]
    targets = [T[:3, 3] if counting == "position" else T for T in starts]
    refs = [ik.lissajous(T, (0.0, 0.02, 0.02), cycles=(1, 3, 2), duration=1.0) for T in targets]
    reference = dict(zip(arm.tips, refs, strict=True)) if arm.by_tip else refs[0]
    counts = {"mask": {"mask": mask}, "slack": {"slack": slack}}.get(counting, {})
    run = ik.track(arm, reference, dt=0.05, q0=arm.home, **counts)
    between = np.abs(run.clock / 0.05 - np.rint(run.clock / 0.05)) > 1e-6
    assert run.added_time > 0.1 and between.sum() > 10
    worst = np.zeros((len(run.t), 2))
    for one, at, ref in zip(arm.arms, arm.places, refs, strict=True):
        for k, (T, q) in enumerate(zip(ref.at(run.clock)[0], run.q, strict=True)):
            tip = one.fk(q[at])
            e = np.concatenate([T[:3, 3] - tip.translation, pin.log3(T[:3, :3] @ tip.rotation.T)])
            if counting == "mask":
                e *= mask
            if counting == "slack":
                e -= np.clip(e, -slack, slack)
            worst[k] = np.maximum(worst[k], np.linalg.norm(e.reshape(2, 3), axis=1))
    assert np.abs(run.position_error - worst[:, 0]).max() < 1e-9
    if counting != "position":
        assert np.abs(run.orientation_error - worst[:, 1]).max() < 1e-7


def test_gains_that_lead_away_from_the_target_are_refused(panda):
    for method, name in (("cv", "kappa"), ("ca", "kp"), ("ca", "kd"), ("aad", "null_damping"), ("av", "damping")):
        given = {"kp": 1.0, "kd": 1.0} if method == "ca" else {}
        with pytest.raises(InvalidOption, match=f"{name} must not be negative, not -3"):
            ik.Tracker(panda, method, **{**given, name: -3.0})
    with pytest.raises(InvalidOption, match="both kp and kd"):
        ik.Tracker(panda, "ca", kd=1.0)


def test_a_cost_that_is_not_finite_is_told_and_no_step_is_taken(panda):
    """At once for q0; later the tracker stays where it is."""

    def barrier(q):
        return -np.log(Q0[0] + 0.01 - q[0]) if q[0] < Q0[0] + 0.01 else np.nan

    def slope(q):
        return np.full(7, np.inf)

    for cost in (slope, lambda q: np.nan):
        with pytest.raises(InvalidOption, match=rf"cost \({cost.__name__}\) .* at or beside q = \["):
            ik.Tracker(panda, q0=Q0, cost=cost)
    tracker = ik.Tracker(panda, q0=Q0, cost=barrier)
    tracker.update(panda.fk(Q0), 0.01)
    tracker.reset(Q0)
    there = Q0 + np.array([0.2, 0, 0, 0, 0, 0, 0])
    with pytest.raises(InvalidOption, match=r"cost \(barrier\) is nan"):
        for _ in range(100):
            before = tracker.q
            tracker.update(panda.fk(there), 0.01)
    assert np.array_equal(tracker.q, before) and before[0] > Q0[0]


def test_command(run, tmp_path):
    plot, file = tmp_path / "cut.png", tmp_path / "cut.npz"
    cut = "track hydrolek_7w --path line --length 0.3 --axis 0 0 -1 --rate 200 -m ca".split()
    code, out, _ = run(*cut, "--plot", plot, "-o", file)
    assert code == 0 and "COMPLETED" in out and "shoulder_pitch" in out
    assert plot.stat().st_size > 20_000 and file.is_file()
    code, out, _ = run(*cut, "--json")
    data = json.loads(out)
    assert code == 0 and data["success"] and data["figures"]["position"]["max"] < 1e-6
    assert data["stability"]["verdict"] == "stable"


def test_command_warns(run):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the command shows the warning itself
        code, out, err = run(*"track planar_2r -m ca --kp 30000 --kd 20 --duration 3 --no-limits --json".split())
    assert code == 1 and "unstable" in err and "Try kp" in err and json.loads(out)["status"] == "DIVERGED"


OWN_OPTIONS = ("dt=0.1", "q0=3", "settle=1", "method=av", "robot=ur5", "acceleration_limits=3")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--path circel", "Did you mean 'circle'"),
        ("-m cw", "Did you mean 'cv'"),
        ("--rate 0", "--rate"),
        ("-o run.txt", ".npz, .csv or .json"),
        ("--path missing.csv", "no reference file"),
        ("-p damping=x", "damping must be a number"),
        ("--position-tolerance -1", "--position-tolerance"),
        ("--orientation-tolerance 0", "--orientation-tolerance"),
        ("--path line --length 0.1 --turns 1.5", "rounds of a line must be a whole number"),  # was one round
        ("--path line --end 1.2 0.9 0 --turns 1.5", "rounds of a line must be a whole number"),
        ("--axis 0 0 0", "--axis must not be zero"),
        # They were passed over: `--length 0.1` alone gave a circle of 0.1 m radius.
        ("--length 0.1", "--length cannot be used with --path circle; it takes --radius, --axis, --start"),
        ("--path line --radius 0.1 --turns 1", "--radius cannot be used with --path line; it takes --length"),
        ("--path eight --end 1 0 0", "--end cannot be used with --path eight"),
        (
            "--path line --end 1 0 0 --length 0.1 --axis 0 0 1",
            "--length, --axis cannot be used with --path line with --end",
        ),
        (
            "--path p.csv --turns 2 --law constant",
            "--law, --turns cannot be used with a path from a file, which says all of it",
        ),
        *[(f"-p {pair}", f"-p cannot set {pair.split('=')[0]}") for pair in OWN_OPTIONS],
    ],
)
def test_command_refuses(run, words, said):
    code, _, err = run("track", "planar_2r", *words.split())
    assert code == 2 and said in " ".join(err.split())


def test_wrong_inputs_of_a_run_are_typed(panda, planar):
    ref = panda_reference(panda, True, 1.0)
    for robot in (None, "panda"):
        with pytest.raises(InvalidOption, match=r"Robot\.load"):
            ik.track(robot, ref)
        with pytest.raises(InvalidOption, match=r"Robot\.load"):
            ik.Tracker(robot)
    no_joints = (np.zeros(3), np.full(7, np.nan), {}, np.zeros((7, 1)))
    for call, option, error, values in (
        (ik.track, "dt", IKError, (0.0, -0.01, np.nan, None, "fast")),
        (ik.track, "limits", IKError, (3, "no")),
        (ik.track, "acceleration_limits", IKError, (np.nan, "high")),
        (ik.track, "kappa", IKError, ("high", None)),
        (ik.track, "q0", InvalidConfiguration, no_joints),
        (ik.track, "rate0", InvalidConfiguration, no_joints),
        (ik.Tracker, "jump", InvalidOption, (0.0, -1.0, np.nan, "far")),
    ):
        for value in values:
            with pytest.raises(error, match=option):
                call(panda, **({"reference": ref} if call is ik.track else {}), **{option: value})

    for method in (None, ["cv"], 7):
        with pytest.raises(IKError, match=r"a solver must be a name|no tracking method"):
            ik.track(panda, ref, method)

    for change in (
        lambda T, V, A: (T, V),
        lambda T, V, A: None,
        lambda T, V, A: (T, V, "no"),
        lambda T, V, A: (T[:1], V, A),
        lambda T, V, A: (T[:, :3], V, A),
    ):
        broken = ik.Reference(lambda t, change=change: change(*ref.at(t)), 1.0, name="mine")
        with pytest.raises(InvalidTarget, match="reference 'mine' must give"):
            ik.track(panda, broken, q0=Q0)
    with pytest.raises(InvalidOption, match="function of time"):
        ik.Reference(None, 1.0)
    for duration in (0.0, -1.0, np.nan, "long", None):
        with pytest.raises(InvalidOption, match="duration"):
            ik.Reference(ref.function, duration)


def test_an_interrupted_run_keeps_its_steps(panda, monkeypatch):
    ref, calls = panda_reference(panda, True, 1.0), []
    run = Stepper.run

    def interrupted(self, *args, **options):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return run(self, *args, **options)

    monkeypatch.setattr(Stepper, "run", interrupted)
    with pytest.raises(TrackInterrupted) as caught:
        ik.track(panda, ref, "cv", dt=0.01, q0=Q0, avoid_collisions=True)
    kept = caught.value.result
    assert str(caught.value).startswith("interrupted") and 0 < len(kept.t) < 101 and kept.q.shape == (len(kept.t), 7)
