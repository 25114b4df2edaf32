"""Simulated run for the page: the study that `gainroom simulate` prints, and its curves."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ..report.simulation_text import sentence, warnings
from ..simulation.simulation_spec import SimulationSpec
from ..studies.progress import Progress
from ..studies.simulation import simulate_study
from .bench import Part, rounded

POINTS = 1500
MOST_CHANNELS = 3


def shaken(
    spec: SimulationSpec, progress: Progress, film: Callable[[Any], dict[str, Any]] | None = None, shown: str = ""
) -> Iterator[Part]:
    """Parts of a run at the spec's gains, and of its film. `progress` ends the run by raising.

    shown   a channel whose motion is among the curves, as the strongest are
    """
    progress(0, spec.ticks, "")
    outcome = simulate_study(spec, 1.0, progress=progress)
    run = outcome.run
    pick = slice(None, None, max(1, len(run.time) // POINTS))
    chosen = list(outcome.leading[:MOST_CHANNELS])
    if shown in run.channels and (place := list(run.channels).index(shown)) not in chosen:
        chosen[-1] = place
    hardest = int(np.argmax(outcome.torque_peak))

    def curve(name: str, values: Any, dashed: bool = False) -> dict[str, Any]:
        return {"name": name, "values": rounded(values[pick].tolist()), "dashed": dashed}

    start = run.measured[0]  # a robot's joints stand anywhere: beside their angles small motions would not be seen
    motion = [curve(run.channels[k], run.measured[:, k] - start[k]) for k in chosen]
    motion += [curve(f"{run.channels[k]}, commanded", run.reference[:, k] - start[k], True) for k in chosen]
    yield (
        "run",
        {
            "sentence": sentence(outcome),
            "sound": outcome.sound,
            "warnings": warnings(outcome),
            "ms": rounded((1e3 * run.time[pick]).tolist()),
            "motion": motion,
            "unit": run.units[chosen[0]],
            "torque": [curve(run.joint_names[hardest], run.actual_torque[:, hardest])],
            "torque_unit": run.torque_units[hardest],
        },
    )
    if film is not None:
        yield "film", film(run)
