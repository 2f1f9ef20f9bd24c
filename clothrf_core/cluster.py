"""Roll-outs on a Dask cluster, through its own futures.

Not its joblib backend: that one never returns when a task keeps killing its worker (measured with
joblib 1.6 and distributed 2026.8). A roll-out lost with its worker runs again, up to a number of
attempts; then it is named with its seed.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import logging
import os
from collections.abc import Iterator, Sequence
from typing import Any

from clothrf_core.collection import ONE_THREAD, Job, quiet
from clothrf_core.errors import ClothrfError, ConfigError, MissingDependency, RolloutFailed
from clothrf_core.sections import CollectionSection

logger = logging.getLogger(__name__)

# For a cluster of two cores that this process shares with its workers. Idle, with Dask's defaults,
# scheduler and workers take 9 % of a core looking after themselves; with these 1.5 %.
SETTINGS = {
    # Nothing waits at a worker: a task that only waited there would share the blame.
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.scheduler.work-stealing": False,
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.scheduler.http.routes": [],
    # A worker that dies while it starts is not replaced; without any, nothing would ever end.
    "distributed.scheduler.no-workers-timeout": "60s",
}


class Cluster:
    """A running cluster at ``tcp://host:port``, or one started here (``address = "local"``)."""

    def __init__(self, section: CollectionSection, *, timeout_s: float = 15.0) -> None:
        try:
            import dask
            import distributed
        except ImportError as error:
            raise MissingDependency(
                "collection.engine = 'dask' needs 'distributed', which is not installed. "
                "Install it with: pip install 'clothrf[dask]'"
            ) from error
        logging.getLogger("distributed").setLevel(logging.NOTSET)  # as loud as everybody else
        self._section = section
        self._local: Any = None
        if section.address == "local":
            allowed = {"distributed.scheduler.allowed-failures": section.attempts - 1}
            with dask.config.set(SETTINGS | allowed):
                self._local = distributed.LocalCluster(
                    n_workers=section.workers,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address=None,
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                    host="127.0.0.1",
                    env=ONE_THREAD,
                )
        try:
            self._client: Any = distributed.Client(
                self._local or section.address, timeout=timeout_s
            )
        except (OSError, TimeoutError) as error:
            raise ConfigError(
                f"collection.address: expected a Dask scheduler at {section.address}, found none "
                f"({error}). Start one, or set address = 'local'"
            ) from error
        self._check_workers(timeout_s)
        self._client.register_worker_callbacks(_prepare)

    def run(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, Any]]:
        """See `collection.Engine.run`."""
        import distributed
        from distributed.scheduler import NoValidWorkerError, NoWorkerError

        pending = {self._submit(job, 0): (job, 1) for job in jobs}
        queue = distributed.as_completed(pending)
        try:
            for future in queue:
                job, attempt = pending.pop(future)
                if future.status == "finished":
                    yield job, future.result()
                    future.release()
                    continue
                error: Any = future.exception() if future.status == "error" else None
                if isinstance(error, ClothrfError):
                    raise error
                if isinstance(error, NoWorkerError | NoValidWorkerError):
                    raise RolloutFailed(
                        "all Dask workers are gone and none came back; everything collected is "
                        "kept. Go on with --resume"
                    ) from error
                killed = isinstance(error, distributed.KilledWorker)
                if error is not None and not killed and not isinstance(error, OSError):
                    raise error
                if not killed and attempt < self._section.attempts:
                    again = self._submit(job, attempt)
                    pending[again] = (job, attempt + 1)
                    queue.add(again)
                    continue
                lost = error.allowed_failures + 1 if killed else attempt
                message = (
                    f"{job.name} killed its worker {lost} times; everything else collected is kept"
                )
                if self._section.on_failure == "stop":
                    raise RolloutFailed(message)
                logger.error("%s; going on without it", message)
        except distributed.client.FutureCancelledError as error:
            raise RolloutFailed(
                "the Dask scheduler was lost; everything collected is kept. "
                "Start it again and go on with --resume"
            ) from error
        finally:
            for future in pending:
                future.cancel()

    def worker_pids(self) -> list[int]:
        """Process ids of the workers; of use where they run on this machine."""
        return [int(pid) for pid in self._client.run(os.getpid).values()]

    def close(self) -> None:
        """Leave the cluster; end it if it was started here."""
        self._client.close()
        if self._local is not None:
            self._local.close()

    def _submit(self, job: Job, attempt: int) -> Any:
        return self._client.submit(
            _run, job, key=f"{job.name}-{id(job):x}-{attempt}", retries=0, pure=False
        )

    def _check_workers(self, timeout_s: float) -> None:
        here = importlib.metadata.version("clothrf")
        try:
            self._client.wait_for_workers(1, timeout=timeout_s)
        except TimeoutError as error:
            raise ConfigError(
                f"collection.address: expected workers at {self._section.address}, found none "
                f"within {timeout_s:.0f} s. Start some, with this version of clothrf"
            ) from error
        try:
            there = self._client.run(_version)
        except ImportError as error:
            raise ConfigError(
                f"collection.address: a worker of {self._section.address} has no clothrf "
                f"({error}); install the same version on all workers"
            ) from error
        for worker, version in there.items():
            if version != (here, plugin_set()):
                raise ConfigError(
                    f"collection.address: worker {worker} runs clothrf {version[0]} with plugins "
                    f"{', '.join(version[1])}; expected {here} with {', '.join(plugin_set())}. "
                    "Install the same on all workers"
                )


def plugin_set() -> tuple[str, ...]:
    """Names of the plugins installed here; workers must have the same."""
    return tuple(sorted(p.name for p in importlib.metadata.entry_points(group="clothrf")))


def _version() -> tuple[str, tuple[str, ...]]:
    return importlib.metadata.version("clothrf"), plugin_set()


def _prepare() -> None:
    """What every worker does first, those that come later included.

    Dask starts its workers with glibc told to give memory back at once (MALLOC_TRIM_THRESHOLD_):
    then every picture is new pages, 73,000 page faults and 0.2 of 0.85 s a roll-out of 100 samples.
    """
    quiet()
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # another C library
        return
    trim_threshold, mmap_threshold = -1, -3  # malloc.h
    mallopt(trim_threshold, 256 << 20)
    mallopt(mmap_threshold, 32 << 20)


def _run(job: Job) -> Any:
    return job.run()
