/** Hosts, kernels, contexts and components as a tree; the search looks at names, types and ports. */
import { signal } from "../vendor/preact-signals.js";
import { boxes, boxFigures, choose, frames, kernels, selected, sought } from "../store.js";
import { hasEnded, kernelTrouble } from "../words.js";
import { Badge, Cut, Rows, counted, html } from "./parts.js";

/** @import {Box, Frame, Kernel, Selection} from "../types.js" */
/** @typedef {{key: string, level: number, name: string, beside: string, state: string, thing: Selection | null, open: boolean | null,
 *   bad: boolean, size: number, place: number}} Row open: null where nothing is inside */

const HEIGHT = 28;
const closed = signal(/** @type {Set<string>} */ (new Set()));
const at = signal("");

export function Tree() {
  const rows = rowsOf(sought.value.trim().toLowerCase(), closed.value), found = rows.filter((row) => row.thing?.kind === "box").length;
  const chosen = selected.value && `${selected.value.kind}${selected.value.id}`;
  const current = Math.max(0, rows.findIndex((row) => row.key === at.value));
  return html`<div class="tree">
    <input type="search" id="search" aria-label="Search components, types and ports" placeholder="Search   /" value=${sought.value} autocomplete="off" spellcheck="false"
      onInput=${(/** @type {InputEvent} */ { target }) => { sought.value = /** @type {HTMLInputElement} */ (target).value; }}
      onKeyDown=${(/** @type {KeyboardEvent} */ event) => searchKey(event, rows)} />
    <p class="heard" role="status">${sought.value && counted(found, "component")}</p>
    ${sought.value && !found && html`<p class="none">No component, type or port has “${sought.value}” in its name.</p>`}
    <${Rows} count=${rows.length} height=${HEIGHT} role="tree" label="Kernels and components" focus=${false} at=${rows.length ? current : -1}
      onKeyDown=${(/** @type {KeyboardEvent} */ event) => treeKey(event, rows, current)} row=${(/** @type {number} */ index) => html`
        <${Item} key=${rows[index].key} row=${rows[index]} chosen=${rows[index].key === chosen} focusable=${index === current} />`} />
  </div>`;
}

/** @param {{row: Row, chosen: boolean, focusable: boolean}} props */
function Item({ row, chosen, focusable }) {
  const take = () => {
    at.value = row.key;
    if (row.thing) choose(row.thing.kind, row.thing.id);
  };
  return html`<div class=${`item level-${row.level} ${row.bad ? "bad" : ""} ${row.state && row.thing?.kind === "box" ? "" : "over"}`} role="treeitem" data-key=${row.key} tabindex=${focusable ? 0 : -1}
      aria-level=${row.level} aria-expanded=${row.open} aria-selected=${chosen} aria-setsize=${row.size} aria-posinset=${row.place} onClick=${take}>
    ${row.open === null ? null : html`<span class=${`twist ${row.open ? "open" : ""}`} aria-hidden="true" onClick=${(/** @type {Event} */ event) => { event.stopPropagation(); toggle(row.key); }}></span>`}
    ${row.state && html`<${Badge} state=${row.state} />`}
    <${Cut} text=${row.name} class="name" />${row.beside && html`<${Cut} text=${row.beside} class="beside" />`}
  </div>`;
}

/** @param {string} key */
function toggle(key) {
  const all = new Set(closed.value);
  if (!all.delete(key)) all.add(key);
  closed.value = all;
}

/** @param {KeyboardEvent} event @param {Row[]} rows */
function searchKey(event, rows) {
  const first = rows.find((row) => row.thing?.kind === "box");
  if (event.key === "Enter" && first?.thing) choose(first.thing.kind, first.thing.id, { focus: true });
  else if (event.key === "ArrowDown" && rows.length) go((first ?? rows[0]).key);
  else if (event.key === "Escape" && sought.value) sought.value = "";
  else return;
  event.preventDefault();
  event.stopPropagation();
}

/** @param {KeyboardEvent} event @param {Row[]} rows @param {number} current */
function treeKey(event, rows, current) {
  const row = rows[current];
  if (!row || event.ctrlKey || event.altKey || event.metaKey) return;
  const outer = () => rows.slice(0, current).findLastIndex((one) => one.level < row.level);
  const move = (/** @type {number} */ index) => rows[index] && go(rows[index].key);
  const does = /** @type {Record<string, () => void>} */ ({
    ArrowDown: () => move(current + 1), ArrowUp: () => move(current - 1), Home: () => move(0), End: () => move(rows.length - 1),
    ArrowRight: () => (row.open === false ? toggle(row.key) : row.open && move(current + 1)),
    ArrowLeft: () => (row.open ? toggle(row.key) : move(outer())),
    Enter: () => row.thing && choose(row.thing.kind, row.thing.id, { focus: true }), " ": () => row.thing && choose(row.thing.kind, row.thing.id),
  });
  if (!Object.hasOwn(does, event.key)) return;
  event.preventDefault();
  event.stopPropagation();
  does[event.key]();
}

/** Give a row the focus, once it is in the document. @param {string} key */
function go(key) {
  at.value = key;
  requestAnimationFrame(() => /** @type {HTMLElement | null} */ (document.querySelector(`[data-key="${CSS.escape(key)}"]`))?.focus());
}

// -- what is shown -----------------------------------------------------------------------------------------------------

/** @typedef {{key: string, name: string, beside?: string, state?: string, thing?: Selection, bad?: boolean, inside: Branch[]}} Branch */

/** The rows that a search leaves; what is found is never inside something closed. @param {string} word @param {Set<string>} shut @returns {Row[]} */
function rowsOf(word, shut) {
  /** @type {Row[]} */
  const rows = [];
  /** @param {Branch[]} nodes @param {number} level */
  const lay = (nodes, level) => nodes.forEach((node, index) => {
    const open = node.inside.length ? Boolean(word) || !shut.has(node.key) : null;
    rows.push({ level, open, key: node.key, name: node.name, beside: node.beside ?? "", state: node.state ?? "", thing: node.thing ?? null,
      bad: node.bad ?? false, size: nodes.length, place: index + 1 });
    if (open) lay(node.inside, level + 1);
  });
  lay(hosts(word), 1);
  return rows;
}

/** @param {string} word @returns {Branch[]} */
function hosts(word) {
  const all = [...kernels.value.values()].sort((a, b) => a.name.localeCompare(b.name)), names = [...new Set(all.map((one) => one.host))].sort();
  const under = inFrames(word);
  if (names.length < 2) return all.flatMap((one) => kernelNode(one, under));
  return names.map((name) => ({ key: `host ${name}`, name, beside: "host", inside: all.filter((one) => one.host === name).flatMap((one) => kernelNode(one, under)) }))
    .filter((node) => node.inside.length);
}

/** @param {Kernel} kernel @param {Map<string, Branch[]>} under @returns {Branch[]} none where a search finds nothing in it */
function kernelNode(kernel, under) {
  const inside = under.get(kernel.address) ?? [], trouble = kernelTrouble(kernel, kernel.since_s);
  if (!inside.length && sought.value) return [];
  return [{ key: `kernel${kernel.address}`, name: kernel.name, beside: trouble || (kernel.simulated ? "simulated time" : ""), bad: Boolean(trouble) && !hasEnded(kernel),
    thing: { kind: "kernel", id: kernel.address }, inside }];
}

/** What is in each kernel, by its address: frames that are in no other, and components in none. @param {string} word @returns {Map<string, Branch[]>} */
function inFrames(word) {
  /** @type {Map<number, Branch[]>} */
  const within = new Map();
  /** @type {Map<string, Branch[]>} */
  const outer = new Map();
  /** @param {string} kernel @param {number | null} frame @param {Branch} node */
  const put = (kernel, frame, node) => {
    const own = frame === null ? undefined : frames.value.get(frame);
    if (own && own.kind !== "kernel" && own.kind !== "host") within.set(own.id, [...(within.get(own.id) ?? []), node]);
    else outer.set(kernel, [...(outer.get(kernel) ?? []), node]);
  };
  const found = [...boxes.value.values()].filter((box) => box.kind !== "remote" && matches(box, word)).sort((a, b) => a.x - b.x || a.y - b.y);
  for (const box of found) put(box.kernel, box.around, boxNode(box));
  // The frames that are innermost first: what is inside a frame has to be there before the frame is put.
  for (const frame of [...frames.value.values()].sort((a, b) => depth(b) - depth(a) || a.y - b.y)) {
    if (frame.kind === "kernel" || frame.kind === "host" || !within.has(frame.id)) continue;
    put(frame.kernel, frame.parent, { key: `frame${frame.id}`, name: frame.name || "in no context", beside: frame.said || frame.kind,
      thing: { kind: "frame", id: frame.id }, inside: within.get(frame.id) ?? [] });
  }
  return outer;
}

/** @param {Frame} frame @returns {number} */
function depth(frame) {
  const outer = frame.parent === null ? undefined : frames.value.get(frame.parent);
  return outer ? depth(outer) + 1 : 0;
}

/** @param {Box} box @param {string} word */
const matches = (box, word) => !word || [box.name, box.type, ...(box.members ?? []), ...box.ports.map((port) => `${box.name}.${port.name}`)].some((text) => text.toLowerCase().includes(word));

/** @param {Box} box @returns {Branch} */
function boxNode(box) {
  const { state } = boxFigures.value.get(box.id) ?? box;
  return { key: `box${box.id}`, name: box.name, beside: box.kind === "folded" ? "folded" : box.type, state, thing: { kind: "box", id: box.id }, bad: state === "error", inside: [] };
}
