"""The methods against what they are meant to compute."""

from __future__ import annotations

import numpy as np
import pytest
from clothrf_baselines.adam import Adam
from clothrf_baselines.cnn_answer import LAYERS, convolve, forward
from clothrf_baselines.config import (
    BaselineConfig,
    DepthNeighboursConfig,
    DictionaryConfig,
    HowNeighboursConfig,
    LassoConfig,
    MlpConfig,
    RidgeConfig,
    TreesConfig,
)
from clothrf_baselines.dictionary import SparseDictionary, sparse_word
from clothrf_baselines.lasso import LassoDictionary
from clothrf_baselines.linear import Linear, Ridge
from clothrf_baselines.method import Rows, folds, held_out
from clothrf_baselines.mlp import Mlp, _forward, _gradient, _start
from clothrf_baselines.neighbours import DepthNeighbours, HowNeighbours
from clothrf_baselines.trees import Trees
from sklearn.ensemble import ExtraTreesRegressor, RandomForestRegressor
from sklearn.linear_model import Lasso, LinearRegression
from sklearn.linear_model import Ridge as SklearnRidge

RNG = np.random.default_rng


@pytest.fixture
def rows():
    rng = RNG(3)
    x = rng.standard_normal((200, 12)).astype(np.float32)
    y = np.tanh(x @ rng.standard_normal((12, 6))) + 0.05 * rng.standard_normal((200, 6))
    return Rows(x, y, np.repeat(np.arange(20), 10), tuple(f"f{i}" for i in range(12)))


def answers(method, fitted, config, x):
    answer = method.predictor(fitted.arrays, config)
    return np.stack([answer(row) for row in x])


def test_linear_is_least_squares(rows):
    config = BaselineConfig()
    found = answers(Linear(), Linear().fit(rows, config, RNG(0)), config, rows.x)
    truth = LinearRegression().fit(rows.x.astype(float), rows.y).predict(rows.x.astype(float))
    np.testing.assert_allclose(found, truth, atol=1e-9)


def test_ridge_is_ridge(rows):
    config = RidgeConfig(alpha=12.0)
    found = answers(Ridge(), Ridge().fit(rows, config, RNG(0)), config, rows.x)
    truth = SklearnRidge(alpha=12.0).fit(rows.x.astype(float), rows.y)
    np.testing.assert_allclose(found, truth.predict(rows.x.astype(float)), atol=1e-9)


def test_ridge_chooses_more_strength_for_more_noise():
    rng = RNG(0)
    x = rng.standard_normal((120, 60)).astype(np.float32)
    clean = x @ rng.standard_normal((60, 3))
    groups = np.repeat(np.arange(12), 10)
    chosen = [
        Ridge().fit(
            Rows(x, clean + noise * rng.standard_normal(clean.shape), groups, ("f",) * 60),
            RidgeConfig(), RNG(0),
        ).metrics["alpha"]
        for noise in (0.01, 10.0)
    ]  # fmt: skip
    assert chosen[1] > 30 * chosen[0]


def test_the_gradient_of_the_net_is_the_finite_difference(rows):
    weights = {n: a.astype(np.float64) for n, a in _start(12, 7, 6, RNG(1)).items()}
    x, y = rows.x[:9].astype(float), rows.y[:9]
    gradient = _gradient(weights, x, y)

    def loss(w):
        return np.mean((_forward(w, x)[1] - y) ** 2)

    for name, index in (("w1", (2, 3)), ("b1", (4,)), ("w2", (5, 1)), ("b2", (0,))):
        ahead, behind = ({n: a.copy() for n, a in weights.items()} for _ in range(2))
        ahead[name][index] += 1e-6
        behind[name][index] -= 1e-6
        difference = (loss(ahead) - loss(behind)) / 2e-6
        assert gradient[name][index] == pytest.approx(difference, rel=1e-4, abs=1e-9)


def test_adam_finds_the_bottom_of_a_bowl():
    weights = {"w": np.array([3.0, -2.0], np.float32)}
    adam = Adam(weights, rate=0.05)
    for _ in range(400):
        weights = adam.step(weights, {"w": 2.0 * (weights["w"] - np.float32(1.0))})
    np.testing.assert_allclose(weights["w"], 1.0, atol=1e-2)


def test_the_net_learns_what_a_line_cannot():
    rng = RNG(0)
    x = rng.uniform(-2, 2, (800, 2)).astype(np.float32)
    y = np.abs(x[:, :1]) - np.abs(x[:, 1:])
    rows = Rows(x, y / y.std(), np.repeat(np.arange(40), 20), ("a", "b"))
    config = MlpConfig(hidden=32)
    fitted = Mlp().fit(rows, config, RNG(0))
    error = np.mean((answers(Mlp(), fitted, config, x) - rows.y) ** 2)
    assert error < 0.05
    assert fitted.metrics["held_out_error"] < 0.1


def test_neighbours_are_the_nearest_in_l1(rows):
    config = HowNeighboursConfig(k=3)
    query = rows.x[:10] + np.float32(0.1)
    found = answers(HowNeighbours(), HowNeighbours().fit(rows, config, RNG(0)), config, query)
    for row, answer in zip(query, found, strict=True):
        nearest = np.argsort(np.abs(rows.x - row).sum(axis=1))[:3]
        np.testing.assert_allclose(answer, rows.y[nearest].mean(axis=0))


def test_inverse_weights_return_a_known_row(rows):
    config = HowNeighboursConfig(k=5, weights="inverse")
    found = answers(HowNeighbours(), HowNeighbours().fit(rows, config, RNG(0)), config, rows.x[:5])
    np.testing.assert_allclose(found, rows.y[:5], atol=1e-6)


def depth_rows(count=30):
    rng = RNG(0)
    x = np.concatenate([rng.random((count, 4096)), rng.random((count, 6))], axis=1)
    names = tuple(f"depth64_r{i // 64:02d}_c{i % 64:02d}" for i in range(4096))
    names += tuple(f"depth64_grasp{i}_{a}" for i in range(2) for a in "xyz")
    return Rows(x.astype(np.float32), rng.random((count, 6)), np.arange(count), names)


def test_only_the_lower_half_of_the_picture_counts():
    rows = depth_rows()
    config = DepthNeighboursConfig(gate=0.0)
    answer = DepthNeighbours().predictor(DepthNeighbours().fit(rows, config, RNG(0)).arrays, config)
    query = np.array(rows.x[7])
    query[:2048] = 9.0
    assert np.array_equal(answer(query), rows.y[7])
    query[2048:4096] = rows.x[8, 2048:4096]
    assert np.array_equal(answer(query), rows.y[8])


def test_only_rows_with_like_grippers_count():
    rows = depth_rows()
    config = DepthNeighboursConfig(gate=0.05)
    answer = DepthNeighbours().predictor(DepthNeighbours().fit(rows, config, RNG(0)).arrays, config)
    query = np.array(rows.x[7])
    query[4096:] = rows.x[9, 4096:]
    assert np.array_equal(answer(query), rows.y[9])
    query[4096:] += 10.0
    assert answer(query) is None


def test_a_sparse_word_minimises_the_lasso():
    rng = RNG(0)
    atoms = rng.standard_normal((40, 25)).astype(np.float32)
    atoms /= np.linalg.norm(atoms, axis=1)[:, None]
    word = 2 * atoms[3] - atoms[17] + 0.05 * rng.standard_normal(25).astype(np.float32)
    chosen, mix = sparse_word(atoms, word, 0.1, working_set=40, iterations=3000)
    strength = 0.1 * np.abs(atoms @ word).max()
    truth = Lasso(alpha=strength / 25, fit_intercept=False, tol=1e-10, max_iter=20000)
    truth.fit(atoms.T.astype(float), word.astype(float))
    full = np.zeros(40)
    full[chosen] = mix
    np.testing.assert_allclose(full, truth.coef_, atol=2e-3)
    assert 2 <= (np.abs(full) > 1e-4).sum() < 15


def test_a_dictionary_of_all_rows_knows_its_rows(rows):
    config = DictionaryConfig(atoms=500, alpha=1e-3, working_set=200, iterations=2000)
    fitted = SparseDictionary().fit(rows, config, RNG(0))
    found = answers(SparseDictionary(), fitted, config, rows.x[:20])
    assert fitted.metrics["atoms"] == 200
    assert np.mean((found - rows.y[:20]) ** 2) < 0.2 * rows.y.var()


def test_the_dictionary_of_differences_is_a_lasso(rows):
    config = LassoConfig(alpha=0.02, pairs=50.0)
    fitted = LassoDictionary().fit(rows, config, RNG(0))
    found = answers(LassoDictionary(), fitted, config, rows.x)
    # Differences of two independent rows have twice the variance of a row.
    centred = rows.x - rows.x.mean(axis=0)
    truth = Lasso(alpha=0.01, fit_intercept=False).fit(centred, rows.y - rows.y.mean(axis=0))
    np.testing.assert_allclose(
        found, truth.predict(centred) + rows.y.mean(axis=0), atol=0.06 * rows.y.std()
    )
    sparse = LassoDictionary().fit(rows, LassoConfig(alpha=0.5), RNG(0))
    assert sparse.metrics["features_used"] < 12


@pytest.mark.parametrize(
    ("extra", "kind"), [(False, RandomForestRegressor), (True, ExtraTreesRegressor)]
)
def test_flattened_trees_answer_like_scikit_learn(rows, extra, kind):
    config = TreesConfig(trees=7, threads=1)
    method = Trees(extra=extra)
    fitted = method.fit(rows, config, RNG(5))
    truth = kind(
        n_estimators=7, max_features="sqrt", min_samples_leaf=2,
        random_state=int(RNG(5).integers(2**31)),
    ).fit(rows.x, rows.y)  # fmt: skip
    x = RNG(9).standard_normal((50, 12)).astype(np.float32)
    np.testing.assert_allclose(answers(method, fitted, config, x), truth.predict(x), atol=1e-6)


def test_trees_that_point_outside_are_refused(rows):
    config = TreesConfig(trees=2, threads=1)
    arrays = dict(Trees(extra=True).fit(rows, config, RNG(0)).arrays)
    for name, value in (("child", 10**6), ("roots", -1)):
        broken = np.array(arrays[name])
        broken[0] = value
        with pytest.raises(ValueError, match="point outside"):
            Trees(extra=True).predictor(arrays | {name: broken}, config)


def test_convolution_is_the_textbook_one():
    rng = RNG(0)
    picture = rng.standard_normal((3, 9, 9)).astype(np.float32)
    weights = rng.standard_normal((4, 3, 3, 3)).astype(np.float32)
    bias = rng.standard_normal(4).astype(np.float32)
    found = convolve(picture, weights, bias, 2)
    padded = np.pad(picture, ((0, 0), (1, 1), (1, 1)))
    expected = np.zeros((4, 5, 5))
    for o in range(4):
        for y in range(5):
            for x in range(5):
                block = padded[:, 2 * y : 2 * y + 3, 2 * x : 2 * x + 3]
                expected[o, y, x] = np.sum(block * weights[o]) + bias[o]
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_numpy_answers_like_torch():
    torch = pytest.importorskip("torch")
    from clothrf_baselines.cnn import _loss, _start

    weights = _start(4, 6, RNG(0))
    rng = RNG(1)
    picture = np.where(rng.random((64, 64)) < 0.5, 0.5 + 0.1 * rng.random((64, 64)), 0.0)
    picture = picture.astype(np.float32)
    extra = rng.standard_normal(4).astype(np.float32)
    answer = forward(weights, picture, extra)
    from clothrf_baselines.cnn_answer import channels

    data = (
        torch.from_numpy(channels(picture[None])),
        torch.from_numpy(extra[None]),
        torch.from_numpy(answer[None]),
    )
    loss = _loss({n: torch.from_numpy(a) for n, a in weights.items()}, data, np.array([0]))
    assert float(loss) < 1e-8
    assert len(LAYERS) == 4


def test_whole_roll_outs_are_held_out():
    groups = np.repeat([4, 7, 9, 11], 5)
    train, test = held_out(groups, 0.25, RNG(0))
    assert not set(groups[train]) & set(groups[test])
    assert len(train) == 15
    assert [len(part) for part in folds(groups, 3)] == [10, 5, 5]
    assert folds(np.zeros(5, int), 3) == []
    train, test = held_out(np.zeros(10, int), 0.2, RNG(0))
    assert list(test) == [8, 9]
