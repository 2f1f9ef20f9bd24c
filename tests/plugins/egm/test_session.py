"""What one arm's session answers, tick by tick; no sockets and no real time."""

from __future__ import annotations

import numpy as np
import pytest
from clothrf_egm.mapping import from_egm, to_egm
from clothrf_egm.messages import (
    Motion,
    Motors,
    Rapid,
    RobotMessage,
    SensorMessage,
    decode_sensor,
    encode_robot,
)
from clothrf_egm.session import Session, SessionRules

RULES = SessionRules(timeout=0.1, silence=0.1, start_tolerance=0.035, speed_reference=False)
CONTROLLER = ("127.0.0.1", 5000)
ARM = np.linspace(-0.3, 0.3, 7)
ZERO = np.zeros(7)


class Talk:
    """A controller that asks every 4 ms."""

    def __init__(self, rules: SessionRules = RULES) -> None:
        self.session = Session(rules)
        self.now = 1.0
        self.sequence = 0
        self.q = ARM

    def ask(self, **change: object) -> SensorMessage | None:
        self.now += 0.004
        joints, external = to_egm(self.q)
        robot = {
            "sequence": self.sequence,
            "time_ms": round(self.now * 1000),
            "joints": joints,
            "external": external,
            "motors": Motors.ON,
            "motion": Motion.RUNNING,
            "rapid": Rapid.RUNNING,
        }
        source = change.pop("source", CONTROLLER)
        message = RobotMessage(**{**robot, **change})  # type: ignore[arg-type]
        self.sequence = message.sequence + 1
        answer = self.session.answer(encode_robot(message), source, self.now)  # type: ignore[arg-type]
        return None if answer is None else decode_sensor(answer)

    def told(self, **change: object) -> np.ndarray:
        answer = self.ask(**change)
        assert answer is not None
        return from_egm(answer.joints, answer.external)

    def begin(self) -> Talk:
        for _ in range(3):
            self.ask()
            self.session.measured(self.now)
        return self

    def put(self, q: np.ndarray, qd: np.ndarray = ZERO) -> bool:
        if not self.session.accepts(q):
            return False
        self.session.put(q, qd, self.now)
        return True


def test_the_first_answers_are_what_was_measured():
    talk = Talk()
    np.testing.assert_allclose(talk.told(), ARM, atol=1e-14)
    talk.q = ARM + 0.5  # nobody commands; the arm is moved by hand
    np.testing.assert_allclose(talk.told(), ARM, atol=1e-14)


def test_nothing_is_measured_before_two_requests():
    talk = Talk()
    assert talk.session.measured(talk.now) is None
    talk.ask()
    assert talk.session.measured(talk.now) is None
    talk.ask()
    q, qd = talk.session.measured(talk.now)
    np.testing.assert_allclose(q, ARM, atol=1e-14)
    np.testing.assert_allclose(qd, 0.0)


def test_speeds_are_differences_over_the_controllers_clock():
    talk = Talk().begin()
    talk.q = ARM + 0.004
    talk.ask()
    _, qd = talk.session.measured(talk.now)
    np.testing.assert_allclose(qd, 1.0, rtol=1e-9)


def test_a_put_posture_is_in_the_next_answer():
    talk = Talk().begin()
    assert talk.put(ARM + 0.01)
    np.testing.assert_allclose(talk.told(), ARM + 0.01, atol=1e-14)


def test_the_first_posture_must_be_near_the_arm_and_later_ones_need_not():
    talk = Talk().begin()
    assert not talk.put(ARM + 0.05)
    np.testing.assert_allclose(talk.told(), ARM, atol=1e-14)
    assert talk.put(ARM + 0.03)
    assert talk.put(ARM + 0.06)
    np.testing.assert_allclose(talk.told(), ARM + 0.06, atol=1e-14)


def test_every_request_gets_one_answer_and_answers_are_numbered():
    talk = Talk()
    answers = [talk.ask() for _ in range(20)]
    assert [answer.sequence for answer in answers] == list(range(20))
    assert talk.session.counters.requests == 20


def test_silence_of_the_bridge_holds_the_last_posture_at_speed_zero():
    rules = SessionRules(timeout=0.1, silence=0.1, start_tolerance=0.035, speed_reference=True)
    talk = Talk(rules).begin()
    talk.put(ARM + 0.01, np.full(7, 0.5))
    np.testing.assert_allclose(talk.ask().speeds, np.degrees(0.5))
    for _ in range(30):
        answer = talk.ask()
    np.testing.assert_allclose(from_egm(answer.joints, answer.external), ARM + 0.01, atol=1e-14)
    np.testing.assert_allclose(answer.speeds, 0.0)
    assert talk.session.counters.silent > 0


def test_no_speeds_are_sent_unless_asked_for():
    talk = Talk().begin()
    talk.put(ARM, np.ones(7))
    assert talk.ask().speeds == ()


def test_sequence_zero_forgets_the_old_target():
    talk = Talk().begin()
    talk.put(ARM + 0.03)
    talk.ask()
    talk.q = ARM - 0.5  # the arm was jogged while the program was stopped

    np.testing.assert_allclose(talk.told(sequence=0), ARM - 0.5, atol=1e-14)

    assert not talk.put(ARM + 0.03)
    np.testing.assert_allclose(talk.told(), ARM - 0.5, atol=1e-14)
    assert talk.session.counters.sessions == 2


def test_a_restart_is_seen_once_even_if_the_bridge_was_slow():
    talk = Talk().begin()
    talk.put(ARM)
    talk.ask(sequence=0)
    talk.ask()
    talk.ask()
    assert not talk.put(ARM), "near, but the bridge has not seen the restart"
    assert talk.session.measured(talk.now) is None
    assert talk.session.measured(talk.now) is not None
    assert talk.put(ARM)


def test_a_sequence_far_back_is_a_new_session_too():
    talk = Talk().begin()
    for _ in range(40):
        talk.ask()
    talk.put(ARM + 0.02)
    assert talk.ask(sequence=3) is not None  # request 0 to 2 of the new session were lost
    assert talk.session.counters.sessions == 2


def test_a_request_out_of_order_is_not_answered():
    talk = Talk().begin()
    for _ in range(20):
        talk.ask()
    newest = talk.sequence
    assert talk.ask(sequence=newest - 3) is None
    assert talk.ask(sequence=newest - 1) is None, "twice the same"
    assert talk.ask(sequence=newest) is not None
    assert talk.session.counters.reordered == 2
    assert talk.session.counters.sessions == 1


def test_lost_requests_are_counted():
    talk = Talk().begin()
    talk.ask(sequence=talk.sequence + 4)
    assert talk.session.counters.lost == 4


def test_a_second_sender_is_ignored_while_the_first_speaks():
    talk = Talk().begin()
    talk.put(ARM + 0.01)
    assert talk.ask(source=("127.0.0.1", 6000), sequence=0) is None
    assert talk.session.counters.foreign == 1
    assert talk.session.counters.sessions == 1


def test_another_sender_may_begin_once_the_first_is_silent():
    talk = Talk().begin()
    talk.put(ARM + 0.01)
    talk.now += 0.2
    np.testing.assert_allclose(talk.told(source=("127.0.0.1", 6000), sequence=500), ARM, atol=1e-14)
    assert talk.session.counters.sessions == 2


def test_silence_of_the_controller_ends_the_session():
    talk = Talk().begin()
    talk.put(ARM + 0.02)
    assert talk.session.measured(talk.now + 0.09) is not None
    assert talk.session.measured(talk.now + 0.11) is None
    talk.now += 0.11
    np.testing.assert_allclose(talk.told(), ARM, atol=1e-14)
    assert talk.session.counters.sessions == 2


@pytest.mark.parametrize(
    "change",
    [{"motors": Motors.OFF}, {"motion": Motion.STOPPED}, {"rapid": Rapid.STOPPED}],
)
def test_an_arm_that_cannot_move_is_answered_with_where_it_is(change):
    talk = Talk().begin()
    talk.put(ARM + 0.02)
    talk.q = ARM + 0.2
    np.testing.assert_allclose(talk.told(**change), ARM + 0.2, atol=1e-14)
    assert talk.session.measured(talk.now) is None
    assert not talk.put(ARM + 0.2)
    talk.q = ARM + 0.3
    np.testing.assert_allclose(talk.told(**change), ARM + 0.3, atol=1e-14)


def test_motors_switched_on_again_do_not_continue_the_old_target():
    talk = Talk().begin()
    talk.put(ARM + 0.02)
    talk.ask(motors=Motors.OFF)
    np.testing.assert_allclose(talk.told(), ARM, atol=1e-14)
    assert not talk.put(ARM + 0.02), "the restart has not been seen"
    assert talk.session.measured(talk.now) is None
    assert talk.put(ARM + 0.02)


@pytest.mark.parametrize("data", [b"", b"\xff" * 40, encode_robot(RobotMessage(0, 0, (), ()))])
def test_broken_requests_are_counted_and_not_answered(data):
    session = Session(RULES)
    assert session.answer(data, CONTROLLER, 1.0) is None
    assert session.counters.broken == 1


def test_angles_that_are_not_finite_are_broken():
    talk = Talk()
    assert talk.ask(joints=(np.nan,) * 6) is None
    assert talk.ask(external=(np.inf,)) is None
    assert talk.session.counters.broken == 2
