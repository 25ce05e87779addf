"""Maps of reach: equal to geometry where it is known, never a false yes, audited noes, files that survive, helpful errors."""

import json
import pickle
import resource
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import robots
import second_fk

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, InvalidTarget
from ik_toolkit.solvers.batch.solve_batch import solve_parts
from ik_toolkit.study import reachability as study
from ik_toolkit.study.reachability import MapNotSaved, ReachabilityInterrupted

TURNS = np.array([np.eye(3), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [[1, 0, 0], [0, -1, 0], [0, 0, -1]]], dtype=float)
BOX = ((0.3, -0.4, -0.3), (1.1, 0.4, 0.5))


@pytest.fixture(scope="module")
def dense():
    """The HydroLek on a grid of tool axes and its map."""
    robot = robots.load("hydrolek_7w")
    return robot, ik.reachability(robot, BOX, resolution=0.1, orientations=5, audit=20)


def two_links(x, y, limit, slack=0.0):
    """Whether two links of 1 m, joints within +-limit [rad], reach points, by the law of cosines."""
    c = (x * x + y * y - 2.0) / 2.0
    bend = np.arccos(np.clip(c, -1.0, 1.0))
    found = np.zeros(np.shape(x), bool)
    for q2 in (bend, -bend):
        q1 = np.arctan2(y, x) - np.arctan2(np.sin(q2), 1.0 + np.cos(q2))
        q1 = (q1 + np.pi) % (2.0 * np.pi) - np.pi
        found |= (np.abs(q1) <= limit + slack) & (np.abs(q2) <= limit + slack) & (np.abs(c) <= 1.0 + slack)
    return found


@pytest.mark.parametrize("resolution", [0.0511, 0.1])
def test_a_planar_arm_equals_the_law_of_cosines(resolution):
    found = ik.reachability(robots.load("planar_2r"), ((-2.1, -2.1, 0), (2.1, 2.1, 0)), resolution=resolution)
    x, y, _ = found.grid.centres().T
    limit = np.deg2rad(150.0)
    sure = two_links(x, y, limit, 1e-5) == two_links(x, y, limit, -1e-5)  # not within some micrometres of the border
    assert sure.mean() > 0.99
    assert (found.reached.ravel() == two_links(x, y, limit))[sure].all()
    assert found.counts()["unknown"] == 0 and str(found.audit) == "every no is proven"


def test_poses_of_three_planar_links_equal_geometry():
    arm, limit, angles = robots.load("planar_3r"), np.pi / 3.0, np.linspace(-2.9, 2.9, 12)
    c, s, o, i = np.cos(angles), np.sin(angles), np.zeros(12), np.ones(12)
    turns = np.stack([c, -s, o, s, c, o, o, o, i], axis=-1).reshape(-1, 3, 3)
    found = ik.reachability(arm, ((-6.1, -6.1, 0), (6.1, 6.1, 0)), resolution=0.41, orientations=turns, audit=0)
    x, y, _ = (found.grid.centres()[:, None] - 2.0 * turns[None, :, :, 0]).transpose(2, 0, 1) / 2.0
    want = np.zeros(x.shape, bool)
    for sign in (1.0, -1.0):
        cos = (x * x + y * y - 2.0) / 2.0
        q2 = sign * np.arccos(np.clip(cos, -1.0, 1.0))
        q1 = np.arctan2(y, x) - np.arctan2(np.sin(q2), 1.0 + np.cos(q2))
        q1 = (q1 + np.pi) % (2 * np.pi) - np.pi
        q3 = (angles - q1 - q2 + np.pi) % (2 * np.pi) - np.pi
        want |= (np.abs(cos) <= 1.0) & (np.abs([q1, q2, q3]) <= limit).all(axis=0)
    assert want.sum() > 100
    assert ((found.states == 1) == want).all()


def judged(robot, found, urdf=None):
    """Check every reached cell's configuration by the FK from the URDF's text; return how many there are."""
    fk = second_fk.SecondFK(urdf or robot.urdf, robot.base, robot.tip)
    yes = found.reached.ravel()
    q, T = found.q[yes], fk.fk(found.q[yes], robot.joint_names)
    assert ((q >= robot.lower) & (q <= robot.upper)).all()
    assert np.linalg.norm(T[:, :3, 3] - found.grid.centres()[yes], axis=1).max() < 1.1e-6
    return T, yes


def test_every_yes_is_true(dense):
    robot, found = dense
    T, yes = judged(robot, found)
    assert yes.sum() > 20
    axes = T[:, None, :3, 2] @ found.grid.rotations[:, :, 2].T  # cosine to each tool axis
    best = np.where(found.states[yes] == 1, axes[:, 0], -1.0).max(axis=1)
    assert best.min() > 1.0 - 1e-11


def test_no_yes_is_missed(dense):
    """Also those that a few attempts miss and a neighbour or more attempts find."""
    robot, found = dense
    T = found.grid.targets(np.arange(found.grid.answers))
    truth = ik.solve_batch(robot, T, free_turn="z", restarts=80, seed=5).success.reshape(found.states.shape)
    assert truth.sum() > 60
    assert ((found.states == 1) | ~truth).all()


def test_neighbours_and_more_attempts_find_what_few_miss(monkeypatch):
    robot, asked = robots.load("hydrolek_7w"), {"resolution": 0.04, "audit": 0, "max_iterations": 5}
    T = robot.fk(0.72 * robot.upper + 0.28 * robot.lower).homogeneous  # far from home
    asked["orientations"] = T[None]
    box = (T[:3, 3] - 0.12, T[:3, 3] + 0.12)
    monkeypatch.setattr(study, "decides", lambda plan: False)
    full = ik.reachability(robot, box, **asked).reached.sum()
    monkeypatch.setattr(study, "EFFORT", study.EFFORT._replace(few=1))
    monkeypatch.setattr(study._Study, "flood", lambda *_: None)
    monkeypatch.setattr(study._Study, "open_beside_yes", lambda _: ())
    few = ik.reachability(robot, box, **asked).reached.sum()
    assert 0 < few < full


def test_neighbours_start_elsewhere_and_help_each_other(monkeypatch):
    """With starts of their own the noes that touch a yes miss at most a quarter of what they miss with shared ones."""
    box = ((0.125, -0.15, -0.2), (0.375, 0.15, 0.3))
    asked = {"resolution": 0.025, "orientations": [ik.pose(rpy=(1.5661, -0.7576, 1.7676))], "audit": 0}
    robot, yes = robots.load("panda"), {}
    for groups, many in ((study.EFFORT.groups, 50), (1, 50), (1, 300)):
        monkeypatch.setattr(study, "EFFORT", study.EFFORT._replace(groups=groups, many=many))
        yes[groups, many] = ik.reachability(robot, box, **asked).counts()["yes"]
    shared, own = (yes[1, 300] - yes[groups, 50] for groups in (1, 16))
    assert 0 <= own <= shared / 4 and shared > 0


def test_the_audit_finds_false_noes_and_corrects_them(monkeypatch):
    robot = robots.load("hydrolek_7w")
    Q = robot.random_q(np.random.default_rng(3), 150)
    T = robot.chain.forward(Q)[0]
    monkeypatch.setattr(study, "decides", lambda plan: False)
    monkeypatch.setattr(study, "EFFORT", study.EFFORT._replace(many=1, audited=200))
    short = {"max_iterations": 4}  # most attempts then end too early
    bare = ik.reachability(robot, T, audit=0, **short)
    assert bare.audit.tried == 0 and bare.audit.unproven == bare.counts()["unknown"] > 10
    found = ik.reachability(robot, T, audit="full", **short)
    audit = found.audit
    assert audit.tried == audit.unproven == bare.audit.unproven and audit.found > 0.8 * audit.tried
    assert 0.9 < audit.interval[0] < audit.found / audit.tried <= audit.interval[1]
    assert found.counts()["yes"] == bare.counts()["yes"] + audit.found
    part = ik.reachability(robot, T, audit=7, **short)
    assert part.audit.tried == 7 and "7 of" in str(part.audit)


def test_questions_to_a_map(dense):
    _, found = dense
    centres, R = found.grid.centres(), found.grid.rotations
    T = np.tile(np.eye(4), (found.grid.answers, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = np.tile(R, (len(centres), 1, 1)), np.repeat(centres, len(R), axis=0) + 0.04
    assert (found.contains(T) == (found.states == 1).ravel()).all()
    assert (found.contains(centres) == found.reached.ravel()).all()
    assert not found.contains([[9.0, 0.0, 0.0]]).any()
    assert found.score(centres).max() == 1.0 and (found.score(T)[~found.contains(T)] == 0.0).all()
    assert (found.score(centres, "share") == found.share.ravel()).all()
    values, at = found.slice("z", 0.12)
    assert values.shape == found.grid.shape[:2] and abs(at - 0.12) <= 0.05
    assert (values == found.share[:, :, round((at - centres[0, 2]) / 0.1)]).all()
    nothing = replace(found, states=np.full_like(found.states, 2), manipulability=0.0 * found.manipulability)
    assert (nothing.score(centres) == 0.0).all()
    for words, call in (
        ("x, y", lambda: found.slice("w")),
        ("0.45", lambda: found.slice("z", 3.0)),
        ("0.45", lambda: found.slice("z", 1e308)),
        ("all be poses", lambda: found.contains([(0.9, 0.0, 0.2), np.eye(4)])),
        ("share", lambda: found.score(centres, "shares")),
        ("finite", lambda: found.contains([[np.nan, 0.0, 0.0]])),
    ):
        with pytest.raises((InvalidOption, InvalidTarget), match=words):
            call()


def test_a_file_reads_back_and_a_damaged_one_says_so(dense, tmp_path):
    _, found = dense
    file = found.save(tmp_path / "map.npz")
    again = ik.ReachabilityMap.load(file)
    with pytest.raises(InvalidOption, match=r"cannot read the map 'gone\.npz': No such file"):
        ik.ReachabilityMap.load(tmp_path / "gone.npz")
    assert repr(again) == repr(found) and again.audit == found.audit
    for name in ("states", "manipulability", "margin", "q"):
        assert np.array_equal(getattr(again, name), getattr(found, name), equal_nan=True)
    assert (again.contains(found.grid.centres()) == found.reached.ravel()).all()
    data = file.read_bytes()
    for bad in (data[: len(data) // 2], b"", b"no map", data.replace(b"shape.npy", b"shope.npy")):
        (tmp_path / "bad.npz").write_bytes(bad)
        with pytest.raises(InvalidOption, match=r"bad\.npz"):
            ik.ReachabilityMap.load(tmp_path / "bad.npz")
    for damaged in (replace(found, states=np.full_like(found.states, 9)), replace(found, margin=found.margin * np.nan)):
        with pytest.raises(InvalidOption, match=r"bad\.npz"):
            ik.ReachabilityMap.load(damaged.save(tmp_path / "bad.npz"))
    with np.load(file) as arrays:
        kept = dict(arrays)
    about = json.loads(str(kept["about"]))
    changes: list[dict] = [{"about": np.array(json.dumps({k: about[k] for k in about if k != name}))} for name in about]
    changes += [{"audit": kept["audit"][None]}, {"low": np.zeros(2)}, {"size": kept["size"] * np.nan}]
    for change in [*changes, {"rotations": np.zeros((1, 2))}, {"shape": np.array([kept["shape"].prod()])}]:
        np.savez(tmp_path / "bad.npz", **kept | change)
        with pytest.raises(InvalidOption, match=r"'bad\.npz' is no map"):
            ik.ReachabilityMap.load(tmp_path / "bad.npz")
    with pytest.raises(InvalidOption, match=r"a map is written as \.npz, not 'map\.json'"):
        found.save(tmp_path / "map.json")


def stopping(after):
    """A progress that presses Ctrl-C."""
    count = iter(range(10**9))

    def tell(_):
        if next(count) == after:
            raise KeyboardInterrupt

    return tell


def test_a_stopped_study_goes_on_where_it_was(tmp_path, monkeypatch):
    robot, asked = robots.load("hydrolek_7w"), {"resolution": 0.08, "audit": 30, "threads": 2}
    monkeypatch.setattr(study, "EFFORT", study.EFFORT._replace(chunk=256))
    whole, file = ik.reachability(robot, BOX, **asked), tmp_path / "map.npz"
    with pytest.raises(ReachabilityInterrupted) as stop:
        ik.reachability(robot, BOX, file=file, progress=stopping(1), **asked)
    part = stop.value.result
    assert part.counts()["untried"] == part.states.size - 256 and "not tried" in repr(part)
    partial = tmp_path / "map.npz.partial"
    partial.write_bytes(partial.read_bytes()[:-7])  # as if it was killed in the middle of an entry
    told = []
    again = ik.reachability(robot, BOX, file=file, progress=told.append, **asked)
    assert told[0] == 256  # the first part was not computed again, the one cut off was
    assert (again.states == whole.states).all()
    assert file.exists() and not partial.exists()
    with pytest.raises(ReachabilityInterrupted):
        ik.reachability(robot, BOX, file=file, progress=stopping(1), **asked)
    with pytest.raises(InvalidOption, match=r"another robot, region or options"):
        ik.reachability(robot, BOX, file=file, **{**asked, "resolution": 0.2})
    partial.write_text("notes of mine")
    with pytest.raises(InvalidOption, match=r"map\.npz\.partial' is no unfinished map"):
        ik.reachability(robot, BOX, file=file, **asked)
    assert partial.read_text() == "notes of mine"


def test_a_study_does_not_go_on_with_other_obstacles(tmp_path, monkeypatch):
    """An obstacle elsewhere, of another size or held makes it another study; the same shapes in a new model do not."""
    monkeypatch.setattr(study, "EFFORT", study.EFFORT._replace(chunk=32))
    arm, file = robots.load("planar_2r"), tmp_path / "map.npz"
    asked = {"region": ((0, -1.2, 0), (1.8, 1.2, 0)), "resolution": 0.2, "audit": 0, "file": file}

    def world(size=(0.3, 0.5, 0.3), at=(1.2, 0.6, 0.0)):
        return ik.CollisionModel(arm).add_box(size, at, name="wall")

    with pytest.raises(ReachabilityInterrupted):
        ik.reachability(arm, avoid_collisions=world(), progress=stopping(1), **asked)
    for other in (world(at=(1.2, -0.6, 0.0)), world(size=(0.3, 0.1, 0.3)), world().attach(ik.Shape.sphere(0.01))):
        with pytest.raises(InvalidOption, match="another robot, region or options"):
            ik.reachability(arm, avoid_collisions=other, **asked)
    told = []
    again = ik.reachability(arm, avoid_collisions=world(), progress=told.append, **asked)
    assert told[0] == 96  # two parts of 32 were read from the file
    assert (again.states == ik.reachability(arm, avoid_collisions=world(), **asked).states).all()


def test_loose_poses_are_taken_in_every_form_and_made_exact():
    robot = robots.load("hydrolek_7w")
    rng = np.random.default_rng(1)
    T = [robot.fk(robot.random_q(rng)) for _ in range(3)]
    for count in (1, 2, 3):
        for given in (T[:count], tuple(T[:count]), [one.homogeneous for one in T[:count]]):
            found = ik.reachability(robot, given, audit=0)
            assert found.counts()["yes"] == count and found.reached.shape == (count, 1, 1)
    rough = np.array([one.homogeneous for one in T])
    rough[1, :3, :3] *= 1.001  # as `solve` and `solve_batch` take it
    kept = rough.copy()
    assert ik.solve_batch(robot, rough).success.all() and ik.reachability(robot, rough, audit=0).counts()["yes"] == 3
    assert (rough == kept).all()
    rough[2, 0, 0] = np.nan
    with pytest.raises(InvalidTarget, match="target 2"):
        ik.reachability(robot, rough)


def test_a_full_disk_loses_nothing_finished(run, tmp_path):
    robot, asked = robots.load("hydrolek_7w"), {"resolution": 0.1, "audit": 0, "file": tmp_path / "map.npz"}
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))  # no file may grow longer
    try:
        with pytest.raises(MapNotSaved, match=r"map\.npz") as failure:
            ik.reachability(robot, BOX, **asked)
        shell = ["reach", "hydrolek_7w", "--region", *BOX[0], *BOX[1], "--resolution", 0.1, "--audit", 0]
        code, _, said = run(*shell, "-o", tmp_path / "shell.npz")
        assert code == 2 and "is lost if the study is stopped" in said and "interrupted" not in said
        assert "has what fitted; with more space the same command goes" in said
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    kept = failure.value.result
    assert kept.counts()["untried"] == 0
    assert (ik.reachability(robot, BOX, **asked).states == kept.states).all()


def test_an_executor_gives_the_same_map():
    robot, asked = robots.load("hydrolek_7w"), {"resolution": 0.2, "orientations": 3, "audit": 0}
    with ThreadPoolExecutor(2) as pool:
        pooled = ik.reachability(robot, BOX, executor=pool, **asked)
    assert (pooled.states == ik.reachability(robot, BOX, threads=1, **asked).states).all()


@pytest.mark.parametrize("name", ["cartesian_pp", "scara", "palletizer"])
def test_slides_mimic_joints_and_few_joints(name):
    robot = robots.load(name)
    found = ik.reachability(robot, resolution=robot.reach / 6, audit=0)
    T, yes = judged(robot, found)
    assert yes.any() and (found.manipulability[yes] >= 0.0).all() and (found.manipulability > 0.0).any()
    assert np.isfinite(found.margin).all() and found.margin.max() <= 1.0


def test_obstacles_and_priority_count():
    arm = robots.load("planar_2r")
    around = ik.CollisionModel(arm).add_box((0.3, 0.5, 0.3), (1.2, 0.6, 0.0))
    asked = {"region": ((0, -1.2, 0), (1.8, 1.2, 0)), "resolution": 0.2, "audit": 5}
    free, kept = ik.reachability(arm, **asked), ik.reachability(arm, avoid_collisions=around, **asked)
    assert 0 < kept.reached.sum() < free.reached.sum() and (free.reached | ~kept.reached).all()
    assert not any(around.collisions(q) for q in kept.q[kept.reached.ravel()]) and kept.audit.tried == 5
    robot = robots.load("hydrolek_7w")
    asked = {"region": BOX, "resolution": 0.25, "audit": 0}
    any_turn = ik.reachability(robot, **asked).reached
    first = ik.reachability(robot, orientations=TURNS[:1], priority="position", **asked).reached
    # At the very border the search for the nearest orientation may need more attempts than the map makes.
    assert (any_turn | ~first).all() and any_turn.sum() - 2 <= first.sum()
    assert first.sum() > 2 * ik.reachability(robot, orientations=TURNS[:1], **asked).reached.sum()


def test_narrower_limits_have_a_smaller_region_whatever_is_asked_for():
    arm, asked = robots.load("planar_2r"), {"resolution": 0.3, "limits": {"joint_1": (0.0, 0.5)}, "audit": 0}
    wide = ik.reachability(arm, resolution=0.3, audit=0)
    found = [ik.reachability(arm, orientations=one, **asked) for one in ("any", 2)]
    assert found[0].grid.shape == found[1].grid.shape and found[0].grid.cells < wide.grid.cells


def test_a_page_cuts_the_cells_with_its_slider(dense):
    robot, found = dense
    scene = ik.view(robot, found)
    planes = [name for name in scene.names if name.startswith("cells/")]
    drawn = sum(len(scene.window.objects[name]) for name in planes)
    told = scene.window.about["animation"]
    assert len(planes) == told["count"] == len(told["labels"]) > 3 and drawn > 0
    scene.update(robot.home)
    assert not any(name.startswith("cells/") for name in scene.names) and scene.window.about["animation"] is None
    with pytest.raises(InvalidOption, match="planar_2r"):
        ik.view(robots.load("planar_2r"), found)


def test_mistakes_are_named():
    robot = robots.load("hydrolek_7w")
    for words, arguments in (
        ("resolution", {"resolution": -0.1}),
        ("resolution", {"resolution": np.nan}),
        (r"of 0\.\d+ m fits", {"resolution": 1e-4}),
        ("lower first", {"region": (BOX[1], BOX[0])}),
        ("two corners", {"region": (1.0, 2.0)}),
        ("orthonormal", {"orientations": 2.0 * TURNS}),
        ("'any'", {"orientations": "all"}),
        ("at least 1", {"orientations": 0}),
        ("at least 1", {"orientations": robot.fk(robot.home)}),
        ("rotations", {"orientations": [[1.0, 2.0], [3.0]]}),
        ("full", {"audit": -1}),
        ("restarts", {"restarts": 3}),
        ("chooses the solver", {"solver": "dls"}),
        ("omit closest", {"closest": True}),
        ("omit follow", {"follow": True}),
        ("position is not kept", {"orientations": 2, "priority": "orientation"}),
        ("position is not kept", {"orientations": 2, "priority": ["orientation"]}),
        ("position is not kept", {"orientations": 2, "priority": [("tool", "orientation"), "position"]}),
        ("two corners", {"region": [[0.0, 0.0, 0.0]] * 3}),
        ("two corners", {"region": ((-1e308, 0.0, 0.0), (1e308, 1.0, 1.0))}),  # its width is not finite
        ("a resolution of 1e-200 m makes .* cells; make it coarser, or the region smaller", {"resolution": 1e-200}),
        ("m makes inf cells", {"resolution": 1e-320}),
        ("loose poses", {"region": np.tile(np.eye(4), (3, 1, 1)), "resolution": 0.1}),
        ("npz", {"file": "map.csv"}),
        ("tolerance", {"tolerence": 1e-3}),
    ):
        with pytest.raises(InvalidOption, match=words):
            ik.reachability(robot, **arguments)


def test_the_command(run, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    asked = "reach hydrolek_7w --region 0.3 -0.4 -0.3 1.1 0.4 0.5 --resolution 0.2 --audit 10".split()
    code, out, err = run(*asked, "-o", "map.npz", "--plot", "map.png", "--html", "map.html")
    assert code == 0 and "reached" in out and "64 cells of 200 mm: 64 answers" in err
    assert ik.ReachabilityMap.load("map.npz").grid.shape == (4, 4, 4) and (tmp_path / "map.png").stat().st_size > 10_000
    assert (tmp_path / "map.html").stat().st_size > 100_000
    assert "number of tool axes" in refused("reach", "hydrolek_7w", "--orientations", "many")


def test_batches_may_leave_failures_where_the_search_ended():
    """The same answers but for what the descent afterwards reaches; also in another process."""
    robot = robots.load("hydrolek_7w")
    T = np.random.default_rng(2).uniform(-0.6, 1.2, (300, 3))
    whole = ik.solve_batch(robot, T, restarts=2)
    (bare, *more) = solve_parts(robot, T, restarts=2, finish=False, threads=1)
    assert not more and bare.plan.bare and pickle.loads(pickle.dumps(bare.plan)).bare and not whole.plan.bare
    assert (whole.success | ~bare.success).all() and 0 < bare.success.sum() < 300
    assert ((bare.status == ik.Status.UNREACHABLE) == (whole.status == ik.Status.UNREACHABLE)).all()
    lost = ~whole.success
    assert (bare.position_error[lost] >= whole.position_error[lost] - 1e-9).all()
    assert (bare.q[lost] != whole.q[lost]).any()
