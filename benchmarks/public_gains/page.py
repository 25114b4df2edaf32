"""Page and picture of all rows."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

from .measured import ENOUGH, Numbers
from .rows import ASSUMED_DRIVE, ASSUMED_RATE, BARE, DELAY, DELAYS, DRIVE, GEARS, HOST, PLACES, Row

PICTURE = "images/public-gains.svg"
COLOURS = {"drive": "#0072B2", "host": "#D55E00", "simulation": "#999999"}
WORDS = {"drive": "run in the drives", "host": "run on the host", "simulation": "of a simulation"}
LATER = 1.5
"""Multiple of the given delay."""
SHORTEST = 0.03
"""Left end of the picture [ms], to which shorter delays are drawn."""
Found = Mapping[str, Numbers]
TEXTS = Path(__file__).with_name("page.md").read_text("utf-8").partition("<!-- sections -->\n")
"""Text before the rows of the table, and text before the sections, each with fields of str.format."""


def verdict(row: Row, reading: str, one: Numbers) -> str:
    """Verdict on a reading: fine with ENOUGH headroom in the gains and LATER in the delay."""
    if one.factor < 1:
        return "vibrates"
    given = row.drive["delay"] if row.in_drive(reading) else DELAY
    return "fine" if one.factor >= ENOUGH and one.delay >= LATER * given else "tight"


def page(found: Sequence[tuple[Row, Found]], left_out: Sequence[str]) -> str:
    """Page as Markdown."""
    hosts = [verdict(row, HOST, each[HOST]) for row, each in found]
    drives = [verdict(row, DRIVE, each[DRIVE]) for row, each in found if row.run == "drive"]
    parts = [
        TEXTS[0].format(
            picture=PICTURE,
            delay=f"{DELAY:g}",
            shortest=f"{DELAYS[0]:g}",
            longest=f"{DELAYS[-1]:g}",
            host_rate=f"{ASSUMED_RATE:g}",
            drive_rate=f"{ASSUMED_DRIVE['rate'] / 1e3:g}",
            drive_delay=f"{ASSUMED_DRIVE['delay']:g}",
            count=len(found),
            robots=len({row.robot for row, _ in found}),
            unsafe=hosts.count("vibrates"),
            tight=hosts.count("tight"),
            host_fine=hosts.count("fine"),
            in_drive=len(drives),
            drive_fine=drives.count("fine"),
        )
    ]
    parts += [_overview(row, each) for row, each in found]
    parts.append(TEXTS[2])
    parts += [_section(row, each) for row, each in found]
    if left_out:
        parts.append("\n## Left out\n\n" + "".join(f"- {line}\n" for line in left_out))
    return "".join(parts)


def _overview(row: Row, found: Found) -> str:
    host, drive, gears = found[HOST], found.get(DRIVE), found.get(GEARS)
    cells = [
        f"[{_heading(row)}](#{_anchor(row)}) ({row.run})",
        f"{_factor(host.factor)} {verdict(row, HOST, host)}",
        _delay(host),
        _first(host, 1),
        "–" if drive is None else f"{_factor(drive.factor)} {verdict(row, DRIVE, drive)}",
        "–" if gears is None else f"{_factor(gears.factor)} {verdict(row, GEARS, gears)}",
        _delay(found[BARE]),
    ]
    return f"| {' | '.join(cells)} |\n"


def _section(row: Row, found: Found) -> str:
    source = row.source
    link = f"[{source['repository']}: {source['path']}](https://github.com/{source['repository']}/blob/HEAD/{source['path']})"
    sentences = [
        f"Gains: {link}, {source['date']}. {PLACES[row.run]}",
        f"Model: {_model(row)}.",
        f"Motors: {row.inertia}.",
        f"Rates: {_rates(row)}.",
        *([f"{row.note[0].upper()}{row.note[1:]}."] if row.note else []),
    ]
    lines = ["| reading | verdict | factor | at | from | first |", "|---|---|---|---|---|---|"]
    lines += [
        f"| {row.title(reading)} | {verdict(row, reading, one)} | {_factor(one.factor)} | {_hertz(one)} | {_delay(one)} "
        f"| {_first(one, 2)} |"
        for reading, one in found.items()
    ]
    commands = "\n".join(row.command(reading) for reading in found)
    others = ", ".join(f"{_factor(found[HOST].factors[delay])} with {delay:g} ms" for delay in DELAYS)
    lines.append(f"\nFactor on a host: {others}.")
    table = "\n".join(lines)
    return f"\n### {_heading(row)}\n\n{' '.join(sentences)}\n\n{table}\n\n```sh\n{commands}\n```\n"


def _heading(row: Row) -> str:
    return f"{row.robot}: {row.set}"


def _anchor(row: Row) -> str:
    """Anchor of a section, as GitHub makes it of its heading."""
    return "".join(letter for letter in _heading(row).lower().replace(" ", "-") if letter.isalnum() or letter in "-_")


def _model(row: Row) -> str:
    if row.repository is None:
        return f"`{row.model}`"
    return f"[{row.repository}: {row.model}](https://github.com/{row.repository}/blob/HEAD/{row.model})"


def _rates(row: Row) -> str:
    host = f"host {row.rate:g} Hz ({row.rate_said or 'assumed'})"
    if not row.drive:
        return f"{host}; its drives run no kp and kd"
    said = f"{row.drive['said']}; its delay is assumed" if "said" in row.drive else "assumed"
    return f"{host}; drive {row.drive['rate']:g} Hz with {row.drive['delay']:g} ms ({said})"


def _factor(factor: float) -> str:
    return "none" if math.isinf(factor) else "0" if factor == 0 else f"{factor:.3g}"


def _hertz(one: Numbers) -> str:
    return "–" if math.isnan(one.frequency) else f"{one.frequency:.3g} Hz"


def _delay(one: Numbers) -> str:
    return "never" if math.isinf(one.delay) else "0 ms" if one.delay == 0 else f"{one.delay:.3g} ms"


def _first(one: Numbers, most: int) -> str:
    return ", ".join(f"`{name}`" for name in one.joints[:most]) or "–"


def picture(found: Sequence[tuple[Row, Found]], target: Path) -> None:
    """Draw the delay at which each set of gains vibrates on a host, the shortest on top."""
    kept = sorted(((row, each[HOST]) for row, each in found), key=lambda pair: -pair[1].delay)
    style = {"font.size": 9, "svg.hashsalt": "gainroom", "svg.fonttype": "none", "axes.spines.top": False, "axes.spines.right": False}
    with mpl.rc_context(style):
        figure, axes = plt.subplots(figsize=(7.2, 0.21 * len(kept) + 1.1), layout="constrained")
        ends = [max(one.delay, SHORTEST) for _, one in kept]
        names = [_heading(row) for row, _ in kept]
        axes.barh(names, [end - SHORTEST for end in ends], left=SHORTEST, color=[COLOURS[row.run] for row, _ in kept], height=0.7)
        for place, ((_, one), end) in enumerate(zip(kept, ends, strict=True)):
            text = "vibrates without delay" if one.delay == 0 else f"{one.delay:.2g}"
            axes.text(end * 1.07, place, text, va="center", fontsize=7.5)
        axes.axvline(DELAY, color="black", linewidth=1, linestyle="--", zorder=3)
        axes.text(DELAY * 1.05, len(kept) - 0.3, f"{DELAY:g} ms", va="bottom", fontsize=9)
        axes.set(xscale="log", xlim=(SHORTEST, 1.9 * max(ends)), ylim=(-0.7, len(kept) + 0.2))
        axes.set_xlabel("delay at which these gains vibrate on a host [ms]")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.tick_params(axis="y", length=0)
        for place, words in WORDS.items():
            axes.barh([names[0]], [0], color=COLOURS[place], label=words)
        axes.legend(loc="upper right", bbox_to_anchor=(1.0, 0.97), frameon=False)
        figure.savefig(target, metadata={"Date": None})
        plt.close(figure)
