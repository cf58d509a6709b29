/** What several panels show alike: a name that may be cut, a button that leads to a thing, a moment, a list of many rows. */
import { h } from "../vendor/preact.js";
import { useLayoutEffect, useRef } from "../vendor/preact-hooks.js";
import { signal, useSignal } from "../vendor/preact-signals.js";
import htm from "../vendor/htm.js";
import { boxes, choose, frames, kernels } from "../store.js";
import { letterOf } from "../words.js";

/** @import {Box} from "../types.js" */

export const html = htm.bind(h);

// -- texts that are cut ------------------------------------------------------------------------------------------------

/** A text on one line, whole in a tip where it is cut. @param {{text: string, class?: string}} props */
export function Cut({ text, class: kind = "" }) {
  return html`<span class=${`cut ${kind}`} data-full=${text}>${text}</span>`;
}

const shown = signal(/** @type {{text: string, x: number, y: number} | null} */ (null));

/** Shows the text of a cut name under the pointer, or in what has the focus. It is one for all panels. */
export function CutTip() {
  const node = useRef(/** @type {HTMLElement | null} */ (null));
  useLayoutEffect(() => {
    if (!node.current || !shown.value) return;
    const { x, y } = shown.value, { offsetWidth, offsetHeight } = node.current;
    node.current.style.left = `${Math.max(4, Math.min(x, window.innerWidth - offsetWidth - 8))}px`;
    node.current.style.top = `${y + offsetHeight > window.innerHeight - 8 ? y - offsetHeight - 32 : y}px`;
  });
  return shown.value && html`<div class="cut-tip" role="tooltip" ref=${node}>${shown.value.text}</div>`;
}

/** @param {EventTarget | null} target @param {boolean} inside whether a cut text in what has the focus counts */
function showCut(target, inside) {
  if (!(target instanceof Element)) return;
  const node = target.closest("[data-full]") ?? (inside ? target.querySelector("[data-full]") : null);
  if (!(node instanceof HTMLElement) || node.scrollWidth <= node.clientWidth) {
    shown.value = null;
    return;
  }
  const { left, bottom } = node.getBoundingClientRect();
  shown.value = { text: node.dataset.full ?? "", x: left, y: bottom + 4 };
}
document.addEventListener("pointerover", ({ target }) => showCut(target, false));
document.addEventListener("focusin", ({ target }) => showCut(target, true));
for (const kind of ["focusout", "scroll", "pointerdown"]) document.addEventListener(kind, () => { shown.value = null; }, true);

// -- things ------------------------------------------------------------------------------------------------------------

/** The badge of a state: its colour and its letter. @param {{state: string}} props */
export const Badge = ({ state }) => html`<span class=${`badge is-${state}`} role="img" aria-label=${state}>${letterOf(state)}</span>`;

/** The box of a component, by its kernel's address or name and its own name. @param {string} kernel @param {string} name @returns {Box | undefined} */
export function boxOf(kernel, name) {
  const address = kernels.value.has(kernel) ? kernel : [...kernels.value.values()].find((one) => one.name === kernel)?.address;
  for (const box of boxes.value.values()) if (box.name === name && (!address || box.kernel === address)) return box;
  return undefined;
}

/** A button that leads to a component; its name alone where that is not there. @param {{kernel: string, component: string}} props */
export function Lead({ kernel, component }) {
  const box = component ? boxOf(kernel, component) : undefined;
  if (!box) return html`<${Cut} text=${component} class="quiet" />`;
  return html`<button class="lead" onClick=${() => choose("box", box.id)}><${Cut} text=${component} /></button>`;
}

/** What a click on a row does: it selects the component, where it is there and no text was marked. @param {string} kernel @param {string} component */
export const rowLeads = (kernel, component) => (/** @type {MouseEvent} */ { target }) => {
  const box = component ? boxOf(kernel, component) : undefined, marked = String(document.getSelection() ?? "");
  if (box && !marked && target instanceof Element && !target.closest("button")) choose("box", box.id);
};

/** A button that leads to a context. @param {{kernel: string, context: string}} props */
export function LeadToContext({ kernel, context }) {
  const frame = [...frames.value.values()].find((one) => one.kind === "context" && one.kernel === kernel && one.name === context);
  return frame ? html`<button class="lead" onClick=${() => choose("frame", frame.id)}><${Cut} text=${context} /></button>` : null;
}

const BILLION = 1_000_000_000n;
/** Times before this one are not of a calendar: simulated. */
const CALENDAR_NS = 1_000_000n * BILLION;

/** A moment of a kernel's clock, as text. @param {number | string} ns since the epoch, or of simulated time */
export function moment(ns) {
  const value = BigInt(typeof ns === "number" ? Math.round(ns) : ns);
  const thousandths = String((value / 1_000_000n) % 1000n).padStart(3, "0");
  if (value < CALENDAR_NS) return `${value / BILLION}.${thousandths} s`;
  return `${new Date(Number(value / 1_000_000n)).toLocaleTimeString("en-GB")}.${thousandths}`;
}

/** A value on one line. @param {unknown} value */
export function said(value) {
  if (typeof value === "string") return value.replace(/\s+/g, " ").trim();
  return typeof value === "number" && !Number.isInteger(value) ? String(Number(value.toPrecision(6))) : JSON.stringify(value) ?? "";
}

/** "one lost", "3 lost". @param {number} number @param {string} one @param {string} [many] */
export const counted = (number, one, many = `${one}s`) => `${number.toLocaleString("en")} ${number === 1 ? one : many}`;

// -- many rows ---------------------------------------------------------------------------------------------------------

/** Rows beyond the visible ones that are in the document, above and below. */
const BEYOND = 8;

/**
 * A list of rows of one height, of which only the visible ones are in the document. It stays at its end as long as it
 * is scrolled there.
 * @param {{count: number, height: number, row: (index: number) => any, role: string, label: string, follow?: boolean,
 *   focus?: boolean, onKeyDown?: (event: KeyboardEvent) => void, at?: number}} props at: a row that is scrolled into view when it changes
 */
export function Rows({ count, height, row, role, label, follow = false, focus = true, onKeyDown, at = -1 }) {
  const host = useRef(/** @type {HTMLElement | null} */ (null)), atEnd = useRef(true);
  const from = useSignal(0), room = useSignal(400);
  useLayoutEffect(() => {
    const node = /** @type {HTMLElement} */ (host.current);
    const seen = new ResizeObserver(() => { room.value = node.clientHeight; });
    seen.observe(node);
    return () => seen.disconnect();
  }, []);
  useLayoutEffect(() => {
    const node = /** @type {HTMLElement} */ (host.current);
    if (follow && atEnd.current) node.scrollTop = node.scrollHeight;
  });
  useLayoutEffect(() => {
    const node = /** @type {HTMLElement} */ (host.current), top = at * height;
    if (at < 0) return;
    if (top < node.scrollTop) node.scrollTop = top;
    else if (top + height > node.scrollTop + node.clientHeight) node.scrollTop = top + height - node.clientHeight;
  }, [at]);
  // a browser tells of a scroll a frame later: the list may have left the page, and host is null
  const scrolled = (/** @type {{currentTarget: HTMLElement}} */ { currentTarget: node }) => {
    atEnd.current = node.scrollTop + node.clientHeight >= node.scrollHeight - height;
    from.value = Math.floor(node.scrollTop / height);
  };
  const first = Math.max(0, Math.min(from.value, count) - BEYOND), last = Math.min(count, from.value + Math.ceil(room.value / height) + BEYOND);
  const rows = [];
  for (let index = first; index < last; index++) rows.push(row(index));
  return html`<div class="rows" ref=${host} role=${role} aria-label=${label} aria-rowcount=${role === "table" ? count : null} tabindex=${focus ? 0 : null}
      onScroll=${scrolled} onKeyDown=${onKeyDown}>
    <${Space} height=${first * height} />${rows}<${Space} height=${(count - last) * height} />
  </div>`;
}

/** The place of rows that are not in the document. The height is set by the CSSOM: the policy allows no attribute. @param {{height: number}} props */
function Space({ height }) {
  const node = useRef(/** @type {HTMLElement | null} */ (null));
  useLayoutEffect(() => { /** @type {HTMLElement} */ (node.current).style.height = `${height}px`; }, [height]);
  return html`<div role="presentation" ref=${node}></div>`;
}
