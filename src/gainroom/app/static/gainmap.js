// The gain map as SVG: outlines, edge and marks come from the server; here they are only drawn, and the dot is moved.
// @ts-check
import { made } from "./elements.js";

const NS = "http://www.w3.org/2000/svg";
const FRAME = { left: 64, right: 24, top: 10, bottom: 44 };

/** @param {string} tag @param {Record<string, string | number>} attributes @param {Element} [parent] @returns {SVGElement} */
export function svg(tag, attributes, parent) {
  const element = /** @type {SVGElement} */ (document.createElementNS(NS, tag));
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  if (parent) parent.append(element);
  return element;
}

/** Round numbers for an axis. @param {number} low @param {number} high @param {number} count @returns {number[]} */
export function ticks(low, high, count) {
  const raw = (high - low) / count, size = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 2.5, 5, 10].map((each) => each * size).find((each) => each >= raw) || raw;
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high * (1 + 1e-9); value += step) found.push(value);
  return found;
}

const GROUPED = new Intl.NumberFormat("en-US", { maximumFractionDigits: 6 });

/** @param {number} value @param {number} [digits] */
export function number(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = Number(value.toPrecision(digits));
  const typed = Math.abs(text) >= 1e6 || (text !== 0 && Math.abs(text) < 1e-3) ? text.toExponential() : GROUPED.format(text).replaceAll(",", "\u202f");
  return typed.replace(/^-/, "\u2212");
}

export class GainMap {
  /**
   * @param {HTMLElement} place
   * @param {(point: number[], final: boolean) => void} moved
   * @param {(start: boolean) => void} gesture
   */
  constructor(place, moved, gesture) {
    this.place = place;
    this.moved = moved;
    this.gesture = gesture;
    this.window = [1, 1];
    this.width = this.height = 0;
    this.names = ["kp", "kd"];
    this.units = ["N·m/rad", "N·m·s/rad"];
    this.green = "in every state this loop keeps the required margins and all gains together the gain margin (nominal values)";
    this.nowhere = ": no gains here are stable";
    this.sure = ""; // what is certified and what is not, where some is not
    this.late = this.old = false; // old: the recommended gains are of other values
    /** @type {boolean | null} */ this.met = null; // of the gains now everything is, by the full verdict; null: it is not there yet
    /** @type {Record<string, string>} */ this.of = {}; // whose map each part is
    this.star = ""; // what is certified of the recommended ones
    this.blue = "every requirement met at the nominal values";
    /** @type {any} */ this.data = { stable: [], required: [], edge: [], lines: [], heights: [] };
    /** @type {Record<string, number[] | null>} */ this.points = { dot: null, ghost: null, star: null, rule: null };
    /** @type {number | null} */ this.cursor = null;
    this.root = svg("svg", { viewBox: "0 0 600 440", role: "application", "aria-label": "Gain map" }, place);
    this.legend = made("p", { className: "legend" });
    place.append(this.legend);
    this.layers = Object.fromEntries(["ground", "areas", "axes", "labels", "marks"].map((name) => [name, svg("g", { "data-layer": name }, this.root)]));
    this.dot = svg("g", { id: "dot", tabindex: 0, role: "slider", "aria-label": "Gains", visibility: "hidden" }, this.root);
    svg("circle", { r: 22, fill: "transparent" }, this.dot);
    svg("circle", { r: 8, fill: "#000", stroke: "#fff", "stroke-width": 2 }, this.dot);
    this.above = svg("g", { "pointer-events": "none" }, this.root);
    this.root.addEventListener("pointerdown", (event) => this.down(event));
    this.root.addEventListener("pointermove", (event) => this.drag(event));
    this.root.addEventListener("pointerup", (event) => this.up(event));
    this.root.addEventListener("pointercancel", (event) => this.up(event));
    this.dot.addEventListener("keydown", (event) => this.key(/** @type {KeyboardEvent} */ (event)));
    this.dragging = false;
    new ResizeObserver(() => this.resize()).observe(place);
    this.resize();
  }

  resize() {
    const width = Math.max(280, this.place.clientWidth);
    if (width === this.width) return;
    this.width = width;
    this.height = Math.round(Math.min(440, Math.max(300, 0.72 * width)));
    this.root.setAttribute("viewBox", `0 0 ${width} ${this.height}`);
    this.draw();
  }

  /** @param {number} kp */
  x(kp) { return FRAME.left + (kp / this.window[0]) * (this.width - FRAME.left - FRAME.right); }
  /** @param {number} kd */
  y(kd) { return this.height - FRAME.bottom - (kd / this.window[1]) * (this.height - FRAME.top - FRAME.bottom); }

  /** @param {PointerEvent} event */
  at(event) {
    const box = this.root.getBoundingClientRect(), scale = this.width / box.width;
    const x = (event.clientX - box.left) * scale, y = (event.clientY - box.top) * scale;
    const kp = ((x - FRAME.left) / (this.width - FRAME.left - FRAME.right)) * this.window[0];
    const kd = ((this.height - FRAME.bottom - y) / (this.height - FRAME.top - FRAME.bottom)) * this.window[1];
    const clamp = (/** @type {number} */ value, /** @type {number} */ top) => Number(Math.min(Math.max(value, 1e-3 * top), top).toPrecision(4));
    return [clamp(kp, this.window[0]), clamp(kd, this.window[1])];
  }

  /** @param {PointerEvent} event */
  down(event) {
    if (event.button !== 0 || !this.points.dot) return;
    if (event.pointerType === "touch" && !this.dot.contains(/** @type {Node} */ (event.target))) return; // a finger there scrolls the page
    this.dragging = true;
    this.root.setPointerCapture(event.pointerId);
    this.dot.focus({ preventScroll: true });
    this.gesture(true);
    this.put(this.at(event), false);
    event.preventDefault();
  }

  /** @param {PointerEvent} event */
  drag(event) { if (this.dragging) this.put(this.at(event), false); }

  /** @param {PointerEvent} event */
  up(event) {
    if (!this.dragging) return;
    this.dragging = false;
    this.put(event.type === "pointerup" ? this.at(event) : /** @type {number[]} */ (this.points.dot), true);
    this.gesture(false);
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const steps = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!steps || !this.points.dot) return;
    event.preventDefault();
    const size = event.shiftKey ? 0.05 : 0.005;
    if (!event.repeat) this.gesture(true);
    const to = this.points.dot.map((value, k) => Number(Math.max(value + steps[k] * size * this.window[k], 1e-3 * this.window[k]).toPrecision(4)));
    this.put(to, true);
  }

  /** @param {number[]} point @param {boolean} final */
  put(point, final) {
    this.points.dot = point;
    this.drawDot();
    this.moved(point, final);
  }

  /** @param {any} part */
  take(part) {
    for (const name of ["stable", "required", "edge", "lines", "heights", "every", "safe", "whole", "missing", "next", "unread"]) if (part[name] !== undefined) { this.data[name] = part[name]; this.of[name] = part.plant; }
    if (part.window) this.window = part.window;
    if (part.stable && this.data.channel !== part.channel) Object.assign(this.data, { every: part.follows ? [] : null, safe: [], whole: null, channel: part.channel });
    this.late = Boolean(part.stable && part.follows); // what holds in every state comes after what holds in this one
    this.draw();
  }

  /** @param {any} line @param {boolean} [closed] */
  path(line, closed) {
    let text = "", pen = false;
    const limit = 50 * this.window[1];
    for (let k = 0; k < line[0].length; k++) {
      if (line[0][k] === null || line[1][k] === null) { pen = false; continue; }
      text += `${pen ? "L" : "M"}${this.x(line[0][k]).toFixed(1)} ${this.y(Math.min(line[1][k], limit)).toFixed(1)}`;
      pen = true;
    }
    return text + (closed && text ? "Z" : "");
  }

  draw() {
    const { width, height } = this;
    for (const layer of Object.values(this.layers)) layer.replaceChildren();
    const { ground, areas, axes, labels } = this.layers, fresh = (/** @type {string} */ name) => this.of[name] === this.of.stable;
    const inner = { x: FRAME.left, y: FRAME.top, width: width - FRAME.left - FRAME.right, height: height - FRAME.top - FRAME.bottom };
    const clip = svg("clipPath", { id: "frame" }, ground);
    svg("rect", inner, clip);
    const hatch = svg("pattern", { id: "hatch", width: 9, height: 9, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" }, ground);
    svg("rect", { width: 9, height: 9, fill: "#ececec" }, hatch);
    svg("line", { x1: 0, y1: 0, x2: 0, y2: 9, stroke: "#c8c8c8", "stroke-width": 2 }, hatch);
    svg("rect", { ...inner, fill: "url(#hatch)" }, ground);
    areas.setAttribute("clip-path", "url(#frame)");
    for (const outline of this.data.stable) svg("path", { d: this.path(outline, true), fill: "#fffdf3", stroke: "#1a1a1a", "stroke-width": 2, "data-area": "stable" }, areas);
    for (const outline of this.data.required) svg("path", { d: this.path(outline, true), fill: "#56b4e9", "fill-opacity": fresh("required") ? 0.4 : 0.15, "data-area": "required" }, areas);
    for (const outline of this.data.safe || []) svg("path", { d: this.path(outline, true), fill: "#009e73", "fill-opacity": this.late ? 0.15 : 0.45, "data-area": "safe" }, areas);
    for (const outline of this.data.whole || []) svg("path", { d: this.path(outline, true), fill: "#006b4e", "fill-opacity": this.late ? 0.15 : 0.6, "data-area": "whole" }, areas);
    for (const outline of this.data.every || []) svg("path", { d: this.path(outline, true), fill: "none", stroke: "#1a1a1a", "stroke-width": 1.6, "stroke-dasharray": "7 5", "stroke-opacity": this.late ? 0.3 : 1, "data-area": "every" }, areas);
    for (const { text, line } of this.data.heights) svg("title", {}, svg("path", { d: this.path(line), fill: "none", stroke: "#8a8a8a", "stroke-width": 1.2, "stroke-opacity": fresh("heights") ? 1 : 0.2, "data-area": "height" }, areas)).textContent = `dynamic stiffness of the link ${text}`;
    const colors = ["#009e73", "#0072b2", "#cc79a7", "#d55e00"], dashes = ["none", "7 4", "2 4", "7 3 2 3"];
    this.data.lines.forEach((/** @type {any} */ line, /** @type {number} */ k) => {
      for (const part of line.parts) svg("path", { d: this.path(part), fill: "none", stroke: colors[k % 4], "stroke-width": 2, "stroke-dasharray": dashes[k % 4], "stroke-opacity": fresh("lines") ? 1 : 0.2, "data-area": "line" }, areas);
    });
    for (const value of ticks(0, this.window[0], Math.max(4, Math.floor(inner.width / 90)))) {
      svg("line", { x1: this.x(value), x2: this.x(value), y1: height - FRAME.bottom, y2: height - FRAME.bottom + 5, stroke: "#666" }, axes);
      svg("text", { x: this.x(value), y: height - FRAME.bottom + 18, "text-anchor": "middle" }, axes).textContent = number(value);
    }
    for (const value of ticks(0, this.window[1], 6)) {
      svg("line", { x1: FRAME.left - 5, x2: FRAME.left, y1: this.y(value), y2: this.y(value), stroke: "#666" }, axes);
      svg("text", { x: FRAME.left - 8, y: this.y(value) + 4, "text-anchor": "end" }, axes).textContent = number(value);
    }
    svg("rect", { ...inner, fill: "none", stroke: "#666" }, axes);
    svg("text", { x: FRAME.left + inner.width / 2, y: height - 6, "text-anchor": "middle" }, axes).textContent = `${this.names[0]} [${this.units[0]}]`;
    svg("text", { transform: `translate(13 ${FRAME.top + inner.height / 2}) rotate(-90)`, "text-anchor": "middle" }, axes).textContent = `${this.names[1]} [${this.units[1]}]`;
    const corner = new DOMPoint(width - FRAME.right - 34, FRAME.top + 14), stable = /** @type {NodeListOf<SVGGeometryElement>} */ (areas.querySelectorAll("[data-area=stable]"));
    if (![...stable].some((path) => path.isPointInFill(corner))) svg("text", { x: width - FRAME.right - 8, y: FRAME.top + 18, "text-anchor": "end", class: "soft" }, labels).textContent = "unstable";
    const inside = this.data.lines.map((/** @type {any} */ line, /** @type {number} */ k) => ({ text: line.text, color: colors[k % 4], dash: ["——", "– –", "···", "–·–"][k % 4] }));
    this.legend.replaceChildren(this.sure, `Hatched: unstable${this.of.stable && !this.data.stable.length ? this.nowhere : ""}. `, this.data.required.length ? `Blue: ${this.blue}. ` : "", this.everywhere(), this.leftOut(), this.data.heights.length ? `Grey lines: dynamic stiffness of the link, ${this.data.heights.map((/** @type {any} */ one) => one.text).join(", ")}. ` : "", "● now, ○ file", this.points.star ? `, ★ recommended${this.star && ` (${this.star})`}` : "", this.shows(this.points.rule) ? `, × rule of thumb (10 Hz)${this.meet(this.points.ghost, this.points.rule) ? ", here the file's gains" : ""}. ` : ". ");
    for (const one of inside) {
      const mark = made("span", {}, ` ${one.dash} ${one.text} `);
      Object.assign(mark.style, { color: one.color, opacity: fresh("lines") ? 1 : 0.4 });
      this.legend.append(mark);
    }
    this.drawMarks();
    this.drawDot();
  }

  /** What is said of all states of a robot. */
  everywhere() {
    const { every, safe, whole, missing, next } = this.data;
    if (missing) return `All states: ${missing}. `;
    if (!every) return "";
    if (this.late) return "Pale and dashed: all states, as they were; they follow. ";
    const none = every.length ? "Dashed: stable in every state. " : "Nowhere here is it stable in every state. ";
    const fine = this.met ? "The gains now meet every requirement in every state, as the verdict says" : "";
    const others = next ? `Being computed: where ${next === "safe" ? "the required margins are kept" : "every requirement is met"} in every state … ` : !whole ? "" : whole.length ? `Dark green: every requirement in every state, of every loop and of all together (nominal values). ${fine && `${fine}. `}` : fine ? `${fine}; around them the map finds no room. ` : this.met === null ? "" : "No gains of this loop alone meet every requirement in every state. ";
    return none + (safe && safe.length ? `Green: ${this.green}. ` : "") + others;
  }

  /** Requirements that no area shows. */
  leftOut() { return this.data.unread?.length ? `Required, and not in this map: ${this.data.unread.join(", ")}. ` : ""; }

  /** @param {number[] | null} point @returns {point is number[]} */
  shows(point) { return Boolean(point && point.every((each, k) => each <= this.window[k])); }

  /** Whether two marks are drawn over each other. @param {number[] | null} one @param {number[] | null} other */
  meet(one, other) { return Boolean(one && other && Math.hypot(this.x(one[0]) - this.x(other[0]), this.y(one[1]) - this.y(other[1])) < 8); }

  drawMarks() {
    const marks = this.layers.marks;
    marks.replaceChildren();
    this.above.replaceChildren();
    const { ghost, star, rule } = this.points;
    if (ghost) svg("circle", { cx: this.x(ghost[0]), cy: this.y(ghost[1]), r: 8, fill: "none", stroke: "#666", "stroke-width": 2, "data-mark": "ghost" }, marks);
    if (this.shows(star)) svg("text", { x: this.x(star[0]), y: this.y(star[1]) + 8, "text-anchor": "middle", class: "star", opacity: this.old ? 0.25 : 1, "data-mark": "star" }, this.above).textContent = "★";
    if (this.shows(rule)) svg("text", { x: this.x(rule[0]), y: this.y(rule[1]) + 6, "text-anchor": "middle", "data-mark": "rule" }, marks).textContent = "✕";
    if (this.cursor !== null) this.drawCursor();
  }

  drawCursor() {
    const hz = /** @type {number} */ (this.cursor);
    let best = null, least = 0.03;
    for (const piece of this.data.edge) {
      for (let k = 0; k < piece.hz.length; k++) {
        const gap = piece.hz[k] ? Math.abs(Math.log(piece.hz[k] / hz)) : 9;
        if (gap < least && piece.line[0][k] <= this.window[0] && piece.line[1][k] <= this.window[1]) { least = gap; best = [piece.line[0][k], piece.line[1][k], piece.hz[k]]; }
      }
    }
    if (!best) return;
    svg("circle", { cx: this.x(best[0]), cy: this.y(best[1]), r: 6, fill: "#e69f00", stroke: "#000", "data-mark": "cursor" }, this.layers.marks);
    svg("text", { x: this.x(best[0]) - 9, y: this.y(best[1]) + (this.y(best[1]) > this.height - FRAME.bottom - 24 ? -10 : 18), "text-anchor": "end" }, this.layers.marks).textContent = `vibrates at ${number(best[2], 3)} Hz here`;
  }

  /** @param {number | null} hz */
  setCursor(hz) { this.cursor = hz; this.drawMarks(); }

  drawDot() {
    const point = this.points.dot;
    this.dot.setAttribute("visibility", point ? "visible" : "hidden");
    if (!point) return;
    const inside = [Math.min(point[0], this.window[0]), Math.min(point[1], this.window[1])];
    this.dot.setAttribute("transform", `translate(${this.x(inside[0]).toFixed(2)} ${this.y(inside[1]).toFixed(2)})`);
    this.dot.setAttribute("aria-valuetext", `${this.names[0]} ${number(point[0])}, ${this.names[1]} ${number(point[1])}`);
    this.dot.setAttribute("aria-valuenow", String(point[0]));
  }
}
