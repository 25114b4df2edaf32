// Taking gains away: copied, saved behind a difference, or the whole view as a page.
// @ts-check

import { by, made } from "./elements.js";

/** @param {any} opening @param {(message: any) => void} send */
export function forms(opening, send) {
  const place = by("forms"), button = by("copy");
  const toggle = (/** @type {boolean} */ on) => { place.hidden = !on; button.setAttribute("aria-expanded", String(on)); if (on) place.querySelector("button").focus(); };
  for (const [form, title] of Object.entries(opening.forms)) {
    const each = made("button", { textContent: title, onclick: () => { toggle(false); send({ ask: "copy", form }); } });
    each.dataset.form = form;
    place.append(each);
  }
  button.onclick = () => toggle(place.hidden);
  document.addEventListener("keydown", (event) => { if (event.key === "Escape" && !place.hidden) { toggle(false); button.focus(); } });
  for (const kind of ["pointerdown", "focusin"]) document.addEventListener(kind, (event) => { if (!(/** @type {Element} */ (event.target).closest(".menu"))) toggle(false); });
}

/** @param {any} part */
export async function copied(part) {
  try {
    await navigator.clipboard.writeText(part.text);
    toast(`Copied as ${part.form}${part.form === "yaml" ? ": in the place of the gains of your file" : ""}`);
  } catch {
    dialog(`Gains as ${part.form}`, part.text, "Select and copy: this browser does not let a page do it.");
  }
}

/** @param {any} part @param {string} name @param {(message: any) => void} send */
export function difference(part, name, send) {
  if (part.part === "saved") { by("dialog").close(); return toast("Saved"); }
  if (!part.text) return toast("Nothing to save: these are the file's values");
  dialog(`Save to ${name}?`, part.text, "", "Save", () => send({ ask: "save", digest: part.digest }));
  return undefined;
}

/** @param {string} title @param {string} text @param {string} said @param {string} [action] @param {() => void} [act] */
export function dialog(title, text, said, action, act) {
  const box = by("dialog");
  box.querySelector("h2").textContent = title;
  box.querySelector("pre").textContent = text;
  box.querySelector(".say").textContent = said;
  Object.assign(by("confirm"), { hidden: !act, textContent: action || "", onclick: act || null });
  if (!box.open) box.showModal();
}

/** @param {string} text */
export function download(text) {
  const link = made("a", { href: URL.createObjectURL(new Blob([text], { type: "text/html" })), download: "gainroom.html" });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  toast("The page is written where downloads go");
}

let fading = 0;
/** @param {string} text */
export function toast(text) {
  by("toast").textContent = text;
  by("toast").classList.add("on");
  clearTimeout(fading);
  fading = setTimeout(() => by("toast").classList.remove("on"), 4000);
}
