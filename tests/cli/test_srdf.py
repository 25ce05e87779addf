"""SRDF in a shell: `--srdf`, `--group`, named configurations, `ik check --self-collision`; and `--margin`."""

import json

from srdf_arm import ARM, SAMPLED, SRDF


def test_in_a_shell(told, run, tmp_path):
    (tmp_path / "arm.urdf").write_text(SAMPLED)
    words = ["check", tmp_path / "arm.urdf", "--self-collision", "--samples", 100]
    code, out, err = run(*words, "-o", tmp_path / "arm.srdf")
    assert code == 0 and "4 adjacent, 1 always" in out and "wrote" in err
    found = told(*words)["self_collision"]
    assert found["counts"]["Adjacent"] == 4 and found["samples"] == 100
    assert told("info", tmp_path / "arm.urdf")["srdf"]["may_touch"] == sum(found["counts"].values())
    assert run("check", tmp_path / "arm.urdf", "-o", tmp_path / "x.srdf")[0] == 2


def test_names_in_a_shell(told, run, tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "other.txt").write_text(SRDF)
    given = [tmp_path / "arm.urdf", "--srdf", tmp_path / "other.txt"]
    code, out, _ = run("info", *given)
    assert code == 0 and all(x in out for x in ("upper (l1 -> l4)", "hand (on l5)", "  1 pair of links "))
    assert "home, up" in out.replace("up, home", "home, up")
    assert told("fk", *given, "--q", "up")["q"][:3] == [0.1, 0.2, 0.3]
    code, _, err = run("fk", *given, "--q", "hme")
    assert code == 2 and "Did you mean 'home'" in err
    assert told("fk", *given, "--group", "upper")["tip"] == "l4"
    assert run("fk", *given, "--group", "upper", "--tip", "l2")[0] == 2


def test_a_margin(told, run, tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM)
    words = ["solve", tmp_path / "arm.urdf", "--xyz", 0, 0, 1.5, "--q0", "home", "--obstacle", "sphere:0.1,0,0.9,0.03"]
    assert told(*words)["clearance"] < 0.05
    near = told(*words, "--margin", 0.05, code=1)
    assert near["status"] == "COLLISION" and near["collision"][1] == "sphere_1"
    assert run(*words, "--margin", -1)[0] == 2


def test_check_lists_what_an_srdf_beside_the_robot_says_wrongly(run, tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "arm.srdf").write_text('<robot name="arm"><group name="both"><group name="nobody"/></group></robot>')
    code, out, err = run("check", tmp_path / "arm.urdf", "--json")
    said = {one["element"]: one["problem"] for one in json.loads(out)["findings"]}
    assert code == 0 and not err and "'nobody', which does not exist" in said["SRDF 'arm.srdf'"]
