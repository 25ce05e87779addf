"""Where files go: a folder that is missing, a file in its place, a pipe."""

import os

import pytest

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.files import write_whole
from ik_toolkit.papers.report import Report
from ik_toolkit.solvers.presets import write_preset


def every_call_that_writes():
    """Each public call that writes a file, with the suffix of its files."""
    robot = ik.Robot.load("hydrolek_7w")
    path = ik.solve_path(robot, [robot.fk(robot.home), robot.fk(robot.home + 0.02)])
    motion = path.retime(acceleration=1.0)
    run = ik.track(robot, ik.line(robot.fk(robot.home), robot.fk(robot.home + 0.01), duration=0.1), dt=0.02)
    report = Report("a report", "of nothing")
    return {
        "PathResult.save": (path.save, ".csv .json .npz"),
        "Trajectory.to_csv": (motion.to_csv, ".csv"),
        "Trajectory.to_json": (motion.to_json, ".json"),
        "TrackResult.save": (run.save, ".csv .json .npz"),
        "plot": (lambda file: ik.plot(path, file=file), ".png"),
        "Scene.save": (ik.view(robot).save, ".html"),
        "Scene.page": (ik.view(robot).page, ".html"),
        "write_preset": (lambda file: write_preset(file, "lm", {}, {}, {}), ".toml"),
        "Report.write_partial": (lambda file: report.write_partial(file.parent), ".md"),
    }


def test_every_call_names_the_folder_that_is_missing(tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "file").write_text("old")
    for name, (call, suffixes) in every_call_that_writes().items():
        for suffix in suffixes.split():
            file = tmp_path / "resluts" / "deeper" / f"a{suffix}"
            with pytest.raises(InvalidOption) as raised:
                call(file)
            said = f"there is no folder '{tmp_path / 'resluts'}'. Did you mean '{tmp_path / 'results'}'?"
            assert said in str(raised.value), name
            with pytest.raises(InvalidOption, match=r"file' is a file, not a folder"):
                call(tmp_path / "file" / f"a{suffix}")
            (tmp_path / "results" / f"a{suffix}").mkdir(exist_ok=True)
    assert sorted(os.listdir(tmp_path)) == ["file", "results"] and (tmp_path / "file").read_text() == "old"
    with pytest.raises(InvalidOption, match="is a folder, not a file"):
        write_whole(tmp_path / "results" / "a.csv", "")
    with pytest.raises(InvalidOption, match="cannot make the folder"):
        Report("a report", "of nothing").write(tmp_path / "file" / "below", pictures=False)


@pytest.mark.skipif(os.geteuid() == 0, reason="the system lets root write everywhere")
def test_a_folder_without_permission_is_named(tmp_path):
    tmp_path.chmod(0o555)
    with pytest.raises(InvalidOption, match="no permission to write"):
        write_whole(tmp_path / "a.json", "")


def test_a_pipe_is_written_to():
    out, into = os.pipe()
    write_whole(f"/dev/fd/{into}", "all of it")
    os.close(into)
    assert os.read(out, 100) == b"all of it"
    os.close(out)
