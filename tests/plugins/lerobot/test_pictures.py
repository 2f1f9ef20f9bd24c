"""Pictures are drawn again from the seeds, and refused when they would be of something else."""

import dataclasses
import io

import numpy as np
import pytest

from clothrf_core.compose import cached_workshop
from clothrf_core.dataset import read_rollout, write_rollout
from clothrf_core.errors import DataError

pytest.importorskip("pyarrow", reason="needs the extra 'lerobot'")

import pyarrow.parquet as pq
from clothrf_lerobot import writer
from clothrf_lerobot.layout import COLOUR, DEPTH
from clothrf_lerobot.reader import import_dataset
from clothrf_lerobot.source import open_source

av = pytest.importorskip("av")


@pytest.fixture
def frames(run, toy):
    """The frames of the second iteration's only roll-out, seen by listening to the camera."""
    from clothrf_lerobot import pictures

    source, seen = open_source(run.path, toy, None), []
    name = "iteration_002/rollout_0000.npz"
    job = pictures.replays_of(source, toy).jobs[name]
    pictures.replay(job, read_rollout(run.dataset / name), seen.append)
    assert cached_workshop(job.config).camera.__class__ is not pictures.Watched
    return seen


@pytest.fixture
def exported(run, toy, tmp_path):
    out = tmp_path / "out"
    source = open_source(run.path, toy, None)
    assert source.fps == 30.0
    assert writer.export(source, toy, out, pictures=True) == 4
    return out


def test_the_film_shows_what_the_policy_saw(exported, frames):
    film = exported / f"videos/{COLOUR}/chunk-000/file-003.mp4"
    with av.open(str(film)) as container:
        shown = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
        assert float(container.streams.video[0].average_rate) == 30.0
    assert len(shown) == len(frames) == 8
    for picture, frame in zip(shown, frames, strict=True):
        assert np.abs(picture.astype(int) - frame.rgb).mean() < 8.0
    assert np.ptp(frames[0].rgb) > 100


def test_depth_is_millimetres_and_nothing_where_nothing_was_measured(exported, frames):
    column = pq.read_table(exported / "data/chunk-000/file-003.parquet")[DEPTH].to_pylist()
    for entry, frame in zip(column, frames, strict=True):
        with av.open(io.BytesIO(entry["bytes"]), format="png_pipe") as container:
            [picture] = container.decode(video=0)
        found = picture.to_ndarray(format="gray16be")
        measured = np.isfinite(frame.depth)
        assert found.dtype == np.uint16
        assert np.abs(found[measured] - 1e3 * frame.depth[measured]).max() <= 0.5
        assert not found[~measured].any()


def test_the_info_describes_both_pictures(exported):
    from clothrf_lerobot.layout import read_info

    features = read_info(exported).features
    assert (features[COLOUR].dtype, features[COLOUR].shape) == ("video", (60, 80, 3))
    assert (features[DEPTH].dtype, features[DEPTH].shape) == ("image", (60, 80, 1))
    row = pq.read_table(exported / "meta/episodes/chunk-000/file-003.parquet").to_pylist()[0]
    assert row[f"videos/{COLOUR}/from_timestamp"] == 0.0
    assert row[f"videos/{COLOUR}/to_timestamp"] == pytest.approx(8 / 30)
    assert np.shape(row[f"stats/{COLOUR}/mean"]) == (3, 1, 1)
    assert np.shape(row[f"stats/{DEPTH}/mean"]) == (1, 1, 1)


def test_the_rows_come_back_bit_for_bit_beside_pictures(exported, run, tmp_path, contents):
    import_dataset(exported, tmp_path / "back")
    assert contents(tmp_path / "back") == contents(run.dataset)


def test_a_rollout_that_comes_out_differently_is_not_given_pictures(run, toy, tmp_path):
    path = run.dataset / "iteration_001" / "rollout_0000.npz"
    stored = read_rollout(path)
    write_rollout(path, dataclasses.replace(stored, anchors=stored.anchors + 1e-12))
    with pytest.raises(DataError, match="gives other anchors than were stored"):
        writer.export(open_source(run.path, toy, None), toy, tmp_path / "out", pictures=True)


def test_pictures_need_the_run(dataset, toy, tmp_path):
    source = open_source(dataset.folder, toy, 10.0)
    with pytest.raises(DataError, match="name the run folder, or leave --pictures out"):
        writer.export(source, toy, tmp_path / "out", pictures=True)
