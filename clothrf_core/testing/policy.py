"""What every `Policy` must keep to; call it with a function that builds yours."""

from __future__ import annotations

import functools
import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from clothrf_core.errors import DataError, FeatureMismatch
from clothrf_core.interfaces import Policy
from clothrf_core.types import Action, DatasetView, Features


def check_policy(make: Callable[[], Policy], view: DatasetView | None = None) -> None:
    """Raise AssertionError at the first promise of `Policy` that `make`'s breaks.

    Checked, for one task and for all of them: no tasks before `fit`; actions are finite, of the
    right shape and confident within [0, 1]; the same rows and seed give the same bits, in memory
    and in the file; the rows are not changed; saved and loaded it acts bit-identically; features of
    other names and folders that are empty, damaged, truncated, foreign or newer are refused;
    pictures that are not valid and numbers that are not finite never crash it.

    Args:
        make: builds a policy that was not fitted; called more than once.
        view: rows to learn from; `synthetic_view` by default.
    """
    view = synthetic_view() if view is None else view
    assert make().tasks == (), "a policy that was not fitted must have no tasks"
    for count in sorted({1, len(view.tasks)}):
        with tempfile.TemporaryDirectory() as folder:
            _check_tasks(make, _first_tasks(view, count), Path(folder))


def synthetic_view(
    *, rows: int = 240, tasks: int = 3, features: int = 24, groups: int = 12, seed: int = 0
) -> DatasetView:
    """Rows whose labels follow smoothly from their features, with a little noise.

    Args:
        rows: N.
        tasks: T.
        features: F.
        groups: roll-outs.
        seed: of everything random.
    """
    rng = np.random.default_rng(seed)
    hidden = rng.uniform(-1.0, 1.0, (rows, 6))
    mixed = np.sin(hidden @ rng.normal(size=(6, features)))
    values = (mixed + 0.05 * rng.normal(size=mixed.shape)).astype(np.float32)
    anchors = 0.5 + 0.05 * rng.normal(size=(rows, 3))
    move = 0.1 * np.tanh(hidden @ rng.normal(size=(6, tasks * 6)))
    return DatasetView(
        features=values,
        names=tuple(f"feature {i}" for i in range(features)),
        anchors=anchors,
        labels=anchors[:, None, None, :] + move.reshape(rows, tasks, 2, 3),
        tasks=tuple(f"task {t}" for t in range(tasks)),
        groups=np.sort(np.arange(rows, dtype=np.int64) % groups),
        grasps=np.repeat(anchors[:, None, :], 2, axis=1),
    )


def _first_tasks(view: DatasetView, count: int) -> DatasetView:
    return DatasetView(
        features=view.features,
        names=view.names,
        anchors=view.anchors,
        labels=view.labels[:, :count],
        tasks=view.tasks[:count],
        groups=view.groups,
        grasps=view.grasps,
    )


def _check_tasks(make: Callable[[], Policy], view: DatasetView, folder: Path) -> None:
    before = _bytes_of(view)
    policy = make()
    facts = policy.fit(view, np.random.default_rng(7))
    assert _bytes_of(view) == before, "fit must not change the rows"
    assert policy.tasks == view.tasks, f"expected tasks {view.tasks}, got {policy.tasks}"
    for name, value in facts.items():
        assert np.isfinite(value), f"fit: the metric '{name}' is {value}"

    actions = _acts(policy, view)
    shape = view.labels.shape[2:]
    for action in actions:
        assert action.targets.shape == shape, f"expected {shape}, got {action.targets.shape}"
        assert np.isfinite(action.targets).all(), "targets must be finite"
        assert 0.0 <= action.confidence <= 1.0, f"confidence {action.confidence} not in [0, 1]"
    assert _same(actions, _acts(policy, view)), "acting twice must give the same bits"

    saved = _saved(policy, folder / "first")
    twin = make()
    twin.fit(view, np.random.default_rng(7))
    assert _same(actions, _acts(twin, view)), "same rows and seed must give the same bits"
    assert _files(_saved(twin, folder / "second")) == _files(saved), "files must be bit-identical"

    loaded = make().load(saved)
    assert loaded.tasks == view.tasks, "load must restore the tasks"
    assert _same(actions, _acts(loaded, view)), "a loaded policy must act bit-identically"
    assert _files(_saved(loaded, folder / "third")) == _files(saved), "saving again must not differ"

    _check_refusals(make, policy, view, folder, saved)


def _check_refusals(
    make: Callable[[], Policy], policy: Policy, view: DatasetView, folder: Path, saved: Path
) -> None:
    task = view.tasks[0]
    row = view.feature_row(0)
    others = tuple(f"other {name}" for name in row.names)
    _refuses(
        "features of other names",
        FeatureMismatch,
        lambda: policy.act(Features(row.values, others, row.anchor), task),
    )
    _refuses(
        "fewer features",
        FeatureMismatch,
        lambda: policy.act(Features(row.values[1:], row.names[1:], row.anchor), task),
    )
    blank = Features(np.zeros_like(row.values), row.names, np.zeros(3), valid=False)
    policy.act(blank, task)
    policy.act(Features(np.full_like(row.values, np.nan), row.names, row.anchor), task)

    empty = folder / "empty"
    empty.mkdir()
    _refuses("an empty folder", DataError, lambda: make().load(empty))
    _refuses("a folder that is not there", DataError, lambda: make().load(folder / "nowhere"))
    for name, damage in _damages(saved).items():
        spoilt = folder / name.replace(" ", "-").replace("/", "-")
        spoilt.mkdir()
        for file, data in damage.items():
            if data is not None:
                (spoilt / file).write_bytes(data)
        _refuses(name, DataError, functools.partial(make().load, spoilt))


def _damages(saved: Path) -> dict[str, dict[str, bytes | None]]:
    """Folders that must be refused: what each file of the policy becomes; None = missing."""
    whole: dict[str, bytes | None] = dict(_files(saved))
    result: dict[str, dict[str, bytes | None]] = {}
    for file, data in _files(saved).items():
        middle = len(data) // 2
        flipped = bytes([data[middle] ^ 0x55])
        result[f"{file} missing"] = {**whole, file: None}
        result[f"{file} empty"] = {**whole, file: b""}
        result[f"{file} truncated"] = {**whole, file: data[:middle]}
        result[f"{file} of something else"] = {**whole, file: b"{}\n"}
        if not file.endswith(".json"):
            changed = data[:middle] + flipped + data[middle + 1 :]
            result[f"{file} with one byte changed"] = {**whole, file: changed}
            continue
        about = json.loads(data)
        if isinstance(about, dict) and isinstance(about.get("version"), int):
            newer = json.dumps({**about, "version": about["version"] + 1}).encode()
            result[f"{file} of a newer version"] = {**whole, file: newer}
    return result


def _refuses(what: str, error: type[Exception], call: Callable[[], object]) -> None:
    try:
        call()
    except error as raised:
        message = str(raised)
    else:
        raise AssertionError(f"{what}: expected {error.__name__}, nothing was raised")
    assert message, f"{what}: the error must say what is wrong"


def _acts(policy: Policy, view: DatasetView) -> list[Action]:
    return [
        policy.act(view.feature_row(row), task)
        for row in range(0, len(view), max(1, len(view) // 20))
        for task in view.tasks
    ]


def _same(first: list[Action], second: list[Action]) -> bool:
    return all(
        a.targets.tobytes() == b.targets.tobytes() and a.confidence == b.confidence
        for a, b in zip(first, second, strict=True)
    )


def _saved(policy: Policy, folder: Path) -> Path:
    folder.mkdir()
    policy.save(folder)
    return folder


def _files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _bytes_of(view: DatasetView) -> list[bytes]:
    arrays = (view.features, view.anchors, view.labels, view.groups, view.grasps)
    return [array.tobytes() for array in arrays]
