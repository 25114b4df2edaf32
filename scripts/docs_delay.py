"""Draws docs/images/delay-cases.svg: where the gains of one joint run, what the same bus then delays, and what is left of the gains."""

import math
from pathlib import Path

import gainroom as gr
from gainroom.analysis.margin_record import PathMargins

TARGET = Path(__file__).resolve().parents[1] / "docs" / "images" / "delay-cases.svg"
WIDTH, ROW = 560, 214
BUS, BUS_RATE = 4e-3, 500.0
OWN, OWN_RATE = 0.05e-3, 20000.0
KP, KD = 3000.0, 300.0
BLUE, ORANGE, GREY, INK, SOFT = "#0072B2", "#D55E00", "#8a8a8a", "#1b1b1b", "#5a5a5a"
HOST, DRIVE, JOINT = (20, 150), (288, 418), 500  # [px] left and right of the boxes, and the middle of the joint
TOP, BOTTOM = 50, 122


def main() -> None:
    """Compute and draw."""
    joint, gains = gr.ElasticJoint(motor_inertia=1.0, link_inertia=16.0, stiffness=1e4, damping=1.0), gr.PD(KP, KD)
    near, far = gr.Drive(4000.0, 0.9, OWN), gr.Drive(4000.0, 0.9, BUS)
    host = gr.gain_limit(gr.build_loop(joint, far, gains, sample_time=1 / BUS_RATE))
    drive = gr.gain_limit(gr.build_loop(joint, near, gains, sample_time=1 / OWN_RATE))
    split = gr.margins(gr.build_loop(joint, far, gains, sample_time=1 / BUS_RATE, kd_path=gr.GainPath(OWN, 1 / OWN_RATE))).paths
    assert split is not None
    parts = [
        _row(0, "host: both gains see the bus", ("kp", "kd"), (), f"4 ms lie in the loop: {_limit(host)}"),
        _row(1, "drive: only set-points see the bus", (), ("kp", "kd"), f"4 ms delay the motion, and no margin: {_limit(drive)}"),
        _row(2, "split: kp sees the bus, kd does not", ("kp",), ("kd",), f"4 ms lie in kp's loop: {_limit(split)}"),
        _text(10, 3 * ROW + 6, f"One joint, kp {KP:.0f} N·m/rad and kd {KD:.0f} N·m·s/rad in all three cases.", SOFT, anchor="start"),
        _text(10, 3 * ROW + 26, "What closes on the drive has 0.05 ms of delay and runs at 20 kHz.", SOFT, anchor="start"),
    ]
    heads = "".join(
        f'<marker id="{name}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0 0 L8 4 L0 8 z" fill="{colour}"/></marker>'
        for name, colour in (("blue", BLUE), ("orange", ORANGE), ("grey", GREY))
    )
    TARGET.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{3 * ROW + 40}" viewBox="0 0 {WIDTH} {3 * ROW + 40}" '
        f'font-family="system-ui, sans-serif" font-size="14"><title>Which delay: three places for kp and kd</title><defs>{heads}</defs>'
        f'<rect width="100%" height="100%" fill="white"/>{"".join(parts)}</svg>\n',
        "utf-8",
    )


def _limit(found: gr.GainLimit | PathMargins) -> str:
    if not isinstance(found, gr.GainLimit):
        return f"vibrates from {found.others:.3g} × kp, or {found.kd:.3g} × kd"
    return f"vibrates from {found.gain:.3g} × these gains" if found.stable else f"unstable, stable only below {found.gain:.2g} ×"


def _row(place: int, title: str, host: tuple[str, ...], drive: tuple[str, ...], result: str) -> str:
    """One case: its boxes, the loops that close, and what comes of it."""
    middle = (TOP + BOTTOM) / 2
    x, wide = (HOST[1] + DRIVE[0]) / 2, 92
    bus = f'<rect x="{x - wide / 2}" y="{TOP - 8}" width="{wide}" height="{BOTTOM - TOP + 50}" rx="6" fill="#f0f0f0"/>'
    parts = [
        _text(0, 22, title, INK, weight=600, anchor="start"),
        bus,
        _text(x, TOP + 8, "bus", SOFT),
        _text(x, TOP + 62, "4 ms, 500 Hz", SOFT),
    ]
    if host:
        parts.append(_loop(ORANGE, "orange", middle - 10, BOTTOM + 26, (HOST[0] + HOST[1]) / 2, HOST[1]))
    if drive:
        parts.append(_loop(BLUE, "blue", middle + 8, BOTTOM + 14, (DRIVE[0] + DRIVE[1]) / 2, DRIVE[1]))
    if not host:
        parts.append(_arrow([(HOST[1], middle), (DRIVE[0], middle)], GREY, "grey", "6 5"))
        parts.append(_text((HOST[0] + HOST[1]) / 2, middle + 12, "set-points", SOFT))
    for (left, right), name, gains in ((HOST, "host", host), (DRIVE, "drive", drive)):
        box = f'x="{left}" y="{TOP}" width="{right - left}" height="{BOTTOM - TOP}" rx="6" fill="none" stroke="{INK}" stroke-width="1.4"'
        parts += [f"<rect {box}/>", _text(left + 8, TOP + 17, name, SOFT, anchor="start")]
        for k, gain in enumerate(gains):
            at = (left + right) / 2 + (k - (len(gains) - 1) / 2) * 48
            colour = ORANGE if name == "host" else BLUE
            parts.append(
                f'<rect x="{at - 19}" y="{middle - 3}" width="38" height="26" rx="4" fill="white" stroke="{colour}" stroke-width="2"/>'
            )
            parts.append(_text(at, middle + 15, gain, colour, weight=600))
    parts.append(f'<circle cx="{JOINT}" cy="{middle}" r="30" fill="white" stroke="{INK}" stroke-width="1.4"/>')
    parts += [_text(JOINT, middle + 5, "joint", INK), _text(0, BOTTOM + 60, result, INK, anchor="start")]
    return f'<g transform="translate(10 {place * ROW})">{"".join(parts)}</g>'


def _loop(colour: str, head: str, forward: float, back: float, into: float, out: float) -> str:
    """Torque from a box at `out` to the joint at height `forward`, and the measurement back at height `back` to the box at `into`."""
    middle = (TOP + BOTTOM) / 2
    below = middle + math.sqrt(30**2 - 10**2)
    side = JOINT + (10 if colour == ORANGE else -10)
    torque = [(out, forward), (JOINT - math.sqrt(30**2 - (forward - middle) ** 2), forward)]
    return _arrow(torque, colour, head) + _arrow([(side, below), (side, back), (into, back), (into, BOTTOM)], colour, head)


def _arrow(points: list[tuple[float, float]], colour: str, head: str, dash: str = "") -> str:
    line = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
    dashed = f' stroke-dasharray="{dash}"' if dash else ""
    return f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2.4" marker-end="url(#{head})"{dashed}/>'


def _text(x: float, y: float, text: str, colour: str, weight: int = 400, anchor: str = "middle") -> str:
    return f'<text x="{x}" y="{y}" fill="{colour}" font-weight="{weight}" text-anchor="{anchor}">{text}</text>'


if __name__ == "__main__":
    main()
