"""Draws docs/images/fig9-gain-map.svg: the gains that Fig. 9's joint can take. Plain SVG, no plotting library."""

from pathlib import Path

import numpy as np

import gainroom as gr

TARGET = Path(__file__).resolve().parents[1] / "docs" / "images" / "fig9-gain-map.svg"
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 720, 430, 70, 40, 46, 56
KP_END, KD_END = 100_000.0, 700.0
BLUE, ORANGE, GREEN, INK, SOFT = "#0072B2", "#D55E00", "#009E73", "#1b1b1b", "#5a5a5a"


def main() -> None:
    """Write the picture."""
    joint = gr.ElasticJoint(motor_inertia=1.0, link_inertia=16.0, stiffness=1e4, damping=1.0)
    drive = gr.Drive(bandwidth=4000.0, damping_ratio=0.9, delay=2e-3)
    asked = {"gain_margin": 10 ** (6 / 20), "phase_margin": np.pi / 6, "peak_sensitivity": 2.0}
    stable = gr.pd_region(joint, drive).boundary
    required = gr.pd_region(joint, drive, **asked).boundary
    sampled = gr.pd_region(joint, drive, sample_time=5e-4).boundary
    recommended = gr.recommend_pd(joint, drive)
    assert recommended is not None
    shapes = [
        *(_outline(outline, BLUE, "#0072B2", 0.12) for outline in stable),
        *(_outline(outline, ORANGE, "none", 0, "7 5") for outline in sampled),
        *(_outline(outline, GREEN, "#009E73", 0.30) for outline in required),
        _text(62_000, 470, "stable", BLUE),
        _text(21_000, 420, "stable when sampled at 2 kHz", ORANGE),
        _text(9_500, 130, "keeps 6 dB, 30° and Ms 2", GREEN),
        _dot(10_000, 300),
        _text(11_500, 318, "the paper's gains", INK),
        _star(recommended.kp, recommended.kd),
        _text(9_000, 222, f"recommended: kp {_thousands(recommended.kp)}, kd {recommended.kd:.0f}", INK),
    ]
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(_svg([*_axes(), *shapes]), "utf-8")


def _thousands(value: float) -> str:
    return f"{value:,.0f}".replace(",", "\u202f")


def _place(kp: float, kd: float) -> tuple[float, float]:
    x = LEFT + (WIDTH - LEFT - RIGHT) * kp / KP_END
    y = HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * kd / KD_END
    return round(x, 1), round(y, 1)


def _outline(outline: np.ndarray, colour: str, fill: str, opacity: float, dash: str = "none") -> str:
    points = " ".join("{},{}".format(*_place(kp, kd)) for kp, kd in outline)
    style = f'stroke="{colour}" stroke-width="2" stroke-dasharray="{dash}" fill="{fill}" fill-opacity="{opacity}"'
    return f'<polygon points="{points}" {style}/>'


def _dot(kp: float, kd: float) -> str:
    x, y = _place(kp, kd)
    return f'<circle cx="{x}" cy="{y}" r="5" fill="{INK}" stroke="white"/>'


def _star(kp: float, kd: float) -> str:
    x, y = _place(kp, kd)
    angles = np.pi / 5 * np.arange(10)
    radii = np.where(np.arange(10) % 2, 4.0, 9.0)
    points = " ".join(f"{x + r * np.sin(a):.1f},{y - r * np.cos(a):.1f}" for a, r in zip(angles, radii, strict=True))
    return f'<polygon points="{points}" fill="{INK}" stroke="white"/>'


def _text(kp: float, kd: float, text: str, colour: str, anchor: str = "start") -> str:
    x, y = _place(kp, kd)
    return f'<text x="{x}" y="{y}" fill="{colour}" text-anchor="{anchor}">{text}</text>'


def _axes() -> list[str]:
    parts = [f'<text x="{LEFT}" y="24" font-weight="600" fill="{INK}">Gains that the joint of Fig. 9 can take (2 ms of delay)</text>']
    for kp in range(0, int(KP_END) + 1, 20_000):
        x, low = _place(kp, 0)
        parts.append(f'<line x1="{x}" y1="{TOP}" x2="{x}" y2="{low}" stroke="#e4e4e4"/>')
        parts.append(f'<text x="{x}" y="{low + 18}" text-anchor="middle" fill="{SOFT}">{_thousands(kp)}</text>')
    for kd in range(0, int(KD_END) + 1, 100):
        x, y = _place(0, kd)
        parts.append(f'<line x1="{x}" y1="{y}" x2="{WIDTH - RIGHT}" y2="{y}" stroke="#e4e4e4"/>')
        parts.append(f'<text x="{x - 8}" y="{y + 4}" text-anchor="end" fill="{SOFT}">{kd}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{middle}" y="{HEIGHT - 14}" text-anchor="middle" fill="{INK}">kp (N m/rad)</text>')
    height = (TOP + HEIGHT - BOTTOM) / 2
    parts.append(f'<text transform="translate(18 {height}) rotate(-90)" text-anchor="middle" fill="{INK}">kd (N m s/rad)</text>')
    return parts


def _svg(parts: list[str]) -> str:
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" font-family="sans-serif" font-size="13">'
    )
    background = f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>'
    return "\n".join([head, "<title>Gain map of Fig. 9's joint</title>", background, *parts, "</svg>", ""])


if __name__ == "__main__":
    main()
