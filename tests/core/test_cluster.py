"""Collection on a real Dask cluster of worker processes on loopback."""

import os
import platform
import resource
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from clothrf_core.collection import collect
from clothrf_core.errors import ConfigError, DataError, RolloutFailed
from clothrf_core.sections import CollectionSection

distributed = pytest.importorskip("distributed")

pytestmark = pytest.mark.filterwarnings("ignore")  # Dask's own shutdown noise


@dataclass(frozen=True)
class Task:
    number: int
    folder: str = ""
    deaths: int = 0
    pause: float = 0.0

    @property
    def name(self):
        return f"task {self.number} (seed {self.number})"

    def run(self):
        if self.number < 0:
            raise DataError("the policy is damaged")
        if self.deaths:
            file = Path(self.folder) / f"deaths{self.number}"
            died = len(file.read_text()) if file.exists() else 0
            if died < self.deaths:
                file.write_text("x" * (died + 1))
                os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(self.pause)
        if self.folder:
            (Path(self.folder) / f"pid{self.number}").write_text(str(os.getpid()))
        return self.number**2


@dataclass(frozen=True)
class Pictures:
    name: str = "pictures"

    def run(self):
        """Page faults of making and dropping a hundred pictures; OpenCV's threads."""
        cv2 = pytest.importorskip("cv2")
        for _ in range(3):  # glibc's own arenas grow first
            np.ones((480, 640))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        for _ in range(100):
            np.ones((480, 640))
        faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
        return faults, cv2.getNumThreads()


@pytest.fixture(scope="module")
def cluster():
    from clothrf_core.cluster import Cluster

    runner = Cluster(CollectionSection(engine="dask", workers=2))
    yield runner
    runner.close()


def test_results_come_in_the_order_of_the_jobs(cluster):
    assert collect([Task(n) for n in range(12)], cluster) == [n * n for n in range(12)]


def test_a_job_lost_with_its_worker_runs_again(cluster, tmp_path):
    jobs = [Task(0), Task(1, str(tmp_path), deaths=1), Task(2), Task(3)]
    assert collect(jobs, cluster) == [0, 1, 4, 9]


def test_a_job_that_always_kills_its_worker_is_named_and_nothing_hangs(cluster, tmp_path):
    jobs = [Task(0), Task(1, str(tmp_path), deaths=99), Task(2)]
    with pytest.raises(RolloutFailed, match=r"task 1 \(seed 1\) killed its worker 3 times"):
        collect(jobs, cluster)
    assert (tmp_path / "deaths1").read_text() == "xxx"


def test_a_worker_killed_from_outside_loses_nothing(cluster, tmp_path):
    jobs = [Task(n, str(tmp_path), pause=0.2) for n in range(10)]

    def kill():
        while not (tmp_path / "pid0").exists():
            time.sleep(0.02)
        os.kill(int((tmp_path / "pid0").read_text()), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    assert collect(jobs, cluster) == [n * n for n in range(10)]
    killer.join()


def test_what_a_job_says_is_wrong_reaches_the_user(cluster):
    with pytest.raises(DataError, match="the policy is damaged"):
        collect([Task(1), Task(-1)], cluster)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's own habit")
def test_a_worker_draws_on_the_pages_it_has_with_one_thread(cluster):
    [(faults, threads)] = collect([Pictures()], cluster)
    assert faults < 1000  # 100 pictures of 600 pages each
    assert threads == 1


def test_an_absent_scheduler_is_said():
    from clothrf_core.cluster import Cluster

    section = CollectionSection(engine="dask", address="tcp://127.0.0.1:9")
    with pytest.raises(ConfigError, match="expected a Dask scheduler at tcp://127.0.0.1:9"):
        Cluster(section, timeout_s=1.0)


def test_a_scheduler_without_workers_is_said():
    from clothrf_core.cluster import Cluster

    scheduler = distributed.LocalCluster(n_workers=0, dashboard_address=None, host="127.0.0.1")
    try:
        section = CollectionSection(engine="dask", address=scheduler.scheduler_address)
        with pytest.raises(ConfigError, match="expected workers at tcp.*found none within 1 s"):
            Cluster(section, timeout_s=1.0)
    finally:
        scheduler.close()


def test_a_cluster_that_lost_all_its_workers_ends_the_run(monkeypatch):
    from clothrf_core import cluster as module

    monkeypatch.setitem(module.SETTINGS, "distributed.scheduler.no-workers-timeout", "1s")
    runner = module.Cluster(CollectionSection(engine="dask", workers=1))
    try:
        runner._local.scale(0)
        with pytest.raises(RolloutFailed, match="all Dask workers are gone"):
            collect([Task(0, pause=1.0), Task(1)], runner)
    finally:
        runner.close()


def test_a_worker_with_other_plugins_is_refused(tmp_path):
    """A worker whose environment offers one more plugin than ours."""
    from clothrf_core.cluster import Cluster

    extra = tmp_path / "extra-1.0.dist-info"
    extra.mkdir()
    (extra / "METADATA").write_text("Name: extra\nVersion: 1.0\n")
    (extra / "entry_points.txt").write_text("[clothrf]\nextra = extra\n")
    scheduler = distributed.LocalCluster(n_workers=0, dashboard_address=None, host="127.0.0.1")
    worker = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", scheduler.scheduler_address,
         "--nworkers", "1", "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        scheduler.wait_for_workers(1, timeout=60)
        section = CollectionSection(engine="dask", address=scheduler.scheduler_address)
        with pytest.raises(ConfigError, match="Install the same on all workers"):
            Cluster(section)
    finally:
        worker.kill()
        worker.wait()
        scheduler.close()
