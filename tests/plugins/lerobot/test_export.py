"""An export is what LeRobot's v3.0 says, at every moment, and the same whoever interrupts it."""

import io
import json

import numpy as np
import pytest

from clothrf_core import files
from clothrf_core.dataset import read_rollout
from clothrf_core.errors import DataError
from clothrf_core.registry import Registry

pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")

import pyarrow as pa
import pyarrow.parquet as pq
from clothrf_lerobot import writer
from clothrf_lerobot.reader import import_dataset
from clothrf_lerobot.source import open_source

F32, F64, I64 = pa.float32(), pa.float64(), pa.int64()
FILE = "chunk-000/file-{:03d}.parquet"

# The schema of LeRobot 0.6.1 (lerobot/datasets: feature_utils.py, dataset_metadata.py), written
# down by hand; its own LeRobotDataset opens these folders.
DATA_SCHEMA = {
    "observation.state": pa.list_(F32, 6),
    "observation.environment_state": pa.list_(F32, 5),
    "action": pa.list_(F32, 6),
    "clothrf.valid": pa.bool_(),
    "clothrf.anchors": pa.list_(F64, 3),
    "clothrf.labels": pa.list_(F64, 12),
    "clothrf.executed": pa.list_(F64, 6),
    "clothrf.grasps": pa.list_(F64, 6),
    "clothrf.hands": pa.list_(F64, 6),
    "clothrf.by_expert": pa.bool_(),
    "clothrf.confidence": F64,
    "clothrf.feasible": pa.bool_(),
    "timestamp": F32,
    "frame_index": I64,
    "episode_index": I64,
    "index": I64,
    "task_index": I64,
}
EPISODE_SCHEMA = {
    "episode_index": I64,
    "tasks": pa.list_(pa.string()),
    "length": I64,
    "data/chunk_index": I64,
    "data/file_index": I64,
    "dataset_from_index": I64,
    "dataset_to_index": I64,
    "meta/episodes/chunk_index": I64,
    "meta/episodes/file_index": I64,
}


def export(folder, out, **options):
    registry = Registry.of()
    return writer.export(open_source(folder, registry, 10.0), registry, out, **options)


@pytest.fixture
def exported(dataset, tmp_path):
    out = tmp_path / "out"
    assert export(dataset.folder, out) == 4
    return out


def table(folder, kind, index):
    return pq.read_table(io.BytesIO((folder / kind / FILE.format(index)).read_bytes()))


def test_the_info_is_that_of_the_format(exported):
    info = json.loads((exported / "meta/info.json").read_text())
    features = info.pop("features")
    assert info == {
        "codebase_version": "v3.0",
        "robot_type": "clothrf",
        "total_episodes": 4,
        "total_frames": 22,
        "total_tasks": 2,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": 10,
        "splits": {"heldout": "0:1", "train": "1:4"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
    }
    assert list(features) == list(DATA_SCHEMA)
    assert features["action"] == {
        "dtype": "float32",
        "shape": [6],
        "names": [f"gripper{i}.{a}" for i in (0, 1) for a in "xyz"],
    }
    assert features["clothrf.labels"]["names"][6:9] == [f"bent.gripper0.{a}" for a in "xyz"]
    assert features["timestamp"] == {"dtype": "float32", "shape": [1], "names": None}


def test_a_data_file_has_the_columns_and_types_of_the_format(exported):
    schema = table(exported, "data", 2).schema
    assert {field.name: field.type for field in schema} == DATA_SCHEMA


def test_frames_are_numbered_through_and_timed_within_their_episode(exported):
    found = table(exported, "data", 2).to_pydict()
    assert found["index"] == [10, 11, 12, 13, 14]
    assert found["frame_index"] == [0, 1, 2, 3, 4]
    assert found["episode_index"] == [2] * 5
    assert found["timestamp"] == [float(np.float32(i / 10)) for i in range(5)]
    assert found["task_index"] == [1] * 5


def test_the_action_is_where_the_rollouts_own_expert_wants_the_grippers(dataset, exported):
    rollout = read_rollout(dataset.path(1, 1))
    action = np.array(table(exported, "data", 2)["action"].to_pylist())
    assert np.array_equal(action, rollout.labels[:, 1].reshape(5, 6).astype(np.float32))


def test_an_episode_says_where_its_frames_are(exported):
    found = table(exported, "meta/episodes", 3)
    plain = [field for field in found.schema if not field.name.startswith("stats/")]
    assert {field.name: field.type for field in plain} == EPISODE_SCHEMA
    [row] = found.select([field.name for field in plain]).to_pylist()
    assert row["tasks"] == ["straight"]
    assert (row["dataset_from_index"], row["dataset_to_index"], row["length"]) == (15, 22, 7)
    assert (row["data/chunk_index"], row["data/file_index"]) == (0, 3)


def test_tasks_are_a_pandas_frame_indexed_by_their_words(exported):
    schema = pq.read_schema(exported / "meta/tasks.parquet")
    assert json.loads(schema.metadata[b"pandas"])["index_columns"] == ["task"]
    rows = pq.read_table(exported / "meta/tasks.parquet").to_pylist()
    assert rows == [{"task_index": 0, "task": "straight"}, {"task_index": 1, "task": "bent"}]


def test_statistics_of_the_whole_are_those_of_all_rows(dataset, exported):
    rollouts = [read_rollout(p) for k in ("heldout", "iteration") for p in dataset.paths(kind=k)]
    features = np.concatenate([r.features for r in rollouts]).astype(float)
    found = json.loads((exported / "meta/stats.json").read_text())["observation.environment_state"]
    assert found["count"] == [22]
    for name in ("min", "max", "mean", "std"):
        assert np.allclose(found[name], getattr(features, name)(axis=0), rtol=1e-12)


def test_it_comes_back_bit_for_bit(dataset, exported, tmp_path, contents):
    made = import_dataset(exported, tmp_path / "back")
    assert (made.rollouts, made.held_out, made.rows) == (4, 1, 22)
    assert contents(tmp_path / "back") == contents(dataset.folder)


def test_an_interrupted_export_is_whole_at_every_write_and_goes_on(
    dataset, tmp_path, contents, monkeypatch
):
    """The disk fails at write 1, 2, 3, ...: what is there opens, and the next try finishes it."""
    monkeypatch.setattr(files.os, "fsync", lambda handle: None)  # slow, and no power is cut here
    for path in (dataset.path(0, 0, kind="heldout"), dataset.path(2, 0)):
        path.unlink()
    export(dataset.folder, tmp_path / "whole")
    wanted, finished = contents(tmp_path / "whole"), set()
    for failing in range(1, 60):
        out, left = tmp_path / f"out{failing}", [failing]

        def fsync(handle, left=left):
            left[0] -= 1
            if left[0] == 0:
                raise OSError(5, "torn")

        with monkeypatch.context() as patch:
            patch.setattr(files.os, "fsync", fsync)
            try:
                export(dataset.folder, out)
            except OSError:
                pass
            else:
                break
        if (out / "meta/info.json").exists():
            back = tmp_path / f"back{failing}"
            made = import_dataset(out, back).rollouts
            assert made == json.loads((out / "meta/info.json").read_text())["total_episodes"]
            assert contents(back).items() <= contents(dataset.folder).items()
            finished.add(made)
        export(dataset.folder, out)
        assert contents(out) == wanted
    assert finished == {1, 2}


def test_going_on_writes_only_what_is_missing(dataset, tmp_path, rng):
    out, seen = tmp_path / "out", []

    def stop():
        seen.append(1)
        if len(seen) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(dataset.folder, out, on_episode=stop)
    assert export(dataset.folder, out) == 2
    assert export(dataset.folder, out) == 0


def test_a_rollout_that_changed_is_written_again(dataset, exported):
    path = dataset.path(1, 0)
    path.write_bytes(dataset.path(1, 1).read_bytes())
    assert export(dataset.folder, exported) == 3  # and those after it, whose frames moved


def test_while_an_episode_is_replaced_only_those_before_it_are_promised(
    dataset, exported, tmp_path, monkeypatch
):
    dataset.path(1, 1).write_bytes(dataset.path(1, 0).read_bytes())
    monkeypatch.setattr(writer, "_write", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        export(dataset.folder, exported)
    assert import_dataset(exported, tmp_path / "back").rollouts == 2
    dataset.path(0, 0, kind="heldout").write_bytes(dataset.path(1, 0).read_bytes())
    with pytest.raises(ZeroDivisionError):
        export(dataset.folder, exported)
    assert not (exported / "meta/info.json").exists()


@pytest.mark.parametrize("stranger", ["notes.txt", "data/chunk-000/file-000.parquet"])
def test_it_writes_into_no_folder_of_somebody_else(dataset, tmp_path, stranger):
    path = tmp_path / "out" / stranger
    path.parent.mkdir(parents=True)
    pq.write_table(pa.table({"action": [1.0]}), path)
    before = path.read_bytes()
    with pytest.raises(DataError, match=f"found {path.name}; choose another"):
        export(dataset.folder, tmp_path / "out")
    assert path.read_bytes() == before


def test_a_data_set_without_its_run_must_say_how_fast_it_is(dataset):
    with pytest.raises(DataError, match="say it: --fps"):
        open_source(dataset.folder, Registry.of(), None)


def test_a_folder_that_is_neither_run_nor_data_set_is_named(tmp_path):
    with pytest.raises(DataError, match="found neither"):
        open_source(tmp_path, Registry.of(), 10.0)
