// The robot in its critical mode: its own shapes where it has some, slowed, growing or decaying as the root says.
// @ts-check
import * as T from "./vendor/three.js";
import { number } from "./gainmap.js";
import { made } from "./elements.js";

const three = /** @type {any} */ (T);
// ColorBrewer's YlOrBr, as in the report
const SCALE = [[0, 0xfffbe6], [0.15, 0xfee391], [0.35, 0xfec44f], [0.55, 0xfe9929], [0.75, 0xcc4c02], [1, 0x662506]];
const DRAWN = 0.09; // of the robot's size: the largest motion
const PERIOD = 1.0; // [s] of the slowed vibration
const LOOP = 4.0; // [s] after which growth or decay begins anew

/** @param {number} part */
function shade(part) {
  const k = Math.max(1, SCALE.findIndex(([at]) => at >= part - 1e-9)), [low, from] = SCALE[k - 1], [high, to] = SCALE[k];
  return new three.Color(from).lerp(new three.Color(to), (part - low) / (high - low));
}

export class RobotView {
  /** @param {HTMLElement} place @param {any[]} shapes @param {() => boolean} busy */
  constructor(place, shapes, busy) {
    this.size = 1;
    this.key = "";
    this.place = place;
    this.shapes = shapes;
    this.busy = busy;
    this.stale = this.asked = false; // whether what is drawn has changed, and a frame is to come
    this.drawn = 0;
    /** @type {any} */ this.part = null;
    /** @type {any} */ this.root = null;
    /** @type {any} */ this.film = null;
    /** @type {any} */ this.bar = null;
    this.still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const caption = /** @type {any} */ (place.parentElement).querySelector("figcaption");
    this.title = caption.firstChild;
    this.note = made("p", { className: "legend", id: "mode" });
    const canvas = made("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The robot in its critical mode; drag to turn");
    if (!made("canvas").getContext("webgl2")) {
      this.note.textContent = "This browser shows no 3-D pictures (WebGL 2 is missing).";
      place.append(this.note);
      return;
    }
    place.append(canvas, this.note);
    this.renderer = new three.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    this.scene = new three.Scene();
    this.camera = new three.PerspectiveCamera(35, 1.4, 0.01, 100);
    this.camera.up.set(0, 0, 1);
    const sun = new three.DirectionalLight(0xffffff, 1.6);
    sun.position.set(3, -2, 5);
    this.turn = new three.OrbitControls(this.camera, canvas);
    this.turn.addEventListener("change", () => this.changed());
    this.turn.addEventListener("start", () => { this.placed = true; });
    canvas.style.touchAction = "pan-y"; // a finger across it turns the robot, along it scrolls the page
    this.axes = new three.AxesHelper(1);
    this.group = new three.Group();
    this.scene.add(new three.HemisphereLight(0xffffff, 0x888888, 2.2), sun, this.axes, this.group);
    /** @type {any[]} */ this.links = [];
    /** @type {any[]} */ this.joints = [];
    /** @type {any[]} */ this.pieces = [];
    this.placed = false;
    this.seen = true;
    new IntersectionObserver((entries) => { this.seen = entries[0].isIntersecting; this.changed(); }).observe(canvas);
    new ResizeObserver(() => this.fit()).observe(place);
    const pause = made("button", { textContent: this.still ? "Move" : "Hold" });
    pause.onclick = () => { this.still = !this.still; pause.textContent = this.still ? "Move" : "Hold"; this.changed(); };
    caption.append(pause);
    this.build();
  }

  /** As wide as its place, out of sight, too, as it would keep the page wide. */
  fit() {
    const wide = Math.max(260, this.place.clientWidth), high = Math.round(Math.min(440, 0.72 * wide));
    this.renderer.setSize(wide, high);
    this.camera.aspect = wide / high;
    this.camera.updateProjectionMatrix();
    this.changed();
  }

  /** Draws it anew. What does not move is not drawn again until then. */
  changed() { this.stale = true; this.ask(); }

  ask() {
    if (this.asked || !this.renderer) return;
    this.asked = true;
    requestAnimationFrame((now) => {
      this.asked = false;
      if (!this.seen) return;
      if (now - this.drawn > 33 && !this.busy()) { // while gains are dragged they go first
        this.drawn = now;
        this.stale = false;
        this.draw(now / 1000);
      }
      if (this.stale || (this.film ? this.film.runs : this.part && this.part.re && !this.still)) this.ask();
    });
  }

  build() {
    this.shapes.forEach((shape, k) => {
      const [a, b, c] = shape.size, forms = /** @type {Record<string, () => any>} */ ({
        box: () => new three.BoxGeometry(a, b, c), sphere: () => new three.SphereGeometry(a, 20, 14),
        cylinder: () => new three.CylinderGeometry(a, a, b, 24).rotateX(Math.PI / 2), capsule: () => new three.CapsuleGeometry(a, b, 8, 18).rotateX(Math.PI / 2),
      });
      const put = (/** @type {any} */ geometry) => {
        const mesh = new three.Mesh(geometry, new three.MeshStandardMaterial({ color: 0xb9bec4, roughness: 0.8, metalness: 0.1 }));
        mesh.matrixAutoUpdate = false;
        mesh.userData = { frame: shape.frame, place: matrix(shape.place) };
        this.group.add(mesh);
        this.pieces.push(mesh);
        this.paint();
        if (this.nodes && !this.placed) this.frame(this.nodes);
        this.changed();
      };
      if (shape.kind === "mesh") this.load(k).then(put);
      else put(forms[shape.kind]());
    });
  }

  /** Each link in the colour of the joint that moves it. */
  paint() {
    const { part } = this;
    if (!part) return;
    for (const piece of this.pieces) {
      const joint = part.drives[part.frames.indexOf(piece.userData.frame)], size = part.re && joint >= 0 ? Math.hypot(part.mode_re[joint], part.mode_im[joint]) : 0;
      piece.material.color.copy(size > 0.03 ? shade(Math.min(1, size)) : new three.Color(0xc4c8cc));
    }
  }

  /** @param {number} k */
  async load(k) {
    const answer = await fetch(`/mesh/${k}${location.search}`), bytes = await answer.arrayBuffer();
    const [corners, faces] = new Uint32Array(bytes, 0, 2), geometry = new three.BufferGeometry();
    geometry.setAttribute("position", new three.BufferAttribute(new Float32Array(bytes, 8, 3 * corners), 3));
    geometry.setIndex(new three.BufferAttribute(new Uint32Array(bytes, 8 + 12 * corners, 3 * faces), 1));
    geometry.computeVertexNormals();
    return geometry;
  }

  /** The camera to where all that is there is seen; anew with each mesh that comes, until a hand turns it. @param {any} box around the joints */
  frame(box) {
    const { part } = this, rest = new Map(part.frames.map((/** @type {string} */ name, /** @type {number} */ k) => [name, matrix(part.rest[k + 1])]));
    this.nodes = box.clone();
    for (const piece of this.pieces) {
      if (!rest.has(piece.userData.frame)) continue;
      piece.matrix.multiplyMatrices(rest.get(piece.userData.frame), piece.userData.place);
      piece.updateMatrixWorld(true);
      box.expandByObject(piece);
    }
    const middle = box.getCenter(new three.Vector3()), size = box.getSize(new three.Vector3()).length() || 1;
    this.turn.target.copy(middle);
    this.axes.scale.setScalar(0.2 * this.size);
    this.axes.position.copy(box.min);
    this.camera.position.copy(middle).add(new three.Vector3(1.5, -1.3, 0.5).multiplyScalar(0.85 * size));
    this.camera.near = 0.01 * size;
    this.camera.far = 20 * size;
    this.camera.updateProjectionMatrix();
    this.placed = this.pieces.length === this.shapes.length;
  }

  /** @param {any} part @param {boolean} aged whether other gains are shown by now */
  take(part, aged) {
    this.part = part;
    this.note.classList.toggle("old", aged);
    if (!this.renderer) return;
    this.endFilm(); // it was of other values
    const points = part.rest[0], count = part.nodes.names.length;
    const box = new three.Box3();
    for (let k = 0; k < count; k++) box.expandByPoint(new three.Vector3(points[3 * k], points[3 * k + 1], points[3 * k + 2]));
    const size = this.size = box.getSize(new three.Vector3()).length() || 1;
    this.paint();
    if (!this.placed) this.frame(box);
    const key = JSON.stringify([part.rest[0], part.contacts]);
    if (key === this.key) return this.recolor();
    this.key = key;
    for (const old of [...this.links, ...this.joints, ...(this.feet || [])]) { this.group.remove(old); old.geometry.dispose(); old.material.dispose(); }
    this.links = [];
    this.joints = [];
    for (let k = 0; k < count; k++) {
      const joint = part.nodes.joints[k];
      const ball = new three.Mesh(new three.SphereGeometry(size * (joint >= 0 ? 0.022 : 0.009), 18, 12), new three.MeshStandardMaterial({ color: 0x7d7d7d, roughness: 0.6 }));
      this.joints.push(ball);
      this.group.add(ball);
      if (part.nodes.parents[k] < 0) continue;
      const bone = new three.Mesh(new three.CylinderGeometry(1, 1, 1, 10).rotateX(Math.PI / 2), new three.MeshStandardMaterial({ color: 0x7d7d7d }));
      bone.userData = { from: part.nodes.parents[k], to: k, radius: size * (this.shapes.length ? 0.004 : 0.011) };
      this.links.push(bone);
      this.group.add(bone);
    }
    this.feet = part.contacts.map((/** @type {any} */ contact) => {
      const [long, across] = { flat: [0.16, 0.1], line: [0.02, 0.16], point: [0.04, 0.04] }[/** @type {"flat"} */ (contact.kind)];
      const patch = new three.Mesh(new three.BoxGeometry(long * size, across * size, 0.006 * size), new three.MeshBasicMaterial({ color: 0x0072b2, transparent: true, opacity: 0.55, depthTest: false })), a = contact.axes, p = contact.at;
      patch.matrixAutoUpdate = false;
      patch.matrix.set(a[0], a[1], a[2], p[0], a[3], a[4], a[5], p[1], a[6], a[7], a[8], p[2], 0, 0, 0, 1);
      this.group.add(patch);
      return patch;
    });
    return this.recolor();
  }

  /** The same posture in another mode. */
  recolor() {
    const { part, size } = this, count = part.nodes.names.length;
    this.joints.forEach((ball, k) => {
      const joint = part.nodes.joints[k];
      if (joint >= 0) ball.material.color.copy(shade(part.re ? Math.min(1, Math.hypot(part.mode_re[joint], part.mode_im[joint])) : 0));
    });
    if (part.re) {
      let most = 1e-12;
      for (let k = 0; k < 3 * count; k++) most = Math.max(most, Math.hypot(part.re[0][k], part.im[0][k]));
      this.scale = Math.min((DRAWN * size) / most, 0.35);
    }
    this.say();
  }

  /** @param {any} root */
  takeRoot(root) { this.root = root; this.say(); }

  say() {
    this.changed();
    const { part } = this, root = part && this.root && this.root.key === part.key ? this.root : null; // that of other gains says nothing of these
    this.title.data = this.film ? "Simulated run" : "Critical mode";
    if (!part) return;
    if (this.film) { this.note.textContent = `The simulated run in real time. Colour: participation in the vibration at the gain limit. ${part.contacts.length ? "Blue: contacts. " : ""}Axes: x red, y green, z blue.`; return; }
    if (!part.re) { this.note.textContent = "No vibration at any common factor on the gains."; return; }
    const hz = part.hz, slow = hz * PERIOD;
    const order = part.names.map((/** @type {string} */ name, /** @type {number} */ k) => [Math.hypot(part.mode_re[k], part.mode_im[k]), name]).sort((/** @type {any} */ a, /** @type {any} */ b) => b[0] - a[0]);
    const most = order.filter((/** @type {any} */ each) => each[0] >= 0.3).slice(0, 4).map((/** @type {any} */ each) => `${each[1]} ${Math.round(100 * each[0])} %`);
    const rate = root && root.growth !== null ? `${number(Math.abs(root.growth), 3)} 1/s, at ${number(root.hz, 3)} Hz` : "";
    const now = rate ? (root.growth > 0 ? ` These gains: it grows, ${rate}.` : ` These gains: the slowest vibration decays at ${rate}.`) : "";
    this.note.textContent = `Vibration at the gain limit, ${number(hz, 3)} Hz, shown ${number(slow, 2)} × slower. Colour: participation (${most.join(", ")}). ${part.contacts.length ? "Blue: contacts. " : ""}Axes: x red, y green, z blue.${now}`;
  }

  /** A simulated run on the drawing, with a scrubber; the critical mode comes back at a press. @param {any} film */
  play(film) {
    if (!this.renderer) return;
    this.endFilm();
    const slider = made("input", { type: "range", min: "0", max: String(film.ms.length - 1), value: "0", id: "film" }), time = made("output");
    slider.setAttribute("aria-label", "Moment of the simulated run");
    slider.addEventListener("input", () => { this.film.runs = false; this.changed(); });
    let most = 1e-9;
    for (const [points] of film.moved) for (const each of points) most = Math.max(most, Math.abs(each));
    const large = [100, 50, 20, 10, 5, 2, 1].find((each) => each * most <= DRAWN * this.size) || 1, size = made("button");
    const say = () => { size.textContent = this.film.larger > 1 ? `Motion drawn ${this.film.larger} × as large` : "Motion drawn as it is"; };
    size.onclick = () => { this.film.larger = this.film.larger > 1 ? 1 : large; this.changed(); say(); };
    this.bar = made("p", { className: "film" }, slider, time, ...(large > 1 ? [size] : []), made("button", { textContent: "Critical mode", onclick: () => this.endFilm() }));
    this.note.before(this.bar);
    this.film = { ...film, slider, time, larger: large, runs: !this.still, began: performance.now() / 1000 };
    say();
    this.say();
  }

  endFilm() {
    if (!this.bar) return;
    this.bar.remove();
    this.film = this.bar = null;
    this.say();
  }

  /** The moment of the run that is shown. @param {number} now @returns {any} */
  moment(now) {
    const { film } = this, last = film.ms.length - 1;
    if (film.runs) {
      const at = ((now - film.began) * 1000) % (film.ms[last] + 500), next = film.ms.findIndex((/** @type {number} */ each) => each >= at);
      film.slider.value = String(next < 0 ? last : next);
    }
    const k = Number(film.slider.value);
    film.time.textContent = `${number(film.ms[k] / 1000, 3)} s`;
    return (/** @type {number} */ row, /** @type {number} */ i) => film.start[row][i] + film.larger * film.moved[k][row][i];
  }

  /** @param {number} now */
  draw(now) {
    const { part } = this;
    if (!part) return;
    const angle = (2 * Math.PI * now) / PERIOD, hz = part.hz || 1;
    const rate = this.root && this.root.growth ? this.root.growth / (hz * PERIOD) : 0, time = now % LOOP;
    const envelope = rate > 0 ? Math.exp(Math.min(rate, 1.2) * (time - LOOP)) : Math.exp(Math.max(rate, -1.2) * time);
    const size = part.re && !this.still ? (this.scale || 0) * envelope : 0, c = size * Math.cos(angle), s = -size * Math.sin(angle);
    const pose = this.film ? this.moment(now) : null;
    const at = (/** @type {number} */ row, /** @type {number} */ k) => pose ? pose(row, k) : part.rest[row][k] + (size ? part.re[row][k] * c + part.im[row][k] * s : 0);
    this.joints.forEach((ball, k) => ball.position.set(at(0, 3 * k), at(0, 3 * k + 1), at(0, 3 * k + 2)));
    for (const bone of this.links) {
      const from = this.joints[bone.userData.from].position, to = this.joints[bone.userData.to].position, length = from.distanceTo(to);
      bone.visible = length > 1e-6;
      bone.position.copy(from).add(to).multiplyScalar(0.5);
      bone.scale.set(bone.userData.radius, bone.userData.radius, Math.max(length, 1e-6));
      bone.lookAt(to);
    }
    const moved = new Map(part.frames.map((/** @type {string} */ name, /** @type {number} */ k) => [name, matrix(Array.from({ length: 12 }, (_, i) => at(k + 1, i)))]));
    for (const piece of this.pieces) { const frame = moved.get(piece.userData.frame); piece.visible = Boolean(frame); if (frame) piece.matrix.multiplyMatrices(frame, piece.userData.place); }
    this.turn.update();
    this.renderer.render(this.scene, this.camera);
  }
}

/** Of three rows. @param {number[]} m */
function matrix(m) { return new three.Matrix4().set(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9], m[10], m[11], 0, 0, 0, 1); }
