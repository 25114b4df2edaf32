"""An audit as it is shown: keys of --json, lines of the terminal, page."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..files.audit_options import Audited
from ..files.carried_robot import carried
from ..io.as_typed import as_typed
from ..studies.audit import Audit
from ..studies.verdict import Verdict
from ..system.margin_units import to_db
from ..system.requirements import REQUIREMENTS
from .audit_advice import what_to_do
from .audit_text import audit_scale, audit_sentence, audit_warnings, reason, verdict
from .columns import definitions, facts
from .gearboxes import CAPTION, gearbox_assumptions, look_columns, needed_facts, range_facts, shown_looks
from .margin_columns import required_facts
from .number_format import model_facts, model_text, path_facts
from .page import Advice
from .presentation import Grid, Legend, Part, Presentation, closing, do_this, folded, warned_first
from .robot_columns import AUDITED_JOINT, audited_joints, audited_states, joint_caption, legend
from .words import in_simulator

if TYPE_CHECKING:
    from ..studies.audited_workspace import AuditedWorkspace
    from ..studies.simulator_audit import SimulatorAudit

STIFFNESS = "By the stiffness of the gearboxes that are not known"
FEW_LINES = 4
"""Shown without being asked for all; of more, the table has the factors."""
FEW_JOINTS = 4
"""Shown without being asked for all, at most: those with the least headroom."""
ELSEWHERE = ("gain_margin", "delay_margin")
"""Requirements whose least margins have keys of their own."""


@dataclass(frozen=True)
class AuditPresentation(Presentation):
    """All that is shown of an audit.

    of          the robot as it was read, and how
    simulated   the simulator's answer, and swept the whole workspace; None where it was not asked for: then it is not loaded
    """

    result: Audit
    of: Audited
    simulated: "SimulatorAudit | None" = None
    swept: "AuditedWorkspace | None" = None

    @property
    def verdict(self) -> Verdict:
        """With what was asked besides."""
        return self.result.verdict_with(self.simulated, self.swept)

    def facts(self) -> dict[str, Any]:
        result, system, control = self.result, self.result.system, self.result.system.control
        least = {
            one.key: one.in_unit(one.value(result.worst[one.name].counted)) for one in REQUIREMENTS.values() if one.name not in ELSEWHERE
        }
        return {
            "robot": system.source.name,
            "gainroom": __version__,
            **self.verdict.facts,
            "safe": self.verdict.level == "safe",
            "decided": result.decided,
            "sentence": audit_sentence(result),
            "requirements_met": result.safe,
            "unmet": list(result.missed),
            "required": required_facts(result.required),
            "balance": system.balance or None,
            "scale": audit_scale(result),
            "to_use": _to_use_facts(result),
            **model_facts(control.sample_time),
            "delay_ms": 1e3 * max(drive.delay for drive in system.drives),
            "command_delay_ms": 1e3 * control.command_delay,
            "kd_path": path_facts(control.kd_path),
            "gains_run": self.of.options.gains_run,
            "joint_damping": self.of.options.joint_damping,
            "margin_db": as_typed(to_db(result.margin)),
            "stable": all(state.limit.stable for state in result.states),
            "gain_limit": result.tightest.limit.gain,
            "limit_frequency_rad_s": result.tightest.limit.frequency,
            "delay_limit_ms": 1e3 * result.delay_limit,
            "delay_margin_ms": 1e3 * result.least_extra_delay if result.stable else math.nan,
            **least,
            "path_gain_limits": _path_facts(result),
            "limiting_joints": list(result.limiting_joints),
            "posture": result.angles,
            "base": system.source.body.base,
            "system": carried(self.of.sections, system),
            "joints": [facts(AUDITED_JOINT, joint) for joint in result.joints],
            "states": [facts(audited_states(result.enough_in), state) for state in result.states + result.immobile],
            **self._further_facts(),
            "needed_stiffness": needed_facts(result),
            "gearbox_range": range_facts(result),
            "readings": _reading_facts(result),
            "rigid_gearboxes": [joint.name for joint, rigid in zip(result.joints, result.assumed_rigid.tolist(), strict=True) if rigid],
            "assumptions": [*system.assumptions, *gearbox_assumptions(result)],
            "warnings": list(audit_warnings(result)),
        }

    def _further_facts(self) -> dict[str, Any]:
        """What was asked for besides."""
        found: dict[str, Any] = {"simulator": None, "workspace": None}
        if self.simulated is not None:
            from .simulator_text import simulator_facts

            found["simulator"] = simulator_facts(self.simulated)
        if self.swept is not None:
            from .workspace import audited_facts

            found["workspace"] = audited_facts(self.swept)
        return found

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        result = self.result
        do = what_to_do(result, self.call, self.files.get("Robot"), None if verbose else FEW_LINES)
        said, assumed = self._further()
        assumed = (*result.system.assumptions, *gearbox_assumptions(result), *assumed)
        doubts, warned = warned_first(audit_warnings(result), verbose)
        begin, posture = [*doubts, *self._answer(do), *said], f"Posture: {result.states[0].posture}; {result.system.source.body.base} base"
        if verbose:
            yield [*begin, "", *_all_there_is(result), *folded(do), posture, *closing(self.files, warned, assumed)]
            return
        how = f"{_rigid(result)}; {self.of.options.where_gains_run} (--gains-run). {len(assumed)} assumptions: --verbose."
        for count in range(FEW_JOINTS, 0, -1):
            yield [*begin, *_tightest_joints(result, count), *closing(self.files, warned), posture + how]

    def _answer(self, do: Advice) -> list[Part]:
        """The verdict, what to do, and why."""
        result, swept = self.result, self.swept
        said, there = in_simulator(verdict(result), self.simulated), do_this(do)
        if swept is not None and not swept.safe:
            from .workspace import advice_there, in_workspace

            said = in_workspace(said, swept)
            there = do_this(replace(advice_there(swept), remarks=())) if result.safe else there
        return [said, *there, reason(result)]

    def _further(self) -> tuple[list[str], tuple[str, ...]]:
        """Paragraphs on what was asked for besides, and what the simulator assumes."""
        said, assumed = [], ()
        if self.simulated is not None:
            from .simulator_text import simulator_assumptions, simulator_sentence

            said, assumed = ["", simulator_sentence(self.simulated)], simulator_assumptions(self.simulated)
        if self.swept is not None:
            from .workspace import workspace_text

            said += ["", workspace_text(self.swept, not self.result.safe)]  # of safe gains the answer says what to do there
        return said, assumed

    def page(self, command: str) -> str:
        from .audit import audit_page  # loads the pictures

        return audit_page(self.result, command, self.simulated, self.swept, self.call)


def _to_use_facts(result: Audit) -> dict[str, Any] | None:
    """The factor (None: each has its own), the joints whose gains it is on, whether they may be used yet, and every joint's gains as typed.

    None for safe gains, and where none are known.
    """
    found = result.to_use
    if found is None:
        return None
    names = result.system.source.joint_names
    columns = {**found.gains, "factor": found.factors}
    gains = [{"name": name, **{key: float(values[k]) for key, values in columns.items()}} for k, name in enumerate(names)]
    return {"factor": found.factor, "scaled": list(found.joints), "ready": result.ready_to_use is not None, "joints": gains}


def _path_facts(result: Audit) -> dict[str, Any] | None:
    paths = result.tightest.margins.paths
    return None if paths is None else {"kp": [paths.lower_others, paths.others], "kd": [paths.lower_kd, paths.kd]}


def _reading_facts(result: Audit) -> list[dict[str, Any]]:
    return [
        {
            "option": one.option,
            "meaning": one.meaning,
            "safe": one.audit.safe,
            "gain_limit": one.audit.tightest.limit.gain,
            "unsafe_joints": [joint.name for joint in one.audit.joints if not joint.safe],
        }
        for one in result.readings
    ]


def _tightest_joints(result: Audit, count: int) -> list[Part]:
    """The `count` joints with the least headroom, and what is left out."""
    other = "gain_limit" if result.stable else "limit_others_closed"  # which is not what joints are judged by
    columns = [one for one in audited_joints(result) if one.key not in ("motor_inertia", other)]
    shown, left = result.joints_tightest_first[:count], result.joints_tightest_first[count:]
    failing = sum(not joint.safe for joint in left)
    of_them = f", {failing} of which fail" if failing else ""
    others = f"{len(left)} more joint{'s' * (len(left) > 1)}{of_them}: --verbose. " if left else ""
    joints = Grid.of("", columns, shown)
    return [joints, Legend([joints], lambda headings: others + legend(result, headings))]


def _all_there_is(result: Audit) -> list[Part]:
    """Every contact state and joint."""
    control, columns, needed = result.system.control, audited_states(result.enough_in), result.needed
    title = f"All joints together ({model_text(control.sample_time, control.kd_path)})"
    states = Grid.of(title, columns, result.states + result.immobile)
    joints = Grid.of("Joint by joint, in the worst state", audited_joints(result), result.joints, ("motor inertia", "one loop"))
    stiffness = [] if needed is None else ["", Grid.of(STIFFNESS, look_columns(result, needed), shown_looks(needed)), CAPTION]
    return [
        states,
        Legend([states], lambda headings: definitions(columns, headings)),
        "",
        joints,
        Legend([joints], lambda headings: joint_caption(result, headings)),
        *stiffness,
    ]


def _rigid(result: Audit) -> str:
    """That gearboxes are assumed to be rigid, where some are."""
    rigid = result.assumed_rigid.tolist()
    count = sum(rigid)
    which = "" if all(rigid) else f"{count} of {len(rigid)} "
    return f"; {which}gearboxes assumed rigid (--stiffness, --damping)" if count else ""
