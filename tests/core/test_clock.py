from clothrf_core.clock import ManualClock, WallClock, ticks


def test_ticks_come_at_the_rate():
    clock = ManualClock()
    stamps = [clock.now_ns() for _ in ticks(clock, 100.0, count=4)]
    assert stamps == [0, 10_000_000, 20_000_000, 30_000_000]


def test_one_late_tick_does_not_shift_the_next():
    clock = ManualClock()
    stamps = []
    for sequence in ticks(clock, 100.0, count=4):
        stamps.append(clock.now_ns())
        if sequence == 1:
            clock.sleep_until_ns(clock.now_ns() + 12_000_000)
    assert stamps == [0, 10_000_000, 22_000_000, 30_000_000]


def test_after_a_long_pause_ticks_do_not_burst():
    clock = ManualClock()
    stamps = []
    for sequence in ticks(clock, 100.0, count=4):
        stamps.append(clock.now_ns())
        if sequence == 0:
            clock.sleep_until_ns(95_000_000)
    assert stamps[1:] == [95_000_000, 105_000_000, 115_000_000]


def test_the_wall_clock_waits_until_the_deadline():
    clock = WallClock()
    deadline = clock.now_ns() + 5_000_000
    clock.sleep_until_ns(deadline)
    assert clock.now_ns() >= deadline
