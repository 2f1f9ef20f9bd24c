"""DAgger runs of a study, iteration by iteration, judged on roll-outs of other seeds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clothrf_core import compose, config, imitation
from clothrf_core.evaluation import held_out
from clothrf_core.paper import data
from clothrf_core.registry import Registry
from clothrf_core.run_folder import RunFolder


class Silent:
    """Progress that nobody sees: a worker has no terminal."""

    def advance(self, what: str) -> None:
        """Nothing."""

    def finished(self, record: dict[str, Any]) -> None:
        """Nothing."""


@dataclass(frozen=True, slots=True)
class DaggerJob:
    """One DAgger run; a killed one goes on where it was.

    Attributes:
        label: how messages call it.
        config: resolved experiment; collects in this process.
        run_folder: where the run lives.
        test: folder of the data set that every iteration's policy is judged on.
        columns: beginnings of the features that the policies were trained on.
    """

    label: str
    config: str
    run_folder: str
    test: str
    columns: tuple[str, ...]

    @property
    def name(self) -> str:
        """How messages call it."""
        return self.label

    def run(self) -> dict[str, Any]:
        """The run's records, each with its error on the test roll-outs, and the iteration kept.

        That iteration is chosen on the run's own held-out roll-outs, never on the test ones.
        """
        registry = Registry.installed()
        path = Path(self.run_folder)
        resolved = config.load(Path(self.config), registry)
        run = RunFolder.start(path, resolved, resume=(path / "experiment.toml").exists())
        records = imitation.dagger(run, registry, Silent())
        test = data.columns(data.test_view(self.test), self.columns)
        judged = []
        for record in records:
            policy, _ = compose.open_policy(run.policy(record["iteration"]), registry)
            judged.append({**record, "test": held_out(policy, test)})
        return {"iterations": judged, "best": imitation.best(records)}
