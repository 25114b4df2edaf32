// The page: one view (what is asked for), one socket, and the pictures that follow. No number is computed here.
// @ts-check
import { GainMap } from "./gainmap.js";
import { Bode, Nyquist, Step, traces } from "./charts.js";
import { Controls, choice } from "./controls.js";
import { States } from "./states.js";
import { RobotView } from "./robot.js";
import { copied, difference, download, forms, toast } from "./away.js";
import { by, made } from "./elements.js";
import { fromAddress, toAddress } from "./address.js";

const page = {
  /** @type {any} */ opening: null,
  /** @type {any} */ view: {},
  /** @type {any[]} */ past: [],
  /** @type {any} */ found: null,
  /** @type {RobotView | null} */ body: null,
  /** @type {any} */ said: null, // the verdict that is shown
  /** @type {any} */ ranges: {},
  plant: "", // what the recommended gains of this view belong to; "": not known yet
  others: "", // of the view all that is no gain
  key: 0, share: 0,
  /** @type {any} */ waiting: null,
  busy: false, dragging: false, shaking: false, searching: false, certified: false, final: true,
  /** @type {Record<number, number>} */ asked: {},
  /** @type {number[]} */ latency: [],
  /** @type {WebSocket | null} */ socket: null,
  judged: 0, // the question whose full answer has come
};
/** @type {any} */ (window).gainroom = page;

/** @type {GainMap} */ let map;
/** @type {Bode} */ let bode;
/** @type {Nyquist} */ let nyquist;
/** @type {Step} */ let step;
/** @type {States | null} */ let states = null;
/** @type {RobotView | null} */ let body = null;
/** @type {any} */ let inputs = null;

// ---- the server ------------------------------------------------------------------------------------------------------------------------

function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws${location.search}`);
  page.socket = socket;
  socket.onmessage = (event) => take(JSON.parse(event.data));
  socket.onclose = () => {
    by("offline").hidden = false;
    by("verdict").classList.add("quick");
    by("basis").textContent = "Not current: the server does not answer.";
    page.busy = false;
    setTimeout(connect, 500);
  };
}

/** @param {any} message */
function send(message) {
  if (page.socket && page.socket.readyState === WebSocket.OPEN) page.socket.send(JSON.stringify({ view: page.view, ...message, key: page.key }));
}

/** Ask for the view's numbers; one question at a time is under way, and only the latest waits. @param {boolean} final @param {any} [more] */
function look(final, more) {
  page.key += 1;
  page.asked[page.key] = performance.now();
  page.waiting = { ask: "look", final, ...more };
  page.final = final;
  const others = JSON.stringify(page.view, (name, value) => (["gains", "point", "joint", "contact", "posture"].includes(name) ? 0 : value));
  if (others !== page.others) { Object.assign(page, { others, plant: "" }); star(); } // recommended gains are others now
  if (final) { page.dragging = false; toAddress(page.opening, page.view); if (body) body.note.classList.add("old"); }
  next();
}

function next() {
  if (page.busy || !page.waiting || !page.socket || page.socket.readyState !== WebSocket.OPEN) return;
  page.busy = true;
  send(page.waiting);
  page.waiting = null;
}

/** @param {any} part */
function take(part) {
  if (part.part === "opening") return open(part);
  if (part.part === "done" || part.part === "refused") {
    if (part.lane === "quick" || !part.lane) { page.busy = false; next(); }
    if (part.lane === "quick" && part.key === page.key && page.final) intoSight();
    if (part.lane === "full") progress(null);
  }
  if (["done", "refused", "ended"].includes(part.part)) over(part);
  if (part.part === "refused") return refused(part);
  if (part.part === "copied") return copied(part);
  if (part.part === "difference" || part.part === "saved") return difference(part, page.opening.name, send);
  if (part.part === "run") return ran(part);
  if (part.part === "film") return body && body.play(part);
  if (part.part === "page") return download(part.text);
  if (part.part === "progress") return progress(part);
  if ((part.lane === "full" || part.lane === "search") && part.key !== page.key) return undefined; // of gains that nobody looks at any more
  const put = /** @type {Record<string, (part: any) => void>} */ ({ verdict, heat: (each) => states && states.take(each), mode: (each) => body && body.take(each, each.key !== page.key), root: (each) => body && body.takeRoot(each), bode: (each) => { bode.take(each); nyquist.take(each); }, map: (each) => map.take(each), before: (each) => step.takeBefore(each), step: (each) => step.take(each), use })[part.part];
  if (put) put(part);
  return undefined;
}

/** @param {any} part */
function refused(part) {
  if (["text", "run", "page", "search"].includes(part.lane)) return toast(part.message);
  by("verdict").className = "bad";
  by("sentence").textContent = part.message;
  Object.assign(by("brief"), { textContent: "Not computed for these values", className: "bad" });
  by("basis").textContent = "Nothing was computed for these values.";
  by("rows").replaceChildren();
  return undefined;
}

/** @param {any} part */
function progress(part) {
  if (part && part.lane === "run") by("shake").textContent = `Stop (${Math.round((100 * part.done) / Math.max(1, part.total))} %)`;
  else if (part && part.lane === "search") by("snap").textContent = `Stop the search (${page.share = Math.max(page.share, Math.round((100 * part.done) / Math.max(1, part.total)))} %)`;
  else if (!page.certified && part && part.key === page.key) by("basis").textContent = `Not certified yet: ${part.what} …`;
}

// ---- opening ---------------------------------------------------------------------------------------------------------------------------

/** @param {any} opening */
function open(opening) {
  const first = !page.opening;
  Object.assign(page, { opening, busy: false });
  if (!first) for (const lane of ["run", "search"]) over({ lane }); // they ended with the server
  by("offline").hidden = true;
  document.title = `${opening.name} – gainroom`;
  if (first) {
    Object.assign(page, { view: fromAddress(opening), ranges: opening.ranges });
    map = new GainMap(/** @type {HTMLElement} */ (document.querySelector("#map .plot")), (point, final) => { page.view.point = point; look(final); }, gesture);
    map.points.ghost = opening.point || null;
    if (opening.units) map.units = opening.units;
    if (opening.uncertain.length) Object.assign(map, { blue: "every requirement met", sure: "Areas: nominal values. The worst case of the stated ranges allows less; verdict and ★ are of the worst case. " });
    bode = new Bode(/** @type {HTMLElement} */ (document.querySelector("#bode .plot")), opening.span_hz, opening.needed, cursor);
    nyquist = new Nyquist(/** @type {HTMLElement} */ (document.querySelector("#side .plot")), opening.needed);
    if (opening.kind !== "robot") step = new Step(/** @type {HTMLElement} */ (document.querySelector("#step .plot")));
    inputs = new Controls(page, { gesture, look, show });
    show();
    if (opening.kind === "robot") robot();
    if (opening.examples.length) examples(opening);
    forms(opening, send);
    by("save").hidden = !opening.saves;
    by("map").querySelector("figcaption").append(made("button", { textContent: "Fit", title: "Show these gains and the recommended ones", onclick: () => refit() }));
  }
  look(true, first ? (opening.window ? { window: opening.window } : {}) : { window: map.window });
}

/** Another of the shipped files. @param {any} opening */
function examples(opening) {
  const query = new URLSearchParams(location.search), { label, select } = choice("example", "example", opening.examples, (name) => { query.set("example", name); location.assign(`?${query}`); });
  select.value = opening.name.replace(/\.yaml$/, "");
  by("controls").prepend(label);
}

/** Gains that were typed may lie beyond the map. */
function intoSight() {
  const dot = map.points.dot;
  if (dot && map.data.stable.length && dot.some((value, k) => value > map.window[k])) refit();
}

/** @param {number} [wide] */
function refit(wide = 1.6) {
  const points = [map.points.dot, map.points.star || map.points.ghost, map.points.rule].filter((each) => each !== null).slice(0, 2);
  map.window = !points.length ? page.opening.window : [0, 1].map((k) => wide * Math.max(...points.map((/** @type {any} */ each) => each[k]), 1e-6));
  look(true, { window: map.window });
}

function robot() {
  states = new States(page, gesture, look);
  const what = page.opening.space === "task" ? "direction" : "joint";
  const [side, last] = [by("side"), by("step")], captions = [side, last].map((figure) => figure.querySelector("figcaption"));
  const more = /** @type {HTMLElement} */ (last.cloneNode(true));
  more.id = "joint-step";
  /** @type {HTMLElement} */ (more.querySelector("small")).textContent = `of the chosen ${what}, all others closed, after the dot is let go; thick: link, thin: motor; dashed: link with the file's gains`;
  last.after(more);
  step = new Step(/** @type {HTMLElement} */ (more.querySelector(".plot")));
  last.querySelector(".plot").replaceChildren(...side.querySelector(".plot").children);
  captions[1].replaceChildren(...captions[0].childNodes);
  captions[0].textContent = "Critical mode";
  document.body.classList.add("robot");
  page.body = body = new RobotView(side.querySelector(".plot"), page.opening.shapes, () => page.dragging);
  by("map").querySelector("small").textContent = `of the chosen ${what} in this state, all others closed; drag the dot`;
  map.blue = `this ${what}'s own loop keeps the required margins in this state`;
  map.sure = `Areas: sampled, not certified; what is certified of ● is said in the verdict. ${map.sure}`;
  map.nowhere = `: no gains of this ${what} alone make this state stable while all others stay`;
  by("bode").querySelector("small").textContent = `of the chosen ${what}, all others closed; sampled`;
}

function show() {
  inputs.show();
  if (page.opening.kind !== "robot") {
    const { axes, map_of, bode_of } = page.opening.structures[page.view.structure || ""];
    map.names = axes;
    for (const name of ["bode", "side"]) {
      const small = /** @type {HTMLElement} */ (by(name).querySelector("small"));
      small.dataset.own ||= small.textContent || "";
      small.textContent = bode_of || small.dataset.own;
    }
    by("map").querySelector("small").textContent = map_of ? `of ${map_of}` : "drag the dot; arrow keys move it";
  }
  if (states) states.show();
  star();
}

/** A gesture begins: what was there before can be had back. @param {boolean} start */
function gesture(start) {
  page.dragging = start; // of a slider or the dot; look(true) ends it, too
  if (!start) return;
  const now = JSON.stringify(page.view);
  if (page.past[page.past.length - 1] !== now) page.past.push(now);
  if (page.past.length > 200) page.past.shift();
  by("undo").disabled = false;
}

function undo() {
  if (!page.past.length) return;
  page.view = JSON.parse(page.past.pop());
  by("undo").disabled = !page.past.length;
  show();
  look(true);
}

function snap() {
  if (by("snap").disabled || page.searching) return;
  if (page.found && page.found.find) { Object.assign(page, { searching: true, share: 0 }); by("snap").textContent = "Stop the search"; send({ ask: "find" }); return; }
  gesture(true);
  delete page.view.point;
  page.view.gains = { ...page.view.gains, ...page.found.gains };
  const to = map.points.star;
  if (to && (to.some((value, k) => value > map.window[k]) || to.every((value, k) => value < 0.15 * map.window[k]))) {
    map.points.dot = to; // too far off, or too small to be seen
    refit(3);
  } else look(true);
}

// ---- answers ---------------------------------------------------------------------------------------------------------------------------

/** @param {any} part */
function verdict(part) {
  const current = part.key === page.key;
  if (current && part.plant) Object.assign(page, { plant: part.plant, ranges: part.ranges });
  if (part.lane === "quick" && current && part.gains) {
    page.view.gains = { ...page.view.gains, ...part.gains };
    delete page.view.point;
    if (page.final) toAddress(page.opening, page.view);
    show();
  }
  if ("point" in part && !map.dragging) map.points.dot = part.point;
  if (!map.dragging) map.drawDot();
  if (part.lane !== "quick") page.judged = part.key;
  if (part.lane !== "quick" || part.key !== page.judged) sentences(part, current); // a quick answer may come behind the full one
  const asked = page.asked[part.key];
  if (asked !== undefined && part.lane === "quick") {
    delete page.asked[part.key];
    requestAnimationFrame(() => page.latency.push(performance.now() - asked));
  }
}

/** What "certified" covers: of several loops one loop's phase and Ms are read from samples. @param {any} part */
function certified(part) {
  if (!part.states) return part.covers || "Certified for this model.";
  if (part.uncertified.length) return `Not certified in ${part.uncertified.join(", ")}: roots could not be counted on both sides there.`;
  return "Certified in every state by root counts: stability, gain, phase and delay margins. Sampled: phase of one loop, Ms.";
}

/** The verdict as text. @param {any} part @param {boolean} current */
function sentences(part, current) {
  page.certified = part.basis === "certified" && current;
  by("verdict").className = `${part.tone}${page.certified ? "" : " quick"}`;
  const [first, ...rest] = part.sentence.split(/(?<=\.) (?=[A-Z])/); // as on a report: the verdict in bold
  by("sentence").replaceChildren(first, ...(rest.length ? [" ", made("span", {}, rest.join(" "))] : []));
  const ranges = page.opening.uncertain.length > 0, met = page.certified ? part.met === true && !(part.uncertified || []).length : null, once = cards(part);
  if (met !== map.met) { map.met = met; map.draw(); }
  by("basis").textContent = {
    certified: certified(part) + (page.view.sample_rate_hz === 0 && page.opening.asks_rate ? " Continuous time: choose your loop's sample rate." : "") + (ranges ? ` Worst of the stated ranges${once ? `: ${once}` : ""}.` : ""),
    state: `Certified in ${part.examined}${ranges ? " over the stated ranges" : ""}; the others follow.`,
    nominal: "Nominal values only; the stated ranges are not examined yet.",
    quick: "This state only, at nominal values. Stability and gain limit are certified; what is marked ≈ is not.",
  }[/** @type {"quick"} */ (current ? part.basis : "quick")];
  brief(part);
}

/** @type {string | undefined} */ let chosen = ""; // the card that has the focus, which new ones take over

/** Each requirement; where in the stated ranges all are worst, "" where that differs. @param {any} part @returns {string} */
function cards(part) {
  page.said = part;
  const places = new Set(part.rows.map((/** @type {any} */ row) => row.where).filter(Boolean)), once = page.opening.uncertain.length && places.size === 1 ? [...places][0] : "";
  const after = part.basis === "state" ? ", so far" : part.basis === "certified" && page.opening.uncertain.length ? ", worst case" : "";
  const active = /** @type {HTMLElement} */ (document.activeElement);
  if (active !== document.body) chosen = by("rows").contains(active) ? active.dataset.name : ""; // before answers are whole a card is no button, and cannot hold it
  by("rows").replaceChildren(...part.rows.map((/** @type {any} */ row) => {
    const [tone, mark] = row.met === null ? ["", ""] : row.met ? ["yes", " ✓"] : ["no", " ✗"];
    const below = [row.required, row.where && !once ? `${page.opening.kind === "robot" ? "in" : "at"} ${row.where}` : ""].filter(Boolean).join(" · "); // a title, too, where it is too narrow for it
    const better = row.to_use && row.to_use !== "–" && row.to_use !== row.worst && !isTaken() ? made("span", {}, ` ★ ${row.to_use}`) : "";
    const card = made(row.place ? "button" : "div", { className: `row ${tone}`, title: below }, made("small", {}, row.title + after), made("b", {}, row.worst + mark), better, made("small", {}, below));
    card.dataset.name = row.name;
    if (row.place) Object.assign(card, { title: `Show where: ${below}`, onclick: () => states && states.visit(row.place) });
    return card;
  }));
  if (chosen) by("rows").querySelector(`button[data-name="${chosen}"]`)?.focus({ preventScroll: true });
  return once;
}

/** The verdict in a line, which stays on a phone's screen. @param {any} part */
function brief(part) {
  const values = part.rows.filter((/** @type {any} */ row) => row.met !== null).map((/** @type {any} */ row) => `${/^[\d.]+$/.test(row.worst) ? `${row.title.split(" ").pop()} ` : ""}${row.worst} ${row.met ? "✓" : "✗"}`);
  by("brief").textContent = [(/^((In|So far, in) [^:]*: )?(Safe|Not safe|Not decided|Unstable|Every requirement is met)/i.exec(part.sentence) || [part.sentence])[0], ...new Set(values)].join(" · ");
  by("brief").className = part.tone;
}

/** @param {any} part */
function use(part) {
  page.found = part;
  map.points.star = part.point || null;
  map.points.rule = part.rule || null;
  map.star = part.star || "";
  star();
  map.draw();
  cards(page.said);
  const notes = by("notes");
  notes.replaceChildren();
  for (const { text, lines } of part.notes) {
    notes.append(made("p", {}, text));
    if (lines.length) notes.append(made("pre", {}, lines.join("\n")));
  }
}

/** Whether all that is in one is in the other, too. @param {any} part @param {any} whole @returns {boolean} */
const within = (part, whole) => Object.entries(part).every(([name, value]) => (typeof value === "object" ? within(value, whole[name]) : value === whole[name]));

/** Whether the gains now are the recommended ones: those are not offered again. */
const isTaken = () => isFresh() && Boolean(page.found.gains) && within(page.found.gains, page.view.gains);

/** Whether the recommended gains that are known are those of this view. */
const isFresh = () => Boolean(page.found) && page.found.plant === page.plant;

/** Of a robot's recommended gains those of the chosen joint. */
function star() {
  const { found } = page, taken = isTaken(), fresh = isFresh();
  by("snap").disabled = !page.searching && (!fresh || taken || !(found.gains || found.find));
  if (!page.searching) by("snap").textContent = !fresh ? "★ computing …" : taken ? "★ Recommended" : found.find ? "★ Find gains (slow)" : "★ Use recommended";
  map.old = !fresh;
  if (page.opening.kind === "robot") {
    map.points.star = (page.found && page.found.points[page.view.joint]) || null;
    map.points.ghost = page.opening.points[page.view.joint];
    map.names = page.opening.axes[page.view.joint];
  }
  map.drawMarks();
}

/** One frequency on all pictures. @param {number | null} hz */
function cursor(hz) { bode.setCursor(hz); nyquist.setCursor(hz); map.setCursor(hz); }

// ---- a simulated run ------------------------------------------------------------------------------------------------------------------

function shake() {
  if (!page.shaking) by("shake").textContent = "Stop";
  send(page.shaking ? { ask: "cancel", of: "shake" } : { ask: "shake" });
  page.shaking = true;
}

/** What was asked for has been answered, or has ended. @param {any} part */
function over(part) {
  if (part.lane === "run") { page.shaking = false; by("shake").textContent = "Shake it"; }
  if (part.lane !== "search") return;
  page.searching = false;
  star();
  if (part.message && part.part === "ended") toast(part.message);
  if (part.part === "done" && part.key !== page.key) look(true); // found while gains were moved
}

/** @param {any} part */
function ran(part) {
  const place = by("run");
  place.hidden = false;
  place.querySelector("small").textContent = page.opening.kind === "robot" ? "MuJoCo, nonlinear; the file's scenario in this state" : "tick by tick; the file's scenario";
  place.querySelector(".said").textContent = part.sentence;
  traces(place.querySelector(".plot"), part);
  const seen = body && body.renderer ? by("side") : place; // a robot's run is played on its drawing
  requestAnimationFrame(() => seen.scrollIntoView({ behavior: "smooth", block: "nearest" })); // charts have their size then
}

by("snap").onclick = () => (page.searching ? send({ ask: "cancel", of: "find" }) : snap());
by("undo").onclick = undo;
by("shake").onclick = shake;
by("page").onclick = () => { toast("Making the page …"); send({ ask: "page" }); };
by("save").onclick = () => send({ ask: "save" });
document.addEventListener("keydown", (event) => {
  const typing = event.target instanceof HTMLInputElement && event.target.type === "number";
  if ((event.ctrlKey || event.metaKey) && event.key === "z" && !typing) { event.preventDefault(); undo(); }
  if (event.key === "s" && !event.ctrlKey && !event.metaKey && !typing && !by("dialog").open) snap();
});
connect();
