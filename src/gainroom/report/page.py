"""HTML report pages: one self-contained file with style, figures and the drawing library.

A page is  page(title, lead, cards, sections, command);  a section holds the results of figure, table, paragraph, facts, block and details.
Plain strings are escaped wherever they enter; only Html, made here, passes unchanged. Figures are dicts in plotly's own format ({"data":
[...], "layout": {...}}), which may contain numpy arrays.
"""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from html import escape
from importlib.resources import files
from typing import Any, Literal

from .. import __version__
from ..io.strict_json import strict
from ..system.plausibility import by_doubt
from .number_format import MISSED

SIGNIFICANT = 6  # digits of every number in a picture: more cannot be seen

SENTENCE_END = re.compile(r"(?<=\.) (?=[A-Z])")


class Html(str):
    """Markup that is safe to insert."""

    __slots__ = ()


@dataclass(frozen=True)
class Lead:
    """Answer of a page: one sentence and its tone. `state` "bad" puts a banner with `headline` before everything else.

    advice     right under the sentence
    warnings   one line each, after it
    """

    sentence: str
    state: Literal["good", "warn", "bare", "bad"] = "good"
    headline: str = ""
    warnings: Sequence[str] = ()
    advice: str = ""


@dataclass(frozen=True)
class Card:
    """Main number of a page. `met`: True if `requirement` is met; None if nothing is required."""

    label: str
    value: str
    unit: str = ""
    requirement: str = ""
    met: bool | None = None
    note: str = ""


@dataclass(frozen=True)
class Section:
    """Section of a page: heading and content, Html from the functions below, or plain text for a paragraph.

    summary   one line on its content: the section is then folded
    """

    title: str
    parts: Sequence[str]
    summary: str = ""


def page(
    title: str, lead: Lead, cards: Sequence[Card | None], sections: Sequence[Section | None], command: str, sources: Sequence[str] = ()
) -> str:
    """Complete HTML page; cards and sections that are None are left out. The drawing library is included if there is a figure.

    command   command that makes the page, for the last section
    sources   closing lines before the version and the date
    """
    last = Section("Command", [block(command)], "that makes this page")
    body = "".join(_section(section) for section in (*sections, last) if section is not None)
    footer = (*sources, f"gainroom {__version__}, {datetime.now(timezone.utc).date().isoformat()}")
    script = _drawing_scripts() if 'class="plot"' in body else ""
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title>",
            f"<style>{_resource('page.css')}</style></head>",
            f'<body class="{lead.state}"><main>',
            f'<header><p class="kind">{escape(title)}</p>{_lead(lead)}{_cards([*filter(None, cards)])}</header>',
            body,
            f"<footer>{''.join(map(_flow, footer))}</footer></main>",
            script,
            "</body></html>\n",
        ]
    )


def figure(fig: Mapping[str, Any], title: str, caption: str, height: int = 480, narrow: Mapping[str, Any] | None = None) -> Html:
    """Figure with a title that names its content and a caption that gives the conclusion.

    fig      a dict in plotly's format
    height   [px]
    narrow   changes of the layout on a phone, by dotted path ({"margin.l": 40}). Annotations with name="wide" and traces with
             meta="wide" are left out there, annotations with name="narrow" are shown only there.
    """
    text = json.dumps(strict({**fig, "narrow": narrow or {}}, SIGNIFICANT), separators=(",", ":"), allow_nan=False)
    data = text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
    return Html(
        f'<figure><h3>{escape(title)}</h3><div class="plot" style="height:{height:d}px" role="img" aria-label="{escape(title)}"></div>'
        f'<script type="application/json">{data}</script><figcaption>{_inline(caption)}</figcaption></figure>'
    )


MARKS = {"yes": "met", "no": "unmet", "unstable": "unmet"}
"""CSS class of table cells, by their text; a cell that starts with MISSED is unmet, too."""


def table(headers: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "", sorts: bool = True) -> Html:
    """HTML table. The first column is left-aligned, the others right; `sorts`: a click on a heading sorts the rows."""

    def cell(text: str) -> str:
        kind = MARKS.get(text, "unmet" if text.startswith(MISSED) else "")
        return f'<td class="{escape(kind)}">{_inline(text)}</td>' if kind else f"<td>{_inline(text)}</td>"

    head = "".join(f'<th scope="col">{_inline(text)}</th>' for text in headers)
    body = "".join(f"<tr>{''.join(map(cell, row))}</tr>" for row in rows)
    described = f"<figcaption>{_inline(caption)}</figcaption>" if caption else ""
    kind = ' class="sorts"' if sorts else ""
    rows_and_head = f"<table{kind}><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return Html(f'<figure><div class="scroll">{rows_and_head}</div>{described}</figure>')


def facts(pairs: Iterable[tuple[str, str]]) -> Html:
    """List of names and values, one pair per line."""
    return Html("<dl>" + "".join(f"<dt>{_inline(name)}</dt><dd>{_inline(value)}</dd>" for name, value in pairs) + "</dl>")


def paragraph(text: str) -> Html:
    """One paragraph."""
    return Html(f"<p>{_inline(text)}</p>")


def block(text: str) -> Html:
    """Command or file, in fixed width."""
    return Html(f"<pre>{escape(text)}</pre>")


def details(summary: str, *parts: str) -> Html:
    """Folded parts, opened by a click on their summary line."""
    return Html(f"<details><summary>{_inline(summary)}</summary>{''.join(map(_flow, parts))}</details>")


def advice(heading: str, text: str, *parts: str) -> Html:
    """Advice box: a heading, lines to copy, and parts under them."""
    lines = copied(text.splitlines()) if text else ""
    return Html(f'<section class="advice"><h2>Do this</h2>{_flow(heading)}{lines}{"".join(map(_flow, parts))}</section>')


def copied(lines: Sequence[str]) -> Html:
    """Lines to copy."""
    return Html(f'<div class="copied"><pre>{escape(chr(10).join(lines))}</pre><button type="button">Copy</button></div>')


def coded(text: str) -> Html:
    """Paragraph whose `…` parts are set as code."""
    return paragraph(Html(re.sub(r"`([^`]*)`", r"<code>\1</code>", _inline(text))))


def beside(*parts: str) -> Html:
    """Parts side by side if there is room, under each other on a phone."""
    return Html('<div class="beside">' + "".join(map(_flow, parts)) + "</div>")


def _inline(text: str) -> str:
    return text if isinstance(text, Html) else escape(str(text))


def _flow(text: str) -> str:
    return text if isinstance(text, Html) else paragraph(text)


def _section(section: Section) -> str:
    if section.summary:
        line = f"<summary><h2>{_inline(section.title)}</h2> {_inline(section.summary)}</summary>"
        return f'<details class="section">{line}{"".join(map(_flow, section.parts))}</details>\n'
    return f"<section><h2>{_inline(section.title)}</h2>{''.join(map(_flow, section.parts))}</section>\n"


def _lead(lead: Lead) -> str:
    banner = f'<p class="banner" role="alert">{escape(lead.headline)}</p>' if lead.headline else ""
    doubts, others = ("".join(f'<p class="warning"><b>Warning</b> {escape(text)}</p>' for text in part) for part in by_doubt(lead.warnings))
    return f"{banner}{doubts}<h1>{_headline(lead.sentence)}</h1>{lead.advice}{others}"


def _headline(sentences: str) -> str:
    """HTML of an answer: its first sentence, the verdict, in large letters, the rest as a paragraph."""
    verdict, *rest = SENTENCE_END.split(sentences, maxsplit=1)
    return escape(verdict) + "".join(f" <span>{escape(text)}</span>" for text in rest)


def _cards(cards: Sequence[Card]) -> str:
    return f'<div class="cards">{"".join(map(_card, cards))}</div>' if cards else ""


def _card(card: Card) -> str:
    state, verdict = {True: ("met", "✓ met"), False: ("unmet", "✗ not met"), None: ("plain", "")}[card.met]
    unit = f' <span class="unit">{escape(card.unit)}</span>' if card.unit else ""
    below = [f"<b>{verdict}</b>" if verdict else "", escape(card.requirement)]
    note = f'<p class="note">{escape(card.note)}</p>' if card.note else ""
    return (
        f'<div class="card {state}"><p class="label">{escape(card.label)}</p><p class="value">{escape(card.value)}{unit}</p>'
        f'<p class="verdict">{" · ".join(filter(None, below)) or "&nbsp;"}</p>{note}</div>'
    )


def _drawing_scripts() -> str:
    library, own = _resource("vendor/plotly.js"), _resource("page.js")
    return f"<noscript><p>The pictures need JavaScript.</p></noscript><script>{library}</script>\n<script>{own}</script>"


def _resource(name: str) -> str:
    return files("gainroom.report").joinpath(name).read_text("utf-8")


@dataclass(frozen=True)
class Advice:
    """Advice: `heading` with the instruction, ending in a colon before `lines` to type; `remarks` follow. Parts in `…` are code.

    then     commands to type after that: a heading and their lines
    folded   gains that may not be used yet: a heading that says so, and their lines; displayed with all details only
    """

    heading: str
    lines: Sequence[str] = ()
    remarks: Sequence[str] = ()
    folded: tuple[str, Sequence[str]] | None = None
    then: tuple[str, Sequence[str]] | None = None


def advice_box(found: Advice | None, *parts: str) -> Html | str:
    """Advice on a page, with `parts` under it; "" without advice."""
    if found is None:
        return ""
    folded = [] if found.folded is None else [details(found.folded[0].replace("`", "").rstrip(":"), copied(found.folded[1]))]
    then = [] if found.then is None else [coded(found.then[0]), copied(found.then[1])]
    return advice(coded(found.heading), "\n".join(found.lines), *map(coded, found.remarks), *parts, *then, *folded)
