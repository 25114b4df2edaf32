"""Bench of a robot: one joint or task direction is dragged with the other loops closed; the rest is what the command line prints."""

import math
import re
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..analysis.margin_record import GainLimit
from ..analysis.part_region import PartRegion
from ..errors import GainroomError, computable, listed
from ..files.edited_text import edited
from ..files.export_forms import pasted_gains
from ..files.robot_yaml import parse_robot
from ..io.yaml_text import parse_yaml
from ..report.columns import facts
from ..report.gain_advice import robot_to_use, verdict_facts
from ..report.number_format import own_gains, typed
from ..report.recommended_gains import recommended_facts
from ..report.robot import robot_page
from ..report.robot_columns import state_columns
from ..report.robot_tables import RobotPresentation
from ..report.robot_text import sentence, warnings
from ..report.words import tone
from ..robot.model import RobotModel
from ..robot.robot import Posture, Robot
from ..simulation.robot_simulation import RobotSimulation
from ..studies.analysis import analyzed, in_turn
from ..studies.critical_joints import critical_joints_in
from ..studies.loop_numbers import limit_of
from ..studies.progress import Progress, quiet
from ..studies.robot import NUMBERS, RobotStudy, study_robot
from ..studies.state import State, limit_headroom, strongest_first
from ..system.controller import Controller
from ..system.system import System
from .bench import Opened, Part, Remembered, advised, rounded
from .channels import Channel, Channels
from .edits import conditions, form_titles, gain_of, other_formats_hold, ranges, timing
from .messages import View
from .robot_curves import (
    EveryState,
    bode,
    fitted,
    gain_map,
    heat,
    keyframe_angles,
    mode,
    part_of,
    quick_verdict,
    settling,
    slowest_root,
    span_of,
    stand,
    step,
    window_for,
)
from .robot_shapes import described, film, pose, shapes_of
from .shaken import shaken


class RobotBench:
    """Bench of a robot; see Bench."""

    def __init__(self, opened: Opened) -> None:
        self.opened = opened
        self._system = parse_robot(opened.text, opened.source, opened.folder)
        self._data = parse_yaml(opened.text, opened.source)
        self._systems = Remembered[System]()
        self._planes = Remembered[PartRegion]()
        self._found = Remembered[RobotStudy]()
        self._models = Remembered[RobotModel]()
        self._limits = Remembered[tuple[State, GainLimit | None]]()
        self._stars = Remembered[str]()
        self._so_far = GrowingStudy()
        self._lock, self._limiting = threading.Lock(), threading.Lock()
        self._channels = Channels(self._system)
        carriers = self._system.source.body.carriers
        floats = self._system.source.body.base == "floating"
        self._carrier = (carriers[0] if floats else carriers[-1]) if carriers else ""  # a trunk, or an arm's hand
        self.shapes = shapes_of(self._system.source.body)

    def opening(self) -> dict[str, Any]:
        system, source = self._system, self._system.source
        rate, drive = system.control.sample_time, self._data["drive"]
        posture, contact = source.states[0]
        task = self._channels.of_tasks
        frame, mass = self._payload(View())
        held = all(map(other_formats_hold, self._channels.gains(View())))
        return {
            "kind": "robot",
            **self._channels.described(),
            "name": self.opened.source,
            "saves": self.opened.path is not None,
            "space": system.control.space,
            "span_hz": span_of(system),
            "sampled": not system.control.sampling_in_delay,
            "asks_rate": not (system.control.sampling_in_delay or system.control.continuous),
            "continuous": "delay_ticks" not in drive or "sample_rate_hz" in drive,
            "postures": list(source.postures),
            "keyframes": keyframe_angles(source),
            "contacts": list(source.contacts),
            "payload_most": rounded([max(0.5 * source.body.total_mass, 2 * mass)], 1)[0],
            "carriers": list(source.body.carriers),
            "joints": stand(source),
            "shapes": described(self.shapes),
            "view": {
                "gains": self._channels.named(self._channels.gains(View())),
                "delay_ms": 1e3 * system.delay,
                "stiffness": 1.0 if np.isfinite(source.actuators.stiffness).any() else None,
                "link_inertia": None,
                "sample_rate_hz": 0 if rate is None else 1 / rate,
                "payload": mass if frame else None,
                "payload_at": frame,
                "posture": posture,
                "contact": contact,
                "joint": self._channels.names[0 if task else self._leading()],
                "angles": {},
            },
            "needed": system.requirements.needed,
            "uncertain": list(system.uncertainty.names),
            "ranges": self._ranges(system),
            "forms": form_titles(held and not task),
        }

    def _ranges(self, system: System) -> dict[str, list[float | None]]:
        return ranges(system.uncertainty, self._system.source.actuators.stiffness)

    def _leading(self) -> int:
        """Index of the joint that moves most in the vibration of the first state, on which the page opens."""
        try:
            _, limit = self._limited(View())
        except GainroomError:  # said where the state is shown
            return 0
        return int(strongest_first(limit.mode)[0]) if limit is not None and np.isfinite(limit.frequency) else 0

    def text(self, view: View) -> str:
        changes = timing(self._data, self._system.delay, view) | self._channels.changes(view)
        if view.stiffness not in (None, 1.0):
            stiffness = self._system.source.actuators.stiffness * view.stiffness
            for name, value in zip(self._system.source.joint_names, np.asarray(stiffness).tolist(), strict=True):
                if np.isfinite(value):
                    changes["joints", re.escape(name), "stiffness"] = value
        (frame, mass), own = self._payload(view), self._payload(View())
        if (frame, mass) != own and (mass or own[1]):
            changes["model", "payload"] = {"frame": frame, "mass": mass}
        if view.angles:
            posture = view.posture or self._system.source.states[0][0]
            stance = self._system.source.postures[posture]
            named = {re.escape(name): float(value) for name, value in {**stance.angles, **view.angles}.items()}
            changes["postures", posture] = named
        return edited(self.opened.text, self.opened.source, changes)

    def system(self, view: View) -> System:
        """System of the file with the view's values; parts that gains do not change are read again only when they change."""
        base = View(delay_ms=view.delay_ms, sample_rate_hz=view.sample_rate_hz, payload=0.0)
        key = repr(base)
        with self._lock:
            system = self._systems.of(key, lambda: parse_robot(self.text(base), self.opened.source, self.opened.folder))
        if view.stiffness not in (None, 1.0):
            factor = view.stiffness
            system = system.with_values(stiffness=factor * system.source.actuators.stiffness)
            for name, scale in (("stiffness", factor), ("resonance", math.sqrt(factor))):
                if (span := getattr(system.uncertainty, name)) is not None:
                    moved = {name: tuple(scale * np.asarray(end) for end in span)}
                    system = replace(system, uncertainty=replace(system.uncertainty, **moved))
        source = system.source
        frame, mass = self._payload(view)
        if mass:
            carrying = {name: replace(one, body=one.body.with_payload(frame, mass)) for name, one in source.postures.items()}
            source = replace(source, postures=carrying)
        if view.angles:
            source = replace(source, postures={**source.postures, self._state(view)[0]: self._stance(source, view)})
        return self._channels.applied(replace(system, source=source), view)

    def copied(self, view: View, form: str) -> str:
        if form == "yaml":
            return conditions(self.opened.source, self.opening()["view"], view) + self._channels.lines(view)
        channels, system = self._channels, self.system(view)
        if channels.of_tasks:
            raise GainroomError(f"{form}: holds gains of joints, not of tasks; copy as yaml")
        limits = system.source.actuators.known["effort_limit"].tolist()
        gains = {
            name: replace(gain_of(own, form), effort_limit=None if math.isnan(limit) else limit)
            for name, own, limit in zip(channels.names, channels.gains(view), limits, strict=True)
        }
        rate = system.control.sample_time
        margin_text = self._limit_text(system, view)
        kept = f"{Path(self.opened.source).stem}, {margin_text}"
        return pasted_gains(gains, form, kept, None if rate is None else 1 / rate, self._data["control"])

    def _limit_text(self, system: System, view: View) -> str:
        """Text of the gain limit in the worst of all states, certified as `gainroom robot` does, at nominal values."""
        states = [state for place in system.source.states if (state := self._at(system, view, place)).moves]
        if not states:
            return "these gains move nothing"
        limits = [limit_of(state.loop) for state in states]
        worst = min(range(len(limits)), key=lambda k: limit_headroom(limits[k]))
        where = f" in {states[worst].title}" + (f", the worst of {len(states)} states" if len(states) > 1 else "")
        nominal = ", at nominal values" if system.uncertainty.names else ""
        if not limits[worst].stable:
            return f"UNSTABLE{where}, do not run these"
        unknown = [state.title for state, limit in zip(states, limits, strict=True) if math.isnan(limit.gain)]
        missing = f"; the gain limit is not known in {listed(unknown)}" if unknown else ""
        if not math.isfinite(limits[worst].gain):
            return missing.removeprefix("; ") or f"no common factor makes these gains vibrate{nominal}"
        return f"vibration starts at {limits[worst].gain:.3g} × these gains{where}{nominal}{missing}"

    def page(self, view: View) -> str:
        call = self.opened.call("robot")
        return robot_page(RobotPresentation(list(self._studies(view, quiet))[-1], call=call), call)

    def state(self, view: View) -> State:
        """State of the view's posture and contact state."""
        return self._at(self.system(view), view, self._state(view))

    def _at(self, system: System, view: View, place: tuple[str, str]) -> State:
        """State of the view's system; its robot is cached, as gains and delay do not change it."""
        key = repr((view.stiffness, self._payload(view), view.angles if place[0] == self._state(view)[0] else {}, place))
        with self._lock:
            model = self._models.get(key)
        if model is None:
            model = system.source.linearize(*place)
        state = State(system, *place, model)
        with computable(f"{system.source.name}: posture {place[0]!r}, contact {place[1]!r}"):
            state.moves  # noqa: B018 - refused here where nothing of it can be computed
        with self._lock:
            self._models[key] = model
        return state

    def _limited(self, view: View) -> tuple[State, GainLimit | None]:
        """State and its gain limit, computed once for verdict and mode; None if no gain acts on a motion."""

        def found() -> tuple[State, GainLimit | None]:
            state = self.state(view)
            return state, limit_of(state.loop) if state.moves else None

        with self._limiting:
            return self._limits.of(repr(view), found)

    def quick(self, view: View, window: tuple[float, float] | None, known: str) -> Iterator[Part]:
        (state, limit), channel = self._limited(view), self._channels.channel(view)
        own = {
            "gains": {channel.name: {name: value for name, value, _ in own_gains(channel.own)}},
            "point": channel.point,
            "plant": self.plant(view),
            "ranges": self._ranges(state.system),
        }
        key = self._plane_key(channel, view)
        if limit is None or key not in self._planes:
            yield "verdict", quick_verdict(state, limit, channel) | own
        if limit is None:
            return
        plane = self._plane(state, channel, key, window)
        yield "verdict", quick_verdict(state, limit, channel, plane) | own
        yield "bode", bode(plane, channel)
        if key != known:
            follows = len(state.system.source.states) > 1
            yield "map", gain_map(plane, channel, window, state.system.requirements) | {"plant": key, "last": True, "follows": follows}

    def curves(self, view: View, window: tuple[float, float] | None, known: str, final: bool, progress: Progress = quiet) -> Iterator[Part]:
        state, limit = self._limited(view)
        if limit is None:
            return
        yield "mode", mode(state, limit) | pose(state.model, self.shapes, limit.mode if np.isfinite(limit.frequency) else None)
        channel = self._channels.channel(view)
        key = self._plane_key(channel, view)
        if final:
            duration = settling(self._plane(state, channel, key, None), channel)
            changed = ("delay_ms", "stiffness", "payload", "payload_at")
            file = view.model_copy(update={"gains": {}, "point": None, **dict.fromkeys(changed)})
            added, unit, scale = self._channels.disturbance(state.system, channel.place)
            yield "before", step(self.state(file), self._channels.channel(file), duration, scale)
            yield "step", step(state, channel, duration, scale) | {"added": added, "unit": unit}
        if key != known and len(state.system.source.states) > 1:
            plane = self._plane(state, channel, key, window)
            states = (self._at(state.system, view, place) for place in state.system.source.states)
            every = EveryState(states, channel, window or fitted(plane, channel), lambda: progress(0, 1, "every state"))
            for part in every.parts(final):
                yield "map", part | {"plant": key}
        if final:
            yield "root", slowest_root(state)

    def mesh(self, place: int) -> bytes | None:
        """Mesh among the shapes, packed; None if there is none."""
        shape = self.shapes[place] if 0 <= place < len(self.shapes) else None
        return None if shape is None or shape.corners is None else shape.packed()

    def full(self, view: View, window: tuple[float, float] | None, progress: Progress) -> Iterator[Part]:
        study = None
        for study in self._studies(view, progress):
            yield "verdict", self._verdict(study, "state" if study.examined else "certified")
        assert study is not None
        yield "heat", heat(study)
        use = robot_to_use(study, self.opened.call("robot"))
        own = self._own_to_use(study)
        gains = self._to_use(study)
        part = {
            **advised(use, warnings(study) if study.recommended else []),
            "gains": gains or None,
            "star": self._starred(view, gains, progress) if gains else "",
            "points": self._channels.points(own),
            "plant": self.plant(view),
            "find": study.system.requirements.asked != () and not study.recommended,
        }
        yield "use", part

    def recommended(self, view: View, progress: Progress) -> Iterator[Part]:
        study = study_robot(self.system(view), progress)
        there = view.model_copy(update={"gains": self._to_use(study), "point": None})
        with self._lock:
            for each in (view, there):  # P/PI gains as they are typed have proportions of their own
                self._found[self.plant(each)] = study
        yield from self.full(view, None, progress)

    def shaken(self, view: View, progress: Progress) -> Iterator[Part]:
        system = self.system(view)
        posture, contact = self._state(view)
        spec = RobotSimulation.of(replace(system, scenario=replace(system.scenario, posture=posture, contact=contact)))
        yield from shaken(spec, progress, lambda run: film(run, self.shapes), self._channels.channel(view).name)

    def _studies(self, view: View, progress: Progress) -> Iterator[RobotStudy]:
        """Studies of GrowingStudy, with the recommended gains that are known; the view's state and joint do not change them."""
        place = view.posture if view.angles else None
        key = repr(view.model_copy(update={"posture": place, "contact": None, "joint": view.joint if view.point else None}))
        known = self._found.get(self.plant(view))
        for study in self._so_far.studies(key, self.system(view), self._state(view), progress):
            yield study if known is None else replace(study, recommended=known.recommended, exact=known.exact)

    def plant(self, view: View) -> str:
        """Key of the recommended gains, which depend on the file's gains only for the ratios of P/PI tasks."""
        held = [one.from_plane(1.0, 1.0) for one in self._channels.gains(view)] if self._channels.of_tasks else []
        place = view.posture if view.angles else None
        return repr((view.model_copy(update={"joint": None, "point": None, "posture": place, "contact": None, "gains": {}}), held))

    def _verdict(self, study: RobotStudy, basis: str) -> dict[str, Any]:
        found = verdict_facts(study, sentence(study), study.margins_to_use)
        return found | {
            "basis": basis,
            "tone": tone_so_far(study),
            "rows": [row | {"place": self._where(study, row)} for row in found["rows"]],
            "states": [facts(state_columns(), state) for state in study.every],
            "recommended": [recommended_facts(gains) for gains in study.recommended] or None,
            "examined": study.examined,
            "uncertified": [state.title for state in study.states if not state.margins.certified],
        }

    def _where(self, study: RobotStudy, row: dict[str, Any]) -> dict[str, str]:
        """Place of a row's worst value: posture, contact state, and the joint that misses its requirement there."""
        state = study.worst[row["name"]]
        place = {"posture": state.posture, "contact": state.contact}
        missing = critical_joints_in(state, row["name"])[:1] if row["met"] is False and study.stable_in_range else ()
        return {**place, "joint": missing[0]} if missing and missing[0] in self._channels.names else place

    def _to_use(self, study: RobotStudy) -> dict[str, dict[str, float]]:
        """Recommended gains by channel, rounded for typing; empty if there are none."""
        own = self._channels.named(self._own_to_use(study))
        return {name: {gain: float(typed(value)) for gain, value in each.items()} for name, each in own.items()}

    def _own_to_use(self, study: RobotStudy) -> Sequence[Controller]:
        """Recommended gains by channel; empty if there are none, or if they are of another type than the file's."""
        own = study.controllers_to_use if study.to_use is not None else ()
        present = self._channels.gains(View())
        return own if all(type(one) is type(now) for one, now in zip(own, present, strict=False)) else ()

    def _starred(self, view: View, gains: dict[str, dict[str, float]], progress: Progress) -> str:
        """Certified verdict on recommended gains as rounded for typing, from a study of their own: their search does not include it."""
        there = view.model_copy(update={"gains": gains, "point": None, "joint": None, "contact": None})
        key = repr(there)
        if key not in self._stars:
            found = study_robot(self.system(there), progress, recommend=False)
            open_in = [state.title for state in found.states if not state.margins.certified]
            margin_text = "meets every requirement in every state" if found.requirements_met else "does not meet every requirement"
            self._stars[key] = f"{margin_text}; {f'not certified in {listed(open_in)}' if open_in else 'limits certified'}"
        return self._stars[key]

    def _state(self, view: View) -> tuple[str, str]:
        posture, contact = self._system.source.states[0]
        return view.posture or posture, view.contact or contact

    def _payload(self, view: View) -> tuple[str, float]:
        """Frame and mass [kg] of the payload, the file's if the view has none; without one the default frame."""
        body = self._system.source.body
        given = next(iter(body.payload.items()), (self._carrier, 0.0))
        return given[0] if view.payload_at is None else view.payload_at, given[1] if view.payload is None else view.payload

    def _stance(self, source: Robot, view: View) -> Posture:
        name = self._state(view)[0]
        if name not in source.postures:
            raise GainroomError(f"posture {name[:60]!r} is not one of this robot's")
        strange = view.angles.keys() - set(source.joint_names)
        if strange:
            raise GainroomError(f"angles: {min(strange)[:60]!r} is not a joint of this robot")
        stance = source.postures[name]
        return replace(stance, angles={**stance.angles, **view.angles})

    def _plane_key(self, channel: Channel, view: View) -> str:
        """Key of one channel's plane, which does not depend on the gains in it."""
        others = {name: pair for name, pair in view.gains.items() if name != channel.name}
        return repr((view.model_copy(update={"point": None, "gains": others}), self._state(view), channel.name, channel.held))

    def _plane(self, state: State, channel: Channel, key: str, window: tuple[float, float] | None) -> PartRegion:
        with self._lock:
            if key not in self._planes or window is not None:
                self._planes[key] = PartRegion.of(state.loop, part_of(state, channel), window or window_for(channel))
            return self._planes[key]


class GrowingStudy:
    """Study of a robot that grows from the visible state to all states; the latest one is cached for further views at the same gains."""

    def __init__(self) -> None:
        self._last: tuple[str, RobotStudy] | None = None

    def studies(self, key: str, system: System, shown: tuple[str, str], progress: Progress) -> Iterator[RobotStudy]:
        """Studies of the state `shown`, of all states so far whenever another is unstable, and finally of every state.

        `key` differs between different systems. The states with the least headroom before come first.
        """
        last = self._last
        if last is None or last[0] != key:
            progress(0, 1, "this state")
            before = {} if last is None else {_place(state): limit_headroom(state.limit) for state in last[1].states}
            order = sorted(system.source.states, key=lambda place: (place != shown, before.get(place, math.inf)))
            found: dict[tuple[str, str], State] = {}
            for state in in_turn(system, order, progress, NUMBERS):
                found[_place(state)] = state
                if len(found) < len(order) and state.moves and (len(found) == 1 or not state.limit.stable):
                    yield RobotStudy(system, tuple(found[place] for place in system.source.states if place in found))
            every = analyzed(system, (found[place] for place in system.source.states)).every
            last = self._last = key, RobotStudy(system, every)
        yield last[1]


def tone_so_far(study: RobotStudy) -> str:
    """Tone of the verdict on the page; "good" only after all states."""
    found = tone(study.verdict)
    return "wait" if study.examined and found == "good" else found


def _place(state: State) -> tuple[str, str]:
    return state.posture, state.contact
