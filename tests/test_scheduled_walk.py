"""examples/scheduled_biped.py in short: the first step, scheduled gains against the single safe set (docs/realtime.md has both steps)."""

import numpy as np
import pytest
from walking_gains import MOMENTS, with_states
from walking_plan import LIFT, STEP
from walking_run import HERE, biped, error_of, loop, phases, plan_of, rms, steps, tables, vibrations, walked

import gainroom as gr
from gainroom.analysis.margins import joint_margins

PACE, TICKS = 1.25, 5600
"""A fourth faster than usual, until the lifted foot stands again and the gains have followed."""


class NoLimit:
    """A tracker that sees no limit at all."""

    safe_gain, certified = np.inf, True

    def update(self, q, contact):
        return self


@pytest.fixture(scope="module")
def walks():
    """(plan, run, gains) by the name of the table."""
    system, plan = biped(), plan_of(biped(), PACE)
    return {name: (plan, *walked(system, plan, table, ticks=TICKS)) for name, table in tables().items()}


@pytest.mark.slow
def test_the_plan_keeps_feet_on_the_ground_and_the_weight_over_them(body):
    """Forward kinematics of every 150th posture: soles where they belong, the centre of mass over the foot that stands."""
    plan = plan_of(biped())
    rows = np.arange(0, len(plan.time), 150)
    postures = [plan.posture(body, k) for k in rows]
    places = {side: np.array([body.frame_placement(q, f"{side}_sole")[1] for q in postures]) for side in ("left", "right")}
    phase = np.array(plan.phase)[rows]
    for side, other in (("left", "right"), ("right", "left")):
        lifted = places[side][:, 2] - places[side][0, 2]
        assert np.abs(lifted[phase != other]).max() < 1e-6
        assert LIFT * 0.97 < lifted.max() <= LIFT + 1e-6
        assert places[side][-1, 0] - places[side][0, 0] == pytest.approx(STEP, abs=1e-6)
    for k in np.flatnonzero(phase != "double"):
        assert body.com(postures[k])[:2] == pytest.approx(places[str(phase[k])][k, :2], abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["single set", "scheduled"])
def test_both_tables_meet_the_same_requirements_weight_included(name):
    """In two of the 17 states: standing, and on the left foot with the right one lifted."""
    system = biped()
    walk = with_states(system, plan_of(system), MOMENTS)
    own = tables()[name].own
    for posture, contact in (("double0", "double"), ("left1", "left")):
        model = walk.source.linearize(posture, contact, weight=True)
        assert walk.requirements.met_by(joint_margins(walk.loop(model, gr.PD(*own[contact]))))
    assert np.array_equal(own["right"], np.roll(own["left"], 6, axis=1))  # legs alike, walk mirrored


@pytest.mark.slow
def test_scheduled_gains_track_better_at_the_same_margins(walks):
    """With friction. The whole of the two steps: docs/realtime.md."""
    errors = {name: rms(error_of(run, plan)) for name, (plan, run, _) in walks.items()}
    assert all(run.ending == "completed" for _, run, _ in walks.values())
    assert errors["scheduled"] < 0.9 * errors["single set"]


@pytest.mark.slow
def test_nothing_vibrates_in_any_phase_and_no_switch_is_a_step(walks):
    """The command moves by no more about a switch of contact than within phases, while gains fall to a ninth."""
    for plan, run, _ in walks.values():
        assert [name for name, _ in phases(plan, TICKS)] == ["double", "left", "double"]
        assert vibrations(run, plan) == []
        assert steps(run, plan).max() <= np.abs(np.diff(run.target_torque, axis=0)).max()
    kp = np.array([one.kp for one in walks["scheduled"][2]])
    assert (kp[1:] / kp[:-1]).min() < 1 / 8
    assert steps(walks["scheduled"][1], walks["scheduled"][0]).max() < 2.0  # [N m], of some hundred


@pytest.mark.slow
def test_the_detector_finds_gains_above_the_limit():
    """Times 2.6, where the limits are 2.3 times the gains: the same detector finds it, or the run diverges."""
    system, plan = biped(), plan_of(biped())
    table = gr.GainTable.of({name: tuple(2.6 * gains) for name, gains in tables()["scheduled"].own.items()})
    run, _ = walked(system, plan, table, friction=False, ticks=1000, trackers=dict.fromkeys(table.own, NoLimit()), rise=1e4)
    assert run.ending == "diverged" or vibrations(run, plan)


@pytest.mark.slow
def test_with_the_tracker_gains_end_at_its_limit_over_the_margin():
    """Gains that are three times too high, along the swing on the left foot: where a tick is certified, cold limits say the same."""
    system, plan = biped(), plan_of(biped())
    kp, kd = 3 * tables()["scheduled"].own["left"]
    tracker = gr.GainTracker(gr.load_robot(HERE / "scheduled_biped.yaml"), gr.PD(kp, kd), contacts=["left"])
    table = gr.GainTable.of({"left": (kp, kd)}, (kp / 100, kd / 100))
    running = gr.GainScheduler(table, {"left": tracker}, system.requirements, rise=1e4)
    certified = 0
    for k in range(3600, 4200):
        q = plan.posture(system.source.body, k)
        out = running.update(q, "left", plan.time[1])
        if out.certified and k % 100 == 99:
            certified += 1
            cold = gr.gain_limit(loop(system, q, "left", np.array([kp, kd]))).gain
            assert out.settled
            assert out.factor * system.requirements.gain_margin == pytest.approx(cold, rel=2e-6)
            assert np.array_equal(out.kp, out.factor * kp)
    assert certified >= 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["single set", "scheduled"])
def test_equal_legs_closed_by_the_ground_are_followed(name):
    """Double support: two roots of equal legs that lie at the same frequency once were passed in one step of a count, which missed one."""
    system, plan = biped(), plan_of(biped())
    gains = tables()[name].own["double"]
    tracker = gr.GainTracker(gr.load_robot(HERE / "scheduled_biped.yaml"), gr.PD(*gains), contacts=["double"])
    certified = 0
    for k in range(1200):
        q = plan.posture(system.source.body, k)
        out = tracker.update(q, "double")
        if k % 100 == 99:
            cold = gr.gain_limit(loop(system, q, "double", np.array(gains))).gain
            certified += out.certified
            assert out.safe_gain < cold
            assert not out.certified or out.gain == pytest.approx(cold, rel=1e-6)
    assert certified >= 10


def test_a_tracker_of_other_gains_is_refused():
    gains = tables()["scheduled"].own["left"]
    tracker = gr.GainTracker(gr.load_robot(HERE / "scheduled_biped.yaml"), gr.PD(*gains), contacts=["left"])
    with pytest.raises(gr.GainroomError, match="follows the limit of other gains"):
        gr.GainScheduler(gr.GainTable.of({"left": tuple(2 * gains)}), {"left": tracker})
