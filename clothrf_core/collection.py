"""Roll-outs in parallel behind one small interface: sequential, processes, or a Dask cluster.

One job is one roll-out from its seed; it writes its own file atomically and returns a small
summary. So every engine gives the same files, a job may run twice without harm, and resuming is
submitting what is missing.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Protocol

from clothrf_core.errors import ClothrfError, MissingDependency, RolloutFailed
from clothrf_core.sections import CollectionSection

logger = logging.getLogger(__name__)

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
}


class Job(Protocol):
    """Something that a worker can do; plain values, safe to do twice."""

    @property
    def name(self) -> str:
        """How messages call it."""

    def run(self) -> Any:
        """Do it."""


class Engine(Protocol):
    """Runs jobs somewhere."""

    def run(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, Any]]:
        """Each job with its result, as they finish.

        Raises:
            RolloutFailed: a job was lost as often as allowed (and failures stop the run).
            ClothrfError: a job said what is wrong.
        """

    def close(self) -> None:
        """Let the workers go."""


def engine(section: CollectionSection) -> Engine:
    """The engine that the config asks for."""
    if section.engine == "sequential" or (section.engine == "processes" and section.workers == 1):
        return Sequential()
    if section.engine == "processes":
        if not semaphores():
            logger.warning(
                "no worker processes here: /dev/shm is missing or not writable; collecting in "
                "this process, which gives the same files on one core"
            )
            return Sequential()
        return Processes(section)
    from clothrf_core.cluster import Cluster

    return Cluster(section)


def semaphores() -> bool:
    """Whether this machine offers the shared memory that worker processes need."""
    try:
        multiprocessing.get_context("spawn").Lock()
    except OSError:
        return False
    return True


class Sequential:
    """One job after the other, in this process."""

    def run(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, Any]]:
        """See `Engine.run`."""
        for job in jobs:
            yield job, job.run()

    def close(self) -> None:
        """Nothing to let go."""


class Processes:
    """Worker processes of this machine (loky: spawned, never forked).

    When a worker dies, all jobs in flight are lost with it. Those that were running are then
    repeated one at a time, so that the one that kills its worker is found and named.
    """

    def __init__(self, section: CollectionSection) -> None:
        self._section = section

    def run(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, Any]]:
        """See `Engine.run`."""
        waiting = list(jobs)
        attempts: dict[int, int] = {}
        suspects: list[Job] = []
        while waiting or suspects:
            alone = bool(suspects)
            batch = [suspects.pop(0)] if alone else waiting
            if not alone:
                waiting = []
            lost = yield from self._submit(batch, limit=1 if alone else self._section.workers)
            for job, running in lost:
                if not running:
                    waiting.append(job)
                    continue
                attempts[id(job)] = attempts.get(id(job), 0) + 1
                if attempts[id(job)] < self._section.attempts:
                    suspects.append(job)
                    continue
                message = (
                    f"{job.name} killed its worker {attempts[id(job)]} times; "
                    "everything else collected is kept"
                )
                if self._section.on_failure == "stop":
                    raise RolloutFailed(message)
                logger.error("%s; going on without it", message)

    def _submit(
        self, batch: Sequence[Job], *, limit: int
    ) -> Generator[tuple[Job, Any], None, list[tuple[Job, bool]]]:
        """Run a batch with at most `limit` jobs in flight; returns the lost ones."""
        executor = self._executor()
        queue = list(batch)
        flying: dict[Future[Any], Job] = {}
        lost: list[tuple[Job, bool]] = []
        while queue or flying:
            while queue and len(flying) < limit and not lost:
                job = queue.pop(0)
                flying[executor.submit(job.run)] = job
            done, _ = wait(flying, return_when=FIRST_COMPLETED)
            for future in done:
                job = flying.pop(future)
                try:
                    result = future.result()
                except ClothrfError:
                    raise
                except (BrokenProcessPool, OSError) as error:
                    logger.warning("%s was lost: %s", job.name, type(error).__name__)
                    lost.append((job, True))
                else:
                    yield job, result
            if lost and not flying:
                return lost + [(job, False) for job in queue]
        return lost

    def _executor(self) -> Any:
        try:
            from loky import get_reusable_executor
        except ImportError as error:
            raise MissingDependency(
                "collection.engine = 'processes' needs 'loky', which is not installed. "
                "Install it with: pip install 'clothrf[processes]', or set "
                "collection.engine = 'sequential'"
            ) from error
        return get_reusable_executor(
            max_workers=self._section.workers, timeout=300, env=ONE_THREAD, initializer=quiet
        )

    def close(self) -> None:
        """End the worker processes."""
        try:
            from loky import get_reusable_executor
        except ImportError:
            return
        get_reusable_executor(max_workers=self._section.workers).shutdown(wait=False)


def quiet() -> None:
    """One thread for everything in a worker; the workers are the parallelism."""
    os.environ.update(ONE_THREAD)
    try:
        import cv2
    except ImportError:
        return
    cv2.setNumThreads(1)


def collect(
    jobs: Sequence[Job], runner: Engine, on_done: Callable[[Job], None] = lambda _: None
) -> list[Any]:
    """Run all jobs; results in the order of the jobs, whatever order they finished in."""
    results: dict[int, Any] = {}
    for job, result in runner.run(jobs):
        results[id(job)] = result
        on_done(job)
    return [results[id(job)] for job in jobs if id(job) in results]
