"""Bench of one joint: a view is an edited joint.yaml, so its numbers are the command line's by construction."""

import math
import threading
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..files.edited_text import Keys, edited, plain, written
from ..files.export_forms import pasted_gains
from ..files.joint_yaml import parse_joint, parse_simulation
from ..io.yaml_text import parse_yaml
from ..report.bode import BodeLoop, frequency_span, response
from ..report.columns import facts
from ..report.gain_advice import joint_to_use, verdict_facts
from ..report.gain_map import around, edge_frequencies, gain_points
from ..report.gains_to_use import joint_gains
from ..report.joint import joint_page
from ..report.joint_tables import JointPresentation
from ..report.joint_text import sentence, warnings
from ..report.map_lines import MapView as Window, heights, opened, outlines, required_lines
from ..report.margin_columns import known_columns, margins_text
from ..report.over_time import LOAD, drawn_until
from ..studies.analysis import analyze
from ..studies.gain_paths import PathStudy, study_gain_paths
from ..studies.joint import JointStudy, study_joint
from ..studies.progress import Progress, quiet
from ..system.controller import Controller
from ..system.system import System
from ..system.uncertainty import Uncertainty
from .bench import Opened, Part, Remembered, advised, drawn_line, drawn_response, drawn_step, rounded
from .edits import at_point, conditions, form_titles, gain_of, other_formats_hold, put, ranges, timing
from .messages import View
from .path_parts import one_path, open_loop, plane, stability, step as step_of_paths, use, verdict as verdict_of_paths
from .shaken import shaken
from .structures import Structure, Structures
from .tunables import Tunable

SAME_IN_A_PLANE = ("recommended", "exact", "at_usual_rate", "uncertainty_cost")
"""Fields of a JointStudy that are the same for all gains in their plane."""
WIDER = 2.0
"""Factor by which the frequency axis exceeds that of the report, as gains move."""
STEP_POINTS = 500


class JointBench:
    """Bench of one joint; see Bench."""

    def __init__(self, opened: Opened) -> None:
        self.opened = opened
        self._structures = Structures(opened.text, opened.source)
        self._system = self._structures.own.system
        study = _nominal(one_path(self._system))
        self._span = sweep_span(study)
        self._window = map_window(study)
        self._studies = Remembered[JointStudy]()  # by text
        self._paths = Remembered[PathStudy]()  # likewise, where kd closes on a path of its own
        self._plants = Remembered[JointStudy]()  # by plant: with its recommendation
        self._others = Remembered[System]()  # by what is no gain
        self._one_at_a_time = threading.Lock()

    def opening(self) -> dict[str, Any]:
        system = self._system
        joint, control = system.source, system.control
        controller, rate = control.controller, control.sample_time
        return {
            "kind": "joint",
            "name": self.opened.source,
            "saves": self.opened.path is not None,
            "structures": self._structures.described(),
            "point": controller.plane_gains() if controller.has_plane else None,
            "window": self._window,
            "span_hz": [end / (2 * math.pi) for end in self._span],
            "sampled": not system.control.sampling_in_delay,
            "asks_rate": not (system.control.sampling_in_delay or system.control.continuous),
            "continuous": "delay_ticks" not in self._structures.own.data["drive"] and control.kd_path is None,
            "view": {
                "gains": {one.name: one.value for one in self._structures.own.tunables},
                "delay_ms": 1e3 * system.delay,
                "stiffness": joint.stiffness if math.isfinite(joint.stiffness) else None,
                "link_inertia": joint.link_inertia if math.isfinite(joint.link_inertia) else None,
                "sample_rate_hz": 0 if rate is None else 1 / rate,
            },
            "needed": system.requirements.needed,
            "uncertain": list(system.uncertainty.names),
            "ranges": ranges(system.uncertainty),
            "forms": form_titles(other_formats_hold(controller)),
        }

    def text(self, view: View) -> str:
        return edited(self._structure(view).text, self.opened.source, self._values(view))

    def copied(self, view: View, form: str) -> str:
        system = self.system(view)
        controller = system.control.controller
        if form == "yaml":
            if view.structure:
                lines = [f"{name}: {plain(value)}" for name, value in self._control(view).items()]
            else:
                lines = [*joint_gains(controller), *self._other_lines(view)]
            return conditions(self.opened.source, self.opening()["view"], view) + "".join(f"{line}\n" for line in lines)
        gain, study = gain_of(controller, form), _nominal(system)
        kept = margins_text(study.margins, study.system.requirements) if study.margins.stable else "UNSTABLE, do not run these"
        kept = f"{Path(self.opened.source).stem}, {'nominal ' if study.margins.stable else ''}{kept}"
        if (feedback := study.system.control.feedback).mixed:  # which no form has a key for
            kept += f", measured on {feedback.where}"
        rate = study.system.control.sample_time
        return pasted_gains({"joint": gain}, form, kept, None if rate is None else 1 / rate, self._control(view))

    def _structure(self, view: View) -> Structure:
        """Structure of the view's controller."""
        return self._structures.of(view.structure)

    def _tunables(self, view: View) -> list[Tunable]:
        return self._structure(view).tunables

    def _control(self, view: View) -> Mapping[str, Any]:
        """Section `control` of the edited file."""
        return parse_yaml(self.text(view), self.opened.source)["control"]

    def _other_lines(self, view: View) -> list[str]:
        """Lines of `control` with numbers that are no gains, such as those of filters."""
        control, names = self._control(view), dict.fromkeys(str(one.path[0]) for one in self._tunables(view) if not one.field)
        return [f"{name}: {written(control[name])}" for name in names]

    def mesh(self, place: int) -> bytes | None:
        return None

    def page(self, view: View) -> str:
        if self.system(view).control.kd_path is not None:
            raise GainroomError("there is no page where kd closes on a path of its own; `gainroom joint` has its numbers")
        call = self.opened.call("joint")
        return joint_page(JointPresentation(self._study(view), call=call), call)

    def system(self, view: View) -> System:
        """System of the edited file, as the command line would read it."""
        return parse_joint(self.text(view), self.opened.source, two_paths=True)

    def _followed(self, view: View) -> System:
        """System while gains are dragged: a file is edited and read again only if something else changes."""
        others = view.model_copy(update={"gains": self._other_numbers(view), "point": None})
        system = self._others.of(repr(others), lambda: self.system(others))
        return system.with_controller(self._controller(view, system.control.controller))

    def quick(self, view: View, window: tuple[float, float] | None, known: str) -> Iterator[Part]:
        system, plant = self._followed(view), self.plant(view)
        if system.control.kd_path is not None:
            more = {"plant": plant, "ranges": ranges(system.uncertainty)}
            yield "verdict", stability(system) | self._gains(system, view) | more
            yield "bode", open_loop(system, self._span)
            return
        study = _nominal(system)
        uncertain = bool(system.uncertainty.names)
        more = {"plant": plant, "ranges": ranges(system.uncertainty)}
        yield "verdict", _verdict(study, "nominal" if uncertain else "certified") | self._gains(system, view) | more
        yield "bode", bode(study, self._span)
        if plant != known:
            yield "map", stable_gains(study, window or self._window) | {"plant": plant}

    def curves(self, view: View, window: tuple[float, float] | None, known: str, final: bool, progress: Progress = quiet) -> Iterator[Part]:
        system, plant = self._followed(view), self.plant(view)
        if not known:
            own = self._system
            yield "before", step(_nominal(own)) if own.control.kd_path is None else step_of_paths(own)
        if system.control.kd_path is not None:
            yield "step", step_of_paths(system)
            if plant != known:
                yield "map", plane(system, window or self._window) | {"plant": plant}
            return
        study = _nominal(system)
        if plant != known:
            for part in required_gains(study, window or self._window):
                yield "map", part | {"plant": plant}
        yield "step", step(study)

    def full(self, view: View, window: tuple[float, float] | None, progress: Progress) -> Iterator[Part]:
        system = self.system(view)
        if system.control.kd_path is not None:
            yield from self._full_of_paths(view, system, progress)
            return
        progress(0, 2, "ranges")
        study = JointStudy(system, analyze(system).every)
        vars(study).update(recommended=None, exact=None)
        if system.uncertainty.names:
            yield "verdict", _verdict(study, "certified") | self._gains(system, view)  # before recommended gains, which take longer
        progress(1, 2, "recommended gains")
        study = self._study(view)
        use = joint_to_use(study, self.opened.call("joint"))
        yield "verdict", _verdict(study, "certified") | self._gains(system, view)
        best = study.recommended
        if type(study.template) is not type(system.control.controller):  # gains of another type are no gains of this file's controller
            best = None
        yield "map", limits(study, window or self._window) | {"plant": self.plant(view)}
        yield (
            "use",
            {
                **advised(use, warnings(study)),
                "point": None if best is None else [best.kp, best.kd],
                "gains": None if best is None else {k: float(v) for k, v in (line.split(": ") for line in joint_gains(best.controller))},
                "rule": [study.rule.kp, study.rule.kd],
                "plant": self.plant(view),
            },
        )

    def _full_of_paths(self, view: View, system: System, progress: Progress) -> Iterator[Part]:
        """Parts at rest of a joint whose kd closes on a path of its own: nominal margins first, then over the ranges."""
        gains, text = self._gains(system, view), self.text(view)
        if system.uncertainty.names and text not in self._paths:
            progress(0, 2, "margins")
            yield "verdict", verdict_of_paths(study_gain_paths(replace(system, uncertainty=Uncertainty())), "nominal") | gains
        study = self._paths.of(text, lambda: study_gain_paths(system, progress))
        covers = (
            {"covers": "Nominal values: certified by root counts. Ranges: their corners and samples."} if system.uncertainty.names else {}
        )
        yield "verdict", verdict_of_paths(study, "certified") | gains | covers
        yield "use", use(study) | {"plant": self.plant(view)}

    def recommended(self, view: View, progress: Progress) -> Iterator[Part]:
        yield from self.full(view, None, progress)

    def shaken(self, view: View, progress: Progress) -> Iterator[Part]:
        yield from shaken(parse_simulation(self.text(view), self.opened.source, two_paths=True), progress)

    def _gains(self, system: System, view: View) -> dict[str, Any]:
        controller = system.control.controller
        point = controller.plane_gains() if controller.has_plane else None
        return {"gains": {one.name: float(getattr(controller, one.field)) for one in self._tunables(view) if one.field}, "point": point}

    def _study(self, view: View) -> JointStudy:
        """Study of the view, cached; the recommendation of a PD does not depend on its gains, and is looked up."""
        text = self.text(view)
        with self._one_at_a_time:
            if text in self._studies:
                self._studies.move_to_end(text)
                return self._studies[text]
            study, plant = self.system(view), self.plant(view)
            if (other := self._plants.get(plant)) is not None:  # the recommendation does not depend on where in its plane the gains are
                study = JointStudy(study, analyze(study).every)
                vars(study).update({name: vars(other)[name] for name in SAME_IN_A_PLANE if name in vars(other)})
            else:
                study = study_joint(study)
                study.at_usual_rate  # noqa: B018 - computed now, so that it is remembered
                self._plants[plant] = study
            self._studies[text] = study
            return study

    def plant(self, view: View) -> str:
        """Key of the gain map: everything except the gains in its plane."""
        controller = self._controller(view, self._structure(view).system.control.controller)
        held = controller.from_plane(1.0, 1.0) if controller.has_plane else controller
        return repr(
            (view.structure, view.delay_ms, view.stiffness, view.link_inertia, view.sample_rate_hz, self._other_numbers(view), held)
        )

    def _other_numbers(self, view: View) -> dict[str, Any]:
        """Numbers of the view that are no gains, such as those of filters, where they are not the file's."""
        return {
            one.name: view.gains[one.name]
            for one in self._tunables(view)
            if not one.field and view.gains.get(one.name, one.value) != one.value
        }

    def _controller(self, view: View, own: Controller) -> Controller:
        """The file's controller `own` with the view's gains; a point of the plane takes precedence."""
        known = {one.name: one for one in self._tunables(view)}
        if strange := view.gains.keys() - known.keys():
            raise GainroomError(f"gains: {min(strange)} is not a gain of this controller, which has {', '.join(known)}")
        for name, value in view.gains.items():
            least = known[name].least
            if not isinstance(value, float) or (least is not None and value < least):
                raise GainroomError(f"gains: {name} must be a number{'' if least is None else f' >= {least:g}'}")
        gains: dict[str, Any] = {name: value for name, value in view.gains.items() if known[name].field}
        controller = replace(own, **gains)
        return controller if view.point is None or not own.has_plane else at_point(controller, view.point)

    def _values(self, view: View) -> Mapping[Keys, Any]:
        """Changes of the file by the view, by key."""
        structure = self._structure(view)
        data, changes = structure.data, timing(structure.data, structure.system.delay, view)
        controller = self._controller(view, structure.system.control.controller)
        others = self._other_numbers(view)
        for one in structure.tunables:
            value = float(getattr(controller, one.field)) if one.field else others.get(one.name, one.value)
            if value != one.value:
                changes[("control", *one.path)] = value
        for key in ("stiffness", "link_inertia"):
            if (value := getattr(view, key)) is not None:
                put(changes, data, ("joint", key), data["joint"][key], value)
        return changes


def _nominal(system: System) -> JointStudy:
    """Study at the file's nominal values, without a search for gains."""
    exact = replace(system, uncertainty=Uncertainty())
    study = JointStudy(exact, analyze(exact).every)
    vars(study).update(recommended=None, exact=None)
    return study


def _verdict(study: JointStudy, basis: str) -> dict[str, Any]:
    """Verdict part of the page, first as in terminal and report; `basis`: certified, or nominal where ranges were not examined."""
    best = None if study.recommended is None else study.recommended.worst
    margins = {"numbers": study.margins, "worst": study.in_range.margins}
    return {"basis": basis, **verdict_facts(study, sentence(study), best)} | {
        key: facts(known_columns(study.system.requirements), found) for key, found in margins.items()
    }


def sweep_span(study: JointStudy) -> tuple[float, float]:
    """Span of the frequency axis [rad/s], constant while gains move."""
    low, high = frequency_span(study, [BodeLoop("", study.loop, study.margins)])
    return low / WIDER, high if study.system.control.sample_time is not None else high * WIDER


def map_window(study: JointStudy) -> tuple[float, float]:
    """Largest gains (kp, kd) of the map."""
    window = around(study, gain_points(study))
    return window.kp, window.kd


def bode(study: JointStudy, span: tuple[float, float]) -> dict[str, Any]:
    """Magnitude, phase and the Nyquist plot of the open loop, with the crossings that decide; frequencies in Hz."""
    low, high = span
    if study.system.control.sample_time is not None:
        high = math.pi / study.system.control.sample_time
    omega, _, phase = response(study.loop, min(low, 0.1 * high), high)
    found = study.margins
    marks = {"gain": found.phase_crossover, "phase": found.gain_crossover, "Ms": found.peak_sensitivity_frequency}
    return drawn_response(omega, study.loop.response(omega), phase, marks)


def stable_gains(study: JointStudy, window: tuple[float, float]) -> dict[str, Any]:
    """Outlines of the stable gains."""
    return {"stable": [drawn_line(outline) for outline in outlines(study.region, Window(*window, *window))], "window": window}


def required_gains(study: JointStudy, window: tuple[float, float]) -> Iterator[dict[str, Any]]:
    """Outlines of the gains that meet the requirements at the nominal values; then the frequencies along the edge of the stable ones."""
    view = Window(*window, *window)
    asked = study.system.requirements.asked
    yield {"required": [drawn_line(outline) for outline in outlines(study.required_region, view)] if asked else []}
    pieces = [opened(outline) for outline in outlines(study.region, view)]
    edge = [(piece, edge_frequencies(study.region, piece)) for piece in pieces]
    yield {
        "edge": [{"line": drawn_line(piece), "hz": rounded(omega / (2 * math.pi))} for piece, omega in edge if np.isfinite(omega).any()],
        "last": True,
    }


def limits(study: JointStudy, window: tuple[float, float]) -> dict[str, Any]:
    """Line of each required margin, and lines of equal dynamic stiffness of the link."""
    view = Window(*window, *window)
    return {
        "lines": [{"text": text, "parts": [drawn_line(part) for part in parts]} for text, parts in required_lines(study, view)],
        "heights": [{"text": text, "line": drawn_line(line)} for text, line in heights(study, view)[1]],
    }


def step(study: JointStudy) -> dict[str, Any]:
    """Link and motor after a step of the reference, and under a load on the link."""
    found = study.response
    shown = int(np.searchsorted(found.time, drawn_until(found), side="right"))
    pick = slice(None, shown, max(1, shown // STEP_POINTS))
    return drawn_step(found, pick, 1e3 * LOAD) | {
        "growth": found.growth,
        "hz": found.frequency / (2 * math.pi),
        "added": f"{LOAD:g} N·m on the link",
        "unit": "mrad",
    }
