"""Scheduled gains: never above the tracked limit, rising by decibels per second, and a command without a step."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import gainroom as gr
from gainroom.design.gain_sets import RobotGains
from gainroom.robot.linearize import linearize
from independent.coupled import Coupled, sampled_radius
from robot_truths import BOTH, actuators, biped_posture, feet

TICK = 5e-4
OWN = {"double": ([400.0, 900.0, 50.0], [10.0, 30.0, 2.0]), "left": ([4000.0, 500.0, 60.0], [5.0, 40.0, 3.0])}
SAFE = ([400.0, 300.0, 50.0], [8.0, 20.0, 2.0])
MARGIN = 2.0


class Told:
    """A tracker that says what it was told to."""

    def __init__(self, safe_gain: float = math.inf, certified: bool = True):
        self.safe_gain, self.certified = safe_gain, certified

    def update(self, q, contact):
        return self


def scheduler(limit: Told | None = None, **options) -> gr.GainScheduler:
    trackers = dict.fromkeys(OWN, limit or Told())
    return gr.GainScheduler(gr.GainTable.of(OWN, SAFE), trackers, gr.Requirements(gain_margin=MARGIN), **options)


def gains_of(out) -> np.ndarray:
    return np.array([out.kp, out.kd])


def test_gains_stay_below_the_limit_over_the_margin_and_rise_no_faster_than_asked():
    """Whatever the limits and contacts do, at every tick."""
    rng = np.random.default_rng(0)
    limit, rise = Told(), 40.0
    running = scheduler(limit, rise=rise, highest=3.0)
    before, contact = np.array(SAFE), None
    for _ in range(1500):
        if rng.random() < 0.05:
            contact = rng.choice(["double", "left", None])
        if rng.random() < 0.2:
            limit.safe_gain = rng.choice([0.0, math.nan, -1.0, math.inf, *np.exp(rng.normal(0.5, 1.5, 6))])
            limit.certified = bool(rng.random() < 0.5)
        dt = rng.choice([0.0, TICK, 2 * TICK])
        now = gains_of(running.update(np.zeros(3), contact, dt))
        known = contact is not None and limit.safe_gain > 0
        allowed = min(3.0, limit.safe_gain / MARGIN) * np.array(OWN[contact]) if known else np.array(SAFE)
        assert np.all(now <= allowed * (1 + 1e-12))
        assert np.all(now <= before * 10 ** (rise * dt / 20) * (1 + 1e-12))
        assert np.all((now == allowed) | (now >= before))  # nothing falls further than it must
        before = now


def test_a_rise_takes_as_long_as_its_decibels_say_and_a_fall_no_time():
    """20 dB at 40 dB/s: 0.5 s, along a straight line in dB."""
    running = scheduler(rise=40.0)
    factors = np.array([running.update(np.zeros(3), "left", TICK).kp[0] for _ in range(1100)]) / 400
    k = np.arange(1, 1000)
    assert factors[:999] == pytest.approx(10 ** (40 * k * TICK / 20), rel=1e-9)
    assert factors[1000:] == pytest.approx(10.0)
    assert running.update(np.zeros(3), None, TICK).kp.tolist() == [400.0, 300.0, 50.0]


def test_to_a_constant_error_gains_look_as_behind_a_first_order_lag():
    """Over rises, falls and switches: torque / error = the gain through y(k) = d y(k−1) + (1 − d) kp(k−1), so it is never a step."""
    rng, error, fade = np.random.default_rng(1), np.array([0.01, -0.02, 0.03]), 0.04
    running, decay = scheduler(fade=fade), math.exp(-TICK / fade)
    kp, seen = [], []
    for k in range(2000):
        if k % 200 == 0:
            contact = rng.choice(["double", "left", None])
        kp.append(running.update(np.zeros(3), contact, TICK).kp)
        seen.append(running.torque(error, np.zeros(3)) / error)
    kp, seen = np.array(kp), np.array(seen)
    later = np.empty_like(kp)
    later[0] = kp[0]
    for k in range(1, len(kp)):
        later[k] = decay * later[k - 1] + (1 - decay) * kp[k - 1]
    assert seen == pytest.approx(later, rel=1e-9)
    assert np.abs(np.diff(seen, axis=0)).max() < 1.01 * (1 - decay) * np.ptp(kp, axis=0).max()
    assert np.abs(np.diff(kp, axis=0)).max() > 50 * np.abs(np.diff(seen, axis=0)).max()  # the gains themselves jump


def test_a_moving_error_sees_no_step_where_gains_fall():
    """Between two ticks the torque moves by what the error's own motion and the decay of the offset account for."""
    running, time = scheduler(), TICK * np.arange(2000)
    error = np.outer(np.sin(60 * time), [0.01, 0.02, -0.01])
    rate = np.gradient(error, TICK, axis=0)
    torque, plain, offset = [], [], []
    for k in range(2000):
        out = running.update(np.zeros(3), "left" if (k // 250) % 2 else None, TICK)
        torque.append(running.torque(error[k], rate[k]))
        plain.append(out.kp * error[k] + out.kd * rate[k])
        offset.append(running.offset)
    largest = np.array([4000.0, 500.0, 60.0]), np.array([8.0, 40.0, 3.0])
    moved = largest[0] * np.abs(np.diff(error, axis=0)).max(axis=0) + largest[1] * np.abs(np.diff(rate, axis=0)).max(axis=0)
    bound = moved + (1 - math.exp(-TICK / 0.05)) * np.abs(offset).max(axis=0)
    assert np.all(np.abs(np.diff(torque, axis=0)).max(axis=0) <= bound * (1 + 1e-9))
    assert np.abs(np.diff(plain, axis=0)).max() > 4 * bound.max()


def test_the_offset_of_rising_gains_is_small_beside_them_at_frequencies_of_vibration():
    """Closed form for kp = k₀ e^{rt}, e = Im e^{jωt}: o = −Im r kp e^{jωt} / (jω + r + 1/fade), at most r/ω of kp e."""
    rise, fade, omega, tick = 60.0, 0.02, 250.0, 5e-5
    rate = rise * math.log(10) / 20
    running, kp = scheduler(rise=rise, fade=fade), 0.0
    for k in range(3000):
        kp = running.update(np.zeros(3), "left", tick).kp[0]
        running.torque(np.sin(omega * k * tick), 0.0)
        if k > 2800:
            due = -(rate * kp * np.exp(1j * omega * k * tick) / (1j * omega + rate + 1 / fade)).imag
            assert running.offset[0] == pytest.approx(due, abs=0.01 * rate / omega * kp)
            assert abs(running.offset[0]) <= 1.01 * rate / omega * kp


def test_a_switch_of_contact_takes_over_the_step_of_feed_forward_too():
    running = scheduler()
    torques = []
    for contact, ahead in (("double", 10.0), ("double", 10.0), ("left", 90.0), ("left", 90.0)):
        running.update(np.zeros(3), contact, 0.0)
        torques.append(running.torque(0.0, 0.0, ahead)[0])
    assert torques == pytest.approx([10.0, 10.0, 10.0, 10.0])
    for _ in range(2000):
        running.update(np.zeros(3), "left", TICK)
        last = running.torque(0.0, 0.0, 91.0)[0]
    assert last == pytest.approx(91.0, abs=1e-6)  # within a contact it is followed at once, and the offset is gone


@pytest.mark.parametrize("contact", ["lef", 3, ["left"], math.nan])
def test_a_contact_that_is_not_in_the_table_has_the_safe_set(contact):
    out = scheduler().update(np.zeros(3), contact, TICK)
    assert (out.kp.tolist(), out.problem) == (SAFE[0], "unknown contact state")


@pytest.mark.parametrize("dt", [math.nan, -1.0, math.inf, None, "1", 1j])
def test_without_a_sensible_tick_nothing_rises(dt):
    running = scheduler()
    first = gains_of(running.update(np.zeros(3), "left", 0.0))
    out = running.update(np.zeros(3), "left", dt)
    assert np.array_equal(gains_of(out), first)
    assert "tick" in out.problem


def test_a_pause_is_no_licence_to_jump():
    assert scheduler(rise=60.0).update(np.zeros(3), "left", 100.0).kp[0] <= 400 * 10 ** (60 * 0.02 / 20) * (1 + 1e-12)


@pytest.mark.parametrize("error", [math.nan, [0.0, math.inf, 0.0], [0.0, 0.0], "x", None, [1j, 0, 0]])
def test_the_last_torque_is_held_where_an_error_cannot_be_used(error):
    running = scheduler()
    running.update(np.zeros(3), "left", TICK)
    last = running.torque([0.1, 0.2, 0.3], 0.0)
    running.update(np.zeros(3), "left", TICK)
    assert np.array_equal(running.torque(error, 0.0), last)
    assert np.array_equal(running.torque(0.0, error), last)
    assert np.all(np.isfinite(running.torque([0.1, 0.2, 0.3], 0.0)))


def test_without_a_set_for_all_states_the_least_of_the_table_is_taken():
    table = gr.GainTable.of(OWN)
    assert table.everywhere.tolist() == [[400.0, 500.0, 50.0], [5.0, 30.0, 2.0]]


def test_recommended_gains_make_a_table():
    """NaN: a joint that nothing moves there. Its gains are those of the set for all states, and 0 where nothing ever moves it."""

    def one(*kp):
        return SimpleNamespace(kp=np.array(kp), kd=np.array(kp) / 10)

    found = RobotGains("joint", ("a", "b", "c"), {"double": one(5.0, math.nan, math.nan), "left": None}, one(3.0, 2.0, math.nan), None)  # type: ignore[dict-item,arg-type]
    table = gr.GainTable.recommended(found)
    assert table.own["double"][0].tolist() == [5.0, 2.0, 0.0]
    assert table.own["left"].tolist() == table.everywhere.tolist() == [[3.0, 2.0, 0.0], [0.3, 0.2, 0.0]]
    for wrong, said in ((RobotGains("task", (), {}, None, None), "task space"), (RobotGains("joint", (), {}, None, None), "safe in every")):
        with pytest.raises(gr.GainroomError, match=said):
            gr.GainTable.recommended(wrong)


@pytest.mark.parametrize(
    ("own", "everywhere", "said"),
    [
        ({}, None, "no contact state"),
        ({"a": ([1.0], [math.nan])}, None, "'a': kd .* must be finite"),
        ({"a": ([1.0, 2.0], [1.0])}, None, "must be \\(n,\\) both"),
        ({"a": ([1.0, -2.0], [1.0, 1.0])}, None, "-2 must be >= 0"),
        ({"a": ([1.0], [1.0]), "b": ([1.0, 2.0], [1.0, 2.0])}, None, "numbers of joints must be the same: 'a' 1, 'b' 2"),
        ({"a": ([1.0], [1.0])}, ([1.0, 2.0], [1.0, 2.0]), "'everywhere' 2"),
        ({"a": ([1.0],)}, None, "kp and kd of every joint"),
        ({"a": 3.0}, None, "kp and kd of every joint"),
        ({"a": ([], [])}, None, "must be \\(n,\\) both"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused(own, everywhere, said):
    with pytest.raises(gr.GainroomError, match=said):
        gr.GainTable.of(own, everywhere)


@pytest.mark.parametrize("options", [{"rise": 0.0}, {"rise": math.inf}, {"fade": -1.0}, {"fade": math.nan}, {"highest": 0.0}])
def test_options_that_make_no_sense_are_refused(options):
    with pytest.raises(gr.GainroomError, match=next(iter(options))):
        scheduler(**options)


def test_every_contact_state_needs_a_tracker_and_the_requirements_a_gain_margin():
    table = gr.GainTable.of(OWN, SAFE)
    with pytest.raises(gr.GainroomError, match="only one of them is there for left"):
        gr.GainScheduler(table, {"double": Told()})
    with pytest.raises(gr.GainroomError, match="must have a gain margin"):
        gr.GainScheduler(table, dict.fromkeys(OWN, Told()), gr.Requirements(phase_margin=0.5))


def test_what_a_tracker_flags_is_told():
    """Its safe_gain, of ticks before, is what gains go by."""
    limit = Told(1.0)
    running = scheduler(limit, rise=1e6)
    running.update(np.zeros(3), "double", TICK)
    limit.flag = "posture"
    for safe_gain in (0.9, 0.0, math.nan):
        limit.safe_gain = safe_gain
        out = running.update(np.zeros(3), "double", TICK)
        assert "'posture'" in out.problem
        assert np.allclose(gains_of(out), 0.45 * np.array(OWN["double"]) if safe_gain > 0 else SAFE, rtol=1e-12)
    limit.flag, limit.safe_gain = "", 0.0
    assert running.update(np.zeros(3), "double", TICK).problem == "no limit is known"


@pytest.mark.parametrize("contact", ["double", "left"])
def test_a_robot_whose_table_is_too_high_has_its_limit_over_the_margin(body, contact):
    """The biped at 2 kHz, 4 ticks of delay: times the margin, the scheduled gains are at the edge of stability by an independent count."""
    q, of_biped, drive = biped_posture(body), actuators(12), gr.Drive(4000.0, 0.9, 4 * TICK)
    kp, kd = np.full(12, 2e4), np.full(12, 600.0)
    contacts = {"double": BOTH, "left": feet("left_sole")}

    def model_of(name):
        return linearize(body, of_biped, q, contacts[name])

    class Cold:
        certified = True

        def update(self, q, name):
            self.safe_gain = gr.gain_limit(gr.build_loop(model_of(name), drive, gr.PD(kp, kd), sample_time=TICK)).gain
            return self

    table = gr.GainTable.of(dict.fromkeys(contacts, (kp, kd)), (kp / 100, kd / 100))
    running = gr.GainScheduler(table, dict.fromkeys(contacts, Cold()), gr.Requirements(gain_margin=MARGIN), rise=1e9)
    running.update(q, contact, TICK)
    out = running.update(q, contact, TICK)
    model = model_of(contact)
    assert out.settled
    assert 0 < out.factor < 1

    def radius(factor: float) -> float:
        own = (model.link_inverse_inertia, model.motor_inertia, model.stiffness, model.damping)
        return sampled_radius(Coupled(*own, factor * np.diag(out.kp), factor * np.diag(out.kd), 4 * TICK, 4000.0, 0.9), TICK, 4)

    assert radius(MARGIN * (1 - 1e-4)) < 1 < radius(MARGIN * (1 + 1e-4))
