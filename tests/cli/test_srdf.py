"""SRDF in a shell: `--srdf`, `--group`, named configurations, `ik check --self-collision`; and `--margin`."""

import json

from srdf_arm import ARM, SAMPLED, SRDF


def test_in_a_shell(run, tmp_path):
    (tmp_path / "arm.urdf").write_text(SAMPLED)
    words = ["check", tmp_path / "arm.urdf", "--self-collision", "--samples", 100]
    code, out, err = run(*words, "-o", tmp_path / "arm.srdf")
    assert code == 0 and "4 adjacent, 1 always" in out and "wrote" in err
    told = json.loads(run(*words, "--json")[1])["self_collision"]
    assert told["counts"]["Adjacent"] == 4 and told["samples"] == 100
    info = json.loads(run("info", tmp_path / "arm.urdf", "--json")[1])
    assert info["srdf"]["may_touch"] == sum(told["counts"].values())
    assert run("check", tmp_path / "arm.urdf", "-o", tmp_path / "x.srdf")[0] == 2


def test_names_in_a_shell(run, tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "other.txt").write_text(SRDF)
    given = [tmp_path / "arm.urdf", "--srdf", tmp_path / "other.txt"]
    code, out, _ = run("info", *given)
    assert (
        code == 0
        and "upper (l1 -> l4)" in out
        and "hand (on l5)" in out
        and "  1 pair of links " in out
        and "home, up" in out.replace("up, home", "home, up")
    )
    found = json.loads(run("fk", *given, "--q", "up", "--json")[1])
    assert found["q"][:3] == [0.1, 0.2, 0.3]
    code, _, err = run("fk", *given, "--q", "hme")
    assert code == 2 and "Did you mean 'home'" in err
    assert json.loads(run("fk", *given, "--group", "upper", "--json")[1])["tip"] == "l4"
    assert run("fk", *given, "--group", "upper", "--tip", "l2")[0] == 2


def test_a_margin(run, tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM)
    words = ["solve", tmp_path / "arm.urdf", "--xyz", 0, 0, 1.5, "--q0", "home", "--obstacle", "sphere:0.1,0,0.9,0.03"]
    assert json.loads(run(*words, "--json")[1])["clearance"] < 0.05
    near = json.loads(run(*words, "--margin", 0.05, "--json")[1])
    assert near["status"] == "COLLISION" and near["collision"][1] == "sphere_1"
    assert run(*words, "--margin", -1)[0] == 2


def test_check_lists_what_an_srdf_beside_the_robot_says_wrongly(run, tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM)
    (tmp_path / "arm.srdf").write_text('<robot name="arm"><group name="both"><group name="nobody"/></group></robot>')
    code, out, err = run("check", tmp_path / "arm.urdf", "--json")
    said = {one["element"]: one["problem"] for one in json.loads(out)["findings"]}
    assert code == 0 and not err and "'nobody', which does not exist" in said["SRDF 'arm.srdf'"]
