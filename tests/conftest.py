"""Shared test settings: generated cases are the same in every run, and no test depends on its run time."""

import gc
import json
import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

# Where `ik` is installed a shell finds it, also if the tests are run by another shell.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
os.environ.setdefault("IK_TOOLKIT_WAIT", "1")  # `ik` compiles and waits: no test depends on what is on disk
# The matrices of the tests are small: threads of numpy's library wait for each other, and took three times the processor time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

# Tests that need the same large kernels, or kernels with large parts in common, run in one process: two at once would compile
# them twice, and a process compiles a part once. Others go by file, later, when what they need is on disk: a file that needs
# kernels of two groups belongs to none.
TOGETHER = {
    "tests/servo/": "tracker",
    "tests/cli/test_track.py": "tracker",
    "tests/papers/test_patko_2019.py": "tracker",
    "tests/kernel/test_constrain.py": "tracker",
    "tests/kernel/test_damped_step.py": "tracker",
    "tests/kernel/test_qp.py": "tracker",
    "tests/paths/": "paths",
    "tests/cli/test_path.py": "paths",
    "tests/contract/": "search",
    "tests/papers/test_reports.py": "search",
    "tests/solvers/test_others.py": "search",
    "tests/solvers/test_solve.py": "search",
    "tests/solvers/test_tree_preferences.py": "search",
    "tests/package/test_ratchets.py": "sources",
    "tests/package/test_structure.py": "sources",
    # Few tests, but long ones: groups are handed out by their number of tests, and each of these alone would come last.
    "tests/cli/test_first_use.py": "processes",
    "tests/kernel/test_cache.py": "processes",
    "tests/kernel/test_uncompiled.py": "processes",
    "tests/package/test_processes.py": "processes",
    "tests/solvers/test_cluster.py": "processes",
}


def pytest_configure(config):
    """Let every second process read the folders from the last: what one has rewritten for pytest the other finds on disk."""
    number = os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")
    if int(number) % 2 and config.args == config.getini("testpaths"):
        places = [path for path in Path(__file__).parent.iterdir() if path.is_dir() or path.name.startswith("test_")]
        config.args = sorted(map(str, places), reverse=True)


def pytest_collection_modifyitems(items):
    """Put tests in the order of their files, in every process the same."""
    items.sort(key=lambda item: item.nodeid.partition("::")[0])


def pytest_collection_finish():
    """Spare the garbage collector what was imported and stays."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Hand out the largest groups first, so that at the end no process waits long for the other."""
    from xdist.scheduler import LoadScopeScheduling

    class ByKernel(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            file = nodeid.partition("::")[0]
            return next((group for start, group in TOGETHER.items() if file.startswith(start)), file)

    return ByKernel(config, log)


@pytest.fixture
def run(capsys, monkeypatch):
    """Run a command line in this process; returns exit code, stdout, stderr."""
    from ik_toolkit.cli import main

    monkeypatch.setenv("COLUMNS", "100")

    def call(*arguments):
        code = main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.fixture
def told(run):
    """Run a command line with --json, which ends with the code that is expected; returns what it prints, read."""

    def call(*arguments, code=0):
        ended, out, err = run(*arguments, "--json")
        assert ended == code, err
        return json.loads(out)

    return call


@pytest.fixture
def refused(run):
    """Run a command line that is refused in one sentence, with exit code 2; returns the sentence."""

    def call(*arguments):
        code, out, err = run(*arguments)
        assert code == 2 and not out and err.startswith("ik: ") and err.count("\n") == 1, err
        return err

    return call
