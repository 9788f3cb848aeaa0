"""The delete-block jackknife: exact deletions, blocks in time, parameters that a single block determines."""

from __future__ import annotations

import numpy as np
import pytest

from didim.regression.covariance import (
    Branches,
    Factors,
    deletion_covariance,
    independent,
    intervals,
    rescaled,
)
from didim.terms.rows import Block, LinearSystem, stacked

ROWS, COLUMNS, JOINTS = 60, 7, 3


def rows_of(count: int) -> list[np.ndarray]:
    return [item.rows for item in intervals(stacked(JOINTS, [ROWS]), count)]


def weighted_system(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    scales = 10.0 ** rng.uniform(-2.0, 2.0, COLUMNS)
    a = rng.standard_normal((JOINTS * ROWS, COLUMNS)) * scales
    y = a @ (1.0 / scales) + rng.standard_normal(JOINTS * ROWS)
    return a, y


def factors(a: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    q, r = np.linalg.qr(a)
    x = np.linalg.solve(r, q.T @ y)
    return q, np.linalg.inv(r), x, y - a @ x


def test_deletions_are_those_of_solving_again_without_a_block() -> None:
    a, y = weighted_system()
    q, inverse, x, residual = factors(a, y)
    blocks = rows_of(20)
    found = Factors(q, q, inverse, residual).jackknife(blocks)
    size = np.sqrt(np.sum(inverse**2, axis=1))
    for block, deletion in zip(blocks, found.deletions, strict=True):
        kept = np.setdiff1d(np.arange(len(y)), block)
        again = np.linalg.lstsq(a[kept], y[kept], rcond=None)[0]
        assert np.abs((deletion - (again - x)) / size).max() < 1e-9
    assert 0.0 < found.leverage < 1.0
    assert (found.decisive == -1).all()


def test_branches_have_the_deletions_of_the_whole_system() -> None:
    rng = np.random.default_rng(3)
    blocks = stacked(4, [ROWS])
    w = rng.standard_normal((4 * ROWS, 9))
    # Joints 1 and 3 share columns 0 to 4, joints 2 and 4 the others.
    w.reshape(2, 2, ROWS, 9)[:, 0, :, 5:] = 0.0
    w.reshape(2, 2, ROWS, 9)[:, 1, :, :5] = 0.0
    weights, residual = rng.uniform(0.5, 2.0, 4 * ROWS), rng.standard_normal(4 * ROWS)
    system = LinearSystem(w=w, y=residual, blocks=blocks, names=tuple("abcdefghi"))
    whole = Factors.of(w * weights[:, None], residual * weights)
    branches = Branches.of(system, weights, residual)
    assert [columns.size for _, columns, _ in branches.parts] == [5, 4]
    np.testing.assert_allclose(
        branches.inverse @ branches.inverse.T, whole.inverse @ whole.inverse.T, atol=1e-13
    )
    left_out = [item.rows for item in intervals(blocks, 10)]
    expected, found = whole.jackknife(left_out), branches.jackknife(left_out)
    np.testing.assert_allclose(found.deletions, expected.deletions, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.information, expected.information, rtol=1e-9, atol=1e-12)
    assert found.leverage == pytest.approx(expected.leverage)


def test_deletions_with_instruments_are_those_of_solving_again() -> None:
    a, y = weighted_system()
    rng = np.random.default_rng(5)
    z = a * (1.0 + 0.1 * rng.standard_normal(a.shape))
    q = np.linalg.qr(z)[0]
    inverse = np.linalg.inv(q.T @ a)
    x = inverse @ (q.T @ y)
    blocks = rows_of(12)
    found = Factors(q, a @ inverse, inverse, y - a @ x).jackknife(blocks)
    size = np.sqrt(np.sum(inverse**2, axis=1))
    for block, deletion, shares in zip(blocks, found.deletions, found.information, strict=True):
        kept = np.setdiff1d(np.arange(len(y)), block)
        again = np.linalg.solve(z[kept].T @ a[kept], z[kept].T @ y[kept])
        assert np.abs((deletion - (again - x)) / size).max() < 1e-9
        inner = np.linalg.inv(z[kept].T @ a[kept])
        without = np.diag(inner @ (z[kept].T @ z[kept]) @ inner.T)
        assert shares == pytest.approx(1.0 - np.sum(inverse**2, axis=1) / without, abs=1e-9)


def test_the_covariance_is_that_of_independent_halves() -> None:
    # Two blocks: the estimate is nearly the mean of the halves, and the variance that of a mean of two.
    a = np.ones((10, 1))
    y = np.concatenate([np.zeros(5), np.ones(5)])
    q, inverse, x, residual = factors(a, y)
    found = Factors(q, q, inverse, residual).jackknife([np.arange(5), np.arange(5, 10)])
    assert found.deletions[:, 0] + x == pytest.approx([1.0, 0.0])
    assert found.covariance[0, 0] == pytest.approx(0.25)  # (1/2)((1 - 0)/2)^2 * 2
    assert deletion_covariance(found.deletions) == pytest.approx(found.covariance)


def test_a_parameter_of_one_block_alone_is_named_and_keeps_its_value_elsewhere() -> None:
    a, y = weighted_system()
    blocks = rows_of(10)
    outside = np.setdiff1d(np.arange(len(y)), blocks[3])
    a[outside, 2] = 0.0
    q, inverse, x, residual = factors(a, y)
    found = Factors(q, q, inverse, residual).jackknife(blocks)
    assert found.decisive[2] == 3
    assert (np.delete(found.decisive, 2) == -1).all()
    assert found.leverage == pytest.approx(1.0)
    assert np.isfinite(found.deletions).all()
    # What the other blocks do not show cannot move the other parameters either.
    kept = np.delete(np.arange(COLUMNS), 2)
    again = np.linalg.lstsq(a[np.ix_(outside, kept)], y[outside], rcond=None)[0]
    size = np.sqrt(np.sum(inverse**2, axis=1))[kept]
    assert np.abs((found.deletions[3][kept] - (again - x[kept])) / size).max() < 1e-6


def test_intervals_hold_every_row_once_and_none_spans_two_windows() -> None:
    # Two windows, of 30 and 90 rows per joint: joint by joint, windows one after the other within a joint.
    found = intervals(stacked(JOINTS, [30, 90], rates_hz=[10.0, 10.0]), 20)
    assert len(found) == 20
    assert np.array_equal(np.sort(np.concatenate([item.rows for item in found])), np.arange(360))
    for item in found:
        within = item.rows % 120
        assert ((within < 30) == (item.window == 0)).all()
        # All joints over the same interval.
        assert len(set(np.bincount(item.rows // 120).tolist())) == 1
    assert [item.window for item in found] == [0] * 5 + [1] * 15
    assert [item.start_s for item in found[:6]] == pytest.approx([0.0, 0.6, 1.2, 1.8, 2.4, 0.0])
    assert found[-1].stop_s == pytest.approx(9.0)


def test_a_slower_recording_has_intervals_of_the_same_duration() -> None:
    found = intervals(stacked(1, [100, 50], places=[(0, 0), (1, 0)], rates_hz=[10.0, 5.0]), 10)
    assert [item.recording for item in found] == [0] * 5 + [1] * 5
    assert {round(item.stop_s - item.start_s, 9) for item in found} == {2.0}


def test_more_windows_than_blocks_make_an_interval_each() -> None:
    assert [len(item.rows) for item in intervals(stacked(1, [4] * 30), 20)] == [4] * 30


def test_few_rows_make_few_intervals() -> None:
    assert len(intervals(stacked(2, [30]), 20)) == 10
    assert len(intervals(stacked(2, [9]), 20)) == 5
    assert len(intervals(stacked(2, [3]), 20)) == 3


def test_rows_sample_by_sample_are_divided_in_time_too() -> None:
    found = intervals([Block(slice(joint, 60, 3), joint) for joint in range(3)], 4)
    assert [sorted(item.rows) for item in found] == [list(range(15 * k, 15 * k + 15)) for k in range(4)]


def test_rescaling_keeps_the_correlations() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((4, 4))
    covariance = root @ root.T
    variances = np.array([1.0, 4.0, 0.0, 2.0])
    found = rescaled(covariance, variances)
    assert np.diag(found) == pytest.approx(variances)
    kept = [0, 1, 3]
    size, before = np.sqrt(variances[kept]), np.sqrt(np.diag(covariance)[kept])
    assert found[np.ix_(kept, kept)] / np.outer(size, size) == pytest.approx(
        covariance[np.ix_(kept, kept)] / np.outer(before, before)
    )


@pytest.mark.parametrize("time_constant", [0.0, 6.0])
def test_intervals_cover_white_and_correlated_noise(time_constant: float) -> None:
    # 300 rows of a motion, noise with a memory of six rows: the white deviation is far too small, the jackknife's is not.
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 20.0, 300)
    a = np.column_stack([np.sin(k * t + k) for k in range(1, 6)])
    q, inverse, _, _ = factors(a, t)
    blocks = [item.rows for item in intervals(stacked(1, [300]), 20)]
    keep = np.exp(-1.0 / time_constant) if time_constant else 0.0
    ratios, white = [], []
    for _ in range(150):
        noise = rng.standard_normal(600)
        for k in range(1, 600):
            noise[k] += keep * noise[k - 1]
        y = noise[300:]
        x = inverse @ (q.T @ y)
        residual = y - a @ x
        ratios.append(x / np.sqrt(np.diag(Factors(q, q, inverse, residual).jackknife(blocks).covariance)))
        white.append(x / np.sqrt(np.sum(inverse**2, axis=1) * (residual @ residual) / 295))
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.12)
    assert np.mean(np.abs(ratios) < 2.093) == pytest.approx(0.95, abs=0.03)
    if time_constant:
        assert np.sqrt(np.mean(np.square(white))) > 1.5


@pytest.mark.parametrize(("lasting", "share", "ratio"), [(1, 0.03, 1.0), (60, 0.9, 1.3)])
def test_intervals_are_doubled_where_neighbours_err_alike(lasting: int, share: float, ratio: float) -> None:
    rng = np.random.default_rng(2)
    blocks = stacked(2, [400])
    parts = intervals(blocks)  # of 20 rows a joint; an error lasts over so many
    w = np.column_stack([np.ones(800), rng.standard_normal((800, 3))])
    doubled, errors = [], []
    for _ in range(100):
        error = np.repeat(rng.standard_normal((2, 400 // lasting + 1)), lasting, axis=1)[:, :400].ravel()
        estimate = np.linalg.lstsq(w, error, rcond=None)[0]
        of = Factors.of(w, error - w @ estimate)
        single = of.jackknife([part.rows for part in parts])
        found = independent(of, blocks, parts, single)
        doubled.append(len(found.deletions) < 20)
        errors.append([estimate[0] / np.sqrt(each.covariance[0, 0]) for each in (single, found)])
    assert np.mean(doubled) == pytest.approx(share, abs=0.05)
    before, after = np.sqrt(np.mean(np.square(errors), axis=0))
    assert before / after == pytest.approx(ratio, abs=0.1)


def test_intervals_of_different_windows_are_no_neighbours() -> None:
    blocks = stacked(1, [10] * 20)
    parts = intervals(blocks)
    error = np.repeat([1.0, -2.0, 1.0, 2.0, -2.0], 40)  # over four intervals each
    of = Factors.of(np.ones((200, 1)), error)
    single = of.jackknife([part.rows for part in parts])
    assert independent(of, blocks, parts, single) is single
    one = stacked(1, [200])
    parts = intervals(one)
    assert len(independent(of, one, parts, of.jackknife([part.rows for part in parts])).deletions) == 10
