"""Parquet files as bytes and back; a torn one is named, with what to do."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from clothrf_core.errors import DataError, suggestion


def parquet_bytes(table: pa.Table) -> bytes:
    """`table` as a file of one row group; equal tables give equal bytes."""
    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="snappy", use_dictionary=False)
    return buffer.getvalue()


def read_table(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows of a Parquet file; of some columns only, if they are named.

    Raises:
        DataError: missing, torn, or without one of the columns.
    """
    try:
        with path.open("rb") as file:
            there = pq.ParquetFile(file)
            for name in columns or ():
                if name not in there.schema_arrow.names:
                    raise DataError(
                        f"{path}: expected column '{name}', found none. "
                        f"{suggestion(name, there.schema_arrow.names)}"
                    )
            return there.read(None if columns is None else list(columns))
    except FileNotFoundError as error:
        raise DataError(f"{path}: expected a Parquet file, found none") from error
    except (pa.ArrowException, OSError) as error:
        raise _torn(path, error) from error


def read_schema(path: Path) -> pa.Schema:
    """Names, types and metadata of a Parquet file, without its rows.

    Raises:
        DataError: torn.
    """
    try:
        with path.open("rb") as file:
            return pq.read_schema(file)
    except (pa.ArrowException, OSError) as error:
        raise _torn(path, error) from error


def tasks_table(tasks: Sequence[str]) -> pa.Table:
    """``meta/tasks.parquet``: as pandas writes a frame of task_index indexed by the words."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": list(tasks)})
    described = [
        {
            "name": name,
            "field_name": name,
            "pandas_type": kind,
            "numpy_type": kept,
            "metadata": None,
        }
        for name, kind, kept in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": described,
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }
    return table.replace_schema_metadata({b"pandas": json.dumps(pandas).encode()})


def _torn(path: Path, error: Exception) -> DataError:
    reason = str(error).splitlines()[0][:120]
    return DataError(
        f"{path}: expected an intact Parquet file, found a torn or foreign one ({reason}). "
        "Export or copy the data set again"
    )
