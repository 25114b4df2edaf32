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
    const { opening } = page, robot = opening.kind === "robot";
    if (!robot) this.structure(opening.structures);
    this.place.append(this.fields);
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

  /** Another controller in the place of the file's, with the same numbers where it has them. @param {Record<string, any>} all */
  structure(all) {
    const { page, does } = this, select = made("select", { id: "structure" }, ...Object.entries(all).map(([key, each]) => new Option(each.title, key)));
    select.onchange = () => {
      const to = all[select.value];
      if (to.refused) { toast(to.refused); does.show(); return; }
      does.gesture(true);
      delete page.view.point;
      Object.assign(page.view, { structure: select.value || null, gains: Object.fromEntries(to.gains.map((/** @type {any} */ gain) => [gain.name, page.view.gains[gain.name] ?? gain.value])) });
      does.show();
      does.look(true);
    };
    this.place.append(made("label", {}, "structure", made("output"), select));
    this.shown.push(() => { select.value = page.view.structure || ""; });
  }

  /** An input for each gain; those of one joint or direction may be others than those of the next. */
  inputs() {
    const { opening, view } = this.page, own = opening.kind === "robot" ? opening.gains[view.joint] : opening.structures[view.structure || ""].gains, key = JSON.stringify(own);
    if (this.fields.dataset.of === key) return;
    this.fields.dataset.of = key;
    this.fields.replaceChildren();
    this.ofGains = own.map((/** @type {any} */ gain) => {
      const input = made("input"), now = () => this.gains[gain.name], put = (/** @type {number} */ value) => { delete this.page.view.point; this.gains[gain.name] = value; };
      const title = gain.title || gain.name, label = made("label", {}, `${title} [${gain.unit || "–"}]`, input);
      this.fields.append(label);
      const shown = [this.typed(input, `gain-${gain.name}`, title, gain.least === undefined ? 0 : gain.least, now, put)];
      if (gain.ends) {
        const { slide, show } = this.slide(`slide-${gain.name}`, title, gain.unit, gain.ends, now, put);
        label.append(slide);
        shown.push(show);
      }
      return () => { for (const each of shown) each(); };
    });
  }

  /** A number that is typed; what is none, or too small, is put back. @param {HTMLInputElement} input @param {string} id @param {string} title @param {number | null} least null: any @param {() => number} now @param {(value: number) => void} put @param {boolean} [above] not `least` itself */
  typed(input, id, title, least, now, put, above = false) {
    Object.assign(input, { type: "number", min: least === null ? "" : String(least), step: "any", id });
    const show = () => { input.value = Number.isFinite(now()) ? String(Number(now().toPrecision(7))) : ""; };
    input.addEventListener("change", () => {
      const value = input.value === "" ? NaN : Number(input.value);
      if (Number.isNaN(value) || (least !== null && (above ? value <= least : value < least))) { toast(`${title}: a number${least === null ? "" : ` ${above ? "above" : "from"} ${least}`}`); show(); return; }
      this.does.gesture(true);
      put(value);
      this.does.show();
      this.does.look(true);
    });
    return () => { if (document.activeElement !== input) show(); };
  }

  /** A slider: even steps from 0 or below, else factors; `endless`: its last step stands for 0. @param {string} id @param {string} title @param {string} unit @param {number[]} ends @param {() => number} now @param {(value: number) => void} put @param {{ endless?: boolean, digits?: number }} [more] */
  slide(id, title, unit, ends, now, put, { endless = false, digits = 4 } = {}) {
    const { page, does } = this, slide = made("input"), even = ends[0] <= 0;
    Object.assign(slide, { type: "range", min: even ? ends[0] : Math.log10(ends[0]), max: even ? ends[1] : Math.log10(ends[1]), step: even ? (ends[1] - ends[0]) / 1000 : 0.005, id });
    slide.setAttribute("aria-label", title);
    const [least, most] = [Number(slide.min), Number(slide.max)];
    const value = () => endless && slide.value === slide.max ? 0 : Number((even ? Number(slide.value) : 10 ** Number(slide.value)).toPrecision(digits));
    slide.addEventListener("input", () => { if (!page.dragging) does.gesture(true); put(value()); does.show(); does.look(false); });
    slide.addEventListener("change", () => { does.gesture(false); put(value()); does.look(true); });
    const show = () => {
      const at = now(), place = endless && !at ? most : even ? at : at > 0 ? Math.log10(at) : least;
      if (!page.dragging) Object.assign(slide, { min: Math.min(least, place), max: Math.max(most, place) }); // what is typed may lie further out
      slide.value = String(place);
      slide.setAttribute("aria-valuetext", endless && !at ? "continuous time" : `${number(at)} ${unit}`);
    };
    return { slide, show };
  }

  /** A slider from `low` to `high`, beside a field where it is typed; `endless`: the last step, and 0 typed, are no rate at all. @param {string} name @param {string} title @param {string} unit @param {number} low @param {number} high @param {boolean} endless */
  slider(name, title, unit, low, high, endless = false) {
    const { page } = this, rate = name === "sample_rate_hz", own = page.opening.view[name] === 0 && rate ? 1000 : page.opening.view[name];
    if (own === null) return;
    const now = () => page.view[name], put = (/** @type {number} */ value) => { page.view[name] = value; };
    const typed = made("input"), range = made("small"), { slide, show } = this.slide(name, title, unit, low === 0 ? [0, high] : [low * own, high * own], now, put, { endless, digits: rate ? 2 : 4 });
    this.place.append(made("label", {}, `${title} [${unit}]`, typed, slide, range));
    this.shown.push(() => { const span = page.ranges[name]; range.textContent = span ? `range ${number(span[0])} … ${number(span[1])} ${unit}` : ""; });
    if (endless) typed.placeholder = "∞";
    this.shown.push(this.typed(typed, `${name}-typed`, endless ? `${title}, 0: continuous time` : title, 0, () => now() || (endless ? NaN : 0), put, !(low === 0 || endless)));
    this.shown.push(show);
  }

  /** @param {string} name @param {string} title @param {string[]} options */
  choice(name, title, options) {
    const { page, does } = this, { label, select } = choice(title, name, options, (value) => { does.gesture(true); page.view[name] = value; does.look(true); });
    if (options.length) this.place.append(label);
    this.shown.push(() => { select.value = String(page.view[name]); });
  }
}
