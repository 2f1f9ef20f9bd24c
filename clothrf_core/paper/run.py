"""One command from nothing to the report; a killed one goes on where it was."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clothrf_core.collection import engine
from clothrf_core.errors import ConfigError
from clothrf_core.files import atomic_write, json_bytes, read_json, sha256
from clothrf_core.locations import shipped
from clothrf_core.paper import results, stages
from clothrf_core.paper.cells import Work, do
from clothrf_core.paper.data import Workspace
from clothrf_core.paper.figures import figures
from clothrf_core.paper.report import write_report
from clothrf_core.paper.study import read_study
from clothrf_core.provider import Figure, Setting
from clothrf_core.registry import Registry
from clothrf_core.run_folder import sweep, versions
from clothrf_core.sections import CollectionSection

SIZES = {"quick": "runs/paper_quick", "usual": "runs/paper", "full": "runs/paper_full"}


def paper(setting: Setting) -> list[Figure]:
    """Run the shipped study in ``setting.out`` and report; see `study`."""
    out = setting.out or Path(SIZES[setting.size])
    return study(setting, shipped("paper/study.toml"), out)


def study(setting: Setting, path: Path, out: Path, *, workers: int = 0) -> list[Figure]:
    """Measure what the study in `path` asks for, write tables, plots and the report into `out`.

    Args:
        setting: how much, and who hears of progress.
        path: a `study.toml`; its ``base`` lies beside it.
        out: a new folder, or that of a killed study.
        workers: processes; 0 = one a core.

    Raises:
        ConfigError: `out` holds another study.
    """
    space = opened(setting, path, out)
    missing = stages.prepared(space)
    section = CollectionSection(engine="processes", workers=workers or len(os.sched_getaffinity(0)))
    parts: list[Sequence[Work]] = [
        stages.rollouts(space),
        stages.learning(space, missing),
        stages.closed_loops(space, missing),
    ]
    setting.plan(sum(one.seconds for part in parts for one in part))
    # A worker keeps the data set of its last fit, which loky would take for a leak.
    os.environ.setdefault("LOKY_MAX_MEMORY_LEAK_SIZE", "8e9")
    runner = engine(section)
    try:
        for part in parts:
            do(part, runner, setting)
    finally:
        runner.close()
    found = results.collected(space, missing)
    made = figures(space.study, found)
    atomic_write(out / "results.json", json_bytes(found))
    write_report(space, found, made)
    return made


def opened(setting: Setting, path: Path, out: Path) -> Workspace:
    """The folder `out` with the study in it, new or as a killed run left it.

    Raises:
        ConfigError: it holds another study, or files that are none.
    """
    registry = Registry.installed()
    asked = read_study(path)
    if setting.size not in asked.sizes:
        raise ConfigError(f"{path}: no size '{setting.size}'; it has {', '.join(asked.sizes)}")
    base = path.parent / asked.base
    # What is left open by the file and filled in by the plugins' defaults belongs to the study.
    policies = {name: resolved(c.policy, registry) for name, c in asked.controllers.items()}
    controllers = {
        name: c.model_copy(update={"policy": policies[name]})
        for name, c in asked.controllers.items()
    }
    identity = {
        "size": setting.size,
        "study": sha256(path.read_bytes()),
        "base": sha256(base.read_bytes()),
        "policies": policies,
    }
    note = out / "study.json"
    if note.exists():
        if read_json(note) != identity:
            raise ConfigError(
                f"{out}: holds a study of another size, file or version of the policies. "
                "Choose another folder with --out"
            )
        sweep(out)
    elif out.exists() and any(p for p in out.iterdir() if not p.name.startswith(".")):
        raise ConfigError(
            f"{out}: expected a study or an empty folder, found other files. "
            "Choose another folder with --out"
        )
    else:
        out.mkdir(parents=True, exist_ok=True)
        atomic_write(out / "versions.json", json_bytes(versions()))
        atomic_write(note, json_bytes(identity))
    return Workspace(
        out=out,
        study=asked.model_copy(update={"controllers": controllers}),
        size=asked.sizes[setting.size],
        base=base,
        registry=registry,
        quick=setting.size == "quick",
    )


def resolved(policy: Mapping[str, Any], registry: Registry) -> dict[str, Any]:
    """A [policy] section with every default written out; one that is not installed as it is.

    Raises:
        ConfigError: the policy refuses its options.
    """
    options = copy.deepcopy(dict(policy))
    plugin = str(options.pop("plugin", ""))
    if plugin not in registry.names("policy"):
        return dict(policy)
    provider = registry.find("policy", plugin)
    try:
        known = provider.config.model_validate(options)
    except ValueError as error:
        raise ConfigError(f"policy '{plugin}': {error}") from error
    dumped = known.model_dump(mode="json", exclude_none=True)
    return {"plugin": plugin, **dumped}
