// What is analysed: the gains as numbers, and sliders for what is not a gain.
// @ts-check
import { number } from "./gainmap.js";
import { toast } from "./away.js";
import { by, made } from "./elements.js";

/** @param {string} text @param {string} id @param {string[]} values @param {(value: string) => void} chosen */
export function choice(text, id, values, chosen) {
  const select = made("select", { id, onchange: () => chosen(select.value) }, ...values.map((value) => new Option(value, value)));
  return { label: made("label", {}, text, made("output"), select), select };
}

export class Controls {
  /** @param {any} page @param {{ gesture: (start: boolean) => void, look: (final: boolean) => void, show: () => void }} does */
  constructor(page, does) {
    this.page = page;
    this.does = does;
    this.place = by("controls");
    /** @type {(() => void)[]} */ this.shown = [];
    /** @type {(() => void)[]} */ this.ofGains = [];
    this.fields = made("span", { id: "gains" });
    this.place.append(this.fields);
    const { opening } = page, robot = opening.kind === "robot";
    this.slider("delay_ms", "delay", "ms", 0, Math.max(10, 2.5 * opening.view.delay_ms));
    this.slider("stiffness", "stiffness", robot ? "×" : "N·m/rad", 0.1, 10);
    this.slider("link_inertia", "load", "kg·m²", 0.05, 20);
    if (robot) this.slider("payload", "payload", "kg", 0, opening.payload_most);
    if (robot) this.choice("payload_at", "payload at", opening.carriers);
    if (opening.sampled) this.slider("sample_rate_hz", "sample rate", "Hz", 0.1, 10, opening.continuous);
  }

  /** The gains that are dragged: a joint's own, or those of the robot's chosen joint or direction. @returns {Record<string, number>} */
  get gains() { return this.page.opening.kind === "robot" ? this.page.view.gains[this.page.view.joint] : this.page.view.gains; }

  show() {
    this.inputs();
    for (const each of [...this.shown, ...this.ofGains]) each();
  }

  /** An input for each gain; those of one joint or direction may be others than those of the next. */
  inputs() {
    const { opening, view } = this.page, own = opening.kind === "robot" ? opening.gains[view.joint] : opening.gains, key = JSON.stringify(own);
    if (this.fields.dataset.of === key) return;
    this.fields.dataset.of = key;
    this.fields.replaceChildren();
    this.ofGains = own.map((/** @type {any} */ gain) => {
      const input = made("input");
      this.fields.append(made("label", {}, `${gain.name} [${gain.unit || "–"}]`, input));
      return this.typed(input, `gain-${gain.name}`, gain.name, true, () => this.gains[gain.name], (value) => { delete this.page.view.point; this.gains[gain.name] = value; });
    });
  }

  /** A number that is typed; what is none, or too small, is put back. @param {HTMLInputElement} input @param {string} id @param {string} title @param {boolean} zero @param {() => number} now @param {(value: number) => void} put */
  typed(input, id, title, zero, now, put) {
    Object.assign(input, { type: "number", min: "0", step: "any", id });
    const show = () => { input.value = Number.isFinite(now()) ? String(Number(now().toPrecision(7))) : ""; };
    input.addEventListener("change", () => {
      const value = input.value === "" ? NaN : Number(input.value);
      if (!(zero ? value >= 0 : value > 0)) { toast(`${title}: a number ${zero ? "from" : "above"} 0`); show(); return; }
      this.does.gesture(true);
      put(value);
      this.does.show();
      this.does.look(true);
    });
    return () => { if (document.activeElement !== input) show(); };
  }

  /** Even steps from 0, factors from elsewhere; `endless`: the last step, and 0 typed, are no rate at all. @param {string} name @param {string} title @param {string} unit @param {number} low @param {number} high @param {boolean} endless */
  slider(name, title, unit, low, high, endless = false) {
    const { page, does } = this, rate = name === "sample_rate_hz", own = page.opening.view[name] === 0 && rate ? 1000 : page.opening.view[name];
    if (own === null) return;
    const input = made("input"), even = low === 0;
    Object.assign(input, { type: "range", min: even ? low : Math.log10(low * own), max: even ? high : Math.log10(high * own), step: even ? high / 1000 : 0.005, id: name });
    const typed = made("input"), range = made("small"), [least, most] = [Number(input.min), Number(input.max)];
    input.setAttribute("aria-label", title);
    this.place.append(made("label", {}, `${title} [${unit}]`, typed, input, range));
    this.shown.push(() => { const span = page.ranges[name]; range.textContent = span ? `range ${number(span[0])} … ${number(span[1])} ${unit}` : ""; });
    if (endless) typed.placeholder = "∞";
    this.shown.push(this.typed(typed, `${name}-typed`, endless ? `${title}, 0: continuous time` : title, even || endless, () => page.view[name] || (endless ? NaN : 0), (value) => { page.view[name] = value; }));
    const value = () => endless && input.value === input.max ? 0 : Number((even ? Number(input.value) : 10 ** Number(input.value)).toPrecision(rate ? 2 : 4));
    input.addEventListener("input", () => { if (!page.dragging) does.gesture(true); page.view[name] = value(); does.show(); does.look(false); });
    input.addEventListener("change", () => { does.gesture(false); page.view[name] = value(); does.look(true); });
    this.shown.push(() => {
      const at = page.view[name], place = endless && !at ? most : even ? at : Math.log10(at);
      if (!page.dragging) Object.assign(input, { min: Math.min(least, place), max: Math.max(most, place) }); // what is typed may lie further out
      input.value = String(place);
      input.setAttribute("aria-valuetext", endless && !at ? "continuous time" : `${number(at)} ${unit}`);
    });
  }

  /** @param {string} name @param {string} title @param {string[]} options */
  choice(name, title, options) {
    const { page, does } = this, { label, select } = choice(title, name, options, (value) => { does.gesture(true); page.view[name] = value; does.look(true); });
    if (options.length) this.place.append(label);
    this.shown.push(() => { select.value = String(page.view[name]); });
  }
}
