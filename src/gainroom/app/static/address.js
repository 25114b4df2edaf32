// The view in the address: what differs from the file.
// @ts-check

/** @param {any} opening @returns {any} */
export function fromAddress(opening) {
  const view = structuredClone(opening.view), robot = opening.kind === "robot", words = new URLSearchParams(location.hash.slice(1)), structure = words.get("structure");
  const other = !robot && structure && opening.structures[structure];
  if (other && !other.refused) Object.assign(view, { structure, gains: Object.fromEntries(other.gains.map((/** @type {any} */ gain) => [gain.name, gain.value])) });
  for (const [name, text] of words) {
    const value = Number(text), known = text !== "" && Number.isFinite(value);
    if (robot && name.startsWith("gain.")) {
      const joint = name.slice(5), own = view.gains[joint] || {};
      for (const [k, part] of text.split(",").entries()) {
        const [each, gain] = part.split(":").reverse(), key = gain || ["kp", "kd"][k];
        if (key in own && Number(each) >= 0) own[key] = Number(each);
      }
    } else if (robot && name.startsWith("at.")) {
      if (opening.joints.some((/** @type {any} */ joint) => joint.name === name.slice(3)) && known) view.angles[name.slice(3)] = value;
    } else if (["posture", "contact", "joint", "payload_at"].includes(name)) {
      const list = { posture: opening.postures, contact: opening.contacts, joint: opening.channels, payload_at: opening.carriers }[/** @type {"joint"} */ (name)];
      if (robot && list.includes(text)) view[name] = text;
    } else if (!robot && name in view.gains) {
      const { least } = opening.structures[view.structure || ""].gains.find((/** @type {any} */ gain) => gain.name === name);
      if (known && (least === null || value >= least)) view.gains[name] = value;
    } else if (typeof view[name] === "number" && known) view[name] = value;
  }
  return view;
}

/** @param {any} opening @param {any} view */
export function toAddress(opening, view) {
  const words = new URLSearchParams(), { gains, angles, ...others } = view;
  for (const [name, value] of Object.entries(gains)) {
    const own = opening.view.gains[name];
    if (typeof value !== "object") words.set(name, String(value));
    else if (JSON.stringify(value) !== JSON.stringify(own)) words.set(`gain.${name}`, Object.entries(/** @type {any} */ (value)).map((pair) => pair.join(":")).join());
  }
  for (const [name, value] of Object.entries(angles || {})) words.set(`at.${name}`, String(value));
  for (const [name, value] of Object.entries(others)) if (value !== null && typeof value !== "object") words.set(name, String(value));
  history.replaceState(null, "", `${location.pathname}${location.search}#${words}`);
}
