// A robot's states: joint × state heat map, posture and contact, joint, and where its joints stand.
// @ts-check
import { number } from "./gainmap.js";
import { choice } from "./controls.js";
import { by, made } from "./elements.js";

/** Vermilion to blue around white, as in the report. @param {number | null} factor */
function shade(factor) {
  if (factor === null) return "#eee";
  const height = Math.max(-1, Math.min(1, Math.log10(factor)));
  const from = [255, 255, 255], to = height < 0 ? [224, 122, 47] : [98, 169, 216];
  return `rgb(${from.map((each, k) => Math.round(each + (to[k] - each) * Math.abs(height))).join(",")})`;
}

/** @param {Record<string, number>} one @param {Record<string, number>} other */
const same = (one, other) => Object.keys(one).length === Object.keys(other).length && Object.keys(one).every((name) => one[name] === other[name]);

export class States {
  /** @param {any} page @param {(start: boolean) => void} gesture @param {(final: boolean) => void} look */
  constructor(page, gesture, look) {
    this.page = page;
    this.gesture = gesture;
    this.look = look;
    const { opening } = page, place = by("controls");
    this.selects = /** @type {[string, any][]} */ ([]);
    for (const [text, name, values] of /** @type {[string, string, string[]][]} */ ([[opening.space === "task" ? "direction" : "joint", "joint", opening.channels], ["contact", "contact", opening.contacts], ["posture", "posture", opening.postures]])) {
      const { label, select } = choice(text, name, values, (value) => this.choose({ [name]: value }));
      this.selects.push([name, select]);
      if (name === "posture") this.presets(select, opening.keyframes);
      place.prepend(label);
    }
    this.heat = by("states");
    this.heat.hidden = false;
    this.table = made("div", { id: "heat" });
    this.sliders = this.stand(opening);
    this.heat.append(this.table);
    by("side").append(this.sliders); // below the robot that they move
    /** @type {any} */ this.part = null;
    this.shown = "";
    this.show();
  }

  /** The model's own keyframes stand below the postures: angles in place of the chosen one's. @param {any} select @param {any} frames */
  presets(select, frames) {
    const group = made("optgroup", { label: "keyframes of the model" });
    for (const [name, angles] of Object.entries(frames)) group.append(Object.assign(new Option(name, `keyframe ${name}`), { angles }));
    if (group.children.length) select.append(group);
    select.onchange = () => {
      const { angles } = select.selectedOptions[0];
      this.choose(angles ? { angles: { ...angles } } : { posture: select.value });
    };
  }

  /** @param {any} values */
  choose(values) {
    this.gesture(true);
    Object.assign(this.page.view, values);
    if ("posture" in values && !values.angles) this.page.view.angles = {};
    delete this.page.view.point;
    this.look(true);
    this.show();
  }

  /** A state, as it is posed now, and a joint. @param {{ posture: string, contact: string, joint?: string }} place */
  visit(place) {
    const { view } = this.page;
    this.choose({ ...place, angles: place.posture === view.posture ? view.angles : {} });
  }

  /** A slider for each joint. @param {any} opening */
  stand(opening) {
    const grid = made("div", { className: "grid" });
    /** @type {[any, HTMLInputElement, HTMLOutputElement][]} */ this.angles = [];
    for (const joint of opening.joints) {
      const output = made("output"), input = made("input", { type: "range", min: joint.low, max: joint.high, step: 0.01, id: `angle-${joint.name}` });
      grid.append(made("label", {}, joint.name, output, input));
      this.angles.push([joint, input, output]);
      const put = (/** @type {boolean} */ final) => { this.page.view.angles = { ...this.page.view.angles, [joint.name]: Number(input.value) }; this.show(); this.look(final); };
      input.addEventListener("input", () => { if (!this.page.dragging) this.gesture(true); put(false); });
      input.addEventListener("change", () => { this.gesture(false); put(true); });
    }
    return made("details", {}, made("summary", {}, "Posture: where the joints stand"), grid, made("button", { textContent: "Back to the posture", onclick: () => this.choose({ angles: {} }) }));
  }

  show() {
    const { view } = this.page, now = JSON.stringify([view.posture, view.contact, view.joint, view.angles]);
    if (now === this.shown) return; // gains are dragged, nothing here follows
    this.shown = now;
    for (const [name, select] of this.selects) {
      const frame = name === "posture" && [...select.options].find((each) => each.angles && same(each.angles, view.angles));
      select.value = frame ? frame.value : view[name];
    }
    for (const [joint, input, output] of this.angles || []) {
      const value = view.angles[joint.name] ?? joint.at[view.posture];
      input.value = String(value);
      output.textContent = joint.unit === "m" ? `${number(value, 3)} m` : `${Math.round((180 / Math.PI) * value)}°`;
      input.setAttribute("aria-valuetext", output.textContent);
    }
    for (const cell of this.table.querySelectorAll("button")) cell.setAttribute("aria-pressed", String(cell.dataset.state === JSON.stringify([view.posture, view.contact]) && cell.dataset.part === view.joint));
  }

  /** Joint × state: the factor on its gains until vibration, the other loops closed. @param {any} part */
  take(part) {
    this.part = part;
    const title = made("p", { className: "legend" }), table = made("table"), head = table.createTHead().insertRow();
    const unknown = (/** @type {boolean} */ stable) => part.closed.some((/** @type {any[]} */ state, /** @type {number} */ k) => part.stable[k] === stable && state.includes(null));
    title.textContent = `Factor on the gains until vibration: all together, then each with the others closed. ${unknown(true) ? "any: no factor makes it vibrate. " : ""}${unknown(false) ? "–: of an unstable state none is known. " : ""}Click a cell to look at it.`;
    head.append(made("th"));
    for (const state of part.states) head.append(made("th", { scope: "col" }, state.join(" / ")));
    const body = table.createTBody();
    const row = (/** @type {string} */ name, /** @type {(number | null)[]} */ values, /** @type {string | null} */ joint) => {
      const line = body.insertRow();
      line.append(made("th", { scope: "row" }, name));
      values.forEach((value, k) => {
        const cell = made("button", {}, value === null ? (part.stable[k] ? "any" : "–") : number(value, 3));
        cell.style.background = shade(value);
        cell.dataset.state = JSON.stringify(part.states[k]);
        if (joint) cell.dataset.part = joint;
        cell.setAttribute("aria-label", `${name}, ${part.states[k].join(" / ")}: ${cell.textContent}`);
        cell.onclick = () => this.visit({ posture: part.states[k][0], contact: part.states[k][1], ...(joint ? { joint } : {}) });
        line.insertCell().append(cell);
      });
    };
    row("all together", part.together, null);
    part.parts.forEach((/** @type {string} */ name, /** @type {number} */ k) => row(name, part.closed.map((/** @type {any} */ state) => state[k]), name));
    this.table.replaceChildren(title, table);
    this.shown = "";
    this.show();
  }
}
