import errno
import os

import numpy as np
import pytest

from clothrf_core import files
from clothrf_core.errors import DataError, StorageFull


def test_a_written_file_holds_the_bytes_and_nothing_is_left_beside_it(tmp_path):
    files.atomic_write(tmp_path / "a.bin", b"new")
    assert (tmp_path / "a.bin").read_bytes() == b"new"
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]


def test_a_full_disk_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageFull, match="no space left on the disk"):
        files.atomic_write(path, b"new")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]


def test_a_folder_appears_whole(tmp_path):
    with files.atomic_folder(tmp_path / "f") as temporary:
        (temporary / "x").write_text("1")
        assert not (tmp_path / "f").exists()
    assert (tmp_path / "f" / "x").read_text() == "1"
    assert [p.name for p in tmp_path.iterdir()] == ["f"]


def test_a_folder_whose_block_fails_never_appears(tmp_path):
    def fail():
        with files.atomic_folder(tmp_path / "f") as temporary:
            (temporary / "x").write_text("1")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_replaced_as_a_whole(tmp_path):
    for text in ("1", "2"):
        with files.atomic_folder(tmp_path / "f") as temporary:
            (temporary / text).write_text(text)
    assert [p.name for p in (tmp_path / "f").iterdir()] == ["2"]


def test_equal_arrays_give_equal_bytes():
    arrays = {"a": np.arange(5.0), "b": np.zeros((2, 3), np.float32)}
    assert files.npz_bytes(arrays) == files.npz_bytes({k: v.copy() for k, v in arrays.items()})


def test_a_flipped_byte_in_an_array_file_is_found(tmp_path):
    path = tmp_path / "a.npz"
    data = bytearray(files.npz_bytes({"a": np.arange(1000.0)}))
    data[3000] ^= 1
    path.write_bytes(data)
    with pytest.raises(DataError, match="found a damaged one"):
        files.read_npz(path)


def test_a_truncated_array_file_is_found(tmp_path):
    path = tmp_path / "a.npz"
    path.write_bytes(files.npz_bytes({"a": np.arange(1000.0)})[:-200])
    with pytest.raises(DataError, match="expected an intact .npz file"):
        files.read_npz(path)


def test_a_file_with_pickled_objects_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, a=np.array([{"x": 1}], dtype=object))
    with pytest.raises(DataError):
        files.read_npz(path)
