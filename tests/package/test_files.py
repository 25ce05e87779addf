"""Write errors, hostile names, closed streams: no output is lost, no control character reaches a terminal, no bug report."""

import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest
from robots import branches, joint

from ik_toolkit import files
from ik_toolkit.cli import main
from ik_toolkit.errors import CONTROLS, InvalidOption, clean
from ik_toolkit.files import WholeFile, as_output, whole_file, write_whole
from ik_toolkit.robot.library import find

ARM = "planar_2r"
OLD = "what was here before\n"


@pytest.fixture
def out(tmp_path):
    """A file that was there before."""
    path = tmp_path / "out.csv"
    path.write_text(OLD)
    return path


def targets(folder, count=20):
    """A file of so many targets."""
    np.savez(folder / "in.npz", targets=np.tile([1.0, 1.0, 0.0], (count, 1)))
    return str(folder / "in.npz")


def check_partial(out, said):
    """The old file is as it was, and whole rows lie in another beside it."""
    assert out.read_text() == OLD
    rows = out.with_name("out.csv.partial").read_text().splitlines()
    assert f"the first {len(rows) - 1} solutions" in said and {row.count(",") for row in rows} == {rows[0].count(",")}


# ------------------------------------------------------------------------------------------------------------ the writer
def fail_at(monkeypatch, call, error):
    """Let one system call of the writer fail."""

    def fail(*_, **__):
        raise OSError(error, os.strerror(error))

    if call == "write":

        class Stream(io.BytesIO):
            def fileno(self):
                return 0

            write = fail

        class Full(WholeFile):
            def __init__(self, path):
                super().__init__(path)
                self.stream.close()
                self.stream = Stream()

        monkeypatch.setattr(files, "WholeFile", Full)
    else:
        monkeypatch.setattr(os, call, fail)


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO, errno.EDQUOT])
@pytest.mark.parametrize("call", ["write", "fsync", "replace"])
def test_a_fault_at_any_step_leaves_the_file_that_was_there(tmp_path, monkeypatch, out, call, error):
    fail_at(monkeypatch, call, error)
    with pytest.raises(OSError) as raised:
        write_whole(out, "new")
    assert raised.value.errno == error and raised.value.filename == str(out)
    assert out.read_text() == OLD and os.listdir(tmp_path) == ["out.csv"]


@pytest.mark.parametrize("mistake", [KeyboardInterrupt, InvalidOption, SystemExit])
def test_what_raises_inside_leaves_the_file_that_was_there(tmp_path, out, mistake):
    with pytest.raises(mistake), whole_file(out) as stream:
        stream.write(b"half")
        raise mistake("no")
    assert out.read_text() == OLD and os.listdir(tmp_path) == ["out.csv"]


def test_links_modes_and_devices_are_respected(tmp_path):
    path, link, hard = tmp_path / "file", tmp_path / "link", tmp_path / "hard"
    path.write_text(OLD)
    path.chmod(0o640)
    link.symlink_to(path)
    os.link(path, hard)
    write_whole(link, "new")
    assert link.is_symlink() and path.read_text() == "new" and path.stat().st_mode & 0o777 == 0o640
    assert hard.read_text() == OLD
    write_whole("/dev/null", "nothing")
    assert not os.path.isfile("/dev/null")
    for suffixes in ((".json",), (".urdf", ".xml"), (".html", ".htm")):  # a device has no suffix to choose a format by
        assert as_output("/dev/null", "it", *suffixes).name == "null"
    with pytest.raises(InvalidOption, match=r"it is written as \.csv or \.json, not 'null'"):
        as_output("/dev/null", "it", ".csv", ".json")


def test_a_place_that_cannot_be_written_is_named_as_it_was_given(tmp_path, capsys):
    """Not the temporary file beside it. (A folder without write permission stops nobody who is root.)"""
    for place in ("/proc/out.json", str(tmp_path / ("x" * 250 + ".json"))):  # with .part the name is too long
        assert main(["solve", ARM, "--xyz", "1", "1", "0", "-o", place]) == 2
        said = capsys.readouterr().err
        assert place in said.replace("\n", "") and ".part" not in said


def test_what_is_kept_ends_at_the_last_mark(tmp_path, out):
    file = WholeFile(out)
    file.write("a,b\n1,2\n")
    file.stream.write(b"3,")  # torn
    kept = file.keep(".partial")
    assert kept == tmp_path / "out.csv.partial" and kept.read_text() == "a,b\n1,2\n" and out.read_text() == OLD
    assert WholeFile(out).keep(".other") is None
    assert sorted(os.listdir(tmp_path)) == ["out.csv", "out.csv.partial"]


# ------------------------------------------------------------------------------------------------- outputs of the commands
def writers(folder):
    """Command lines that write a file, and the file."""
    many = ["solve", ARM, "--targets", targets(folder), "-o"]
    shutil.copy(find(ARM).dh_file, folder / "dh.toml")
    shape = ["--duration", "0.2", "--position-only", "--radius", "0.1"]
    return {
        "solve.json": ["solve", ARM, "--xyz", "1", "1", "0", "-o"],
        "batch.csv": many,
        "batch.npz": many,
        "dh.urdf": ["dh", str(folder / "dh.toml"), "-o"],
        "track.csv": ["track", ARM, *shape, "-o"],
        "track.npz": ["track", ARM, *shape, "-o"],
        "targets.csv": ["workspace", ARM, "-n", "50", "-s", "planar-2r", "--csv"],
        "workspace.json": ["workspace", ARM, "-n", "50", "-s", "planar-2r", "-o"],
        "bench.json": ["bench", ARM, "--solvers", "planar-2r", "-n", "20", "-o"],
    }


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO])
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_no_command_loses_the_file_that_was_there(tmp_path, monkeypatch, capsys, call, error):
    lines = writers(tmp_path)
    there = {*os.listdir(tmp_path), *lines}
    for name, words in lines.items():
        (tmp_path / name).write_text(OLD)
        with monkeypatch.context() as patched:
            fail_at(patched, call, error)
            code = main([*words, str(tmp_path / name)])
        said = capsys.readouterr().err
        assert code == 2 and os.strerror(error) in said, (name, code, said)
        assert (tmp_path / name).read_text() == OLD, name
        kept = {path for path in os.listdir(tmp_path) if path not in there}
        assert all(path.endswith(".partial") for path in kept), kept


def test_the_commands_write_what_they_say(tmp_path, capsys):
    for name, words in writers(tmp_path).items():
        (tmp_path / name).write_text(OLD)
        assert main([*words, str(tmp_path / name)]) in (0, 1), capsys.readouterr().err
        assert OLD.encode() not in (tmp_path / name).read_bytes(), name
    assert not [name for name in os.listdir(tmp_path) if name.endswith((".part", ".partial"))]


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_a_target_that_is_nan_does_not_cost_the_old_file(tmp_path, capsys, suffix):
    out = tmp_path / f"out{suffix}"
    out.write_text(OLD)
    targets = np.tile([1.0, 1.0, 0.0], (20, 1))
    targets[7] = np.nan
    np.savez(tmp_path / "in.npz", targets=targets)
    assert main(["solve", ARM, "--targets", str(tmp_path / "in.npz"), "-o", str(out)]) == 2
    assert "7" in capsys.readouterr().err and out.read_text() == OLD


def test_a_bad_line_late_in_a_file_keeps_the_solutions_before_it_apart(tmp_path, capsys, out):
    (tmp_path / "in.csv").write_text("x,y,z\n" + "1,1,0\n" * 40000 + "1,nan,0\n")
    assert main(["solve", ARM, "--targets", str(tmp_path / "in.csv"), "-o", str(out)]) == 2
    said = capsys.readouterr().err
    assert "line 40002" in said and f"{out}.partial" in said
    check_partial(out, said)


def test_what_is_read_is_not_overwritten_under_another_name(tmp_path, capsys):
    arm, table, path = tmp_path / "arm.urdf", tmp_path / "dh.toml", tmp_path / "way.csv"
    arm.write_text(find(ARM).source.read_text())
    batch = ["solve", ARM, "--targets", targets(tmp_path)]
    os.link(tmp_path / "in.npz", tmp_path / "hard.npz")
    (tmp_path / "soft.npz").symlink_to("in.npz")
    table.write_text("no table")
    os.link(table, tmp_path / "table.toml")
    path.write_text("t,x,y,z\n0,1,1,0\n1,1,1.1,0\n")
    os.link(arm, tmp_path / "hard.json")
    os.link(table, tmp_path / "table.urdf")
    (tmp_path / "soft.json").symlink_to("arm.urdf")
    solve = ["solve", str(arm), "--xyz", "1", "1", "0"]
    for words in (
        *([*solve, "-o", str(tmp_path / name)] for name in ("hard.json", "soft.json")),
        ["solve", "-o", f"{tmp_path}/./hard.json", *solve[1:]],
        *([*batch, "-o", str(tmp_path / name)] for name in ("hard.npz", "soft.npz")),
        ["workspace", str(arm), "-n", "3", "-o", str(tmp_path / "soft.json")],
        ["bench", ARM, str(arm), "-n", "3", "--solvers", "dls", "-o", str(tmp_path / "hard.json")],
        ["convert", str(arm), "-o", str(arm)],
        ["dh", str(table), "-o", str(tmp_path / "table.urdf")],
        ["track", str(arm), "--path", str(path), "-o", str(path)],
        ["tune", str(arm), "pid", "--from", str(table), "-o", str(tmp_path / "table.toml")],
    ):
        before = {file: file.read_bytes() for file in tmp_path.iterdir()}
        assert main(words) == 2, words
        assert "would overwrite" in capsys.readouterr().err
        assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before, words
    twice = ["-o", str(tmp_path / "a.html"), "--html", str(tmp_path / "." / "a.html")]
    assert main([*solve, *twice]) == 2 and "one file" in capsys.readouterr().err


def test_a_full_disk_names_the_file_of_arrays(tmp_path, capsys, monkeypatch):
    def fail(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # as numpy does, which writes to a stream

    words, out = ["solve", ARM, "--targets", targets(tmp_path, 3), "-o"], str(tmp_path / "out.npz")
    monkeypatch.setattr(np, "savez", fail)
    assert main([*words, out]) == 2
    assert out in capsys.readouterr().err and os.listdir(tmp_path) == ["in.npz"]


def test_sigterm_keeps_what_is_finished_apart(tmp_path, out):
    words = ["solve", ARM, "--targets", targets(tmp_path, 1_000_000), "-s", "planar-2r", "-o", str(out)]
    with subprocess.Popen([sys.executable, "-m", "ik_toolkit", *words], stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and not any(p.stat().st_size > 0 for p in tmp_path.glob("out.csv.*.part")):
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 143 and "ik: terminated" in said, said
    check_partial(out, said)
    assert f" solutions are in {out}.partial" in said
    assert sorted(os.listdir(tmp_path)) == ["in.npz", "out.csv", "out.csv.partial"]


def test_a_real_limit_on_the_size_of_files(tmp_path, out):
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (10**6, 10**6))\n"
        "from ik_toolkit.cli import main; sys.exit(main())"
    )
    words = ["solve", ARM, "--targets", targets(tmp_path, 20_000), "-s", "planar-2r", "-o", str(out)]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and "too large" in done.stderr and str(out) in done.stderr, done.stderr
    check_partial(out, done.stderr)


# ------------------------------------------------------------------------------------------------------- hostile targets
def npz(**arrays):
    data = io.BytesIO()
    np.savez(data, **arrays)
    return data.getvalue()


def changed(data, at, value):
    """Set bytes in the local and in the central head of the first member."""
    data = bytearray(data)
    local, central = data.index(b"PK\x03\x04"), data.index(b"PK\x01\x02")
    for start, offset in ((local, at), (central, at + 2)):
        data[start + offset : start + offset + len(value)] = value
    return bytes(data)


def zeros(rows, megabytes=0, packing=zipfile.ZIP_STORED):
    """An archive that promises so many rows of zeros, and holds so much of them."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", packing) as archive, archive.open("targets.npy", "w") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (rows, 3)})
        for _ in range(megabytes):
            stream.write(bytes(1 << 20))
    return data.getvalue()


GOOD = npz(targets=np.ones((4, 3)))
HOSTILE = {
    "scalar.npz": npz(targets=np.float64(1.0)),
    "flat.npz": npz(targets=np.ones(3)),
    "words.npz": npz(targets=np.array([["a", "b", "c"]])),
    "dates.npz": npz(targets=np.zeros((2, 3), "datetime64[s]")),
    "complex.npz": npz(targets=np.ones((2, 3), complex)),
    "objects.npz": npz(targets=np.array([{"x": 1}], dtype=object)),
    "xyz.npz": npz(xyz=np.float64(1.0)),
    "named.npz": npz(**{"\x1b]0;owned\x07\x9b31m\u202e": np.ones(3)}),
    "encrypted.npz": changed(GOOD, 6, b"\x01\x00"),
    "method.npz": changed(GOOD, 8, b"\x63\x00"),
    "deflated.npz": changed(GOOD, 8, b"\x08\x00"),
    "lzma.npz": changed(GOOD, 8, b"\x0e\x00"),
    "cut.npz": GOOD[:-40],
    "torn.npz": GOOD[:200] + bytes(64) + GOOD[264:],
    "promising.npz": zeros(1 << 50),
    "quote.csv": b'x,y,z\n1,"1,0\n1,1,0\n',
    "quotes.csv": b'x,y,z\n1,"1""\n2",0\n',
    "head.csv": b'"x,y,z\n1,1,0\n',
    "huge.csv": b"x,y,z\n1," + b"9" * 300_000 + b"x,0\n",
    "wide.csv": b"a" * 300_000 + b"\n1,1,0\n",
    "escape.csv": b"\x1b]0;owned\x07,\xc2\x9b31m,\xe2\x80\xae\n1,1,0\n",
    "cell.csv": b"x,y,z\n1,\x1b[2J\xe2\x80\xae,0\n",
    "latin.csv": b"x,y,z\n1,1,0\n1,\xff,0\n",
    "nul.csv": b"x,y,z\n1,\x00,0\n",
    "utf16.csv": "x,y,z\n1,1,0\n".encode("utf-16"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_of_targets_is_refused_in_a_short_sentence(tmp_path, capsys, out, name):
    path = tmp_path / name
    path.write_bytes(HOSTILE[name])
    assert main(["solve", ARM, "--targets", str(path), "-o", str(out)]) == 2
    said = capsys.readouterr().err
    assert name in said or "targets" in said
    assert len(said) < 1000 and not CONTROLS.search(said), said
    assert out.read_text() == OLD


@pytest.mark.slow  # writes and packs 1.5 GB
def test_an_archive_that_grows_without_measure_is_refused(tmp_path, capsys):
    (tmp_path / "bomb.npz").write_bytes(zeros(1 << 26, 1536, zipfile.ZIP_DEFLATED))
    assert main(["solve", ARM, "--targets", str(tmp_path / "bomb.npz"), "-o", str(tmp_path / "out.csv")]) == 2
    assert "unpacks to 1,610.6 MB" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------------------------ the terminal
EVIL = "a\x1b]0;owned\x07\x9b31m\u202e\u2066\x7f\u2028z"


def test_clean_leaves_text_alone_and_escapes_controls():
    assert clean("Gelenk 1, 腕, é, a\tb\n") == "Gelenk 1, 腕, é, a\tb\n"
    said = clean(EVIL)
    assert not CONTROLS.search(said) and said.startswith("a\\x1b]0;owned\\x07\\x9b31m\\u202e") and said.endswith("z")
    assert str(InvalidOption(EVIL)) == said


def test_names_from_a_file_do_not_act_on_the_terminal(tmp_path, capsys, monkeypatch):
    evil = "\u009b31m\u202ejoint\u2066"  # XML holds no ESC, but these
    path = tmp_path / f"{evil}.urdf"
    path.write_text(branches(joint(evil, "revolute", "o", f"{evil}tip", xyz="1 0 0"), name=evil), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for words in (
        ["info"], ["fk"], ["check"], ["fk", "--q", "9"], ["fk", "--q", "1", "2"], ["solve", "--xyz", "1", "0", "0"],
        ["info", "--tip", evil], ["info", "--lock", f"{evil}=1"], ["track", "--duration", "0.05", "--position-only"],
    ):  # fmt: skip
        for extra in ([], ["--json"]):
            main([words[0], str(path), *words[1:], *extra])
            said = capsys.readouterr()
            assert not CONTROLS.search(said.out) and not CONTROLS.search(said.err), (words, said)
    assert main(["info", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["joints"][0]["name"] == evil


def test_closed_and_full_streams_are_no_bug():
    for stream, code, said in ((">&-", 0, ""), ("2>&- <&-", 0, ""), ("> /dev/full", 2, "No space left")):
        line = f"{sys.executable} -m ik_toolkit robots {stream}"
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=60)
        assert done.returncode == code and said in done.stderr, (stream, done)
        assert "bug" not in done.stderr and "Traceback" not in done.stderr, (stream, done)


def test_no_goals_is_a_mistake_with_a_name(capsys):
    assert main(["workspace", ARM, "-n", "0"]) == 2
    assert "--targets" in capsys.readouterr().err
