"""A command line run in this process."""

import pytest

from ik_toolkit import cli


@pytest.fixture
def run(capsys, monkeypatch):
    """Run a command line; returns exit code, stdout, stderr."""
    monkeypatch.setenv("COLUMNS", "100")

    def call(*arguments):
        code = cli.main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call
