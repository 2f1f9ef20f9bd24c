"""Scheduling and threads are lent for a block and given back after it."""

import os

import pytest

from clothrf_core.punctual import alone, punctual


def test_scheduling_is_as_before_after_the_block():
    before = os.sched_getscheduler(0)
    with punctual(10) as granted:
        inside = os.sched_getscheduler(0)
    assert os.sched_getscheduler(0) == before
    assert (inside == os.SCHED_FIFO) == (granted == "SCHED_FIFO 10")


def test_priority_zero_asks_for_nothing():
    before = os.sched_getscheduler(0)
    with punctual(0) as granted:
        assert os.sched_getscheduler(0) == before
    assert granted == "default"


@pytest.mark.parametrize("error", [PermissionError, OSError])
def test_without_permission_the_block_runs_all_the_same(monkeypatch, error):
    def refused(*_):
        raise error

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    monkeypatch.setattr(os, "nice", refused)
    with punctual(10) as granted:
        assert granted == "default (no permission for SCHED_FIFO)"


def test_without_permission_for_real_time_it_is_at_least_nicer_for_the_block(monkeypatch):
    def refused(*_):
        raise PermissionError

    given = []
    monkeypatch.setattr(os, "sched_setscheduler", refused)
    monkeypatch.setattr(os, "nice", given.append)
    with punctual(10) as granted:
        assert granted == "nice -10"
    assert given == [-10, 10]


def test_a_core_is_kept_for_the_block_only():
    before = os.sched_getaffinity(0)
    with punctual(0, cpu=min(before)):
        assert os.sched_getaffinity(0) == {min(before)}
    assert os.sched_getaffinity(0) == before


def test_a_core_that_is_not_there_is_not_insisted_on():
    before = os.sched_getaffinity(0)
    with punctual(0, cpu=10_000):
        assert os.sched_getaffinity(0) == before


def test_opencv_has_one_thread_inside_and_its_own_after():
    cv2 = pytest.importorskip("cv2")
    before = cv2.getNumThreads()
    with alone():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before
