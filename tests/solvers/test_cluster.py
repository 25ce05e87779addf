"""A batch on a Dask cluster of two worker processes: the same bytes as locally, even if a worker is lost."""

import gc
import warnings

import numpy as np
import pytest

pytest.importorskip("distributed", reason="the extra 'cluster' (dask.distributed) is not installed")
pytestmark = pytest.mark.filterwarnings("ignore")  # what Dask and its servers warn about is theirs

import ik_toolkit as ik  # noqa: E402
from ik_toolkit.cli import main  # noqa: E402


@pytest.fixture(scope="module")
def cluster():
    import dask
    from distributed import LocalCluster

    with (
        dask.config.set({"distributed.worker.memory.terminate": False}),
        LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
        ) as made,
    ):
        yield made
    # distributed leaves a socket to the collector now and then: not in the middle of another test
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


@pytest.fixture(scope="module")
def targets():
    robot = ik.Robot.load("hydrolek_7w")
    return robot, robot.chain.forward(robot.random_q(np.random.default_rng(0), 20000))[0]


def test_a_cluster_gives_the_same_bytes(cluster, targets):
    from distributed import Client

    robot, T = targets
    with Client(cluster) as client:
        far = ik.solve_batch(robot, T, "lm", executor=client.get_executor(), seed=5)
        worked = client.run(lambda: "ik_toolkit.solvers.batch.parts" in __import__("sys").modules)
    assert far.table.tobytes() == ik.solve_batch(robot, T, "lm", seed=5).table.tobytes()
    assert len(worked) == 2 and all(worked.values())


def test_the_command_line_uses_an_existing_scheduler(cluster, targets, tmp_path, capsys):
    robot, T = targets
    np.savez(tmp_path / "targets.npz", targets=T[:5000])
    common = ["solve", "hydrolek_7w", "--targets", str(tmp_path / "targets.npz"), "-s", "lm", "-o"]
    assert main([*common, str(tmp_path / "far.npz"), "--cluster", cluster.scheduler_address]) in (0, 1)
    assert main([*common, str(tmp_path / "near.npz")]) in (0, 1)
    far, near = np.load(tmp_path / "far.npz"), np.load(tmp_path / "near.npz")
    assert far["q"].shape == (5000, robot.n)
    assert all(far[name].tobytes() == near[name].tobytes() for name in near.files)


def test_an_address_without_a_scheduler_is_a_sentence(tmp_path, capsys):
    np.savez(tmp_path / "targets.npz", targets=np.eye(4)[None])
    words = ["solve", "hydrolek_7w", "--targets", str(tmp_path / "targets.npz"), "-o", str(tmp_path / "out.csv")]
    assert main([*words, "--cluster", "tcp://127.0.0.1:9"]) == 2
    assert "no Dask scheduler" in capsys.readouterr().err
