"""Jobs whose results are kept, so that a killed study goes on where it was."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from clothrf_core.collection import Engine, Job
from clothrf_core.errors import DataError
from clothrf_core.files import atomic_write, json_bytes, read_json

TIMINGS = "seconds"  # the one key of a result that two runs may differ in


class Progress(Protocol):
    """Where a study tells how far it is."""

    def plan(self, seconds: float) -> None:
        """Roughly so much work is ahead."""

    def done(self, what: str, seconds: float) -> None:
        """That much of it is behind; `what` was the last of it."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A job, the file of its result, and roughly how long it takes.

    The result is a JSON object. Its key ``seconds``, if any, goes to a file of its own beside it,
    so that equal seeds give equal bytes.
    """

    job: Job
    out: str
    seconds: float

    @property
    def name(self) -> str:
        """How messages call it."""
        return self.job.name

    @property
    def ready(self) -> bool:
        """An intact result is there."""
        try:
            read_json(Path(self.out))
        except DataError:
            return False
        return True

    def run(self) -> str:
        """Do it unless it is done; returns the file's path."""
        path = Path(self.out)
        if self.ready:
            return self.out
        start = time.perf_counter()
        result: dict[str, Any] = dict(self.job.run())
        spent = {"total": time.perf_counter() - start, **result.pop(TIMINGS, {})}
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path.with_suffix(".seconds"), json_bytes(spent))
        atomic_write(path, json_bytes(result))
        return self.out


@dataclass(frozen=True, slots=True)
class File:
    """A job that keeps its own file (a roll-out), and roughly how long it takes."""

    job: Job
    out: str
    seconds: float

    @property
    def name(self) -> str:
        """How messages call it."""
        return self.job.name

    @property
    def ready(self) -> bool:
        """The file is there; whether it is intact is seen when it is read."""
        return Path(self.out).exists()

    def run(self) -> Any:
        """Do it; the job itself looks whether it is done."""
        return self.job.run()


Work = Cell | File


def do(work: Sequence[Work], workers: Engine, progress: Progress) -> None:
    """Do what is not done yet; the longest first, so that no core waits at the end."""
    for one in work:
        if one.ready:
            progress.done(one.name, one.seconds)
    left = [one for one in work if not one.ready]
    weight = {id(one): one.seconds for one in left}
    for job, _ in workers.run(left):
        progress.done(job.name, weight[id(job)])


def result(path: Path) -> dict[str, Any]:
    """What a finished cell found.

    Raises:
        DataError: it is not there or not intact.
    """
    found: dict[str, Any] = read_json(path)
    return found


def timing(path: Path) -> dict[str, float]:
    """How long a finished cell took, by part; empty if nobody knows."""
    try:
        spent: dict[str, float] = read_json(path.with_suffix(".seconds"))
    except DataError:
        return {}
    return spent
