"""The gain limit at every tick: rigid-body terms, crossings, counts and misuse, against linearize, the loop's response and gain_limit."""

import itertools
import threading
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

import gainroom as gr
import machines
from benchmarks.talos import talos
from gainroom.native import _core
from gainroom.robot.contact import Contact
from gainroom.robot.linearize import linearize
from robot_walks import Walk

BIPED = files("gainroom") / "files" / "examples" / "biped.yaml"
TICK = 5e-4
SWITCH = 50  # ticks from a contact switch on


@pytest.fixture(scope="module")
def biped():
    return gr.load_robot(BIPED)


def sampled(robot, sample_time):
    return replace(robot.system.control, sample_time=sample_time)


def joint_rows(loop: gr.Loop):
    """The core's table of a loop's joints."""
    plant, drives, pd = loop.parts.plant, loop.parts.drives, loop.parts.controller
    of_drives = np.array([(drive.bandwidth, drive.damping_ratio, drive.delay) for drive in drives])
    gains = [loop.gain * np.broadcast_to(gain, loop.size) for gain in (pd.kp, pd.kd)]
    gearbox = (plant.stiffness, np.where(plant.elastic, plant.damping, 0.0))
    return np.column_stack([plant.motor_inertia, plant.motor_viscous, plant.link_viscous, *gearbox, of_drives, *gains])


def settled(loop: gr.Loop, ticks: int = 4000):
    """The core's answer for a loop that stays as it is, and the crossings it knows."""
    w = np.ascontiguousarray(loop.parts.plant.link_inverse_inertia)
    core = _core.GainTracker(np.ascontiguousarray(joint_rows(loop)), loop.sample_time or 0.0, loop.size, 0, 1, 2.0, 10.0)
    for _ in range(ticks):
        found = core.update_inverse(w, 0)
        if found[2]:
            break
    return found, core.crossings(0)


STANCES = {
    "flight": (),
    "flat": (Contact("left_sole"),),
    "both": (Contact("left_sole"), Contact("right_sole")),
    "line": (Contact("left_sole", "line"), Contact("right_sole", "point")),
}


@pytest.mark.parametrize("stance", STANCES)
def test_link_inertia_is_that_of_linearize(biped, stance: str):
    """Another algorithm (Cholesky and Gram-Schmidt against an SVD) on random postures; and rows that repeat others change nothing."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = biped.body.integrate(biped.body.neutral(), rng.uniform(-1, 1, biped.body.nv))
        model = linearize(biped.body, biped.actuators, q, STANCES[stance])
        rows = np.ascontiguousarray(model.contact_jacobian)
        twice = np.vstack([rows, rng.normal(size=(len(rows), len(rows))) @ rows])
        for held in (rows, twice):
            found = _core.link_inverse_inertia(model.inertia, held, biped.body.size)
            # Round-off is that of A⁻¹, of which the contacts take most away.
            assert np.abs(found - model.link_inverse_inertia).max() < 1e-10 * np.abs(model.link_inverse_inertia).max()


def test_link_inertia_refuses_what_is_no_mass_matrix():
    for mass in (np.zeros((3, 3)), np.diag([1.0, -1.0, 1.0]), np.diag([1.0, np.nan, 1.0]), np.diag([1.0, np.inf, 1.0])):
        with pytest.raises(ValueError, match="positive definite"):
            _core.link_inverse_inertia(mass, np.ones((1, 3)), 2)
    for entry in (np.nan, np.inf, 1e200, 1e-200):  # or of held directions, whose squares have to be numbers
        for rows in (np.full((1, 3), entry), np.array([[1.0, 0.0, 0.0], [0.0, entry, 0.0]])):
            with pytest.raises(ValueError, match="positive definite"):
                _core.link_inverse_inertia(np.eye(3), rows, 2)


def friction(loop: gr.Loop, rng: np.random.Generator) -> gr.Loop:
    """The same loop with friction at motors and links, and drives that differ."""
    parts = loop.parts
    some = 0.01 * np.sqrt(parts.plant.stiffness * parts.plant.motor_inertia)
    motor, link = (some * rng.uniform(0, 1, loop.size) for _ in range(2))
    drives = [replace(drive, bandwidth=drive.bandwidth * rng.uniform(0.8, 1.2)) for drive in parts.drives]
    if loop.sample_time is None:
        drives = [replace(drive, delay=drive.delay * rng.uniform(0.9, 1.1)) for drive in drives]
    return gr.build_loop(replace(parts.plant, motor_viscous=motor, link_viscous=link), drives, parts.controller, "motor", loop.sample_time)


def rigid(loop: gr.Loop) -> gr.Loop:
    parts = loop.parts
    plant = replace(parts.plant, stiffness=np.full(loop.size, np.inf), damping=np.zeros(loop.size))
    return gr.build_loop(plant, parts.drives, parts.controller, "motor", loop.sample_time)


def as_it_is(loop: gr.Loop, rng: np.random.Generator) -> gr.Loop:
    return loop


@pytest.mark.slow
@pytest.mark.parametrize("change", [as_it_is, friction, lambda loop, rng: rigid(loop)], ids=["limbs", "friction", "rigid"])
@pytest.mark.parametrize("number", range(12))
def test_crossings_are_the_loops_own(change, number: int):
    """At each one L has the eigenvalue −1/g, and a settled limit is gain_limit's; equal limbs, continuous and sampled (every fourth)."""
    loop = change(machines.limbs(11, number).loop, np.random.default_rng(number))
    found, crossings = settled(loop)
    for gain, omega, *_ in crossings[:4]:
        values = np.linalg.eigvals(loop.response([omega])[0])
        # Aliases of what carries W are left out: at most 1e-9, see alias_left.
        assert np.abs(gain * values + 1).min() < 1e-7
    if found[2]:
        assert found[0] == pytest.approx(gr.gain_limit(loop).gain, rel=1e-7)


def test_motion_with_contact_switches(biped):
    """Symmetric and asymmetric walks: no certified gain is above the limit by 1e-6, and nearly all are certified."""
    for sample_time, seed, least in ((None, 1, 0.99), (TICK, 2, 0.97)):
        walk = Walk(biped, sample_time, seed, symmetric=seed % 2 == 1)
        share, worst = walk.run(ticks=3200, checks=12)
        assert worst < 1e-6
        assert share >= least


def test_joints_that_are_not_alike_are_certified(biped):
    """Motor inertias from 0.3 to 4: crossings lie apart by more than modes of √J W √J tell."""
    inertia = np.tile([1.0, 4.0, 0.3, 2.0, 0.3, 1.0], 2)
    robot = replace(biped, actuators=replace(biped.actuators, motor_inertia=inertia))
    pd = gr.PD(2000.0 * inertia, 100.0 * inertia)
    for sample_time in (None, TICK):
        walk = Walk(robot, sample_time, 3, pd=pd)
        share, worst = walk.run(ticks=3200, checks=12)
        assert worst < 1e-6
        assert share >= 0.97


@pytest.mark.parametrize("stance", ["flat", "both", "line"])
def test_other_contacts_share_the_mass_matrix(biped, stance: str):
    """After a tick in flight, another state is prepared at the W that it would have had: its crossings are its own ticks'."""
    robot = replace(biped, contacts=dict(STANCES))
    q = biped.body.configuration(dict(biped.postures["stand"].angles))
    here, there = (gr.GainTracker(robot, contacts=["flight", stance]) for _ in range(2))
    q[10] += 0.002
    rows = [biped.body.frame_jacobian(q, one.frame)[list(one.rows)] for one in robot.contacts[stance]]
    here.update_dynamics(biped.body.mass_matrix(q), [], "flight")
    here.prepare(rows, stance)
    there.update(q, stance)
    assert here.crossings(stance)[0] == pytest.approx(there.crossings(stance)[0], rel=1e-6)


def test_prepared_states_are_certified_at_the_switch(biped):
    """Without `prepare` every switch costs ticks; with it next to none."""
    body, lost = biped.body, []
    for prepared in (False, True):
        walk = Walk(biped, None, 5)
        certified = np.zeros(3200, dtype=bool)
        for tick in range(3200):
            q, name = walk.posture(tick), walk.contact(tick)
            rows = {one: [body.frame_jacobian(q, contact.frame) for contact in biped.contacts[one]] for one in walk.contacts}
            certified[tick] = walk.tracker.update_dynamics(body.mass_matrix(q), rows[name], name).certified
            other = walk.contacts[tick // 3 % len(walk.contacts)]
            if prepared and tick % 3 == 0 and other != name:
                walk.tracker.prepare(rows[other], other)
        assert certified.mean() > 0.96
        lost.append([np.count_nonzero(~certified[switch : switch + SWITCH]) for switch in (800, 1600, 2400)])
    assert max(lost[1]) <= 1
    assert sum(lost[0]) > 5 * sum(lost[1])


def test_a_jump_of_posture_is_certified_again_in_bounded_time(biped):
    tracker = gr.GainTracker(biped, contacts=["left"])
    for seed in range(3):
        q = biped.body.neutral()
        q[7:] += np.random.default_rng(seed).uniform(-0.6, 0.6, biped.body.size)
        answers = [tracker.update(q, "left") for _ in range(400)]
        assert answers[-1].certified
        limit = gr.gain_limit(biped.system.loop(linearize(biped.body, biped.actuators, q, biped.contacts["left"])))
        assert answers[-1].gain == pytest.approx(limit.gain, rel=1e-9)
        assert all(one.safe_gain <= limit.gain or not one.certified for one in answers)


class Hostile:
    """What a program may hand over in place of an array."""

    def __array__(self, *_, **__):
        raise RuntimeError("no array")


@pytest.mark.parametrize("sample_time", [None, TICK])
def test_a_motion_at_once_is_its_ticks(biped, sample_time):
    walk = Walk(biped, sample_time, 7)
    q = np.array([walk.posture(tick) for tick in range(300)])
    q[40, 3:7] *= 1.5  # no rotation
    contacts = ["double"] * 100 + ["left"] * 100 + ["double"] * 100
    tracker, other = gr.GainTracker(biped, walk.system.control), walk.tracker
    motion = tracker.replay(q, contacts)
    ticks = [other.update(*tick) for tick in zip(q, contacts, strict=True)]
    for name in gr.TrackedLimit._fields:
        np.testing.assert_array_equal(getattr(motion, name), [getattr(tick, name) for tick in ticks])
    assert np.flatnonzero(motion.flag != "").tolist() == [40]
    assert np.all(motion.seconds > 0)
    assert tracker.replay(q[:2], "right").gain.tolist() == [other.update(tick, "right").gain for tick in q[:2]]  # goes on from there


def test_threads_that_share_a_tracker_wait_for_each_other(biped):
    """One tick at a time: each is what it would be if all were done in one thread, whatever their order."""
    tracker, q = gr.GainTracker(biped), biped.body.configuration(dict(next(iter(biped.postures.values())).angles))
    asked = threading.Thread(target=lambda: tracker.replay(np.tile(q, (20_000, 1)), "double"))
    limit = gr.GainTracker(biped).update(q, "left").gain
    asked.start()
    while asked.is_alive():
        assert tracker.update(q, "left").gain == pytest.approx(limit, rel=1e-9)
        assert len(tracker.crossings("double")) > 0


@pytest.mark.parametrize(
    ("q", "contacts", "words"),
    [
        (np.zeros(20), "double", r"q of shape \(20,\) must have the shape \(ticks, 19\)"),
        (np.zeros((3, 12)), "double", r"q of shape \(3, 12\)"),
        (np.array([[0.0] * 19, [np.nan] * 19]), "double", "q of tick 1 must be finite"),
        ("q", "double", "q must be an array of real numbers"),
        ([[0.0] * 19, [0.0]], "double", "q must be an array of real numbers"),
        (1j * np.zeros((3, 19)), "double", "q must be an array of real numbers"),
        (np.zeros((3, 19)), None, "contacts must be the name of a contact state or one name for each posture"),
        (np.zeros((3, 19)), ["double"] * 2, "2 contact states for 3 postures"),
        (np.zeros((3, 19)), ["double", "duble", "left"], "contact 'duble' is not one of those tracked; did you mean 'double'"),
        (np.zeros((3, 19)), ["double", None, "left"], "contacts must be the name"),
    ],
)
def test_a_motion_that_is_none_is_refused(biped, q, contacts, words):
    with pytest.raises(gr.GainroomError, match=words):
        gr.GainTracker(biped).replay(q, contacts)


def assert_wrong_ticks_are_flagged(tracker: gr.GainTracker, q: np.ndarray, good: gr.TrackedLimit):
    """Of a tracker in "left", where `good` is right, that knows "toe", on which nothing can stand."""
    wrong = [(q[:-1], "left", "posture"), (q * np.nan, "left", "posture"), ("?", "left", "posture"), (2 * q, "left", "posture")]
    wrong += [(np.where(np.arange(len(q)) == 9, bad, q), "left", "posture") for bad in (np.nan, np.inf)]
    wrong += [(np.where(np.arange(len(q)) == k, bad, q), "left", "posture") for k in (0, 4) for bad in (np.nan, np.inf)]
    wrong += [(q * (1 + 0j), "left", "posture"), ([10**400] * len(q), "left", "posture"), (Hostile(), "left", "posture")]
    wrong += [(q, "up", "contact"), (q, None, "contact"), (q, ["left"], "contact"), (q, "toe", "too few constraints")]
    for posture, contact, flag in wrong:
        answer = tracker.update(posture, contact)
        assert (answer.flag, answer.certified) == (flag, False)
        assert 0 < answer.safe_gain < good.gain


def test_misuse_in_the_loop_is_flagged(biped):
    loose = replace(biped, contacts={**biped.contacts, "toe": (Contact("left_sole", "point"),)})
    tracker = gr.GainTracker(loose, contacts=["left", "toe"])
    q = biped.body.configuration(dict(biped.postures["stand"].angles))
    good = tracker.update(q, "left")
    assert good.certified
    assert good.flag == ""
    assert_wrong_ticks_are_flagged(tracker, q, good)
    assert tracker.update(list(q), "left").gain == pytest.approx(good.gain, rel=1e-9)
    for rows, name in (([], "up"), ([], None), (None, "left"), ([np.zeros((6, 3))], "left"), ([np.zeros((7, 18))], "left"), ("?", "left")):
        assert tracker.prepare(rows, name) is None
    for bad in (np.nan, np.inf, 1e300):
        tracker.prepare([np.full((6, 18), bad)], "left")
    answers = [tracker.update(q, "left") for _ in range(20)]
    assert answers[-1].certified
    assert all(not one.certified or one.gain == pytest.approx(good.gain, rel=1e-9) for one in answers)
    for mass in (np.zeros((18, 18)), np.full((18, 18), np.nan), np.eye(3), None):
        assert tracker.update_dynamics(mass, [], "left").flag == "posture"
    mass, rows = biped.body.mass_matrix(q), biped.body.frame_jacobian(q, "left_sole")
    for bad in (np.nan, np.inf, 1e200):  # one entry that is no number, or has no square
        held = rows.copy()
        held[2, 9] = bad
        assert tracker.update_dynamics(mass, [held], "left").flag == "posture"
    for few in (1, 3, 5):
        assert tracker.update_dynamics(mass, [rows[:few]], "left").flag == "too few constraints"


def walk(robot, names, ticks: int, seed: int = 3):
    """Postures and contact states of a smooth motion from the first posture, one contact state after the other."""
    rng, q = np.random.default_rng(seed), robot.body.configuration(dict(robot.postures["stand"].angles))
    phases, rates, swings = rng.uniform(0, 2 * np.pi, 12), rng.uniform(0.1, 0.8, 12), rng.uniform(0.1, 0.5, 12)
    for k in range(ticks):
        now = q.copy()
        now[-12:] += np.clip(swings * (np.sin(2e-3 * np.pi * rates * k + phases) - np.sin(phases)), -0.6, 0.6)
        yield now, names[k // 400 % len(names)]


@pytest.mark.parametrize("space", ["joint", "task"])
def test_a_tick_of_which_nothing_is_known_does_not_raise_the_safe_gain(biped, space: str):
    """Nor after many of them, nor where tasks are unstable at every factor in a state: the robot may have moved on."""
    control = biped.system.control
    tracker = gr.GainTracker(biped, control if space == "joint" else replace(control, space="task", controller=None, sample_time=TICK))
    raised, fallen = [], 0
    for tick, (q, contact) in enumerate(walk(biped, tracker.contacts, 1600)):
        last = tracker.update(q, contact).safe_gain
        if tick % 7 == 0:
            given = [(q * np.nan, contact), (q[1:], contact), (q, "up"), (q * np.nan, "up")] * 3
            said = [last, *(tracker.update(*one).safe_gain for one in given)]
            raised += [tick] * any(after > before for before, after in itertools.pairwise(said))
            fallen += said[-1] < said[1]
    assert raised == []
    assert fallen > 100  # while the robot moves, and nobody sees where


@pytest.mark.parametrize("sample_time", [None, TICK])
def test_what_is_left_of_a_limit_goes_by_where_the_robot_is_now(biped, sample_time):
    """Not by how far it has been: back where a contact state was certified, 10 % less than that limit is left, or all of it."""
    tracker, q = gr.GainTracker(biped, sampled(biped, sample_time)), biped.body.configuration(dict(biped.postures["stand"].angles))
    soles = {"double": ("left_sole", "right_sole"), "left": ("left_sole",)}

    def ask(bend: float, contact: str) -> gr.TrackedLimit:  # other contact states are not made ready
        posture = q.copy()
        posture[10] += bend
        body = biped.body
        return tracker.update_dynamics(body.mass_matrix(posture), [body.frame_jacobian(posture, sole) for sole in soles[contact]], contact)

    there = ask(0.0, "double")
    assert there.certified
    for bend in 0.5 * np.sin(2e-3 * np.pi * np.arange(1000)):
        ask(bend, "left")
    back = ask(0.0, "double")
    assert there.gain * (0.9 - 1e-9) <= back.safe_gain <= there.gain


@pytest.mark.parametrize("sample_time", [None, TICK])
def test_a_contact_switch_in_fast_motion_leaves_a_quarter_of_the_limit(biped, sample_time):
    """A knee that swings by 0.5 rad at 1 Hz; contact states are made ready by `update`, but counts of theirs are soon too old."""
    tracker, q = gr.GainTracker(biped, sampled(biped, sample_time)), biped.body.configuration(dict(biped.postures["stand"].angles))
    system = replace(biped.system, source=biped, control=sampled(biped, sample_time))
    shares = []
    for tick in range(4000):
        bent, contact = q.copy(), ("double", "left", "double", "right")[tick // 350 % 4]
        bent[10] += 0.5 * np.sin(2e-3 * np.pi * tick)
        now = tracker.update(bent, contact)
        if tick > 350 and not now.certified:
            model = linearize(biped.body, biped.actuators, bent, biped.contacts[contact])
            shares.append(now.safe_gain / gr.gain_limit(system.loop(model)).gain)
    assert 10 < len(shares) < 200
    assert min(shares) > 0.25  # the knee changes ln(W + 1/J) by up to 2, and an unknown crossing is taken to move half as far
    assert max(shares) <= 1


LINK = """<inertial><origin xyz="0.3 0 0"/><mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>"""
WHEELS = f"""<robot name="wheels"><link name="base"/><link name="a">{LINK}</link><link name="b">{LINK}</link>
<joint name="p" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/></joint>
<joint name="q" type="continuous"><parent link="a"/><child link="b"/><origin xyz="0.5 0 0"/><axis xyz="0 0 1"/></joint></robot>"""
WHEELS_YAML = """
model: {file: wheels.urdf, base: fixed}
joints: {default: {motor_inertia: 0.1, stiffness: 5000.0, damping: 1.0}}
drive: {bandwidth: 4000.0, delay_ms: 2.0}
postures: {home: {q: 0.5}}
contacts: {free: []}
control: {type: pd, space: joint, feedback: motor, kp: 100.0, kd: 10.0}
"""


def test_angles_of_wheels_are_on_the_circle(tmp_path):
    """Cosines and sines that nearly are are taken for those next to them; what is none is flagged, on a fixed base as well."""
    (tmp_path / "wheels.urdf").write_text(WHEELS, "utf-8")
    (tmp_path / "robot.yaml").write_text(WHEELS_YAML, "utf-8")
    robot = gr.load_robot(str(tmp_path / "robot.yaml"))
    tracker = gr.GainTracker(robot)
    q = robot.body.configuration({"p": 1.0, "q": 0.5})
    there = tracker.update(q, "free")
    assert there.certified
    assert tracker.update(q * (1 + 1e-4), "free").gain == pytest.approx(there.gain, rel=1e-12)
    for wrong in (2 * q, 0 * q, np.array([0.5, 0.1, 0.2, 0.3])):
        assert tracker.update(wrong, "free").flag == "posture"


@pytest.mark.parametrize("sample_time", [None, TICK])
@pytest.mark.parametrize("w", [0.0, 0.3, 3.33, 10.0])
def test_one_joint_that_crosses_where_a_count_begins(sample_time, w: float):
    """Its limit lies within the first step of a count, next to the frequencies at which its controller takes energy out."""
    drive, pd = gr.Drive(4000.0, 0.9, 1.2e-3 if sample_time is None else 1.5e-3), gr.PD(2000.0, 100.0)
    plant = gr.Plant(np.array([[w]]), np.array([1.0]), np.array([1e4]), np.array([10.0]))
    loop = gr.build_loop(plant, drive, pd, "motor", sample_time)
    found, _ = settled(loop, ticks=60)
    assert found[2]
    assert found[0] == pytest.approx(gr.gain_limit(loop).gain, rel=1e-7)


def test_dynamics_of_another_library_give_the_same(biped):
    body = biped.body
    trackers = [gr.GainTracker(biped, contacts=["left"]) for _ in range(2)]
    for k in range(5):
        q = body.configuration(dict(biped.postures["stand"].angles))
        q[7:] += 0.01 * k
        here = trackers[0].update(q, "left")
        there = trackers[1].update_dynamics(body.mass_matrix(q), [body.frame_jacobian(q, "left_sole")], "left")
        assert there == pytest.approx(here, rel=1e-12) if here.flag else there[:2] == pytest.approx(here[:2], rel=1e-12)


REFUSED = {
    "other than PD": lambda robot: {"control": gr.PID(2000.0, 10.0, 100.0)},
    "link's side": lambda robot: {"control": replace(robot.system.control, feedback="link")},
    "filters": lambda robot: {"control": gr.PD(2000.0, 100.0, velocity_filter=gr.LowPass(500.0, 1))},
    "gain matrices": lambda robot: {"control": gr.PD(2000.0 * np.eye(12), 100.0)},
    "lag of": lambda robot: {"control": gr.PD(2000.0, 2.0)},
    "not both 0": lambda robot: {"control": gr.PD(0.0, 0.0)},
    "must be a Control": lambda robot: {"control": "pd"},
    "is not one of": lambda robot: {"contacts": ["dubble"]},
    "must name": lambda robot: {"contacts": []},
    "one for each of 12 joints": lambda robot: {"control": gr.PD([2000.0, 1000.0], [100.0, 50.0])},
    "must be Requirements": lambda robot: {"limits": 2.0},
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_tracked_is_refused(biped, words: str):
    with pytest.raises(gr.GainroomError, match=words):
        gr.GainTracker(biped, **REFUSED[words](biped))


@pytest.mark.population
@pytest.mark.parametrize("seed", range(20))
def test_population_of_walks(biped, seed: int, capsys: pytest.CaptureFixture[str]):
    """Of 100,000 ticks in all, every one that is certified is checked."""
    share, worst = walked(biped, seed, 5000, None)
    with capsys.disabled():
        print(f"\nwalk {seed}: {100 * share:.2f} % of ticks certified; above the limit by {worst:.1e} at most")


@pytest.mark.population
@pytest.mark.parametrize("seed", range(10))
def test_population_of_walks_of_talos(tmp_path, seed: int, capsys: pytest.CaptureFixture[str]):
    """Of 20,000 ticks in all, every one that is certified is checked."""
    file = tmp_path / "talos.yaml"
    file.write_text(talos("{double: [left_sole_link, right_sole_link], left: [left_sole_link], right: [right_sole_link], flight: []}"))
    share, worst = walked(gr.load_robot(str(file)), seed, 2000, None)
    with capsys.disabled():
        print(f"\nTALOS, walk {seed}: {100 * share:.2f} % of ticks certified; above the limit by {worst:.1e} at most")


@pytest.mark.parametrize("seed", [2, 7])
def test_a_share_of_the_walks(biped, seed: int):
    share, _ = walked(biped, seed, 5000, 100)
    assert share > 0.98


def walked(robot, seed: int, ticks: int, checks: int | None) -> tuple[float, float]:
    """Every certified gain that is looked up is the limit: continuous and sampled, with equal limbs (symmetric walks) among them."""
    walk = Walk(
        robot, (None, TICK)[seed % 2], 100 + seed, symmetric=seed % 4 > 1, speed=(0.3, 1.0)[seed % 3 > 0], stance=(800, 333)[seed % 5 == 4]
    )
    share, worst = walk.run(ticks, checks)
    assert worst < 1e-6
    return share, worst
