// What is analysed: the gains as numbers, and sliders for what is not a gain.
// @ts-check
import { number } from "./gainmap.js";

export class Controls {
  /** @param {any} page @param {{ gesture: (start: boolean) => void, look: (final: boolean) => void, show: () => void }} does */
  constructor(page, does) {
    this.page = page;
    this.does = does;
    this.place = /** @type {HTMLElement} */ (document.getElementById("controls"));
    /** @type {(() => void)[]} */ this.shown = [];
    this.fields = Object.assign(document.createElement("span"), { id: "gains" });
    this.place.append(this.fields);
    const { opening } = page, robot = opening.kind === "robot";
    this.slider("delay_ms", "delay", "ms", 0, Math.max(10, 2.5 * opening.view.delay_ms));
    this.slider("stiffness", "stiffness", robot ? "× the file's" : "N·m/rad", 0.1, 10);
    this.slider("link_inertia", "load", "kg·m²", 0.05, 20);
    this.rate();
  }

  /** The gains that are dragged: a joint's own, or those of the robot's chosen joint or direction. @returns {Record<string, number>} */
  get gains() { return this.page.opening.kind === "robot" ? this.page.view.gains[this.page.view.joint] : this.page.view.gains; }

  show() {
    this.inputs();
    for (const each of this.shown) each();
    for (const [name, value] of Object.entries(this.gains)) {
      const input = /** @type {HTMLInputElement | null} */ (document.getElementById(`gain-${name}`));
      if (input && document.activeElement !== input) input.value = String(Number(Number(value).toPrecision(7)));
    }
  }

  /** An input for each gain; those of one joint or direction may be others than those of the next. */
  inputs() {
    const { opening, view } = this.page, own = opening.kind === "robot" ? opening.gains[view.joint] : opening.gains, key = JSON.stringify(own);
    if (this.fields.dataset.of === key) return;
    this.fields.dataset.of = key;
    this.fields.replaceChildren(...own.map((/** @type {any} */ gain) => {
      const label = document.createElement("label"), input = document.createElement("input");
      Object.assign(input, { type: "number", min: "0", step: "any", id: `gain-${gain.name}` });
      label.append(`${gain.name} [${gain.unit || "–"}]`, input);
      input.addEventListener("change", () => {
        if (!(Number(input.value) >= 0) || input.value === "") return this.does.show();
        this.does.gesture(true);
        delete this.page.view.point;
        this.gains[gain.name] = Number(input.value);
        return this.does.look(true);
      });
      return label;
    }));
  }

  /** @param {string} title @param {HTMLElement} input */
  add(title, input) {
    const label = document.createElement("label"), output = document.createElement("output");
    label.append(title, output, input);
    this.place.append(label);
    return output;
  }

  /** Even steps for the delay, factors for the others. @param {string} name @param {string} title @param {string} unit @param {number} low @param {number} high */
  slider(name, title, unit, low, high) {
    const { page, does } = this, own = page.opening.view[name];
    if (own === null) return;
    const input = document.createElement("input"), even = name === "delay_ms";
    Object.assign(input, { type: "range", min: even ? low : Math.log10(low * own), max: even ? high : Math.log10(high * own), step: even ? 0.01 : 0.005, id: name });
    const output = this.add(title, input);
    const value = () => (even ? Number(input.value) : Number((10 ** Number(input.value)).toPrecision(4)));
    input.addEventListener("input", () => { if (!page.dragging) does.gesture(true); page.view[name] = value(); does.show(); does.look(false); });
    input.addEventListener("change", () => { does.gesture(false); page.view[name] = value(); does.look(true); });
    this.shown.push(() => {
      const at = page.view[name];
      input.value = String(even ? at : Math.log10(at));
      output.textContent = `${number(at)} ${unit}`;
      input.setAttribute("aria-valuetext", output.textContent);
    });
  }

  rate() {
    const { page, does } = this, rates = document.createElement("select");
    rates.id = "sample_rate_hz";
    for (const rate of page.opening.rates) rates.add(new Option(rate ? `${number(rate)} Hz` : "continuous", String(rate)));
    this.add("sample rate", rates);
    rates.addEventListener("change", () => { does.gesture(true); page.view.sample_rate_hz = Number(rates.value); does.look(true); });
    this.shown.push(() => { rates.value = String(page.view.sample_rate_hz); });
  }
}
