"""Importing: strangers' columns by name, and refusals that say what was expected and found."""

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clothrf_core import config, imitation
from clothrf_core.dataset import Dataset, read_rollout
from clothrf_core.errors import DataError
from clothrf_core.registry import Registry
from clothrf_core.run_folder import RunFolder

pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")

import pyarrow as pa
import pyarrow.parquet as pq
from clothrf_lerobot import writer
from clothrf_lerobot.layout import Info, parse_info
from clothrf_lerobot.reader import import_dataset
from clothrf_lerobot.source import open_source

DATA = "data/chunk-000/file-000.parquet"
LENGTHS = (3, 4, 5, 4)


def stranger(folder, tasks=("fold",), rng=None):
    """A data set as LeRobot's own recorder writes it: all episodes in one file."""
    rng = rng or np.random.default_rng(3)
    count = sum(LENGTHS)
    state = rng.normal(size=(count, 9)).astype(np.float32)
    action = rng.normal(size=(count, 7)).astype(np.float32)
    episode = np.repeat(np.arange(len(LENGTHS)), LENGTHS)
    columns = {
        "observation.state": pa.FixedSizeListArray.from_arrays(state.ravel(), 9),
        "action": pa.array(action.tolist(), pa.list_(pa.float32())),
        "timestamp": np.concatenate([np.arange(n) for n in LENGTHS]).astype(np.float32),
        "frame_index": np.concatenate([np.arange(n) for n in LENGTHS]),
        "episode_index": episode,
        "index": np.arange(count),
        "task_index": episode % len(tasks),
    }
    kinds = {"observation.state": ("float32", [9]), "action": ("float32", [7])}
    features = {
        key: {"dtype": kinds.get(key, ("int64", [1]))[0], "shape": kinds.get(key, ("", [1]))[1]}
        for key in columns
    }
    info = {
        "codebase_version": "v3.0",
        "fps": 30,
        "features": features,
        "total_episodes": len(LENGTHS),
        "total_frames": count,
    }
    (folder / DATA).parent.mkdir(parents=True)
    (folder / "meta").mkdir()
    pq.write_table(pa.table(columns), folder / DATA)
    (folder / "meta/info.json").write_text(json.dumps(info))
    listed = pa.table({"task_index": range(len(tasks)), "__index_level_0__": list(tasks)})
    pq.write_table(listed, folder / "meta/tasks.parquet")
    return state, action


COLUMNS = ("labels=action[1:7]", "grasps=observation.state[0:6]", "features=observation.state")


def test_a_strangers_columns_are_taken_by_name(tmp_path):
    state, action = stranger(tmp_path / "in")
    made = import_dataset(tmp_path / "in", tmp_path / "out", columns=COLUMNS)
    assert (made.rollouts, made.held_out, made.rows, made.tasks) == (4, 1, 16, ("fold",))
    rollout = read_rollout(tmp_path / "out/iteration_001/rollout_0000.npz")
    rows = slice(3, 7)
    assert np.array_equal(rollout.features, state[rows])
    assert np.array_equal(rollout.labels.reshape(4, 6), action[rows, 1:].astype(float))
    assert np.array_equal(rollout.grasps.reshape(4, 6), state[rows, :6].astype(float))
    assert not rollout.anchors.any()


def test_several_columns_are_joined_and_keep_distinct_names(tmp_path):
    stranger(tmp_path / "in")
    joined = "features=observation.state[0:2],action[0:1],observation.state[0:1]"
    import_dataset(
        tmp_path / "in", tmp_path / "out", columns=(*COLUMNS[:2], joined, "anchors=action[0:3]")
    )
    names = Dataset.open(tmp_path / "out").names
    assert len(names) == 4
    assert names[2] == "action.action[0]"


def test_one_task_of_several_is_chosen(tmp_path):
    stranger(tmp_path / "in", tasks=("fold", "lift"))
    made = import_dataset(tmp_path / "in", tmp_path / "out", columns=COLUMNS, task="lift")
    assert (made.rollouts, made.tasks) == (2, ("lift",))


def test_a_policy_is_cloned_from_an_import(tmp_path, toy, toy_experiment):
    stranger(tmp_path / "in")
    import_dataset(tmp_path / "in", tmp_path / "out", columns=COLUMNS)
    run = RunFolder.start(tmp_path / "run", config.load(toy_experiment, toy), resume=False)

    class Silent:
        advance = finished = staticmethod(lambda _: None)

    [record] = imitation.clone(run, toy, Dataset.open(tmp_path / "out"), Silent())
    assert record["samples"] == 13
    assert run.metrics() == [record]
    assert (run.best / "clothrf.json").exists()


def test_a_damaged_file_is_named(tmp_path, dataset):
    registry = Registry.of()
    out = tmp_path / "lerobot"
    writer.export(open_source(dataset.folder, registry, 10.0), registry, out)
    path = out / "data/chunk-000/file-002.parquet"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(DataError, match=r"file-002.parquet: expected an intact Parquet file"):
        import_dataset(out, tmp_path / "back")
    assert not (tmp_path / "back").exists()


def test_a_missing_episode_is_missed(tmp_path, dataset):
    registry = Registry.of()
    out = tmp_path / "lerobot"
    writer.export(open_source(dataset.folder, registry, 10.0), registry, out)
    (out / "data/chunk-000/file-002.parquet").unlink()
    with pytest.raises(DataError, match="expected 4 episodes, found 3"):
        import_dataset(out, tmp_path / "back")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"columns": ()}, r"'action' as labels: expected 6 numbers .* found 7"),
        ({"columns": ("labels=actoin",)}, "Did you mean 'action'"),
        ({"columns": ("label=action",)}, "Did you mean 'labels'"),
        ({"columns": ("labels=action[1:",)}, r"expected column or column\[first:stop\]"),
        ({"columns": ("labels=action,action",)}, "expected one column, found 2"),
        ({"columns": COLUMNS, "task": "iron"}, "no task 'iron'"),
    ],
)
def test_a_wrong_mapping_says_what_is_wrong(tmp_path, options, message):
    stranger(tmp_path / "in")
    with pytest.raises(DataError, match=message):
        import_dataset(tmp_path / "in", tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_several_tasks_must_be_told_apart(tmp_path):
    stranger(tmp_path / "in", tasks=("fold", "lift"))
    with pytest.raises(DataError, match="expected one task, found 2: fold, lift.*choose one"):
        import_dataset(tmp_path / "in", tmp_path / "out", columns=COLUMNS)


def test_a_column_of_words_is_refused(tmp_path):
    stranger(tmp_path / "in")
    table = pq.read_table(tmp_path / "in" / DATA)
    words = pa.array(["x"] * len(table))
    pq.write_table(table.set_column(1, "action", words), tmp_path / "in" / DATA)
    with pytest.raises(DataError, match="column 'action': expected numbers, found string"):
        import_dataset(tmp_path / "in", tmp_path / "out", columns=COLUMNS)


def test_a_column_with_gaps_is_refused(tmp_path):
    stranger(tmp_path / "in")
    table = pq.read_table(tmp_path / "in" / DATA)
    gaps = pa.array([None, *table["action"].to_pylist()[1:]], pa.list_(pa.float32()))
    pq.write_table(table.set_column(1, "action", gaps), tmp_path / "in" / DATA)
    with pytest.raises(DataError, match="expected a number in every row, found 1 gap"):
        import_dataset(tmp_path / "in", tmp_path / "out", columns=COLUMNS)


def test_a_column_that_the_info_promises_must_be_in_the_files(tmp_path):
    stranger(tmp_path / "in")
    table = pq.read_table(tmp_path / "in" / DATA)
    pq.write_table(table.drop_columns(["action"]), tmp_path / "in" / DATA)
    with pytest.raises(DataError, match="expected column 'action', found none"):
        import_dataset(tmp_path / "in", tmp_path / "out", columns=COLUMNS)


@pytest.mark.parametrize(
    ("version", "message"),
    [("v2.1", "Convert it with LeRobot's"), ("v4.0", "Update clothrf"), (3, "valid string")],
)
def test_another_version_is_refused(tmp_path, version, message):
    stranger(tmp_path / "in")
    path = tmp_path / "in/meta/info.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "codebase_version": version}))
    with pytest.raises(DataError, match=message):
        import_dataset(tmp_path / "in", tmp_path / "out", columns=COLUMNS)


def test_an_existing_folder_is_not_touched(tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(DataError, match="expected a new folder"):
        import_dataset(tmp_path, tmp_path / "out")


def test_a_folder_without_info_is_named(tmp_path):
    with pytest.raises(DataError, match="expected a LeRobotDataset"):
        import_dataset(tmp_path, tmp_path / "out")


ANY_SPEED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=8,
)
FEATURE = st.fixed_dictionaries(
    {"dtype": st.text(max_size=8), "shape": st.lists(st.integers(1, 9), max_size=3)},
    optional={"names": JSON},
)
INFO = st.fixed_dictionaries(
    {
        "codebase_version": st.sampled_from(["v3.0", "3.0", "v3.1"]),
        "fps": st.integers(1, 500) | st.floats(0.1, 500.0),
        "features": st.dictionaries(st.text(max_size=8), FEATURE, max_size=4),
        "total_episodes": st.integers(0, 10**9),
        "total_frames": st.integers(0, 10**12),
    },
    optional={"robot_type": st.none() | st.text(max_size=8), "anything": JSON},
)


@ANY_SPEED
@given(JSON)
def test_whatever_stands_in_an_info_it_is_refused_in_words(value):
    with pytest.raises(DataError, match="expected"):
        parse_info(value, "info.json")


@ANY_SPEED
@given(INFO)
def test_a_good_info_is_read_and_every_number_has_a_name(value):
    info = parse_info(value, "info.json")
    assert isinstance(info, Info)
    for key, feature in info.features.items():
        assert len(feature.flat_names(key)) == int(np.prod(feature.shape, dtype=int))


@ANY_SPEED
@given(INFO, st.data())
def test_a_good_info_with_one_thing_wrong_is_refused_by_its_name(value, data):
    key = data.draw(st.sampled_from(["fps", "features", "total_episodes", "total_frames"]))
    wrong = data.draw(st.sampled_from([None, -1, "many", [], float("nan")]))
    with pytest.raises(DataError, match=key):
        parse_info({**value, key: wrong}, "info.json")
