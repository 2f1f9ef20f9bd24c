"""What is exported: the roll-outs of a run or of a bare data set, held-out ones first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from clothrf_core.dataset import Dataset, Rollout, read_rollout
from clothrf_core.errors import DataError
from clothrf_core.files import names_digest, sha256
from clothrf_core.registry import Registry
from clothrf_core.run_folder import RunFolder

KINDS = ("heldout", "iteration")  # so that a run that goes on only appends


@dataclass(frozen=True)
class Source:
    """Roll-outs and what must be known about them.

    Attributes:
        dataset: where they are.
        paths: their files, in the order of the episodes.
        fps: samples a second of simulated time.
        run: the run they are from; None for a bare data set.
    """

    dataset: Dataset
    paths: tuple[Path, ...]
    fps: float
    run: RunFolder | None = None

    @property
    def held_out(self) -> int:
        """How many of them, the first, were never trained on."""
        return sum(path.parent.name.startswith(KINDS[0]) for path in self.paths)

    def name(self, path: Path) -> str:
        """``iteration_001/rollout_0000.npz``."""
        return str(path.relative_to(self.dataset.folder).as_posix())

    def rollouts(self) -> Iterator[tuple[str, Rollout, str]]:
        """(name, roll-out, digest of its file), one at a time.

        Raises:
            DataError: a file is damaged or of another data set.
        """
        names = names_digest(self.dataset.names)
        for path in self.paths:
            rollout = read_rollout(path)
            if rollout.meta.get("names") != names:
                raise DataError(
                    f"{path}: was recorded with other features than {self.dataset.folder}"
                )
            yield self.name(path), rollout, sha256(path.read_bytes())


def open_source(folder: Path, registry: Registry, fps: float | None) -> Source:
    """The roll-outs of a run folder or of a data set folder.

    Args:
        folder: either.
        registry: to understand the run's config.
        fps: samples a second; only for a data set that stands alone.

    Raises:
        DataError: it is neither, holds no roll-outs, or nothing says how fast they were sampled.
    """
    run = next(
        (RunFolder(f) for f in (folder, folder.parent) if (f / "experiment.toml").exists()), None
    )
    if run is not None and folder.resolve() not in (run.path.resolve(), run.dataset.resolve()):
        run = None
    where = run.dataset if run is not None else folder
    if not (where / "dataset.json").exists():
        raise DataError(
            f"{folder}: expected a run folder (with experiment.toml) or a data set (with "
            "dataset.json), found neither"
        )
    dataset = Dataset.open(where)
    paths = tuple(path for kind in KINDS for path in dataset.paths(kind=kind))
    if not paths:
        raise DataError(f"{where}: expected roll-outs, found none yet")
    if run is not None:
        experiment = run.resolved(registry).experiment
        fps = experiment.run.rate_hz / experiment.training.stride
    if fps is None:
        raise DataError(
            f"{folder}: a data set without its run does not say how fast it was sampled; "
            "say it: --fps 10"
        )
    return Source(dataset, paths, fps, run)
