"""What the commands make of recordings by an independent simulator: tables of right and wrong answers, by hand or for the tests.

    export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
    python tests/recorded_counts.py diagnose --seed 1            100 of one cause each, 50 quiet, and all with bad rows
    export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
    python tests/recorded_counts.py diagnose --seed 1 --only backlash,quiet --count 20 --keep FOLDER
    python tests/recorded_counts.py identify --seed 1            100 of two masses, 12 of each of five other models

A log and its joint.yaml go through the command as a user's would. `--keep` leaves them in a folder, and takes them from there again.
"""

import argparse
import io
import json
import math
import re
import sys
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gainroom.cli import main
from independent.calm import calm, with_bad_rows
from independent.excited import WRONG, excited
from independent.shaking import CAUSES, Recording, shaking

CONFIDENT = 0.7  # likelihood above which a wrong cause is confidently wrong
NAMES = {"external": "external_torque", "ripple": "torque_ripple", "alias": "aliasing", "outer": "outer_loop"}


@dataclass(frozen=True)
class Answer:
    """What came back: of a vibration `named` (None: cannot tell), `likely` and its share; `failed`: the line of exit status 2."""

    truth: str
    kind: str
    index: int
    spoiled: bool
    vibrates: bool = False
    named: str | None = None
    likely: str | None = None
    share: float = 0.0
    failed: str = ""
    known: dict[str, float] = field(default_factory=dict)

    @property
    def right(self) -> bool:
        return not self.failed and (not self.vibrates if self.truth == "quiet" else self.named == self.truth)

    @property
    def confidently_wrong(self) -> bool:
        return self.truth != "quiet" and self.likely not in (None, "unknown", self.truth) and self.share > CONFIDENT

    @property
    def text(self) -> str:
        said = self.failed or (f"{self.likely} {self.share:.0%}" if self.vibrates else "no vibration")
        known = ", ".join(f"{name} {value:.4g}" for name, value in self.known.items())
        return f"{self.truth} {self.index}{' spoiled' if self.spoiled else ''} ({self.kind}; {known}): {said}"


def call(*words: str | Path) -> tuple[int, str, str]:
    """Exit status, output and errors of the command."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main([*map(str, words)])
    return status, out.getvalue(), err.getvalue()


def write_log(path: Path, columns: dict[str, np.ndarray]) -> None:
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")


def recorded(truth: str, index: int, seed: int) -> Recording:
    return calm(index, seed) if truth == "quiet" else shaking(truth, index, seed)


def diagnosed(job: tuple[str, int, int, str | None]) -> list[Answer]:
    """Of one recording as it is, and of the same with bad rows; in a worker."""
    truth, index, seed, keep = job
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(keep or temporary)
        facts = folder / f"{truth}_{index}.json"
        names = [folder / f"{truth}_{index}{end}.csv" for end in ("", "_bad")]
        if not facts.exists():
            folder.mkdir(parents=True, exist_ok=True)
            made = recorded(truth, index, seed)
            bad = with_bad_rows(made, index, seed)
            (folder / f"{truth}_{index}.yaml").write_text(made.yaml, "utf-8")
            for name, one in zip(names, (made, bad), strict=True):
                write_log(name, one.columns)
            facts.write_text(json.dumps([made.kind, bad.kind, made.known]), "utf-8")
        kinds = json.loads(facts.read_text("utf-8"))
        known = kinds.pop()
        yaml = folder / f"{truth}_{index}.yaml"
        return [
            _answer(Answer(truth, kind, index, name != names[0], known=known), name, yaml) for name, kind in zip(names, kinds, strict=True)
        ]


def _answer(blank: Answer, log: Path, yaml: Path) -> Answer:
    truth, kind, index, spoiled, known = blank.truth, blank.kind, blank.index, blank.spoiled, blank.known
    status, out, err = call("diagnose", log, "--joint", yaml, "--json")
    if status not in (0, 1):
        return Answer(truth, kind, index, spoiled, failed=err.strip() or f"exit status {status}", known=known)
    facts = json.loads(out)
    first = facts["causes"][0] if facts["causes"] else None
    named, likely = (NAMES.get(name, name) if name else None for name in (facts["cause"], first and first["cause"]))
    return Answer(truth, kind, index, spoiled, facts["vibrates"], named, likely, first["likelihood"] if first else 0.0, known=known)


def diagnoses(
    seed: int, each: int = 10, quiet: int = 50, only: Iterable[str] = (), keep: str | None = None, processes: int = 1
) -> list[Answer]:
    """Of every cause so many and of quiet ones, each as it is and with bad rows."""
    counts = {**dict.fromkeys(CAUSES, each), "quiet": quiet}
    asked = list(only) or list(counts)
    place = None if keep is None else str(Path(keep) / str(seed))
    jobs = [(truth, index, seed, place) for truth in asked for index in range(counts[truth])]
    return [answer for answers in _worked(diagnosed, jobs, processes) for answer in answers]


def _worked(function, jobs: Sequence, processes: int) -> list:
    if processes <= 1:
        return [function(job) for job in jobs]
    with ProcessPoolExecutor(processes) as pool:
        return list(pool.map(function, jobs))


def diagnosis_table(answers: Sequence[Answer]) -> str:
    """By cause: right, confidently wrong, told otherwise, not seen; and every miss."""
    lines = [f"{'':22}{'of':>4}{'right':>7}{'>70 % wrong':>13}{'quiet':>7}{'cannot tell':>13}{'error':>7}"]
    for spoiled in (False, True):
        part = [one for one in answers if one.spoiled == spoiled]
        groups = {**{truth: [one for one in part if one.truth == truth] for truth in (*CAUSES, "quiet")}}
        groups["all causes"] = [one for one in part if one.truth != "quiet"]
        lines.append("with bad rows" if spoiled else "as recorded")
        for name, group in groups.items():
            if group:
                lines.append(
                    f"  {name:20}{len(group):4}{sum(one.right for one in group):7}{sum(one.confidently_wrong for one in group):13}"
                    f"{sum(not one.vibrates and not one.failed for one in group):7}"
                    f"{sum(one.vibrates and one.named is None for one in group):13}{sum(bool(one.failed) for one in group):7}"
                )
    return "\n".join([*lines, "", *(one.text for one in answers if not one.right)])


NAMED = {
    "backlash": "backlash",
    "stiffening": "stiffen",
    "load change": "load",
    "second mode": "second mode|third mass",
    "torque limit": "limit|clip|saturat|bound",
}
"""What a warning says that names the model."""
COVERED = ("motor_inertia", "link_inertia", "stiffness", "damping", "viscous", "coulomb", "link_coulomb", "delay", "resonance")
KEYS = {"delay": ("delay_ms", 1e-3), "resonance": ("resonance_rad_s", 1.0)}


@dataclass(frozen=True)
class Fit:
    """What `identify joint` said of a log. `off` relative error and `holds` by parameter, as far as it has them."""

    model: str
    kind: str
    index: int
    adequate: bool = False
    named: bool = False
    failed: str = ""
    off: dict[str, float] = field(default_factory=dict)
    holds: dict[str, bool] = field(default_factory=dict)
    rivals: tuple[str, ...] = ()
    known: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def right(self) -> bool:
        """Right ones are adequate, others are not or are named in a warning; a refusal is neither."""
        return not self.failed and (self.adequate if self.model == "right" else not self.adequate or self.named)

    @property
    def text(self) -> str:
        said = self.failed or f"{'adequate' if self.adequate else 'not adequate'}{', named' if self.named else ''} {' '.join(self.rivals)}"
        known = ", ".join(f"{name} {value:.3g}" for name, value in self.known.items())
        misses = ", ".join(f"{name} {self.off[name]:+.1%}" for name, held in self.holds.items() if not held)
        return f"{self.model} {self.index} ({self.kind}; {known}): {said}; beyond their intervals: {misses or 'none'}"


def fitted(job: tuple[str, int, int, str | None]) -> Fit:
    """Of one log; in a worker."""
    model, index, seed, keep = job
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(keep or temporary)
        name = f"{model.replace(' ', '_')}_{index}"
        facts, log = folder / f"{name}.json", folder / f"{name}.csv"
        if not facts.exists():
            folder.mkdir(parents=True, exist_ok=True)
            made = excited(model, index, seed)
            write_log(log, made.columns)
            facts.write_text(json.dumps([made.kind, made.truth, made.known]), "utf-8")
        kind, truth, known = json.loads(facts.read_text("utf-8"))
        status, out, err = call("identify", "joint", log, "--json")
    if status:
        return Fit(model, kind, index, failed=err.strip() or f"exit status {status}", known=known)
    answer = json.loads(out)
    off, holds = {}, {}
    for one in COVERED:
        key, unit = KEYS.get(one, (one, 1.0))
        estimate = answer["parameters"].get(key)
        if estimate is None or estimate.get("value") is None:
            continue
        low, value, high = (math.nan if estimate[part] is None else unit * estimate[part] for part in ("low", "value", "high"))
        off[one] = (value - truth[one]) / (truth[one] or 1.0)
        holds[one] = (math.isnan(low) or low <= truth[one]) and (math.isnan(high) or truth[one] <= high)
    rivals, warnings = tuple(one["name"] for one in answer["rivals"]), tuple(answer["warnings"])
    named = model in rivals or (model in NAMED and any(re.search(NAMED[model], text) for text in warnings))
    return Fit(model, kind, index, answer["adequate"], named, "", off, holds, rivals, known, warnings)


def fits(seed: int, right: int = 100, each: int = 12, only: Iterable[str] = (), keep: str | None = None, processes: int = 1) -> list[Fit]:
    """Of two masses so many, and of each other model."""
    counts = {"right": right, **dict.fromkeys(WRONG, each)}
    place = None if keep is None else str(Path(keep) / f"identify_{seed}")
    jobs = [(model, index, seed, place) for model in list(only) or counts for index in range(counts[model])]
    return _worked(fitted, jobs, processes)


def fit_table(found: Sequence[Fit]) -> str:
    """By model: as it should be, adequate without a word, named, refused; and of right ones the share of intervals that hold."""
    lines = [f"{'':14}{'of':>4}{'right':>7}{'adequate':>10}{'named':>7}{'refused':>9}"]
    for model in ("right", *WRONG):
        if group := [one for one in found if one.model == model]:
            numbers = [
                sum(values)
                for values in ((one.adequate for one in group), (one.named for one in group), (bool(one.failed) for one in group))
            ]
            lines.append(f"{model:14}{len(group):4}{sum(one.right for one in group):7}{numbers[0]:10}{numbers[1]:7}{numbers[2]:9}")
    lines.append(f"\n{'of right ones':16}{'told':>6}{'hold':>6}{'share':>8}{'median error':>14}{'largest':>9}")
    told = [one for one in found if one.model == "right" and not one.failed]
    for name in COVERED:
        held, errors = [one.holds[name] for one in told if name in one.holds], [abs(one.off[name]) for one in told if name in one.off]
        if held:
            share = sum(held) / len(held)
            mark = "" if 0.90 <= share <= 0.99 else "  outside 90 to 99 %"
            lines.append(f"{name:16}{len(held):6}{sum(held):6}{share:8.2f}{np.median(errors):14.3%}{max(errors):9.1%}{mark}")
    misses = [one.text for one in found if not one.right or (one.model == "right" and not all(one.holds.values()))]
    return "\n".join([*lines, "", *misses])


def cli(words: Sequence[str]) -> str:
    parser = argparse.ArgumentParser(description="Tables of right and wrong answers.")
    parser.add_argument("what", choices=["diagnose", "identify"])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument(
        "--count", type=int, help="of each cause (10) and of quiet ones (50); of each other model (12) and of right ones (100)"
    )
    parser.add_argument("--only", default="", help="names, with commas")
    parser.add_argument("--keep", help="a folder for the logs")
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args(words)
    only = [name for name in given.only.split(",") if name]
    count = {} if given.count is None else {"each": given.count}
    if given.what == "identify":
        if given.count is not None:
            count["right"] = given.count
        return fit_table(fits(given.seed, **count, only=only, keep=given.keep, processes=given.processes))
    if given.count is not None:
        count["quiet"] = given.count
    return diagnosis_table(diagnoses(given.seed, **count, only=only, keep=given.keep, processes=given.processes))


if __name__ == "__main__":
    print(cli(sys.argv[1:]))
