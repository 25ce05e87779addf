"""The files of compiled kernels: damaged, on a full disk, of other sources, or written by who knows whom."""

import errno
import importlib.util
import logging
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from numba import config
from numba.core.serialize import dumps

from ik_toolkit.cli import main
from ik_toolkit.cli.options import RobotOptions
from ik_toolkit.compile import cache

pytestmark = pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
SOURCE = """
from ik_toolkit.compile.jit import cached

@cached
def double(x):
    return 2.0 * x
"""


@pytest.fixture
def double(tmp_path, caplog, monkeypatch):
    """A function that calls a freshly imported `double`, compiled or loaded, and gives what was logged meanwhile."""
    monkeypatch.setattr(config, "CACHE_DIR", "")  # what NUMBA_CACHE_DIR sets
    # of a compilation that takes longer than a second, on a busy machine
    monkeypatch.setitem(cache.saying, "said", True)
    path = tmp_path / "small_kernel.py"
    path.write_text(SOURCE)
    spec = importlib.util.spec_from_file_location("small_kernel", path)

    def use():
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        assert module.double(21.0) == 42.0

    def call():
        caplog.clear()
        with caplog.at_level(logging.INFO, "ik_toolkit"):
            use()
        return [(record.name, record.levelname) for record in caplog.records]

    cache.not_kept.cache_clear()
    call.use = use
    call.folder = tmp_path / "__pycache__"
    call.files = lambda: sorted(call.folder.glob("*.nbc"))
    return call


MADE, DAMAGED, UNKEPT = ("ik_toolkit.compile", "INFO"), ("ik_toolkit.cache", "WARNING"), ("ik_toolkit.cache", "WARNING")


def test_compiling_is_said_when_it_happens_and_only_then(double):
    assert double() == [MADE]
    assert double() == []
    assert len(double.files()) == 1


def cuts(data):
    """Every kind of damage: cut anywhere, one bit flipped anywhere, something else altogether."""
    rng = np.random.default_rng(7)
    yield from (data[:k] for k in (0, 1, 19, 30, 52, 60, len(data) // 2, len(data) - 1))
    for k in [0, 20, 51, 52, 53, *rng.integers(0, len(data), 6)]:
        yield data[:k] + bytes([data[k] ^ 1 << rng.integers(8)]) + data[k + 1 :]
    yield from (b"\0" * len(data), data + b"\0", pickle.dumps(KeyboardInterrupt()), cache.HEAD)


def test_a_damaged_file_is_noticed_and_made_anew(double):
    double()
    (path,) = double.files()
    whole = path.read_bytes()
    for damaged in cuts(whole):
        path.write_bytes(damaged)
        assert double() == [DAMAGED, MADE]
        assert double() == []


def test_a_file_of_another_key_is_not_taken(double):
    """Two kernels may not be mixed up, whatever a file is called."""
    double()
    (path,) = double.files()
    _, payload = pickle.loads(cache.content(path))
    cache.write_body(path, dumps((("another", "key"), payload)))
    assert double() == [MADE]


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO, errno.EROFS, errno.EACCES])
@pytest.mark.parametrize("call", ["write_bytes", "replace"])
def test_a_disk_that_takes_nothing_is_said_once(double, monkeypatch, call, error):
    def fail(*_, **__):
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(*((Path, call, fail) if call == "write_bytes" else (os, call, fail)))
    assert double() == [MADE, UNKEPT]
    assert double() == [MADE]
    assert list(double.folder.glob("ik-*")) == []


def test_files_of_other_sources_are_removed(double):
    double()
    (path,) = double.files()
    old = path.with_name(path.name.replace(cache.stamp_of(*cache.STAMPED)[:12], "0" * 12))
    path.rename(old)
    cache._remove_old.cache_clear()
    assert double() == [MADE] and double.files() == [path]


OTHERS = [0o777, 0o757, 0o775, 0o733]  # modes of a folder into which others may write; to root, its group is anybody's


@pytest.mark.parametrize("mode", OTHERS)
def test_kernels_in_a_folder_that_others_may_write_are_neither_loaded_nor_kept(double, caplog, monkeypatch, mode):
    monkeypatch.setattr(cache, "_is_own_group", lambda group: False)
    double()
    (path,) = double.files()
    made = path.stat().st_mtime_ns
    double.folder.chmod(mode)
    assert double() == [UNKEPT, MADE] and "may write to it" in caplog.text and str(double.folder) in caplog.text
    assert double() == [MADE] and path.stat().st_mtime_ns == made  # the warning comes once
    double.folder.chmod(0o755)
    assert double() == []


@pytest.mark.parametrize("mode", [0o666, 0o664, 0o646])
def test_a_kernel_that_others_may_write_is_made_anew(double, caplog, monkeypatch, mode):
    monkeypatch.setattr(cache, "_is_own_group", lambda group: False)
    double()
    (path,) = double.files()
    path.chmod(mode)
    assert double() == [DAMAGED, MADE] and "may write to it" in caplog.text
    assert path.stat().st_mode & 0o777 == 0o644 and double() == []


def test_who_may_have_written_a_kernel(double, monkeypatch):
    """The user and root; others not, whatever the mode; in a folder such as /tmp they can replace no file but their own."""
    double()
    (path,) = double.files()
    double.folder.chmod(0o1777)
    assert double() == []
    if os.geteuid() != 0:
        return
    os.chown(path, 1234, -1)
    assert double() == [DAMAGED, MADE]
    os.chown(double.folder, 1234, -1)
    cache.not_kept.cache_clear()
    assert double() == [UNKEPT, MADE]


def test_files_are_no_more_open_than_they_have_to_be(double):
    before = os.umask(0)
    try:
        double.folder.mkdir(mode=0o755)
        double()
    finally:
        os.umask(before)
    (path,) = double.files()
    assert path.stat().st_mode & 0o777 == 0o644


def test_the_command_says_that_it_compiles_only_when_it_does(double, capsys, monkeypatch):
    """With a small kernel for that of a solver."""
    load = RobotOptions.load
    monkeypatch.setattr(RobotOptions, "load", lambda *words: double.use() or load(*words))
    for said in ("compiling the solver (first use on this machine, up to half a minute) ...\n", ""):
        assert main(["fk", "planar_2r", "--q", "0,0"]) == 0
        assert capsys.readouterr().err == said
    assert len(double.files()) == 1
