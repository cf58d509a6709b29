/**
 * The scene: boxes with ports, edges with labels, frames. Our own SVG, since boxes must be reachable by keyboard and
 * screen reader, with two things that make 1,000 of them cheap:
 *
 *   culling   only what is in view is in the document. A grid finds it; while the same cells are in view, a move of
 *             the view is one `transform` and nothing else.
 *   level     below scale FAR one canvas draws everything, and the SVG holds the focused and the chosen box only.
 */
import { effect } from "../vendor/preact-signals.js";
import * as store from "../store.js";
import { makeBox, updateBox } from "./box.js";
import { makeEdge, updateEdge } from "./edge.js";
import { FAR, farBelow, sizesAt } from "./fonts.js";
import { Frames } from "./frames.js";
import { Grid, cellsOf } from "./grid.js";
import { Looks } from "./looks.js";
import { coloursOf, paint } from "./paint.js";
import { crossings } from "./paths.js";
import { make, html } from "./svg.js";
import { World } from "./world.js";

/** @import {Box, Edge, Frame} from "../types.js" */
/** @typedef {{x: number, y: number, k: number}} View screen = scene * k + (x, y) */

/** A zoom that brings 300 boxes at once into view is spread over frames; of boxes and of edges each. */
const NEW_PER_FRAME = 40;
const LAYERS = /** @type {const} */ (["frames", "edges", "titles", "boxes", "labels"]);

export class Scene {
  /** @param {HTMLElement} host */
  constructor(host) {
    this.host = host;
    /** @type {View} */
    this.view = { x: 0, y: 0, k: 1 };
    this.width = this.height = 0;
    this.grid = new Grid();
    this.world = new World(this.grid);
    this.looks = new Looks(this.world);
    /** @type {Map<number, SVGElement>} */
    this.boxes = new Map();
    /** @type {Map<number, import("./edge.js").Drawn>} */
    this.edges = new Map();
    this.shown = { boxes: /** @type {Set<number>} */ (new Set()), edges: /** @type {Set<number>} */ (new Set()) };
    /** The box that a hand holds, and where. @type {{id: number, x: number, y: number} | null} */
    this.held = null;
    this.far = false;
    this.seen = "";
    this.due = 0;
    /** Called after the view or what is in it has changed. */
    this.onView = () => {};
    /** Called after other things are in the document than before. */
    this.onCulled = () => {};
    this.canvas = host.appendChild(html("canvas", { "aria-hidden": "true" }));
    // "application": a screen reader passes the arrow keys on to us, for the walk along the edges.
    this.svg = host.appendChild(make("svg", { role: "application", "aria-label": "The system", "aria-roledescription": "graph" }));
    this.root = this.svg.appendChild(make("g", { class: "world" }));
    this.layers = Object.fromEntries(LAYERS.map((name) => [name, this.root.appendChild(make("g", { class: name }))]));
    this.frames = new Frames(this.layers.frames, this.layers.titles, this.looks);
    new ResizeObserver(() => this.resize()).observe(host);
    this.resize();
    store.on("picture", () => this.takePicture());
    store.on("change", (change) => this.takeChange(change));
    store.on("figures", (news) => this.takeFigures(news));
    store.on("choose", () => this.takeChoice());
    effect(() => {
      this.world.takeKernels(store.kernels.value);
      this.freshen();
    });
    effect(() => {
      void store.infrastructure.value;
      this.changed();
    });
    setInterval(() => this.frames.sayKernels(), 1000);
  }

  resize() {
    [this.width, this.height] = [this.host.clientWidth, this.host.clientHeight];
    [this.canvas.width, this.canvas.height] = [this.width * devicePixelRatio, this.height * devicePixelRatio];
    /** @type {Record<string, string> | null} */
    this.colours = null;   // the canvas knows no CSS variables
    this.changed();
  }

  // -- what comes from the server ------------------------------------------------------------------------------------

  takePicture() {
    for (const kind of /** @type {const} */ (["boxes", "edges"])) for (const id of [...this.grid.filed[kind].keys()]) this.drop(kind, id);
    this.takeChange({ frames: [...store.frames.peek().values()], boxes: [...store.boxes.peek().values()], edges: [...store.edges.peek().values()] });
  }

  /** @param {{frames?: Frame[], boxes?: Box[], edges?: Edge[], gone?: import("../types.js").Gone}} change */
  takeChange({ frames = [], boxes = [], edges = [], gone = {} }) {
    for (const id of gone.boxes ?? []) this.drop("boxes", id);
    for (const id of gone.edges ?? []) this.drop("edges", id);
    for (const box of boxes) this.putBox(box);
    const touched = this.world.takeEdges(store.edges.peek());
    for (const edge of edges) {
      for (const id of this.grid.beside("edges", edge.id)) touched.add(id);   // those that it crossed
      this.grid.put("edges", edge.id, edge.points);
      for (const id of this.grid.beside("edges", edge.id)) touched.add(id);
      touched.add(edge.id);
    }
    for (const id of touched) this.redraw(id);
    if (this.looks.focused === null || !store.boxes.peek().has(this.looks.focused)) this.looks.focused = store.boxes.peek().keys().next().value ?? null;
    if (frames.length || gone.frames?.length || !store.frames.peek().size) this.frames.draw();
    this.changed();
  }

  /** Show a box where a hand holds it, whatever the server says meanwhile. @param {{id: number, x: number, y: number}} held */
  hold(held) {
    this.held = held;
    const node = this.boxes.get(held.id);
    node?.setAttribute("transform", `translate(${held.x} ${held.y})`);
    node?.classList.add("moving");
  }

  /** Show a box where the server has it again, unless a hand has taken one since. @param {{id: number, x: number, y: number}} held */
  letGo(held) {
    if (this.held !== held) return;
    this.held = null;
    const box = store.boxes.peek().get(held.id);
    if (box) this.putBox(box);
  }

  /** @param {Box} box */
  putBox(box) {
    this.grid.put("boxes", box.id, [[box.x, box.y], [box.x + box.w, box.y + box.h]]);
    const old = this.boxes.get(box.id);
    if (!old) return;
    const node = makeBox(box, this.looks.box(box)), focus = old.contains(document.activeElement);
    const port = focus && document.activeElement?.getAttribute("data-port");
    this.boxes.set(box.id, node);
    old.replaceWith(node);   // in its place, with the focus where it was
    if (focus) ((port && portIn(node, port)) || node).focus({ preventScroll: true });
    if (this.held?.id === box.id) this.hold(this.held);
  }

  /** @param {number} id of an edge */
  redraw(id) {
    const old = this.edges.get(id), edge = store.edges.peek().get(id);
    if (!old || !edge) return;
    if (!this.shown.edges.has(id)) return void this.edges.delete(id);   // drawn anew when it comes into view
    const drawn = this.edgeOf(edge), focus = old.node.contains(document.activeElement);
    this.edges.set(id, drawn);
    old.node.replaceWith(drawn.node);
    old.label.replaceWith(drawn.label);
    if (focus) drawn.node.focus({ preventScroll: true });
  }

  /** The node of a thing that is drawn. @param {import("../types.js").Selection} thing @returns {SVGElement | null | undefined} */
  nodeOf({ kind, id }) {
    if (kind === "box") return this.boxes.get(Number(id));
    if (kind === "edge") return this.edges.get(Number(id))?.node;
    if (kind === "frame") return this.frames.drawn.get(Number(id))?.title;
    const found = kind === "port" ? store.portOf(id, store.boxes.peek()) : null, node = this.boxes.get(found?.box.id ?? NaN);
    return found && node ? portIn(node, found.port.name) : null;
  }

  /** @param {import("../types.js").Figures} news */
  takeFigures({ e = {}, b = {}, f = {} }) {
    const touched = new Set();   // with those whose labels stand beside: which of them gives way may be another now
    for (const id of Object.keys(e).map(Number)) {
      const edge = store.edges.peek().get(id);
      for (const one of edge ? this.world.labelled(edge) : []) touched.add(one.id);
      touched.add(id);
    }
    for (const id of touched) this.freshenEdge(id);
    for (const id of Object.keys(b).map(Number)) if (store.boxes.peek().has(id)) this.putBox(/** @type {Box} */ (store.boxes.peek().get(id)));
    for (const id of Object.keys(f).map(Number)) this.frames.freshen(id);
    if (this.far) this.draw();
  }

  takeChoice() {
    const chosen = store.selected.peek();
    if (chosen?.kind === "box") this.focusOn(Number(chosen.id));
    if (chosen?.kind === "port") this.focusOn(store.portOf(chosen.id, store.boxes.peek())?.box.id ?? this.looks.focused);
    this.freshen();
  }

  // -- what is drawn, and how ------------------------------------------------------------------------------------------

  /** @param {Edge} edge */
  edgeOf(edge) {
    return makeEdge(edge, store.figures.peek().get(edge.id), this.looks.edge(edge), store.boxes.peek(), this.world.jointsOf(edge),
      crossings(edge.points, this.beside(edge)));
  }

  /** The paths of other edges that run through the same cells. @param {Edge} edge */
  * beside(edge) {
    for (const id of this.grid.beside("edges", edge.id)) {
      const other = store.edges.peek().get(id);
      if (other) yield other.points;
    }
  }

  /** @param {number} id */
  freshenEdge(id) {
    const drawn = this.edges.get(id), edge = store.edges.peek().get(id);
    if (drawn && edge && this.shown.edges.has(id)) updateEdge(drawn, edge, store.figures.peek().get(id), this.looks.edge(edge), store.boxes.peek());
  }

  /** Draw anew what may look different: a kernel has fallen silent, something else is chosen. */
  freshen() {
    for (const id of this.shown.edges) this.freshenEdge(id);
    this.frames.freshenAll();
    for (const [id, node] of this.boxes) {
      const box = store.boxes.peek().get(id);
      if (!box) continue;
      updateBox(node, box, this.looks.box(box));
    }
    if (this.far) this.draw();
  }

  /** @param {number | null} id of the box that is in the tab order from now on */
  focusOn(id) {
    this.looks.focused = id;
    this.changed();
  }

  // -- what is in view -----------------------------------------------------------------------------------------------

  /** @param {View} view */
  setView(view) {
    this.view = view;
    this.draw();
  }

  changed() {
    this.seen = "";
    this.draw();
  }

  /** Draw once in the next frame, however often this is called. */
  draw() {
    this.due ||= requestAnimationFrame(() => {
      this.due = 0;
      this.drawNow();
    });
  }

  drawNow() {
    const { x, y, k } = this.view;
    // An attribute, not CSS with `will-change`: a layer of its own is as large as the world, and rasters all of it.
    this.root.setAttribute("transform", `translate(${x} ${y}) scale(${k})`);
    const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    const far = k < farBelow(store.boxes.peek().size);
    if (this.far !== far) {
      this.far = far;
      this.seen = "";
      this.host.classList.toggle("far", this.far);
      context.setTransform(1, 0, 0, 1, 0, 0);
      context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    }
    if (!this.far) this.takeSizes(sizesAt(k));
    this.cull();
    if (this.far) {
      this.colours ??= coloursOf(this.host);
      paint(context, this.view, this.world, this.colours, devicePixelRatio);
    }
    this.onView();
  }

  /** Text has other sizes: what was drawn was cut to fit the ones before. @param {import("./fonts.js").Sizes} sizes */
  takeSizes(sizes) {
    if (sizes.text === this.looks.sizes.text) return;
    this.looks.sizes = sizes;
    for (const name of /** @type {const} */ (["name", "text", "title"])) this.root.style.setProperty(`--${name}`, `${sizes[name]}px`);
    for (const id of [...this.boxes.keys()]) {
      if (this.shown.boxes.has(id)) this.putBox(/** @type {Box} */ (store.boxes.peek().get(id)));
      else this.boxes.delete(id);
    }
    for (const id of this.shown.edges) this.freshenEdge(id);
    this.frames.draw();
  }

  /** The scale as the server knows it: from FAR on it says all figures of what is in view. */
  get scale() {
    return this.far ? Math.min(this.view.k, FAR - 0.01) : Math.max(this.view.k, FAR);
  }

  /** The rectangle of the scene that is in view. @returns {import("./grid.js").Rect} */
  rect() {
    const { x, y, k } = this.view;
    return { x0: -x / k, y0: -y / k, x1: (this.width - x) / k, y1: (this.height - y) / k };
  }

  /** Put into the document what has come into view, take out what has left. */
  cull() {
    const rect = this.rect(), cells = `${cellsOf(rect)},${this.far}`;
    if (cells === this.seen) return;
    this.seen = cells;
    const wanted = this.far ? { boxes: new Set(), edges: new Set() } : this.grid.find(rect);
    if (!store.infrastructure.peek()) this.leaveOut(wanted);
    if (this.looks.focused !== null && store.boxes.peek().has(this.looks.focused)) wanted.boxes.add(this.looks.focused);
    for (const kind of /** @type {const} */ (["boxes", "edges"])) {
      for (const id of this.shown[kind]) if (!wanted[kind].has(id)) this.hide(kind, id);
      let left = NEW_PER_FRAME;
      for (const id of wanted[kind]) {
        if (this.shown[kind].has(id)) continue;
        if (left-- > 0 || id === this.looks.focused) this.show(kind, id);
        else wanted[kind].delete(id);   // its turn comes in one of the next frames
      }
      this.shown[kind] = wanted[kind];
      if (left < 0) this.changed();
    }
    this.onCulled();
  }

  /** What the user has hidden is not drawn. @param {Record<"boxes" | "edges", Set<number>>} wanted */
  leaveOut({ boxes, edges }) {
    for (const id of boxes) if (this.world.hidden(store.boxes.peek().get(id))) boxes.delete(id);
    for (const id of edges) if (this.world.hiddenEdge(/** @type {Edge} */ (store.edges.peek().get(id)))) edges.delete(id);
  }

  /** @param {"boxes" | "edges"} kind @param {number} id */
  show(kind, id) {
    if (kind === "boxes") {
      const box = /** @type {Box} */ (store.boxes.peek().get(id)), node = this.boxes.get(id) ?? makeBox(box, this.looks.box(box));
      this.boxes.set(id, node);
      this.layers.boxes.append(node);
      return;
    }
    const edge = /** @type {Edge} */ (store.edges.peek().get(id)), drawn = this.edges.get(id) ?? this.edgeOf(edge);
    this.edges.set(id, drawn);
    updateEdge(drawn, edge, store.figures.peek().get(id), this.looks.edge(edge), store.boxes.peek());
    this.layers.edges.append(drawn.node);
    this.layers.labels.append(drawn.label);
  }

  /** @param {"boxes" | "edges"} kind @param {number} id */
  hide(kind, id) {
    if (kind === "boxes") this.boxes.get(id)?.remove();
    else {
      this.edges.get(id)?.node.remove();
      this.edges.get(id)?.label.remove();
    }
    this.shown[kind].delete(id);
  }

  /** @param {"boxes" | "edges"} kind @param {number} id */
  drop(kind, id) {
    this.hide(kind, id);
    this.grid.remove(kind, id);
    this[kind].delete(id);
  }
}

/** @param {SVGElement} box @param {string} name @returns {SVGElement | null} */
const portIn = (box, name) => box.querySelector(`[data-port="${CSS.escape(name)}"]`);
