"""Engines: the same results whoever computes them, and nobody hangs when a worker dies."""

import os
import signal
from dataclasses import dataclass
from pathlib import Path

import pytest

from clothrf_core.collection import Processes, Sequential, collect, engine
from clothrf_core.errors import DataError, RolloutFailed
from clothrf_core.sections import CollectionSection

loky = pytest.importorskip("loky")


@dataclass(frozen=True)
class Square:
    number: int

    @property
    def name(self):
        return f"square {self.number} (seed {self.number})"

    def run(self):
        return self.number**2


@dataclass(frozen=True)
class Deadly(Square):
    """Kills its worker until it has done so `times` times."""

    folder: str = ""
    times: int = 99

    def run(self):
        deaths = Path(self.folder) / "deaths"
        count = len(deaths.read_text()) if deaths.exists() else 0
        if count < self.times:
            deaths.write_text("x" * (count + 1))
            os.kill(os.getpid(), signal.SIGKILL)
        return self.number**2


@dataclass(frozen=True)
class Refusing(Square):
    def run(self):
        raise DataError("the policy is damaged")


@pytest.fixture
def processes():
    runner = Processes(CollectionSection(workers=2))
    yield runner
    runner.close()


def test_results_come_in_the_order_of_the_jobs(processes):
    jobs = [Square(n) for n in range(7)]
    assert collect(jobs, processes) == collect(jobs, Sequential()) == [n * n for n in range(7)]


def test_a_job_lost_with_its_worker_runs_again(processes, tmp_path):
    jobs = [Square(1), Deadly(2, str(tmp_path), times=1), Square(3), Square(4)]
    assert collect(jobs, processes) == [1, 4, 9, 16]


def test_a_job_that_always_kills_its_worker_is_named_with_its_seed(processes, tmp_path):
    jobs = [Square(1), Deadly(2, str(tmp_path)), Square(3)]
    with pytest.raises(RolloutFailed, match=r"square 2 \(seed 2\) killed its worker 3 times"):
        collect(jobs, processes)
    assert (tmp_path / "deaths").read_text() == "xxx"


def test_the_run_goes_on_without_it_if_configured(tmp_path):
    runner = Processes(CollectionSection(workers=2, on_failure="continue"))
    jobs = [Square(1), Deadly(2, str(tmp_path)), Square(3), Square(4)]
    try:
        assert collect(jobs, runner) == [1, 9, 16]
    finally:
        runner.close()


def test_what_a_job_says_is_wrong_reaches_the_user(processes):
    with pytest.raises(DataError, match="the policy is damaged"):
        collect([Square(1), Refusing(2)], processes)


def test_one_worker_needs_no_other_process():
    assert isinstance(engine(CollectionSection(workers=1)), Sequential)


def test_without_shared_memory_the_same_work_is_done_in_this_process(monkeypatch, caplog):
    from multiprocessing.context import SpawnContext

    def refused(self):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(SpawnContext, "Lock", refused)
    assert isinstance(engine(CollectionSection(workers=2)), Sequential)
    assert "/dev/shm is missing or not writable" in caplog.text
