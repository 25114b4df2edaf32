"""A simulated run as it is shown: keys of --json, lines of the terminal, page."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..studies.simulation import Outcome
from .columns import Column
from .number_format import digits
from .presentation import Grid, Part, Presentation, closing, do_this, warned_first
from .simulation_advice import what_to_do
from .simulation_text import TRACKING, limit_text, sentence, tracking_cells, unsettled, vibration_text, warnings

MOST_JOINTS = 6
"""In the terminal's table of torques."""
NUMBERS = ("rms", "peak", "steady_state", "overshoot", "settling_time")
"""Of Tracking, in JSON."""


@dataclass(frozen=True)
class SimulationPresentation(Presentation):
    """All that is shown of a run; `study_call`: the command that judges its gains."""

    outcome: Outcome
    study_call: str

    def facts(self) -> dict[str, Any]:
        outcome, run, log = self.outcome, self.outcome.run, self.files.get("Log")
        found, limit, seen = outcome.tracking, outcome.limit, outcome.oscillation
        return {
            **outcome.verdict.facts,
            "diverged": run.diverged,
            "diverged_at": run.diverged_at,
            "fell": run.ending == "fell",
            "ended_at": run.ended_at,
            "vibrates": outcome.vibrates,
            "unstable": outcome.hidden,
            "sentence": sentence(outcome),
            "model": outcome.spec.kind,
            "sample_rate_hz": 1 / run.sample_time,
            "gain": outcome.gain,
            "tracking": {channel: {name: getattr(found, name)[k] for name in NUMBERS} for k, channel in enumerate(run.channels)},
            "at_torque_limit": dict(zip(run.joint_names, outcome.at_torque_limit.tolist(), strict=True)),
            "torque_peak": dict(zip(run.joint_names, outcome.torque_peak.tolist(), strict=True)),
            "slip": dict(zip(outcome.spec.contact_frames, outcome.slip.tolist(), strict=True)),
            "vibration": None
            if seen is None
            else {
                "frequency_rad_s": seen.vibration.frequency,
                "growth_rate": seen.vibration.growth_rate,
                "amplitude": seen.vibration.amplitude,
                "joints": [name for name in seen.strongest if name in run.joint_names] or list(run.joint_names),
            },
            "predicted": None
            if limit is None
            else {"stable": limit.stable, "gain_limit": limit.gain, "limit_frequency_rad_s": limit.frequency},
            "log": None if log is None else str(log),
            "settled": not unsettled(outcome) if any(time == time for time in found.settling_time.tolist()) else None,
            "warnings": list(warnings(outcome)),
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        outcome, run = self.outcome, self.outcome.run
        rows = [(f"{channel} [m{run.units[k]}]", *tracking_cells(outcome, k)) for k, channel in enumerate(run.channels)]
        columns = [Column(title, "", lambda row, k=k: row[k]) for k, title in enumerate(("", *TRACKING))]
        title = f"Tracking ({outcome.spec.kind}, {digits(1 / run.sample_time, 'Hz')}, encoders on the {run.feedback} side)"
        doubts, said = warned_first(warnings(outcome), verbose)
        yield [
            *doubts,
            sentence(outcome),
            *do_this(what_to_do(outcome, self.call, self.study_call)),
            "",
            Grid.of(title, columns, rows),
            *(_all_there_is(outcome) if verbose else []),
            *closing(self.files, said),
            *([] if verbose else ["Torques and vibration: --verbose."]),
        ]

    def page(self, command: str) -> str:
        from .simulation import simulation_page  # loads the pictures

        return simulation_page(self.outcome, command, self.call, self.study_call)


def _all_there_is(outcome: Outcome) -> list[Part]:
    """Torques, and the vibration beside the linear loop's."""
    run = outcome.run
    hardest = sorted(range(len(run.joint_names)), key=lambda k: -outcome.torque_peak[k])[:MOST_JOINTS]
    torques = [
        (run.joint_names[k], *(digits(float(values[k]), run.torque_units[k], 3) for values in (outcome.torque_peak, outcome.torque_rms)))
        for k in hardest
    ]
    vibrations = [("simulated", *vibration_text(outcome)), ("linear loop", *limit_text(outcome.limit))]
    return [
        Grid("Joints with the largest torques" if len(run.joint_names) > 1 else "Torque", ("", "torque peak", "RMS"), torques),
        Grid("Vibration", ("", "frequency", "growth"), vibrations),
    ]
