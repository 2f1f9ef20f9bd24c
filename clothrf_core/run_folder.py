"""Everything a training run leaves behind, in one folder.

::

    run/
      experiment.toml      the resolved config; enough to repeat the run
      versions.json        what it ran with, and when
      dataset/             see dataset.py
      policies/iteration_001/ ...   one folder an iteration
      policy/              the best of them on the held-out roll-outs
      metrics.jsonl        one line an iteration; equal seeds give equal bytes
      timings.jsonl        seconds an iteration took
      evaluation.json      closed loop
      plots/*.png  report.html
"""

from __future__ import annotations

import importlib.metadata
import json
import platform
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from clothrf_core import config
from clothrf_core.errors import ConfigError, DataError
from clothrf_core.files import atomic_folder, atomic_write, json_bytes, read_json
from clothrf_core.registry import Registry

PACKAGES = (
    "clothrf",
    "numpy",
    "scipy",
    "numba",
    "scikit-learn",
    "opencv-python-headless",
    "sapien",
    "pydantic",
    "pluggy",
)


@dataclass(frozen=True)
class RunFolder:
    """Paths and records of one run."""

    path: Path

    @classmethod
    def start(cls, path: Path, resolved: config.Resolved, *, resume: bool) -> RunFolder:
        """Create a run folder, or go on with one of the same config.

        Raises:
            ConfigError: it exists and `resume` is off, or it was started with another config.
        """
        run = cls(path)
        text = resolved.text.encode()
        if run.experiment.exists():
            if not resume:
                raise ConfigError(
                    f"{path}: already holds a run. Go on with it: --resume; or choose another "
                    "folder with --out"
                )
            if _training_part(run.experiment.read_text()) != _training_part(text.decode()):
                raise ConfigError(
                    f"{path}: was started with another config, see {run.experiment}. "
                    "Choose another folder with --out"
                )
            sweep(path)
            if not (path / "versions.json").exists():  # killed between the first two files
                atomic_write(path / "versions.json", json_bytes(versions()))
            return run
        if path.exists() and any(p for p in path.iterdir() if not p.name.startswith(".")):
            raise ConfigError(
                f"{path}: expected a run folder or an empty one, found other files. "
                "Choose another folder with --out"
            )
        path.mkdir(parents=True, exist_ok=True)
        atomic_write(run.experiment, text)
        atomic_write(path / "versions.json", json_bytes(versions()))
        return run

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """An existing run folder.

        Raises:
            DataError: it is not one.
        """
        run = cls(path)
        if not run.experiment.exists():
            raise DataError(f"{path}: expected a run folder (with experiment.toml), found none")
        return run

    @property
    def experiment(self) -> Path:
        """The resolved config."""
        return self.path / "experiment.toml"

    @property
    def dataset(self) -> Path:
        """The data set's folder."""
        return self.path / "dataset"

    @property
    def best(self) -> Path:
        """The best policy's folder."""
        return self.path / "policy"

    def policy(self, iteration: int) -> Path:
        """The folder of one iteration's policy."""
        return self.path / "policies" / f"iteration_{iteration:03d}"

    def resolved(self, registry: Registry) -> config.Resolved:
        """Its config, checked against what is installed now."""
        return config.load(self.experiment, registry)

    def metrics(self) -> list[dict[str, Any]]:
        """One record a finished iteration.

        Raises:
            DataError: a line is damaged.
        """
        return _read_lines(self.path / "metrics.jsonl")

    def finish(self, records: list[dict[str, Any]], timing: Mapping[str, float]) -> None:
        """Record the iterations done so far; the last line is the new one."""
        timings = _read_lines(self.path / "timings.jsonl")[: len(records) - 1]
        _write_lines(self.path / "timings.jsonl", [*timings, dict(timing)])
        _write_lines(self.path / "metrics.jsonl", records)

    def keep_best(self, iteration: int) -> None:
        """Copy one iteration's policy to `policy/`."""
        with atomic_folder(self.best) as temporary:
            shutil.copytree(self.policy(iteration), temporary, dirs_exist_ok=True)

    def evaluation(self) -> dict[str, Any]:
        """What `evaluate` wrote; empty if it did not run."""
        path = self.path / "evaluation.json"
        found: dict[str, Any] = read_json(path) if path.exists() else {}
        return found


def versions() -> dict[str, Any]:
    """What this run uses: packages, Python, machine, date."""
    packages = {}
    for name in PACKAGES:
        try:
            packages[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            packages[name] = "not installed"
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "machine": machine(),
        "packages": packages,
    }


def machine() -> str:
    """Processor, core count and system in one line."""
    import os

    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                model = line.split(":", 1)[1].strip()
                break
    return f"{model}, {os.cpu_count()} cores, {platform.system()}"


def sweep(path: Path) -> None:
    """Remove what a killed writer left behind: temporary files and folders, never a result."""
    for pattern in (".*.tmp", ".*.old"):
        for left in list(path.rglob(pattern)):
            if left.is_dir():
                shutil.rmtree(left, ignore_errors=True)
            else:
                left.unlink(missing_ok=True)


def _training_part(text: str) -> dict[str, Any]:
    """The config without what may change from one sitting to the next."""
    import tomllib

    tree = tomllib.loads(text)
    tree.pop("collection", None)
    tree.pop("evaluation", None)
    tree.pop("tune", None)
    return tree


def _read_lines(path: Path) -> list[dict[str, Any]]:
    if not path.exists():
        return []
    try:
        return [json.loads(line) for line in path.read_text().splitlines() if line]
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DataError(f"{path}: expected JSON lines, found something else ({error})") from error


def _write_lines(path: Path, records: list[dict[str, Any]]) -> None:
    text = "".join(json.dumps(record, ensure_ascii=False) + "\n" for record in records)
    atomic_write(path, text.encode())
