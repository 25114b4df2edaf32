"""Draws docs/images/vibration.svg: one joint's step below and above its gain limit, slowed down. It moves by itself, without a script."""

from pathlib import Path

import numpy as np

import gainroom as gr
from gainroom.simulation import Step, response_vibration

TARGET = Path(__file__).resolve().parents[1] / "docs" / "images" / "vibration.svg"
WIDTH, HEIGHT, PANEL = 860, 400, 400
LEFT, RIGHT, TOP, BOTTOM = 46, 12, 238, 362  # of the curve in its panel
DURATION, SLOWER, STEP = 0.3, 30, 0.01  # [s], –, [rad]
HIGHEST = 2.0 * STEP
SHOWN = 22.0  # degrees in the picture for STEP
ALWAYS = "indefinite"
BLUE, ORANGE, INK, SOFT = "#0072B2", "#D55E00", "#1b1b1b", "#5a5a5a"


def main() -> None:
    """Simulate and draw."""
    joint = gr.ElasticJoint(motor_inertia=0.2, link_inertia=0.8, stiffness=1e4, damping=1.0)
    drive = gr.Drive(bandwidth=4000.0, damping_ratio=0.9, delay=2.174e-3)
    loop = gr.build_loop(joint, drive, gr.PD(kp=1600.0, kd=70.0), sample_time=5e-4)
    limit = gr.gain_limit(loop)
    parts = []
    for k, (factor, colour, title) in enumerate([(0.5, BLUE, "half of the gain limit"), (1.15, ORANGE, "1.15 × the gain limit")]):
        scaled = loop.scaled(factor * limit.gain)
        run = gr.simulate(gr.Testbed(scaled, torque_limit=150.0), gr.Scenario(Step(STEP, start=0.02), duration=DURATION))
        seen = response_vibration(run)
        title += f": vibrates at {seen.frequency / (2 * np.pi):.0f} Hz" if seen and seen.growth_rate > -1.0 else ": settles"
        gains = f"kp {1600 * factor * limit.gain:.0f} N·m/rad, kd {70 * factor * limit.gain:.0f} N·m·s/rad"
        body = _panel(run.time, run.motor_position[:, 0], run.link_position[:, 0], colour, title, gains)
        parts.append(f'<g transform="translate({10 + k * (PANEL + 40)} 0)">{body}</g>')
    note = f"One joint, one step of {1e3 * STEP:.0f} mrad, {1e3 * drive.delay:.1f} ms of delay; angles enlarged, {SLOWER} times slower."
    parts.append(_text(WIDTH / 2, HEIGHT - 6, note, SOFT, 'text-anchor="middle" font-size="12"'))
    TARGET.write_text(_svg(parts), "utf-8")


def _panel(time: np.ndarray, motor: np.ndarray, link: np.ndarray, colour: str, title: str, gains: str) -> str:
    """One joint that moves, its motor's angle over time below."""
    x = LEFT + (PANEL - LEFT - RIGHT) * time / DURATION
    y = BOTTOM - (BOTTOM - TOP) * motor / HIGHEST
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    level = BOTTOM - (BOTTOM - TOP) * STEP / HIGHEST
    end, wide = PANEL - RIGHT, PANEL - LEFT - RIGHT
    return "\n".join(
        [
            _text(0, 24, title, colour, 'font-weight="600" font-size="16"'),
            _text(0, 44, gains, SOFT),
            _arm(link, colour),
            _disc(motor, colour),
            _text(140, 185, "motor", SOFT, 'text-anchor="end" font-size="12"'),
            _text(300, 190, "link", SOFT, 'font-size="12"'),
            *(_grid(milli) for milli in (0, 100, 200, 300)),
            f'<line x1="{LEFT}" x2="{end}" y1="{level:.1f}" y2="{level:.1f}" stroke="{SOFT}" stroke-dasharray="4 4"/>',
            _text(LEFT - 6, level + 4, f"{1e3 * STEP:.0f}", SOFT, 'text-anchor="end" font-size="12"'),
            _text(LEFT - 6, BOTTOM, "0", SOFT, 'text-anchor="end" font-size="12"'),
            _text(LEFT - 6, TOP + 2, "mrad", SOFT, 'text-anchor="end" font-size="12"'),
            f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.6"/>',
            # What is yet to come lies under a white sheet, which draws back. Where nothing moves, there is no sheet.
            f'<rect x="{end}" y="{TOP - 8}" width="0" height="{BOTTOM - TOP + 9}" fill="white" fill-opacity="0.86">'
            f"{_animate('x', [LEFT, end])}{_animate('width', [wide, 0])}</rect>",
        ]
    )


def _arm(link: np.ndarray, colour: str) -> str:
    return (
        f'<g transform="translate(200 150)"><g>{_turn(link)}'
        f'<rect x="-9" y="-9" width="150" height="18" rx="9" fill="{colour}" fill-opacity="0.22" stroke="{colour}"/></g></g>'
    )


def _disc(motor: np.ndarray, colour: str) -> str:
    spokes = "".join(f'<line x1="0" y1="0" x2="46" y2="0" transform="rotate({angle})" stroke="{colour}"/>' for angle in range(60, 360, 60))
    return (
        f'<g transform="translate(200 150)"><g>{_turn(motor)}<circle r="46" fill="#ffffff90" stroke="{colour}" stroke-width="2.5"/>'
        f'{spokes}<line x1="0" y1="0" x2="46" y2="0" stroke="{INK}" stroke-width="3"/></g><circle r="4" fill="{INK}"/></g>'
    )


def _turn(angle: np.ndarray) -> str:
    values = ";".join(f"{-SHOWN * each / STEP:.3g}" for each in angle)
    return (
        f'<animateTransform attributeName="transform" type="rotate" values="{values}" dur="{DURATION * SLOWER}s" repeatCount="{ALWAYS}"/>'
    )


def _animate(name: str, values: list[float]) -> str:
    return f'<animate attributeName="{name}" values="{";".join(map(str, values))}" dur="{DURATION * SLOWER}s" repeatCount="{ALWAYS}"/>'


def _grid(milli: int) -> str:
    x = LEFT + (PANEL - LEFT - RIGHT) * milli / (1e3 * DURATION)
    unit = " ms" if milli == 300 else ""
    anchor = "end" if unit else "middle"
    line = f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{TOP - 8}" y2="{BOTTOM}" stroke="#e4e4e4"/>'
    return line + _text(x + (12 if unit else 0), BOTTOM + 16, f"{milli}{unit}", SOFT, f'text-anchor="{anchor}" font-size="12"')


def _text(x: float, y: float, text: str, colour: str, style: str = "") -> str:
    return f'<text x="{x:.0f}" y="{y:.0f}" fill="{colour}" {style}>{text}</text>'


def _svg(parts: list[str]) -> str:
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" font-family="sans-serif" font-size="13">'
    )
    title = "<title>A joint's step at half of its gain limit, where it settles, and above the limit, where it vibrates</title>"
    return "\n".join([head, title, f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>', *parts, "</svg>", ""])


if __name__ == "__main__":
    main()
