/** What components log: lines by component and level. What comes faster than it can be read is counted, not shown. */
import { useEffect } from "../vendor/preact-hooks.js";
import { signal } from "../vendor/preact-signals.js";
import { copy } from "../commands.js";
import { openTab } from "../shell.js";
import { boxes, connection, kernels, on, say } from "../store.js";
import { count } from "../words.js";
import { Cut, Lead, Rows, html, moment, rowLeads } from "./parts.js";

/** @import {Log as Lines, LogLine} from "../types.js" */

const LEVELS = ["DEBUG", "INFO", "WARNING", "ERROR", "CRITICAL"];
/** Lines that are kept; the oldest are dropped first. */
const KEPT = 2000;
/** How often the list is drawn at most, in ms: nobody reads faster. */
const EVERY_MS = 150;
const HEIGHT = 24;
/** The place in a text that says what has failed. */
const PLACE = /\(([^()\s]+\.py:\d+)\)/;

const level = signal("INFO"), component = signal(""), kernel = signal(""), paused = signal(false);
/** Lines that the server did not send, or that came while the list was paused. */
const missed = signal(0);
const drawn = signal(/** @type {LogLine[]} */ ([]));
/** @type {LogLine[]} */
let lines = [];
let timer = 0, open = false;

function draw() {
  timer = 0;
  drawn.value = lines = lines.slice(-KEPT);
}

on("log", (/** @type {Lines} */ message) => {
  missed.value += message.missed ?? 0;
  if (paused.value) {
    missed.value += message.lines.length;
    return;
  }
  for (const line of message.lines) lines.push(line);
  if (lines.length > 2 * KEPT) {
    missed.value += lines.length - KEPT;
    lines = lines.slice(-KEPT);
  }
  timer ||= window.setTimeout(draw, EVERY_MS);
});

/** Ask for the lines that are wanted; those that are shown were wanted before, and go. */
function subscribe() {
  lines = [];
  draw();
  missed.value = 0;
  say({ t: "log", on: true, level: level.value, component: component.value, kernel: kernel.value });
}
on("hello", () => open && say({ t: "log", on: true, level: level.value, component: component.value, kernel: kernel.value }));

/** Show the lines of a component, and no others. @param {string} of its kernel's address @param {string} name */
export function showLog(of, name) {
  kernel.value = kernels.value.size > 1 ? of : "";
  component.value = name;
  openTab("Log");
}

export function Log() {
  useEffect(() => {
    open = true;
    return () => {
      open = false;
      say({ t: "log", on: false });
    };
  }, []);
  // Not before there is a connection; and anew when another choice is made.
  useEffect(() => { if (connection.value === "live") subscribe(); }, [level.value, component.value, kernel.value]);
  const names = [...new Set([...boxes.value.values()].filter((box) => !kernel.value || box.kernel === kernel.value).map((box) => box.name))].sort();
  const shown = drawn.value;
  return html`<div class="log">
    <div class="bar">
      <${Choice} label="Level" value=${level} all=${LEVELS.map((one) => [one, one === "CRITICAL" ? one.toLowerCase() : `${one.toLowerCase()} and above`])} />
      ${kernels.value.size > 1 && html`<${Choice} label="Kernel" value=${kernel} all=${[["", "all kernels"], ...[...kernels.value.values()].map((one) => [one.address, one.name])]} />`}
      <${Choice} label="Component" value=${component} all=${[["", "all components"], ...names.map((one) => [one, one])]} />
      <button onClick=${() => { paused.value = !paused.value; }}>${paused.value ? "Resume" : "Pause"}</button>
      <button onClick=${subscribe}>Clear</button>
      <span class="quiet" role="status">${missed.value > 0 && `${count(missed.value)} lines not shown: more than can be read, or paused`}</span>
    </div>
    ${shown.length ? html`<${Rows} count=${shown.length} height=${HEIGHT} role="table" label="Log" follow=${true} row=${(/** @type {number} */ index) => html`<${Line} key=${index} line=${shown[index]} index=${index} />`} />`
      : [...kernels.value.values()].every((one) => one.state === "ended") && kernels.value.size ? html`<p class="none">What runs has ended; its log is where it was printed.</p>`
      : html`<p class="none">No line of this level yet${component.value && ` from ${component.value}`}. What a component logs is for its own level to say: <code>aiorts vlog NAME --set info</code>.</p>`}
  </div>`;
}

/** @param {{line: LogLine, index: number}} props */
function Line({ line, index }) {
  const place = PLACE.exec(line.text)?.[1] ?? (line.file ? `${line.file}${line.line ? `:${line.line}` : ""}` : "");
  return html`<div class=${`line ${line.level.toLowerCase()}`} role="row" aria-rowindex=${index + 1} onClick=${rowLeads(line.kernel, line.component)}>
    <span class="when" role="cell">${moment(line.at_ns)}</span><span class="level" role="cell">${line.level}</span>
    <span class="who" role="cell"><${Lead} kernel=${line.kernel} component=${line.component} /></span>
    <span class="what" role="cell" tabindex="0"><${Cut} text=${line.text} /></span><span class="where" role="cell">${place && html`<button class="lead" title="Copy the place" onClick=${() => void copy(place)}><${Cut} text=${place.split("/").pop() ?? ""} /></button>`}</span>
  </div>`;
}

/** @param {{label: string, value: import("../vendor/preact-signals.js").Signal<string>, all: string[][]}} props */
export function Choice({ label, value, all }) {
  return html`<label class="choice"><span>${label}</span><select value=${value.value} onChange=${(/** @type {Event} */ { target }) => { value.value = /** @type {HTMLSelectElement} */ (target).value; }}>
    ${all.map(([one, words]) => html`<option key=${one} value=${one} selected=${one === value.value}>${words}</option>`)}</select></label>`;
}
