"""Sweep as text and columns, and its presentation."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..errors import THIN, beside, listed
from ..io.as_typed import as_typed
from ..studies.factors import typed_factor
from ..studies.sweep.summary import CONFIDENCE, ContactSummary, SweepSummary, SweptPosture
from ..studies.swept_margins import SampledRequirement, WorstStates, swept_verdict
from ..system.margin_units import to_db
from ..system.requirements import Requirements
from .columns import Column, facts
from .margin_columns import margin_value, requirement
from .number_format import digits, gain_factor, hertz, model_facts
from .presentation import Part, Presentation, TextTable, closing, warned_first
from .robot_columns import state_columns
from .words import swept_headline

if TYPE_CHECKING:
    from ..studies.sweep.store import Store

MOST_ANGLES = 8
"""Most joint angles of a posture in a sentence."""


def counted(number: int) -> str:
    """Integer with thin spaces between thousands."""
    return f"{number:,}".replace(",", THIN)


def sentence(found: SweepSummary) -> str:
    """Verdict, worst limit and its posture, as text."""
    plan, worst = found.plan, found.worst_posture
    many, contacts = plan.postures.count, len(plan.contacts)
    states = f"{counted(many)} posture{'s' * (many > 1)} in {contacts} contact state{'s' * (contacts > 1)}"
    states += f" with {len(plan.places) - 1} draws" if len(plan.places) > 1 else ""
    if not found.complete:
        states = f"{counted(found.count)} of {counted(plan.states)} limits"
    if worst is None:
        return f"No gain limit is known in any of {states}."
    where = f", at {hertz(worst.frequency)}, mainly {joint_name(found, worst)}" if math.isfinite(worst.frequency) else ""
    there = f" in {worst.name}, {plan.contacts[worst.contact]}"
    unstable = sum(one.unstable for one in found.contacts)
    if unstable:
        share = digits(100 * unstable / found.count, "%", 3)
        if not worst.gain > 0:
            return f"Unstable in {share} of {states}: no common factor on these gains is stable{there}."
        return f"Unstable in {share} of {states}: the lowest gain limit is {gain_factor(worst.gain, 3)} × these gains{where},{there}."
    if math.isinf(worst.gain):
        return f"No common factor up to 1000 on all gains makes it vibrate in any of {states}."
    factor, level = (f"{worst.gain:.3g}", f"{to_db(worst.gain):.3g}")
    asked = ""
    if found.margin > 1:
        factor, level = beside(worst.gain, found.margin), beside(to_db(worst.gain), to_db(found.margin))
        asked = f"; {digits(to_db(found.margin), '', 3)} dB required"
    verdict = "The gain margin holds" if found.margin_held and found.margin > 1 else "Stable" if found.stable else "Not known to be stable"
    return f"{verdict} in {states}: vibration starts at {factor} × these gains ({level} dB{asked}){where},{there}."


def joint_name(found: SweepSummary, one: SweptPosture) -> str:
    """Name of the joint that moves most; a dash if there is none."""
    return found.plan.robot.joint_names[one.joint] if one.joint >= 0 else "–"


def by_joint(found: SweepSummary) -> str:
    """Sentence with the two commands that search gains joint by joint over the postures of a sweep."""
    file = found.plan.robot.name
    return f"Search joint by joint: the same sweep with `--output sweep.zarr`, then `gainroom robot {file} --sweep sweep.zarr`."


def advice(found: SweepSummary, worst: WorstStates) -> str:
    """Sentence of advice; "" if none is known, or another requirement prevents it."""
    if not math.isfinite(found.scale):
        return ""
    factor = typed_factor(found.scale)
    near = " and where a search from the worst led" if found.searched is not None and found.searched.number < 0 else ""
    if found.scale < 1:
        if missed := worst.unmet_at(factor):
            fail = listed([one.label for one in missed])
            return f"With all gains × {factor:.4g} the gain margin would hold, but not {fail}, in the sample. {by_joint(found)}"
        return f"Use: all gains × {factor:.4g}; then the gain margin holds in every posture swept{near}."
    if found.margin > 1 and found.scale > 1 and not worst.unmet and not worst.unmet_at(factor):
        return f"With all gains × {factor:.4g} the gain margin still holds in every posture swept{near}."
    return ""


def sureness(found: SweepSummary, searched: SweptPosture | None) -> list[str]:
    """Sentences on the certainty of the worst case."""
    worst, texts = found.worst_posture, []
    if worst is None:
        return texts
    if math.isfinite(found.rarer_than):
        share = digits(100 * found.rarer_than, "%", 2)
        texts.append(f"Less than {share} of further postures lie lower ({100 * CONFIDENCE:.0f} % confidence)")
    if searched is not None and worst.gain > 0:
        lower = 1 - searched.gain / worst.gain
        near = (
            "nothing lower"
            if lower < 1e-6
            else "nothing lower by 0.01 %"
            if lower < 1e-4
            else f"{digits(searched.gain, '', 4)} ×, {digits(100 * lower, '%', 2)} lower"
        )
        texts.append(f"a local search from the worst finds {near}" if texts else f"A local search from the worst finds {near}")
    return ["; ".join(texts) + "."] if texts else []


def verdict(found: SweepSummary, worst: WorstStates) -> list[str]:
    """Verdict sentences, the failure first: other requirements if the gain margin holds."""
    return swept_headline(found, worst, sentence(found), unmet_text(found, worst))


def unmet_text(found: SweepSummary, worst: WorstStates, required: Requirements | None = None) -> str:
    """Sentences on the other requirements that fail in the sample of postures; "" if none does.

    required   requirements asked for among those judged; the others are defaults; None: all are asked for
    """
    texts = []
    for usual, heading in ((False, "Not met"), (True, "Not required, and short of what is usual there")):
        unmet = [one for name, one in worst.unmet.items() if usual is not (required is None or name in required.asked)]
        missed = [_missed(found, worst, one, "usual" if usual else "required") for one in unmet if not math.isnan(one.value)]
        texts += [f"{heading}: {'; '.join(missed)}."] if missed else []
    return " ".join(texts)


def _missed(found: SweepSummary, worst: WorstStates, one: SampledRequirement, bound: str) -> str:
    """Clause with the worst value found of one requirement, its state, and how often it is missed."""
    asked, name = found.plan.system.requirements, one.requirement.name
    worst_value = margin_value(asked, name, one.value, False, 3)
    often = f"; missed in {share_missed(worst, one)}" if worst.random_count else ""
    return f"{one.requirement.label} {worst_value} in {one.state.title} ({requirement(asked, name, 3)} {bound}{often})"


def share_missed(worst: WorstStates, one: SampledRequirement) -> str:
    """Text "k of n" on the postures that miss a requirement: of the random ones, or of all if the sample is every posture."""
    if worst.everywhere:
        return f"{counted(one.missed)} of {counted(worst.count)}"
    return f"{one.random_missed} of {worst.random_count} random ones"


def looked_at(found: SweepSummary, worst: WorstStates) -> str:
    """Sentence on the postures in which the other requirements were judged; "" if there are none."""
    others = ", ".join(one.requirement.label for one in worst.requirements)
    if not others or worst.everywhere:
        return f"Judged in every posture, too: {others}." if others else ""
    random = f" and {worst.random} random" if worst.random else ""
    plural = "postures" if worst.lowest + worst.random > 1 else "posture"
    each = f" of each contact state ({counted(worst.count)} in all)" if len(found.plan.contacts) > 1 else ""
    where = f"in the {worst.lowest} lowest{random} {plural}{each}"
    return f"Judged in a sample, not everywhere: {others}, {where}."


def sample_columns(found: SweepSummary, worst: WorstStates) -> list[Column]:
    """Columns of the sample's requirements."""
    asked = found.plan.system.requirements
    return [
        Column("requirement", "name", lambda one: one.requirement.name, shown=lambda one: one.requirement.label),
        Column("worst found", "worst", lambda one: one.requirement.in_unit(one.value),
               shown=lambda one: margin_value(asked, one.requirement.name, one.value, False, 3)),
        Column("required", "required", lambda one: one.requirement.in_unit(one.needed),
               shown=lambda one: requirement(asked, one.requirement.name, 3)),
        Column("met", "met", lambda one: one.met, shown=lambda one: "yes" if one.met else "no"),
        Column("in", "state", lambda one: one.state.title),
        Column("missed", "missed", lambda one: one.missed, shown=lambda one: f"{one.missed} of {worst.count}"),
        Column("at random", "random_missed", lambda one: one.random_missed, shown=lambda one: share_missed(worst, one)),
    ]  # fmt: skip


def sample_facts(found: SweepSummary, worst: WorstStates) -> dict[str, Any]:
    """JSON of the sample in which other requirements were judged."""
    columns = sample_columns(found, worst)
    return {
        "lowest": worst.lowest,
        "random": worst.random,
        "count": worst.count,
        "random_count": worst.random_count,
        "everywhere": worst.everywhere,
        "requirements": [
            facts(columns, one) | {"angles": dict(one.state.system.source.postures[one.state.posture].angles)} for one in worst.requirements
        ],
    }


def warnings(found: SweepSummary) -> list[str]:
    """Warnings that weaken the verdict."""
    texts = list(found.plan.notes)
    if found.unknown:
        texts.append(
            f"{counted(found.unknown)} limits are not known: no certified answer was found there; these postures count as failing."
        )
    if found.uncertified:
        texts.append(f"{counted(found.uncertified)} limits are not certified: roots could not be counted on both sides.")
    if found.lower > 0:
        needed = f"; {digits(to_db(found.margin), 'dB', 3)} required" if found.margin > 1 else ""
        texts.append(
            f"Lower gains are unstable, too: somewhere below {found.lower:.3g} × these ({digits(-to_db(found.lower), 'dB', 3)}{needed})."
        )
    if not found.complete:
        texts.append("The sweep is not complete: the same command goes on.")
    return texts


def columns(found: SweepSummary) -> list[Column]:
    """Columns of a row ContactSummary."""

    def worst(one: ContactSummary) -> SweptPosture | None:
        return one.worst[0] if one.worst else None

    def number(of: Any, none: str | None = None) -> Any:
        return lambda one: none if worst(one) is None else of(worst(one))

    def mainly(at: SweptPosture) -> str:
        return joint_name(found, at)

    def vibration(at: SweptPosture) -> str:
        return hertz(at.frequency) if math.isfinite(at.frequency) else "–"

    return [
        Column("contact", "contact", lambda one: one.name),
        Column("lowest", "gain_limit", number(lambda at: at.gain), definition="the lowest gain limit"),
        Column("10 %", "gain_limit_p10", lambda one: one.quantile(0.1), significant=3, definition="a tenth of postures lie below"),
        Column("median", "gain_limit_median", lambda one: one.quantile(0.5), significant=3),
        Column("highest", "gain_limit_highest", lambda one: one.quantile(1.0), significant=3),
        Column(
            "at",
            "limit_frequency_rad_s",
            number(lambda at: at.frequency),
            shown=number(vibration, "–"),
        ),
        Column("mainly", "limiting_joint", number(mainly), shown=number(mainly, "–")),
        Column("posture", "posture", number(lambda at: at.number), shown=number(lambda at: str(at.number), "–")),
        Column("", "count", lambda one: one.count),
        Column("", "unknown", lambda one: one.unknown),
        Column("", "uncertified", lambda one: one.uncertified),
        Column("", "unstable", lambda one: one.unstable),
        Column("", "below_margin", lambda one: one.short),
        Column("", "lower_gain_highest", lambda one: one.lower),
    ]


def safe_share(found: SweepSummary) -> str:
    """Share of limits that keep the margin, known and certified, as text; never rounded up to "all"."""
    share = 100 * (1 - found.unsafe / max(found.count, 1))
    return "all" if not found.unsafe else "none" if found.unsafe == found.count else f"{min(share, 99.99):.4g} %"


def worse_note(found: SweepSummary, one: SweptPosture, known: float) -> str:
    """Sentence on a posture outside the file that is worse."""
    names = found.plan.robot.joint_names
    low, high = found.plan.postures.low, found.plan.postures.high
    angles = [f"{name} {angle:.2f}" for name, angle, moves in zip(names, one.angles, high > low, strict=True) if moves]
    where = f", with {', '.join(angles)}" if len(angles) <= MOST_ANGLES else ""
    contact = found.plan.contacts[one.contact]
    return (
        f"Another posture is worse than the file's: gain limit {one.gain:.3g} in {contact} (file: {known:.3g}){where}; "
        f"gainroom sweep checks all of them{'' if where else ', and --json has the angles of this one'}."
    )


def checked_sentence(found: SweepSummary) -> str:
    """Sentence on the gain margin of recommended gains in the postures of a sweep."""
    worst, count = found.worst_posture, found.count
    if worst is None:
        return "Recommended gains in the sweep's postures: no limit is known."
    asked, lowest = digits(to_db(found.margin), "dB", 3), digits(to_db(worst.gain), "dB", 3)
    return (
        f"Recommended gains keep a gain margin of {asked} in {safe_share(found)} of {counted(count)} swept limits; the lowest is "
        f"{lowest}, in {found.plan.contacts[worst.contact]}."
    )


def posture_facts(found: SweepSummary, one: SweptPosture | None) -> dict[str, Any] | None:
    """JSON of a posture."""
    if one is None:
        return None
    plan = found.plan
    return {
        "posture": one.number if one.number >= 0 else None,
        "contact": plan.contacts[one.contact],
        "draw": one.draw,
        "gain_limit": one.gain,
        "limit_frequency_rad_s": one.frequency,
        "limiting_joint": joint_name(found, one),
        "certified": one.certified,
        "angles": dict(zip(plan.robot.joint_names, one.angles.tolist(), strict=True)),
    }


@dataclass(frozen=True)
class SweepPresentation(Presentation):
    """Presentation of a sweep; `mended`: damaged parts that were computed again."""

    found: SweepSummary
    at_worst: WorstStates
    store: "Store"
    mended: Sequence[str]

    def facts(self) -> dict[str, Any]:
        found, plan, at_worst, output = self.found, self.found.plan, self.at_worst, self.files.get("Results")
        return {
            "robot": plan.robot.name,
            "gainroom": __version__,
            **swept_verdict(found, at_worst).facts,
            "stable": found.stable,
            "gain_margin_met": found.margin_held if found.margin > 1 else None,
            "unmet": [*(["gain_margin"] if found.margin > 1 and not found.margin_held else []), *at_worst.unmet],
            "sentence": sentence(found),
            **model_facts(plan.system.control.sample_time),
            "margin_db": as_typed(to_db(found.margin)) if found.margin > 1 else None,
            "postures": plan.postures.kind,
            "count": plan.postures.count,
            "draws": len(plan.places) - 1,
            "limits": found.count,
            "unknown": found.unknown,
            "uncertified": found.uncertified,
            "worst": posture_facts(found, found.worst_posture),
            "searched": posture_facts(found, found.searched),
            "worst_states": [facts(state_columns(), state) for state in at_worst.states],
            "judged": sample_facts(found, at_worst),
            "scale": found.scale,
            "rarer_than": found.rarer_than,
            "contacts": [facts(columns(found), one) for one in found.contacts],
            "output": None if output is None else str(output),
            "warnings": [*warnings(found), *self.mended],
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        found, at_worst = self.found, self.at_worst
        doubts, warned = warned_first(warnings(found), True)
        yield [
            *doubts,
            *verdict(found, at_worst),
            *filter(None, [advice(found, at_worst)]),
            TextTable.of("", columns(found), found.contacts, ("highest", "10 %")),
            *sureness(found, found.searched),
            *filter(None, [looked_at(found, at_worst)]),
            *closing(self.files, [*warned, *self.mended]),
        ]
