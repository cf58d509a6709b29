/** Plots of chosen fields over a shared time axis, with a table of the same values beside them; and recording. */
import { useLayoutEffect, useRef } from "../vendor/preact-hooks.js";
import { effect, signal } from "../vendor/preact-signals.js";
import uPlot from "../vendor/uplot.js";
import { copy, quoted } from "../commands.js";
import { openTab } from "../shell.js";
import { ask, boxes, choose, connection, files, kernels, on, right, say, tell, theme } from "../store.js";
import { count, number } from "../words.js";
import { fieldsOf } from "./fields.js";
import { Choice } from "./log.js";
import { Cut, boxOf, html } from "./parts.js";
import { came, drop, indexFrom, keyOf, seriesOf } from "./series.js";

/** @import {Port, Recording} from "../types.js" @import {Series} from "./series.js" */

/** @typedef {{series: Series, colour: number, axis: string}} Line axis: "" the one of its unit, else an axis of its own */
/** @typedef {{id: number, lines: Line[]}} Plot */

const COLOURS = 6;
/** How often plots are drawn at most, in ms. */
const EVERY_MS = 40;
/** Fields of a port that are plotted at once when it is chosen. */
const AT_ONCE = 3;
const WINDOWS = ["5", "10", "30", "60", "300"];

const plots = signal(/** @type {Plot[]} */ ([]));
const seconds = signal("30"), paused = signal(false), chosenPort = signal("");
/** Fields of the ports that were looked at, by "KERNEL PATH". */
const fields = signal(/** @type {Record<string, string[]>} */ ({}));
const recording = signal(/** @type {Recording | null} */ (null));
on("recording", (/** @type {Recording} */ message) => { recording.value = { ...message, why: message.why.replaceAll("`", "") }; });
let last = 0, colours = 0;

// -- what is plotted ---------------------------------------------------------------------------------------------------

/** Whether samples of a port can be watched. @param {Port} port */
export const canPlot = (port) => port.kind === "data";

/** Plot the first fields of a port, and show the plots. @param {string} kernel @param {string} path "component.port" @param {string} type */
export async function plot(kernel, path, type) {
  openTab("Plots");
  const found = await look(kernel, path, type);
  const some = found.length ? found.slice(0, AT_ONCE) : ["*"];
  if (some.some((field) => !isPlotted(kernel, path, field))) plots.value = [...plots.value, { id: ++last, lines: some.map((field) => line(kernel, path, field)) }];
}

/** @param {string} kernel @param {string} path @param {string} type @returns {Promise<string[]>} */
async function look(kernel, path, type) {
  const key = `${kernel} ${path}`;
  if (!fields.value[key]) {
    const { schema } = await ask(kernel, "schema", { type }).catch((/** @type {Error} */ error) => {
      tell(`${path}: ${error.message}`);
      return { schema: "{}" };
    });
    fields.value = { ...fields.value, [key]: fieldsOf(schema) };
  }
  return fields.value[key];
}

/** @param {string} kernel @param {string} path @param {string} field @returns {Line} */
const line = (kernel, path, field) => ({ series: seriesOf(kernel, path, field), colour: colours++ % COLOURS, axis: "" });

/** @param {string} kernel @param {string} path @param {string} field */
const isPlotted = (kernel, path, field) => plots.value.some((one) => one.lines.some(({ series }) => series.key === keyOf(kernel, path, field)));

/** Change the lines of a plot; one without lines goes. @param {Plot} plot @param {Line[]} lines */
function put(plot, lines) {
  plots.value = plots.value.map((one) => (one.id === plot.id ? { ...one, lines } : one)).filter((one) => one.lines.length);
}

/** @param {Plot} plot @param {Line} one */
function remove(plot, one) {
  put(plot, plot.lines.filter((each) => each !== one));
  if (!plots.value.some((each) => each.lines.some(({ series }) => series === one.series))) drop(one.series);
}

/** Move a line into a plot of its own, or from there to the plot before. @param {Plot} plot @param {Line} one */
function move(plot, one) {
  const index = plots.value.indexOf(plot), before = plots.value[index - 1];
  if (plot.lines.length === 1 && before) {
    plots.value = plots.value.filter((each) => each !== plot).map((each) => (each === before ? { ...each, lines: [...each.lines, one] } : each));
  } else if (plot.lines.length > 1) {
    const own = { id: ++last, lines: [one] };
    plots.value = plots.value.flatMap((each) => (each === plot ? [{ ...each, lines: each.lines.filter((other) => other !== one) }, own] : [each]));
  }
}

// -- the panel ---------------------------------------------------------------------------------------------------------

export function Plots() {
  return html`<div class="plots"><${Bar} /><div class="charts">
    ${plots.value.map((one) => html`<${Chart} key=${one.id} plot=${one} />`)}
    ${!plots.value.length && html`<p class="none">Choose a port above, or press Plot at a port of the selected component.</p>`}
  </div></div>`;
}

function Bar() {
  const ports = [...boxes.value.values()].flatMap((box) => (box.kind === "component" ? box.ports.filter(canPlot).map((port) => ({ box, port, path: `${box.name}.${port.name}` })) : []));
  const named = (/** @type {typeof ports[0]} */ { box, path }) => (kernels.value.size > 1 ? `${kernels.value.get(box.kernel)?.name ?? box.kernel}/${path}` : path);
  const take = (/** @type {Event} */ event) => {
    event.preventDefault();
    const found = ports.find((one) => named(one) === chosenPort.value.trim()) ?? ports.find((one) => named(one).includes(chosenPort.value.trim()));
    if (!found || !chosenPort.value.trim()) return tell("There is no such port among those that are shown; a folded frame hides its own");
    chosenPort.value = "";
    return void plot(found.box.kernel, found.path, found.port.type);
  };
  return html`<div class="bar">
    <form onSubmit=${take}><input list="ports" aria-label="Port to plot" placeholder="component.port" autocomplete="off" spellcheck="false" value=${chosenPort.value}
        onInput=${(/** @type {InputEvent} */ { target }) => { chosenPort.value = /** @type {HTMLInputElement} */ (target).value; }} />
      <datalist id="ports">${chosenPort.value.length > 0 && ports.filter((one) => named(one).includes(chosenPort.value)).slice(0, 50).map((one) => html`<option key=${named(one)} value=${named(one)}>${one.port.type}</option>`)}</datalist>
      <button>Plot</button></form>
    <${Choice} label="Window" value=${seconds} all=${WINDOWS.map((one) => [one, Number(one) < 60 ? `${one} s` : `${Number(one) / 60} min`])} />
    <button onClick=${() => { paused.value = !paused.value; tables.value++; }}>${paused.value ? "Resume" : "Pause"}</button>
    <${Record} />
  </div>`;
}

/** Why the plotted ports cannot be recorded; "" where they can. */
function whyNotRecorded() {
  if (!files.value) return recording.value?.why || "The server has no folder to write to";
  if (connection.value !== "live") return "The server is not there";
  return plots.value.length ? "" : "Plot the ports that are to be recorded";
}

function Record() {
  const now = recording.value, why = now?.on ? "" : whyNotRecorded();
  const ports = [...new Map(plots.value.flatMap((one) => one.lines.map(({ series }) => [`${series.kernel} ${series.path}`, [series.kernel, series.path]]))).values()];
  const press = () => {
    if (why) tell(why);
    else say(now?.on ? { t: "record", on: false, ports: [] } : { t: "record", on: true, ports });
  };
  const live = [...kernels.value.values()][0];
  return html`<button class=${now?.on ? "recording" : ""} aria-disabled=${Boolean(why)} aria-pressed=${now?.on ?? false} aria-describedby="record-why" onClick=${press}>${now?.on ? "Stop recording" : "Record"}</button>
    <span class="quiet" id="record-why" role="status" title=${why}>${now?.on ? `${now.file ?? ""}${now.samples ? `: ${count(now.samples)} samples` : ""}` : now?.why || (now?.file ? `${now.file}${now.samples ? `: ${count(now.samples)} samples` : ""}. Open it in Foxglove: "Open local file"` : why)}</span>
    ${live && html`<button class="aside" title="Copies the command that lets Foxglove look at what runs" onClick=${() => void copy(`aiorts foxglove ${quoted(live.name)}`)}>Open in Foxglove</button>`}`;
}

/** The choice of fields of a port, for a plot. @param {{plot: Plot}} props */
function Fields({ plot: own }) {
  const ports = [...new Map(own.lines.map(({ series }) => [`${series.kernel} ${series.path}`, series])).values()];
  const others = ports.flatMap(({ kernel, path }) => (fields.value[`${kernel} ${path}`] ?? []).filter((field) => !isPlotted(kernel, path, field)).map((field) => ({ kernel, path, field })));
  if (!others.length) return null;
  const add = (/** @type {Event} */ { target }) => {
    const select = /** @type {HTMLSelectElement} */ (target), one = others[Number(select.value)];
    if (one) put(own, [...own.lines, line(one.kernel, one.path, one.field)]);
    select.value = "";
  };
  return html`<select aria-label="Add a field" onChange=${add}><option value="">add a field…</option>${others.map((one, index) => html`<option key=${keyOf(one.kernel, one.path, one.field)} value=${index}>${nameOf(one)}</option>`)}</select>`;
}

/** @param {{path: string, field: string}} one */
const nameOf = ({ path, field }) => (field && field !== "*" ? `${path} ${field}` : path);

/** @param {{plot: Plot}} props */
function Chart({ plot: own }) {
  void tables.value;   // units come with the first values
  const host = useRef(/** @type {HTMLElement | null} */ (null)), numbers = own.lines.filter(({ series }) => series.field !== "*");
  const layout = own.lines.map((one) => `${one.series.key} ${one.axis} ${one.colour}`).join("|") + theme.value + own.lines.map((one) => one.series.unit).join();
  useLayoutEffect(() => (numbers.length && host.current ? drawn(host.current, numbers) : undefined), [layout]);
  return html`<section class="chart-of" aria-label=${`Plot of ${own.lines.map(({ series }) => nameOf(series)).join(", ")}`}>
    ${numbers.length > 0 && html`<div class="canvas" ref=${host} aria-hidden="true"></div>`}
    <${Legend} plot=${own} /></section>`;
}

/** What each line shows, as a table: for eyes the legend, for a screen reader the plot. @param {{plot: Plot}} props */
function Legend({ plot: own }) {
  void tables.value;
  return html`<div class="values"><table><thead><tr><th scope="col">field</th><th scope="col" class="figure">now</th><th scope="col" class="figure">least</th><th scope="col" class="figure">most</th></tr></thead>
    <tbody>${own.lines.map((one) => {
      const { series } = one, [least, most] = rangeOf(series), now = series.high.at(-1), box = boxOf(series.kernel, series.path.split(".")[0]);
      return html`<tr class="line-of"><th scope="row"><span class=${`swatch colour-${one.colour}`} aria-hidden="true"></span>
          <button class="lead" onClick=${() => box && choose("box", box.id)}><${Cut} text=${nameOf(series)} /></button>${series.unit && html` <span class="unit">${series.unit}</span>`}</th>
        ${series.field === "*" ? html`<td colspan="3"><${Cut} text=${series.text || series.problem || "no sample yet"} /></td>`
          : series.problem ? html`<td colspan="3" class="bad"><${Cut} text=${series.problem} /></td>`
            : html`<td class="figure">${shownNumber(now)}</td><td class="figure">${shownNumber(least)}</td><td class="figure">${shownNumber(most)}</td>`}
        </tr><tr><td class="does" colspan="4">${own.lines.length > 1 || plots.value[0] !== own ? html`<button title=${own.lines.length > 1 ? "Into a plot of its own" : "Into the plot before"} aria-label=${`Move ${nameOf(series)} ${own.lines.length > 1 ? "into a plot of its own" : "into the plot before"}`} onClick=${() => move(own, one)}>${own.lines.length > 1 ? "Split" : "Join"}</button>` : null}
          ${series.field !== "*" && own.lines.length > 1 && html`<button aria-pressed=${one.axis !== ""} title="An axis of its own" aria-label=${`${nameOf(series)}: an axis of its own`} onClick=${() => put(own, own.lines.map((each) => (each === one ? { ...one, axis: one.axis ? "" : series.key } : each)))}>Own axis</button>`}
          <button title="Remove" aria-label=${`Remove ${nameOf(series)}`} onClick=${() => remove(own, one)}>Remove</button></td></tr>`;
    })}</tbody></table><${Fields} plot=${own} /></div>`;
}

/** @param {number | undefined} value */
const shownNumber = (value) => (value === undefined || Number.isNaN(value) ? "–" : Math.abs(value) < 1e-3 && value !== 0 ? value.toExponential(2) : number(value));

/** Least and most in the window. @param {Series} series @returns {[number | undefined, number | undefined]} */
function rangeOf(series) {
  let least = Infinity, most = -Infinity;
  for (let index = indexFrom(series.times, (series.times.at(-1) ?? 0) - Number(seconds.value)); index < series.times.length; index++) {
    least = Math.min(least, series.low[index]);
    most = Math.max(most, series.high[index]);
  }
  return least > most ? [undefined, undefined] : [least, most];
}

/** Counts twice a second, as long as values come and are not paused: how often the tables change. */
const tables = signal(0);
let tableTimer = 0;
effect(() => {
  void came.value;
  if (!paused.value) tableTimer ||= window.setTimeout(() => {
    tableTimer = 0;
    tables.value++;
  }, 500);
});

// -- drawing -----------------------------------------------------------------------------------------------------------

/** Draw lines in a node as values come. @param {HTMLElement} node @param {Line[]} lines @returns {() => void} ends it */
function drawn(node, lines) {
  const styles = getComputedStyle(node), colour = (/** @type {string} */ name) => styles.getPropertyValue(`--${name}`).trim();
  const scaleOf = (/** @type {Line} */ one) => one.axis || `unit ${one.series.unit}`, scales = [...new Set(lines.map(scaleOf))];
  const axis = { stroke: colour("quiet"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false }, font: `11px ${styles.fontFamily}`, gap: 4 };
  /** @type {uPlot.Options} */
  const options = {
    width: Math.max(120, node.clientWidth), height: Math.max(80, node.clientHeight), legend: { show: false },
    cursor: { sync: { key: "time" }, drag: { x: false, y: false }, points: { show: false } },
    // The shared axis: all plots end at the newest value of any.
    scales: { x: { time: false, range: () => [newest() - Number(seconds.peek()), newest()] }, ...Object.fromEntries(scales.map((one) => [one, {}])) },
    axes: [
      { ...axis, size: 24, splits: (_plot, _axis, least, most) => ticks(least, most), values: (plot, at) => at.map((one) => shortTime(one - (plot.scales.x.max ?? 0))) },
      ...scales.map((scale, index) => {
        const of = lines.filter((one) => scaleOf(one) === scale), unit = of[0].series.unit;
        return { ...axis, scale, side: index % 2 ? 1 : 3, size: 52, grid: index ? { show: false } : axis.grid, ...(scales.length > 1 && of.length === 1 && { stroke: colour(`plot-${of[0].colour}`) }),
          ...(unit && { label: unit, labelSize: 18, labelFont: axis.font, labelGap: 0 }) };
      }),
    ],
    series: [{}, ...lines.flatMap((one) => {
      const stroke = colour(`plot-${one.colour}`), scale = scaleOf(one);
      return [{ scale, stroke, width: 1.5, points: { show: false }, spanGaps: true }, { scale, stroke, width: 1.5, points: { show: false }, spanGaps: true }];
    })],
    bands: lines.map((one, index) => ({ series: /** @type {[number, number]} */ ([2 * index + 2, 2 * index + 1]), fill: colour(`plot-${one.colour}`) })),
  };
  const plot = new uPlot(options, dataOf(lines), node);
  const sized = new ResizeObserver(() => plot.setSize({ width: Math.max(120, node.clientWidth), height: Math.max(80, node.clientHeight) }));
  sized.observe(node);
  let timer = 0, frame = 0;
  const stop = effect(() => {
    void came.value;
    void seconds.value;
    if (paused.value || timer) return;
    timer = window.setTimeout(() => {
      timer = 0;
      frame = requestAnimationFrame(() => plot.setData(dataOf(lines), true));
    }, EVERY_MS);
  });
  return () => {
    stop();
    window.clearTimeout(timer);
    cancelAnimationFrame(frame);
    sized.disconnect();
    plot.destroy();
  };
}

/** The newest time of all plots. */
const newest = () => Math.max(0, ...plots.peek().flatMap((one) => one.lines.map(({ series }) => series.times.at(-1) ?? 0)));

const STEPS_S = [1, 2, 5, 10, 20, 60];

/** Times that are whole seconds before the newest one. @param {number} least @param {number} most */
function ticks(least, most) {
  const step = STEPS_S.find((one) => (most - least) / one <= 8) ?? 60, found = [];
  for (let at = most; at >= least; at -= step) found.unshift(at);
  return found;
}

/** @param {number} value seconds before the newest */
const shortTime = (value) => (Math.abs(value) < 1e-6 ? "now" : `−${Math.round(-value)} s`);

/** The columns in the window, of all lines over one axis of times. @param {Line[]} lines @returns {uPlot.AlignedData} */
function dataOf(lines) {
  const from = newest() - Number(seconds.peek());
  const tables = lines.map(({ series }) => {
    const first = Math.max(0, indexFrom(series.times, from) - 1);
    return /** @type {uPlot.AlignedData} */ ([series.times.slice(first), series.high.slice(first), series.low.slice(first)]);
  });
  return tables.length === 1 ? tables[0] : uPlot.join(tables);
}
