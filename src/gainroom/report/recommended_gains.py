"""Recommended gains of a robot, as sentences and columns: limits, cost of one set for all states, and missing gains."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..design.gain_search import LINK
from ..design.gain_sets import GainSet, RobotGains, StateStiffness
from ..design.robot_gains import EVERYWHERE
from ..errors import listed
from ..studies.softest_link import SoftestLink, softest_of
from ..system.linear.arrays import Floats
from ..system.requirement import Requirement
from ..system.requirements import Requirements, reported, title_of
from .columns import Column, facts
from .margin_columns import margin_facts, margins_text, requirement
from .number_format import digits, hertz
from .robot_columns import damping_facts

if TYPE_CHECKING:
    from ..studies.robot import RobotStudy

LEAST_COST = 1.02
"""Least factor of dynamic stiffness that is worth a switch of gains."""


def gains_text(gains: RobotGains, first: tuple[str, str]) -> list[str]:
    """Sentences below the gains that are safe in every state, or in place of them; `first`: posture and contact state."""
    found = gains.everywhere
    if found is None:
        text = f"No gains were found that meet the requirements in every state, {gains.space} space; nearest: {gains.nearest['']}."
        return [text, *_of_one_contact(gains)]
    if not found.moves:
        return [f"No recommended gains in {gains.space} space: nothing moves in any posture and contact state."]
    where = "Without the weight" if found.without_weight else "In every state"
    text = f"{where} they have: {margins_text(found.margins)}; all loops together and one loop at a time with the other loops closed."
    more = [inertia_text(first)] if gains.inertia is not None else []
    return [" ".join([text, *more]), stiffness_text(found, gains.names), *_immobile(gains), *filter(None, [cost_text(gains)])]


def stiffness_text(found: GainSet, names: Sequence[str]) -> str:
    """Sentences on the dynamic stiffness of the links with a set: the softest, what limits it, and what the gearboxes limit."""
    j, state = found.softest, found.softest_in[found.softest]
    if state < 0:
        return f"What limits them: {_limits(found, names)}."
    one = found.links[state]
    at = f"at {hertz(one.omega[j])} in {one.title}" if one.omega[j] > 0 else f"in {one.title}"
    unit = "" if found.ki is not None or np.isnan(one.stiffness[j]) else " N·m/rad"
    text = (
        f"Dynamic stiffness, the least that a load on a link meets at any frequency: {names[j]} has the least, "
        f"{digits(float(one.stiffness[j]), significant=3)}{unit} {at}; what limits them: {_limits(found, names)}."
    )
    geared = list(dict.fromkeys(names[int(k)] for link in found.links for k in np.flatnonzero(link.gear_limited)))
    if geared:
        text += f" The gearbox alone limits {listed(geared)} in some state: no gain damps that, more gearbox damping B does."
    return text


def inertia_text(first: tuple[str, str]) -> str:
    """Sentence on the inertia J in kp/J and kd/J; `first`: posture and contact state."""
    return f"J: the motor's inertia and the load 1/W_ii in {', '.join(first)}, the first state; in another, kp/J and kd/J differ."


def cost_text(gains: RobotGains) -> str:
    """Sentences on the cost of one set for all states relative to one for each contact state; "" if there is nothing to compare."""
    costs = {contact: cost for contact, cost in gains.cost.items() if math.isfinite(cost)}
    if len(gains.per_contact) < 2 or not costs:
        return ""
    most = max(costs, key=costs.__getitem__)
    if costs[most] < LEAST_COST:
        return "One set for every state costs nothing: no contact state alone allows stiffer links."
    each = ", ".join(f"{contact} {digits(cost, significant=3)}" for contact, cost in costs.items())
    return (
        f"Gains for one contact state alone make its links stiffer, dynamic stiffness is larger by these factors: {each}. Switching gains "
        f"with the contacts gains most in {most}."
    )


def limited_by(found: GainSet, names: Sequence[str]) -> str:
    """Limit of the softest joint or direction: its name, the margin, and the state."""
    margin = _limits_of(found)[found.softest] if found.margin else ""
    weight = ", without the weight" if found.without_weight else ""
    where = f", {found.binding}" if found.binding else ""  # a bound holds in every state
    return f"{names[found.softest]}: {margin}{where}{weight}" if margin else f"no requirement{weight}"


def _limits_of(found: GainSet) -> list[str]:
    """What limits each joint or direction, as text: a requirement, a bound, or the link, which stiffer gains damp less; "": nothing."""
    titles = ["its own link, which would be softer" if margin == LINK else title_of(margin) for margin in found.margin]
    return [f"{title} of sway" if sways else title for title, sways in zip(titles, found.of_sway, strict=True)]


def sway_text(gains: RobotGains, found: GainSet, required: Requirements, balanced: bool) -> str:
    """Sentence on who damps sway with a set of gains, and what joints that have to damp it cannot have; "" where nothing sways."""
    sways = [(*one.damping["sway"], one.title) for one in found.links if "sway" in one.damping]
    if balanced and sways:
        ratio, omega, title = min(sways)
        return (
            f"A controller above the joints damps sway; with these gains alone its damping ratio is {digits(ratio, '', 2)}, at "
            f"{hertz(omega)} in {title}."
        )
    held = [j for j, sway in enumerate(found.of_sway) if sway]
    if not held:
        return ""
    first = min(held, key=lambda j: found.kp[j])
    one, needed = required.asked_by(found.margin[first])
    return (
        f"{one.label[:1].upper()}{one.label[1:]} {one.sign} {one.text(needed)} on sway of the base in {found.case[first]} is what keeps "
        f"{listed([gains.names[j] for j in held])} at kp {digits(float(found.kp[first]), '', 3)}{'' if len(held) == 1 else ' and more'}. "
        "Where a controller above the joints damps it, state `balance: controller`."
    )


HAND = 50.0
"""Force on an arm's hand [N] in sentences: what somebody pushes with, or 5 kg weigh."""


def links_text(study: "RobotStudy") -> list[str]:
    """Sentences on the softest link and on an arm's hand, with the file's gains and with recommended ones."""
    assert study.to_use is not None
    ranges = study.system.uncertainty.names  # then the new gains' is the worst in them, and the present ones' nominal
    now, new = None if ranges else study.softest_now, softest_of(study.to_use[1])
    found = (
        []
        if new is None
        else [
            f"Softest link: {_soft_text(study, new)} with the new gains"
            + ("." if now is None else f"; {_soft_text(study, now)} with the present ones.")
        ]
    )
    before, after = study.hands
    if after is not None:
        was = "" if before is None else f", with the present ones {digits(1e3 * HAND * before.softness, 'mm', 3)}"
        swings = f" where it swings at {hertz(after.omega)}" if after.omega > 0 else ""
        found.append(f"{HAND:.0f} N at {after.frame} move it {digits(1e3 * HAND * after.softness, 'mm', 3)} at most{swings}{was}.")
    return found


def _soft_text(study: "RobotStudy", one: SoftestLink) -> str:
    """A joint with its dynamic stiffness, the state, and the load that turns it by 1°, or moves it by 1 mm."""
    name, straight = study.system.source.joint_names[one.joint], bool(study.system.source.body.prismatic[one.joint])
    unit, force, small = ("N/m", "N", "1 mm") if straight else ("N·m/rad", "N·m", "1°")
    load = digits(one.stiffness * (1e-3 if straight else math.radians(1)), force, 3)
    at = f" at {hertz(one.omega)}" if one.omega > 0 else ""
    return f"{name}, {digits(one.stiffness, unit, 3)}{at} in {one.title} ({load} {'move' if straight else 'turn'} it by {small})"


def none_text(study: "RobotStudy") -> str:
    """Sentence on what keeps gains from meeting everything, and the nearest miss; "" where gains were found or not searched."""
    missing = [gains for gains in study.recommended if gains.space == study.system.control.space and gains.everywhere is None]
    if not missing:
        return ""
    one, *_ = _of_one_contact(missing[0]) or [""]
    return f"No gains meet everything that is required in every state; the nearest miss: {missing[0].nearest['']}. {one}".rstrip()


def weight_warnings(gains: RobotGains) -> list[str]:
    """Warnings about recommended gains that do not meet the requirements with the robot's weight."""
    found, safe = [], gains.everywhere
    if gains.unweighed:
        why = "because contacts there leave the base free to move; take a foot as flat and rigid"
        found.append(f"recommended gains: the weight is left out in {listed(list(gains.unweighed))}, {why}")
    failed = {} if safe is None or not safe.without_weight else {"every state": safe}
    for contact, one in gains.per_contact.items():
        if one is not None and one.without_weight and not (safe is not None and one.kp is safe.kp):
            failed[contact] = one
    if failed:
        nearest = [f"{name} {one.nearest}" if len(failed) > 1 else one.nearest for name, one in failed.items()]
        topples = list(dict.fromkeys(title for one in failed.values() for title in one.topples))
        lost = f"the robot topples on them in {listed(topples)}: a balance controller must prevent that"
        found.append(
            f"recommended gains, {gains.space} space, {', '.join(failed)}: none were found that meet the requirements with the robot's "
            f"weight (the nearest: {'; '.join(nearest)}); those reported meet them without the weight, as where it is compensated, and "
            + (lost if topples else "the robot does not topple on them")
        )
    return found


def _limits(found: GainSet, names: Sequence[str]) -> str:
    """Limit of the softest joint or direction, and the number of joints limited by each margin."""
    reasons = Counter(f"{limit}{' in ' * bool(state)}{state}" for limit, state in zip(_limits_of(found), found.case, strict=True) if limit)
    counted = ", ".join(f"{reason} {count}" for reason, count in reasons.most_common(4))
    return f"{limited_by(found, names)}; of all, {counted}" if counted else limited_by(found, names)


def _of_one_contact(gains: RobotGains) -> list[str]:
    """Sentence on contact states with gains of their own, if no set is safe in all."""
    found = [name for name, one in gains.per_contact.items() if one is not None and one.moves]
    return [f"Contact {', '.join(found)} by itself has recommended gains: see --json and --report."] if found else []


def _immobile(gains: RobotGains) -> list[str]:
    """Sentences on joints or directions without gains, as they cannot move."""
    assert gains.everywhere is not None
    immobile = [name for name, none in zip(gains.names, np.isnan(gains.everywhere.kp).tolist(), strict=True) if none]
    nowhere = [name for name, one in gains.per_contact.items() if one is not None and not one.moves]
    why = "nothing can move there in any state" + ("" if gains.space == "joint" else ", or tasks above take all that could")
    text = [f"No gains for {', '.join(immobile)}: {why}."] if immobile else []
    return text + ([f"Nothing moves in contact {', '.join(nowhere)}: gains have no effect there."] if nowhere else [])


@dataclass(frozen=True)
class GainSetRow:
    """Set of gains of one contact state, or ("") the one safe in all; `gain_set` None: there is none."""

    contact: str
    gain_set: GainSet | None
    gains: RobotGains

    @property
    def title(self) -> str:
        """Name of the set in a table."""
        return self.contact or "for all states"

    @property
    def acts(self) -> bool:
        """True if there are gains that act on some motion."""
        return self.gain_set is not None and self.gain_set.moves

    @property
    def limit(self) -> str:
        """Limit of the gains, or the reason why there are none, as text."""
        if self.gain_set is None:
            return f"none found that meet the requirements; nearest: {self.gains.nearest.get(self.contact, '')}"
        return limited_by(self.gain_set, self.gains.names) if self.gain_set.moves else "nothing moves there: gains have no effect"

    def margin_text(self, one: Requirement) -> str:
        """Least value of a margin over all loops together and one at a time, with the loops it belongs to if not obvious."""
        if self.gain_set is None or not self.acts:
            return "–"
        margins = self.gain_set.margins
        return digits(one.in_unit(one.value(margins)), one.unit, 3) + one.named(margins).removeprefix(one.title).replace(" of", ",", 1)


def rows(gains: RobotGains) -> list[GainSetRow]:
    """Sets of gains, the one safe in all states first."""
    return [
        GainSetRow(EVERYWHERE, gains.everywhere, gains),
        *(GainSetRow(contact, found, gains) for contact, found in gains.per_contact.items()),
    ]


def _link_facts(one: StateStiffness) -> dict[str, Any]:
    """JSON of the dynamic stiffness of the links in one state."""
    return {
        "state": one.title,
        "dynamic_stiffness": one.stiffness,
        "frequency_rad_s": one.omega,
        "gear_limited": one.gear_limited.tolist(),
        "damping": damping_facts(one.damping),
    }


def _limit(row: GainSetRow) -> str | None:
    """What limits the softest joint or direction of a set, by name; None where nothing does."""
    found = row.gain_set
    return (found.margin[found.softest] if found is not None and found.margin else "") or None


SET = [
    Column("set", "contact", lambda row: row.contact or "everywhere", shown=lambda row: row.title),
    Column("", "moves", lambda row: row.gain_set.moves),
    Column("", "kp", lambda row: row.gain_set.kp),
    Column("", "kd", lambda row: row.gain_set.kd),
    Column("", "ki", lambda row: row.gain_set.ki),
    Column("", "binding", lambda row: row.gain_set.binding or None),
    Column("", "binding_joint", lambda row: row.gains.names[row.gain_set.softest] if _limit(row) else None),
    Column("", "binding_margin", _limit),
    Column(
        "",
        "held_back_by",
        lambda row: [
            {"margin": margin or None, "state": state or None, "of_sway": sways}
            for margin, state, sways in zip(row.gain_set.margin, row.gain_set.case, row.gain_set.of_sway, strict=True)
        ],
    ),
    Column("", "dynamic_stiffness", lambda row: row.gain_set.stiffness),
    Column("", "links", lambda row: [_link_facts(one) for one in row.gain_set.links]),
    Column("", "without_weight", lambda row: row.gain_set.without_weight),
    Column("", "nearest_with_weight", lambda row: row.gain_set.nearest or None),
    Column("", "topples", lambda row: list(row.gain_set.topples)),
]
"""Columns of a set of gains; columns in JSON alone are evaluated for existing sets only."""


def set_columns(required: Requirements) -> list[Column]:
    """Columns SET, bounded margins with their requirement, the limit of the gains, and the number of cases."""
    margins = []
    for one in reported(required, several=True):
        needed = requirement(required, one.name, 3)
        margins.append(Column(f"{one.heading} ({needed})" if needed else one.heading, "", lambda row, one=one: row.margin_text(one)))
    cases = Column("cases", "", lambda row: row.gain_set.cases if row.acts else None)
    return [*SET, *margins, Column("limited by", "", lambda row: row.limit), cases]


def recommended_facts(gains: RobotGains) -> dict[str, Any]:
    """JSON of the recommended gains of one space."""
    return {
        "space": gains.space,
        "type": "pd" if gains.space == "joint" else None,
        "names": list(gains.names),
        "sets": [{**facts(SET, row), **margin_facts(row.gain_set.margins)} for row in rows(gains) if row.gain_set is not None],
        "cost": gains.cost,
        "not_found": {name or "everywhere": text for name, text in gains.nearest.items()},
    }


def gain_columns(sets: Sequence[GainSetRow], inertia: Floats | None = None) -> list[Column]:
    """Columns of the gains of a joint or task direction, by index, in every set; with `inertia` (n,) divided by it."""
    gains = sets[0].gains
    cascade = any(row.gain_set is not None and row.gain_set.ki is not None for row in sets)
    titles = {"kp": "kp", "kd": "kv or kd", "ki": "ki"} if cascade else {"kp": "kp", "kd": "kd"}
    if inertia is not None:
        titles = {"kp": "kp/J [1/s²]", "kd": "kd/J [1/s]"}

    def column(row: GainSetRow, name: str, title: str) -> Column:
        values = None if row.gain_set is None else getattr(row.gain_set, name) / (1.0 if inertia is None else inertia)
        return Column(title, "", lambda k: "none" if values is None else values[k])

    def prefix(row: GainSetRow, name: str) -> str:
        return f"{row.title}: " if len(sets) > 1 and name == "kp" else ""

    return [
        Column("joint" if gains.space == "joint" else "direction", "", lambda k: gains.names[k]),
        *(column(row, name, prefix(row, name) + title) for row in sets for name, title in titles.items()),
    ]
