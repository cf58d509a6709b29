/** The rooms of the page: header, tree, scene, what is selected, and below them the tabs; their sizes can be changed. */
import { h } from "./vendor/preact.js";
import { signal } from "./vendor/preact-signals.js";
import htm from "./vendor/htm.js";
import { connection, notice, theme } from "./store.js";
import { html as element } from "./scene/svg.js";
import { why } from "./connection.js";

const html = htm.bind(h);

/** A room of the page. @template {keyof HTMLElementTagNameMap} K @param {K} name @param {string} label @param {string} [kind] */
export function room(name, label, kind = "") {
  return document.body.appendChild(element(name, { ...(label && { "aria-label": label }), ...(kind && { class: kind }) }));
}

const open = signal(localStorage.getItem("aiorts-tab") ?? "");

/** Show the panel of a tab. @param {string} name */
export function openTab(name) {
  open.value = name;
  localStorage.setItem("aiorts-tab", name);
}

/** Show the panel of a tab, or close it. @param {string} name */
export const turnTab = (name) => openTab(open.peek() === name ? "" : name);

/** Dark instead of light, or light instead of dark; it stays so. */
export function flipTheme() {
  theme.value = document.documentElement.dataset.theme = theme.peek() === "dark" ? "light" : "dark";
  localStorage.setItem("aiorts-theme", theme.peek());
}

/** @param {{tabs: Record<string, () => any>}} props the panels by the names of their tabs */
export function Below({ tabs }) {
  const names = Object.keys(tabs), shown = open.value in tabs ? open.value : "";
  document.body.classList.toggle("low", !shown);
  const Panel = tabs[shown];
  const turn = (/** @type {KeyboardEvent} */ event) => {
    const by = event.key === "ArrowRight" ? 1 : event.key === "ArrowLeft" ? -1 : 0, buttons = [.../** @type {HTMLElement} */ (event.currentTarget).querySelectorAll("button")];
    if (by) buttons[(buttons.indexOf(/** @type {HTMLButtonElement} */ (document.activeElement)) + by + buttons.length) % buttons.length].focus();
  };
  return html`<div class="tabs" role="tablist" aria-label="Below" onKeyDown=${turn}>${names.map((name) => html`
      <button key=${name} role="tab" id=${`tab-${name}`} aria-selected=${shown === name} aria-controls="below" tabindex=${(shown || names[0]) === name ? 0 : -1}
        title=${`${name} (${name[0].toLowerCase()})`} onClick=${() => turnTab(name)}>${name}</button>`)}</div>
    <div class="panel" id="below" role="tabpanel" aria-labelledby=${shown ? `tab-${shown}` : null} aria-label=${shown ? null : "closed"} hidden=${!shown}>${shown && html`<${Panel} />`}</div>`;
}

/** What is said for some seconds, and read aloud. */
export function Toast() {
  return html`<p class=${`toast ${notice.value ? "shown" : ""}`} role="status" aria-live="polite">${notice.value}</p>`;
}

/** Says across the page that what is shown is old, and what to do. */
export function Banner() {
  const again = "What is shown is what was last. When it is started again, open the address that it prints.";
  const said = { lost: "The connection to aiorts studio was lost. What is shown is old; trying again…",
    ended: why ? `${why[0].toUpperCase()}${why.slice(1)}. ${again}` : `aiorts studio does not answer any more. ${again}` };
  const text = said[/** @type {"lost"} */ (connection.value)];
  return text ? html`<p class=${`banner ${why ? "over" : ""}`} role="alert">${text}</p>` : null;
}

/** @typedef {{property: string, sign: 1 | -1, axis: "x" | "y", least: number, most: number, first: number, label: string, kind: string}} Edge */
const EDGES = /** @type {Edge[]} */ ([
  { property: "--tree", sign: 1, axis: "x", least: 160, most: 520, first: 232, label: "Width of the tree", kind: "left" },
  { property: "--aside", sign: -1, axis: "x", least: 240, most: 720, first: 328, label: "Width of what is selected", kind: "right" },
  { property: "--below", sign: -1, axis: "y", least: 96, most: 640, first: 208, label: "Height of the panel below", kind: "low" },
]);

/** A screen this wide is looked at from further away: text is larger, in px. */
const LARGE = 2400;

/** Put between the rooms what changes their sizes, by pointer and by arrows. @param {HTMLElement} scene @param {HTMLElement} below */
export function splitters(scene, below) {
  for (const { property, sign, axis, least, most, first, label, kind } of EDGES) {
    const node = (axis === "x" ? scene : below).appendChild(element("div", { class: `splitter ${kind}`, role: "separator", tabindex: "0", "aria-label": label,
      "aria-orientation": axis === "x" ? "vertical" : "horizontal", "aria-valuemin": String(least), "aria-valuemax": String(most) }));
    let size = Number(localStorage.getItem(`aiorts${property}`) ?? (window.innerWidth > LARGE ? first * 1.35 : first));
    const put = (/** @type {number} */ to) => {
      size = Math.round(Math.max(least, Math.min(most, to)));
      document.body.style.setProperty(property, `${size}px`);   // by the CSSOM: allowed by the policy
      node.setAttribute("aria-valuenow", String(size));
    };
    put(size);
    node.addEventListener("pointerdown", (event) => {
      node.setPointerCapture(event.pointerId);
      const [start, before] = [axis === "x" ? event.clientX : event.clientY, size];
      const move = (/** @type {PointerEvent} */ to) => put(before + sign * ((axis === "x" ? to.clientX : to.clientY) - start));
      node.addEventListener("pointermove", move);
      node.addEventListener("lostpointercapture", () => {
        node.removeEventListener("pointermove", move);
        localStorage.setItem(`aiorts${property}`, String(size));
      }, { once: true });
    });
    node.addEventListener("keydown", ({ key }) => {
      const by = { ArrowRight: 16, ArrowLeft: -16, ArrowUp: -16, ArrowDown: 16 }[key];
      if (by && (axis === "x") === /Right|Left/.test(key)) put(size + sign * by);
    });
  }
}
