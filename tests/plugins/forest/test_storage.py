from __future__ import annotations

import json

import numpy as np
import pytest
from clothrf_forest.config import ForestConfig
from clothrf_forest.policy import Forest
from clothrf_forest.storage import load

from clothrf_core.errors import DataError
from clothrf_core.files import npz_bytes, read_npz, sha256
from clothrf_core.testing.policy import synthetic_view


@pytest.fixture
def folder(tmp_path):
    forest = Forest(ForestConfig(trees=4))
    forest.fit(synthetic_view(tasks=1), np.random.default_rng(0))
    forest.save(tmp_path)
    return tmp_path


def spoil(folder, **changes: np.ndarray) -> None:
    """Replace arrays and mend the digest: a file that is whole but wrong."""
    arrays = {**read_npz(folder / "forest.npz"), **changes}
    data = npz_bytes(arrays)
    (folder / "forest.npz").write_bytes(data)
    about = json.loads((folder / "policy.json").read_text())
    about["arrays_sha256"] = sha256(data)
    (folder / "policy.json").write_text(json.dumps(about))


def test_there_are_two_files_and_no_pickle(folder) -> None:
    assert sorted(p.name for p in folder.iterdir()) == ["forest.npz", "policy.json"]
    with np.load(folder / "forest.npz", allow_pickle=False) as stored:
        assert all(stored[name].dtype != object for name in stored.files)


def test_the_json_says_what_it_is_and_what_made_it(folder) -> None:
    about = json.loads((folder / "policy.json").read_text())

    assert about["format"] == "clothrf-forest"
    assert about["version"] == 3
    assert about["tasks"] == ["task 0"]
    assert about["config"]["trees"] == 4
    assert about["names"][0] == "feature 0"


def test_a_changed_byte_is_found(folder) -> None:
    data = bytearray((folder / "forest.npz").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "forest.npz").write_bytes(data)

    with pytest.raises(DataError) as raised:
        load(folder)

    assert str(raised.value) == (
        f"{folder / 'forest.npz'}: not the {len(data)} bytes that policy.json was written for; the "
        "file is damaged, truncated or of another policy. Copy the whole folder again"
    )


def test_a_newer_version_is_refused(folder) -> None:
    about = json.loads((folder / "policy.json").read_text())
    (folder / "policy.json").write_text(json.dumps({**about, "version": 4}))

    with pytest.raises(DataError, match="expected version 3, got 4"):
        load(folder)


def test_another_kind_of_policy_is_refused(folder) -> None:
    (folder / "policy.json").write_text('{"format": "something"}')

    with pytest.raises(DataError, match="expected a policy of format 'clothrf-forest', got 'some"):
        load(folder)


def test_nodes_that_point_outside_are_refused(folder) -> None:
    nodes = read_npz(folder / "forest.npz")["nodes"]
    inner = np.flatnonzero(nodes["first"] >= 0)
    for field, value in (("child", 10**6), ("child", 0), ("first", 10**6), ("second", 10**6)):
        wrong = nodes.copy()
        wrong[field][inner[-1]] = value
        spoil(folder, nodes=wrong)

        with pytest.raises(DataError, match="point outside"):
            load(folder)


def test_a_leaf_that_does_not_exist_is_refused(folder) -> None:
    nodes = read_npz(folder / "forest.npz")["nodes"].copy()
    nodes["child"][np.flatnonzero(nodes["first"] < 0)[0]] = 10**6
    spoil(folder, nodes=nodes)

    with pytest.raises(DataError, match="point outside"):
        load(folder)


def test_arrays_of_another_shape_are_refused(folder) -> None:
    spoil(folder, centre=np.zeros(3, np.float32))

    with pytest.raises(DataError, match=r"expected centre of float32 \(27,\), got float32 \(3,\)"):
        load(folder)


def test_a_missing_array_is_refused(folder) -> None:
    arrays = read_npz(folder / "forest.npz")
    del arrays["values"]
    data = npz_bytes(arrays)
    (folder / "forest.npz").write_bytes(data)
    about = json.loads((folder / "policy.json").read_text())
    (folder / "policy.json").write_text(json.dumps({**about, "arrays_sha256": sha256(data)}))

    with pytest.raises(DataError, match="not a whole forest policy"):
        load(folder)
