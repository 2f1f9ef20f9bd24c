from __future__ import annotations

import numpy as np
from clothrf_forest.binning import Columns, edges, encoded, offered_columns
from clothrf_forest.rows import Rows
from hypothesis import given, settings
from hypothesis import strategies as st


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(-1e6, 1e6, width=32), min_size=2, max_size=400),
    st.sampled_from([2, 5, 256]),
)
def test_a_level_is_at_most_c_exactly_when_the_value_is_at_most_edge_c(values, levels) -> None:
    column = np.array(values, np.float32)[:, None]

    cuts = edges(column, levels)
    codes = encoded(Rows(column), offered_columns(1, 0, 1, np.random.default_rng(0)), cuts)

    assert len(cuts[0]) < levels
    assert (np.diff(cuts[0]) > 0).all()
    for c, edge in enumerate(cuts[0]):
        np.testing.assert_array_equal(codes[0] <= c, column[:, 0] <= edge)


def test_few_values_keep_a_level_each() -> None:
    column = np.array([3, 1, 2, 2, 7], np.float32)[:, None]

    codes = encoded(Rows(column), offered_columns(1, 0, 1, np.random.default_rng(0)), edges(column))

    np.testing.assert_array_equal(codes[0], [2, 0, 1, 1, 3])


def test_neighbouring_floats_are_still_separated() -> None:
    low = np.float32(1.0)
    column = np.array([low, np.nextafter(low, np.float32(2))], np.float32)[:, None]

    (cut,) = edges(column)

    assert column[0, 0] <= cut[0] < column[1, 0]


def test_many_values_fill_all_levels_evenly() -> None:
    column = np.random.default_rng(0).normal(size=(20_000, 1)).astype(np.float32)

    codes = encoded(Rows(column), offered_columns(1, 0, 1, np.random.default_rng(0)), edges(column))

    share = np.bincount(codes[0], minlength=256) / 20_000
    assert share.max() < 1.5 / 256
    assert share.min() > 0.5 / 256


def test_pairs_are_differences_of_two_different_features() -> None:
    values = np.random.default_rng(0).normal(size=(10, 6)).astype(np.float32)

    offered = offered_columns(6, 50, 6, np.random.default_rng(1))

    assert (offered.first[6:] != offered.second[6:]).all()
    found = offered.of(values)
    np.testing.assert_array_equal(found[:, :6], values)
    np.testing.assert_array_equal(
        found[:, 7], values[:, offered.first[7]] - values[:, offered.second[7]]
    )


def test_a_memory_mapped_file_gives_the_same_levels(tmp_path) -> None:
    values = np.random.default_rng(0).normal(size=(9000, 3)).astype(np.float32)
    mapped = np.memmap(tmp_path / "rows", np.float32, "w+", shape=values.shape)
    mapped[:] = values
    plain = Columns(np.arange(3, dtype=np.int32), np.full(3, -1, np.int32))
    cuts = edges(values)

    np.testing.assert_array_equal(
        encoded(Rows(mapped), plain, cuts, threads=2), encoded(Rows(values), plain, cuts)
    )
