// Bode, Nyquist and step: uPlot draws what the server computed.
// @ts-check
import uPlot from "./vendor/uplot.js";
import { number } from "./gainmap.js";
import { made } from "./elements.js";

const AXIS = { stroke: "#444", grid: { stroke: "#eee" }, ticks: { stroke: "#bbb" }, font: "12px system-ui" };

/** Numbers of an axis, as everywhere on the page. @param {any} _ @param {number[]} splits */
const plain = (_, splits) => splits.map((value) => number(value));
const UPRIGHT = { ...AXIS, values: plain };

/** @param {HTMLElement} place @param {any} options @param {any} data */
function plot(place, options, data) {
  const drawn = new (/** @type {any} */ (uPlot))({ width: Math.max(260, place.clientWidth), cursor: { y: false, drag: { x: false, y: false }, points: { show: false } }, legend: { show: false }, ...options }, data, place);
  new ResizeObserver(() => { const width = Math.max(260, place.clientWidth); if (Math.abs(width - drawn.width) > 1) drawn.setSize({ width, height: options.height }); }).observe(place);
  return drawn;
}

/** A band across a chart. @param {any} u @param {string} scale @param {number[][]} bands @param {string} color */
function shade(u, scale, bands, color) {
  u.ctx.save();
  u.ctx.fillStyle = color;
  for (const [low, high] of bands) {
    const top = Math.max(u.valToPos(high, scale, true), u.bbox.top), bottom = Math.min(u.valToPos(low, scale, true), u.bbox.top + u.bbox.height);
    if (bottom > top) u.ctx.fillRect(u.bbox.left, top, u.bbox.width, bottom - top);
  }
  u.ctx.restore();
}

/** @param {any} u @param {number | null} hz @param {string} color @param {string} [text] @param {number} [row] */
function upright(u, hz, color, text, row = 0) {
  if (!hz || hz < u.scales.x.min || hz > u.scales.x.max) return;
  const x = u.valToPos(hz, "x", true), { ctx, bbox } = u;
  ctx.save();
  ctx.strokeStyle = color;
  ctx.fillStyle = color;
  ctx.lineWidth = devicePixelRatio;
  ctx.beginPath();
  ctx.moveTo(x, bbox.top);
  ctx.lineTo(x, bbox.top + bbox.height);
  ctx.stroke();
  if (text) {
    ctx.font = `${12 * devicePixelRatio}px system-ui`;
    ctx.textAlign = x > bbox.left + 0.7 * bbox.width ? "right" : "left";
    const at = /** @type {[string, number, number]} */ ([text, x + (ctx.textAlign === "left" ? 4 : -4) * devicePixelRatio, bbox.top + 14 * (row + 1) * devicePixelRatio]);
    Object.assign(ctx, { strokeStyle: "rgba(255,255,255,.85)", lineWidth: 4 * devicePixelRatio });
    ctx.strokeText(...at); // a curve behind it leaves it legible
    ctx.fillText(...at);
  }
  ctx.restore();
}

export class Bode {
  /** @param {HTMLElement} place @param {number[]} span @param {any} needed @param {(hz: number | null) => void} cursor */
  constructor(place, span, needed, cursor) {
    /** @type {any[]} */ this.marks = [];
    /** @type {number | null} */ this.hz = null;
    const db = needed.gain_margin ? 20 * Math.log10(needed.gain_margin) : 0, angle = needed.phase_margin ? (180 / Math.PI) * needed.phase_margin : 0;
    const x = { distr: 3, range: () => /** @type {[number, number]} */ (span) };
    const sync = (/** @type {any} */ u) => { if (u.cursor.event) cursor(u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null); };
    const lines = (/** @type {any} */ u) => {
      this.marks.forEach((mark, k) => upright(u, mark.hz, mark.color, u === this.size ? mark.text : "", k)); // not on top of each other
      upright(u, this.hz, "#e69f00", u === this.size && this.hz ? `${number(this.hz, 3)} Hz` : "");
    };
    const series = [{}, { stroke: "#000", width: 2, points: { show: false } }];
    const decades = (/** @type {any} */ _, /** @type {number[]} */ splits) => splits.map((value) => (Math.abs(Math.log10(value) % 1) < 1e-6 ? number(value) : ""));
    const xAxis = { ...AXIS, values: decades };
    this.size = plot(place, {
      height: 200, series, scales: { x, y: { range: (/** @type {any} */ _, /** @type {number} */ low, /** @type {number} */ high) => [Math.max(low - 3, -60), Math.max(high + 6, db + 6)] } },
      axes: [{ ...xAxis, size: 32 }, { ...UPRIGHT, label: "|L| [dB]", labelSize: 18, labelFont: "12px system-ui", size: 50 }],
      hooks: { drawAxes: [(/** @type {any} */ u) => shade(u, "y", [[-db, db]], "rgba(213,94,0,.10)")], draw: [lines], setCursor: [sync] },
    }, [span, [null, null]]);
    this.phase = plot(place, {
      height: 200, series: [{}, { stroke: "#000", width: 2, points: { show: false } }],
      scales: { x, y: { range: (/** @type {any} */ _, /** @type {number} */ low, /** @type {number} */ high) => [Math.max(low - 10, -560), Math.max(high + 15, -120)] } },
      axes: [{ ...xAxis, size: 32, label: "frequency [Hz]", labelSize: 18, labelFont: "12px system-ui" }, { ...UPRIGHT, label: "arg L [°]", labelSize: 18, labelFont: "12px system-ui", size: 50, incrs: [15, 30, 45, 90, 180] }],
      hooks: { drawAxes: [(/** @type {any} */ u) => shade(u, "y", [-180, -540, 180].map((at) => [at - angle, at + angle]), "rgba(0,114,178,.12)")], draw: [lines], setCursor: [sync] },
    }, [span, [null, null]]);
  }

  /** @param {any} part */
  take(part) {
    const colors = { gain: "#d55e00", phase: "#0072b2", Ms: "#009e73" }, words = { gain: "gain margin", phase: "phase margin", Ms: "Ms" };
    this.marks = part.marks.map((/** @type {any} */ mark) => ({ hz: mark.hz, color: colors[/** @type {"gain"} */ (mark.name)], text: words[/** @type {"gain"} */ (mark.name)] })).sort((/** @type {any} */ a, /** @type {any} */ b) => b.hz - a.hz); // no line through the name of one before it
    this.size.setData([part.hz, part.size]);
    this.phase.setData([part.hz, part.phase]);
  }

  /** @param {number | null} hz */
  setCursor(hz) { this.hz = hz; this.size.redraw(false); this.phase.redraw(false); }
}

export class Nyquist {
  /** @param {HTMLElement} place @param {any} needed */
  constructor(place, needed) {
    this.needed = needed;
    this.canvas = made("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "Nyquist plot of the open loop");
    place.append(this.canvas);
    this.place = place;
    /** @type {any} */ this.part = null;
    /** @type {number | null} */ this.hz = null;
    new ResizeObserver(() => this.draw()).observe(place);
  }

  /** @param {any} part */
  take(part) { this.part = part; this.draw(); }
  /** @param {number | null} hz */
  setCursor(hz) { this.hz = hz; this.draw(); }

  draw() {
    const wide = Math.max(260, this.place.clientWidth), high = Math.round(Math.min(440, 0.72 * wide)), ratio = devicePixelRatio;
    if (this.canvas.width !== Math.round(wide * ratio) || this.canvas.height !== Math.round(high * ratio)) {
      this.canvas.width = Math.round(wide * ratio);
      this.canvas.height = Math.round(high * ratio);
      this.canvas.style.width = `${wide}px`;
      this.canvas.style.height = `${high}px`;
    }
    const ctx = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d")), scale = high / 4.4;
    const x = (/** @type {number} */ re) => wide * 0.58 + re * scale, y = (/** @type {number} */ im) => high / 2 - im * scale;
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, wide, high);
    const disc = (/** @type {number} */ radius, /** @type {string} */ color) => { ctx.beginPath(); ctx.arc(x(-1), y(0), radius * scale, 0, 7); ctx.fillStyle = color; ctx.fill(); };
    if (this.needed.peak_sensitivity) disc(1 / this.needed.peak_sensitivity, "rgba(0,158,115,.18)");
    ctx.lineWidth = 1;
    ctx.strokeStyle = "#ccc";
    ctx.beginPath(); ctx.moveTo(0, y(0)); ctx.lineTo(wide, y(0)); ctx.moveTo(x(0), 0); ctx.lineTo(x(0), high); ctx.stroke();
    ctx.beginPath(); ctx.setLineDash([3, 4]); ctx.arc(x(0), y(0), scale, 0, 7); ctx.stroke(); ctx.setLineDash([]);
    if (this.needed.gain_margin) { ctx.lineWidth = 5; ctx.strokeStyle = "rgba(213,94,0,.45)"; ctx.beginPath(); ctx.moveTo(x(-this.needed.gain_margin), y(0)); ctx.lineTo(x(-1 / this.needed.gain_margin), y(0)); ctx.stroke(); }
    if (this.needed.phase_margin) { ctx.lineWidth = 5; ctx.strokeStyle = "rgba(0,114,178,.45)"; ctx.beginPath(); ctx.arc(x(0), y(0), scale, Math.PI - this.needed.phase_margin, Math.PI + this.needed.phase_margin); ctx.stroke(); }
    ctx.fillStyle = "#000"; ctx.font = "12px system-ui"; ctx.fillText("−1", x(-1) - 16, y(0) + 18); ctx.fillText("Re L", wide - 30, y(0) - 5); ctx.fillText("Im L", x(0) + 5, 12);
    ctx.beginPath(); ctx.arc(x(-1), y(0), 3, 0, 7); ctx.fill();
    if (!this.part) return;
    ctx.beginPath();
    ctx.lineWidth = 2;
    ctx.strokeStyle = "#000";
    let spot = -1, least = 0.05;
    this.part.re.forEach((/** @type {number} */ re, /** @type {number} */ k) => {
      const near = Math.abs(re) < 40 && Math.abs(this.part.im[k]) < 40;
      if (near && k) ctx.lineTo(x(re), y(this.part.im[k])); else ctx.moveTo(x(re), y(this.part.im[k]));
      const gap = this.hz ? Math.abs(Math.log(this.part.hz[k] / this.hz)) : 9;
      if (gap < least) { least = gap; spot = k; }
    });
    ctx.stroke();
    if (spot >= 0) { ctx.beginPath(); ctx.fillStyle = "#e69f00"; ctx.arc(x(this.part.re[spot]), y(this.part.im[spot]), 6, 0, 7); ctx.fill(); ctx.strokeStyle = "#000"; ctx.lineWidth = 1; ctx.stroke(); }
  }
}

export class Step {
  /** @param {HTMLElement} place */
  constructor(place) {
    /** @type {any} */ this.before = null;
    this.note = made("p", { className: "legend" });
    const lines = [{}, { stroke: "#999", width: 2, dash: [6, 5], points: { show: false } }, { stroke: "#000", width: 1, points: { show: false } }, { stroke: "#000", width: 3, points: { show: false } }]; // before, motor, link
    const axes = (/** @type {string} */ label) => [{ ...AXIS, size: 32, label: "time [ms]", labelSize: 18, labelFont: "12px system-ui", values: plain }, { ...AXIS, label, labelSize: 18, labelFont: "12px system-ui", size: 62, values: plain }];
    const [first, second] = [made("div"), made("div")];
    this.place = place;
    place.classList.add("pair");
    place.append(first, second);
    this.reference = plot(first, { height: 190, series: lines, axes: axes("position / step [–]"), scales: { x: { time: false } } }, [[0, 1], [null, null], [null, null], [null, null]]);
    this.added = made("p", { className: "legend" });
    second.append(this.added);
    this.unit = "mrad";
    const [time, moved] = axes("");
    this.disturbance = plot(second, { height: 170, series: lines.map((line) => ({ ...line })), axes: [time, { ...moved, label: () => `position [${this.unit}]` }], scales: { x: { time: false } } }, [[0, 1], [null, null], [null, null], [null, null]]);
    place.append(this.note);
  }

  /** Of the file's gains. @param {any} part */
  takeBefore(part) { this.before = part.note ? null : part; }

  /** @param {any} part */
  take(part) {
    this.place.classList.toggle("empty", Boolean(part.note));
    if (part.note) { this.note.textContent = part.note; return; }
    this.added.textContent = `Position under a load: ${part.added}`;
    this.unit = part.unit;
    const end = part.ms[part.ms.length - 1], old = this.before || part;
    for (const [chart, key] of /** @type {[any, string][]} */ ([[this.reference, "reference"], [this.disturbance, "disturbance"]])) {
      const count = old.ms.findIndex((/** @type {number} */ t) => t > end), shown = count < 0 ? old.ms.length : count;
      chart.setData(/** @type {any} */ (uPlot).join([[old.ms.slice(0, shown), old[key].slice(0, shown)], [part.ms, part[`${key}_motor`], part[key]]], [[2], [2, 2]]));
    }
    this.note.textContent = part.growth > 0 ? `Grows at ${number(part.growth, 3)} 1/s, at ${number(part.hz, 3)} Hz: do not run these gains.` : "";
  }
}

/** A simulated run: what moves, and the torque of the joint that works hardest. @param {HTMLElement} place @param {any} part */
export function traces(place, part) {
  place.replaceChildren();
  const colors = ["#0072b2", "#d55e00", "#009e73"];
  for (const [curves, label] of /** @type {[any[], string][]} */ ([[part.motion, `moved since the start [${part.unit}]`], [part.torque, `torque [${part.torque_unit}]`]])) {
    const half = curves.length > 1 ? curves.length / 2 : 1;
    const series = [{}, ...curves.map((curve, k) => ({ label: curve.name, stroke: colors[k % half % 3], width: curve.dashed ? 1.2 : 2, dash: curve.dashed ? [5, 5] : undefined, points: { show: false } }))];
    plot(place, { height: 200, series, scales: { x: { time: false } }, axes: [{ ...AXIS, size: 32, label: "time [ms]", labelSize: 18, labelFont: "12px system-ui", values: plain }, { ...AXIS, label, labelSize: 18, labelFont: "12px system-ui", size: 64, values: plain }] }, [part.ms, ...curves.map((curve) => curve.values)]);
  }
  const names = `${part.motion.filter((/** @type {any} */ each) => !each.dashed).map((/** @type {any} */ each) => each.name).join(", ")}; dashed: commanded. Torque: ${part.torque[0].name}, which works hardest.`;
  place.append(made("p", { className: "legend" }, names));
}
