"""Scheduled gains against the single set that is safe in every state: gainroom's biped takes two slow steps in MuJoCo.

    python examples/scheduled_biped.py             two minutes; --picture FILE.svg draws it, --quick leaves the margins out

Nothing holds or guides the robot: it stands on its soles, on ground from which they may slip and lift. All runs have the same plan and the
same feed-forward (the weight, with the load that each foot is planned to carry; no accelerations), and gains that were found for the same
requirements: 6 dB, 30°, Ms 2. They differ in the gains alone.
"""

import argparse
from pathlib import Path

import numpy as np
from walking_plan import Plan
from walking_run import biped, error_of, margins_in_use, phases, plan_of, rms, steps, tables, vibrations, walked

from gainroom.analysis.margin_record import Margins
from gainroom.simulation.robot_run import RobotRun


def worst(found: list[tuple[float, bool, Margins]]) -> str:
    """The least margins, as text."""
    db = 20 * np.log10(min(one.least_gain_margin for *_, one in found))
    phase = np.degrees(min(one.least_phase_margin for *_, one in found))
    return f"{db:.1f} dB, {phase:.1f}°, Ms {max(one.peak_sensitivity for *_, one in found):.2f}"


def told(name: str, run: RobotRun, plan: Plan) -> str:
    """One run, as a line of text."""
    if run.ending != "completed":
        return f"  {name:<11} {run.reason}"
    error = 1e3 * error_of(run, plan)
    parts = [f"{rms(error):5.2f}", *(f"{phase} {rms(error[rows]):.2f}" for phase, rows in phases(plan, len(run.time)))]
    vibrating = ", ".join(f"{phase} at {one.vibration.frequency / 6.2832:.3g} Hz" for phase, one in vibrations(run, plan)) or "none"
    return f"  {name:<11} {', '.join(parts)}; vibration: {vibrating}; steps at switches {steps(run, plan).max():.2f} N·m"


def main() -> None:
    """Run, and print what came out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path, metavar="FILE.svg")
    parser.add_argument("--quick", action="store_true")
    call = parser.parse_args()
    system, found = biped(), {}
    for pace in (1.0, 1.25):
        plan = plan_of(system, pace)
        for friction in (True, False):
            title = f"{plan.time[-1]:.1f} s, {'friction' if friction else 'no friction'}"
            print(f"{title}: rms error of the links [mrad], whole run and phase by phase")
            for name, table in tables().items():
                run, history = walked(system, plan, table, friction=friction)
                print(told(name, run, plan), flush=True)
                if pace == 1.0 and friction:
                    found[name] = plan, run, history
    plan = plan_of(system)
    run, _ = walked(system, plan, tables()["scheduled"], rise=1e9, fade=1e-9)
    print("the same with gains that switch at once and torques that follow, with friction:")
    print(told("abrupt", run, plan), flush=True)
    if not call.quick:
        print("least margins of the gains in use, weight included:")
        for name, (plan, _, history) in found.items():
            looks = margins_in_use(system, plan, history)
            settled = [one for one in looks if one[1]]
            print(f"  {name:<11} {worst(looks)}; without ticks at which gains rise: {worst(settled)}")
    if call.picture:
        from walking_picture import drawn

        call.picture.write_text(drawn({name: (plan, run, history) for name, (plan, run, history) in found.items()}), "utf-8")


if __name__ == "__main__":
    main()
