/** A component in full: profile, connectors, ports, parameters, services, state chart, last error and last lines. */
import { commandsOf, copy, named, quoted } from "../commands.js";
import { boxFigures, boxes, choose, edges, figures, kernels, portId } from "../store.js";
import { count, endsOf, kernelTrouble, number, portKind, reasonsOf } from "../words.js";
import { useAnswer } from "./asked.js";
import { StateChart } from "./chart.js";
import { Commands, CopyIcon } from "./as_commands.js";
import { showLog } from "./log.js";
import { Cut, html, moment, said } from "./parts.js";
import { canPlot, plot } from "./plots.js";
import { Timing } from "./timing.js";
import { lostOn } from "./troubles.js";

/** @import {Box, Edge} from "../types.js" */

const EVERY_MS = 1500;
/** Letters of a value from which on it has a line of its own. */
const LONG = 12;

/** @param {{box: Box}} props */
export function ComponentPart({ box }) {
  const remote = box.kind === "remote";
  const { value, problem } = useAnswer(box.kernel, remote ? "names" : "part", remote ? {} : { components: [box.name] }, remote ? 0 : EVERY_MS);
  const report = remote ? undefined : value?.components?.[box.name], kernel = kernels.value.get(box.kernel);
  const { state, said: words } = boxFigures.value.get(box.id) ?? box;
  const trouble = kernel ? kernelTrouble(kernel, kernel.since_s) : "";
  return html`<h2><${Cut} text=${box.name} /></h2>
    <p class="quiet type">${report?.type ?? box.type}</p>
    <p class="pills"><span class=${`pill is-${state}`}>${state}</span>${trouble && html`<span class="pill is-silent">${kernel?.name}: ${trouble}</span>`}
      ${box.infrastructure && html`<span class="pill plain">infrastructure</span>`}</p>
    ${words && html`<p class="bad">${words}</p>`}
    ${report?.doc && html`<p class="doc">${report.doc.split("\n\n")[0].replaceAll("`", "")}</p>`}
    ${problem && !trouble && html`<p class="quiet" role="status">${problem}</p>`}
    <${LastError} box=${box} text=${report?.last_error ?? ""} />
    ${report && html`<${Timing} box=${box} contexts=${Object.keys(report.states)} />`}
    <${Connectors} box=${box} />
    ${report?.machine && html`<${StateChart} kernel=${box.kernel} component=${box.name} machine=${report.machine} />`}
    ${report?.modes && html`<section><h3 class="over">Modes</h3><p class="pills">${report.modes.modes.map((/** @type {string} */ one) => html`
      <span key=${one} class=${`pill ${one === report.modes.mode ? "lit" : "plain"}`} aria-current=${one === report.modes.mode}>${one}</span>`)}</p></section>`}
    <${Ports} box=${box} ports=${report?.ports ?? {}} />
    ${report && html`<${Parameters} box=${box} report=${report} />`}
    ${report && html`<${Calls} calls=${report.calls} />`}
    ${report?.composite && html`<section><h3 class="over">Members</h3><p class="doc">${report.composite.members.join(", ")}</p></section>`}
    ${report?.log?.length > 0 && html`<section><h3 class="over">Last lines</h3><p><button onClick=${() => showLog(box.kernel, box.name)}>Log of ${box.name}</button></p><ul class="last-lines">${report.log.slice(-5).map((/** @type {any} */ line, /** @type {number} */ index) => html`
      <li key=${index} class=${line.level.toLowerCase()}><b>${line.level}</b> ${line.text}</li>`)}</ul></section>`}
    <${Commands} commands=${commandsOf({ kind: "box", id: box.id }, firstParameter(box, report))} />`;
}

/** The command that changes the first parameter; "" without one, undefined as long as that is not known. @param {Box} box @param {any} report */
function firstParameter(box, report) {
  if (!report) return undefined;
  const [first] = Object.entries(/** @type {Record<string, any>} */ (report.params ?? {}));
  return first ? setting(box, first[0], said(first[1].value)) : "";
}

/** @param {{box: Box, text: string}} props */
function LastError({ box, text }) {
  const message = box.error?.message || text;
  if (!message) return null;
  const where = box.error?.file ? `${box.error.file}${box.error.line ? `:${box.error.line}` : ""}` : "";
  return html`<section class="failure" aria-label="Last error"><h3 class="over">Last error${box.error?.at_ns !== undefined && html` <span>at ${moment(box.error.at_ns)}</span>`}</h3><p>${message}</p>
    ${where && html`<p><button class="lead" onClick=${() => void copy(where)} title="Copy the place"><code>${where}</code></button></p>`}</section>`;
}

/** @param {{box: Box}} props */
function Connectors({ box }) {
  const own = [...edges.value.values()].filter((edge) => edge.from[0] === box.id || edge.to[0] === box.id);
  own.sort((a, b) => Number(a.from[0] === box.id) - Number(b.from[0] === box.id));
  return html`<${ConnectorTable} box=${box} own=${own} none="None of its ports is connected." />`;
}

/** Connectors as one end of them sees them. @param {{box: Box, own: Edge[], none: string}} props none: what is said where there are none */
export function ConnectorTable({ box, own, none }) {
  if (!own.length) return html`<section><h3 class="over">Connectors</h3><p class="quiet">${none}</p></section>`;
  return html`<section><h3 class="over">Connectors</h3><table class="connectors"><thead><tr><th scope="col">to, from</th><th scope="col" class="figure">rate</th><th scope="col" class="figure">lost</th></tr></thead>
    <tbody>${own.map((edge) => html`<${ConnectorRow} key=${edge.id} edge=${edge} box=${box} />`)}</tbody></table></section>`;
}

/** @param {{edge: Edge, box: Box}} props */
function ConnectorRow({ edge, box }) {
  const row = figures.value.get(edge.id), outward = edge.from[0] === box.id, [from, to] = endsOf(edge, boxes.value);
  const lost = lostOn(edge.id, row), words = outward ? `${edge.from[1]} → ${to}` : `${edge.to[1]} ← ${from}`, service = isService(box, outward ? edge.from[1] : edge.to[1]);
  return html`<tr class="whole"><td colspan="3"><button class="lead" onClick=${() => choose("edge", edge.id)}><${Cut} text=${words} /></button></td></tr>
    <tr class="under"><td><small>${edge.state === "up" ? edge.policy : edge.state}</small></td>
    <td class="figure">${service || row?.rate === null || row?.rate === undefined ? "–" : `${number(row.rate)} Hz`}${row?.backlog ? html`<small>${count(row.backlog)} wait</small>` : null}</td>
    <td class=${`figure ${lost ? "bad" : ""}`}>${service || lost === null ? "–" : count(lost)}<small>${reasonsOf(row?.reasons ?? null).lost.map(([why]) => why).join(", ")}</small></td></tr>`;
}

/** @param {Box} box @param {string} port */
const isService = (box, port) => box.ports.some((one) => one.name === port && one.kind === "service");

/** @param {{box: Box, ports: Record<string, any>}} props ports: as the kernel reports them */
function Ports({ box, ports }) {
  if (!box.ports.length) return null;
  return html`<section><h3 class="over">Ports</h3><table class="ports"><tbody>${box.ports.map((port) => {
    const report = ports[port.name], shape = report?.shape ? ` ${said(report.shape)}` : "", path = `${box.name}.${port.name}`;
    return html`<tr key=${port.name}><td><span class=${`mark ${port.kind} ${port.side}`} aria-hidden="true"></span>${box.kind === "folded" ? html`<${Cut} text=${port.name} class="name" />`
        : html`<button class="lead" onClick=${() => choose("port", portId(box.id, port.name))}><${Cut} text=${port.name} class="name" /></button>`}
        <small>${report?.doc || portKind(port)}</small></td>
      <td class="figure"><${Cut} text=${`${port.type}${shape}`} /><small>${port.unit}${report?.interfaces?.length ? report.interfaces.map((/** @type {any} */ one) => one.name).join(", ") : ""}</small></td>
      <td class="does">${canPlot(port) && html`<button onClick=${() => plot(box.kernel, path, port.type)} aria-label=${`Plot ${path}`}>Plot</button>`}</td></tr>`;
  })}</tbody></table></section>`;
}

/** @param {{box: Box, report: any}} props */
function Parameters({ box, report }) {
  const all = Object.entries(report.params ?? {}), sets = Object.keys(report.configuration?.sets ?? {});
  if (!all.length) return null;
  return html`<section><h3 class="over">Parameters${sets.length > 1 && html` <span>of set ${report.configuration.active} (also ${sets.filter((one) => one !== report.configuration.active).join(", ")})</span>`}</h3>
    <table><tbody>${all.map(([name, one]) => {
      const value = said(one.value), changed = JSON.stringify(one.value) !== JSON.stringify(one.default), limits = constraint(one);
      const shown = html`<button class=${`value ${changed ? "changed" : ""}`} title=${`${changed ? `The default is ${said(one.default)}. ` : ""}Copies the command that sets it`}
          onClick=${() => void copy(setting(box, name, value))}><span class="whole" data-full=${value}>${value === "" ? "“”" : value}</span>${one.unit && html` <span class="unit">${one.unit}</span>`}<${CopyIcon} /></button>
        <small>${limits || one.type}</small>`;
      const says = html`<${Cut} text=${name} class="name" /><small>${one.doc}</small>`;
      if (value.length <= LONG) return html`<tr key=${name}><td>${says}</td><td class="figure">${shown}</td></tr>`;
      return html`<tr key=${name} class="whole"><td colspan="2">${says}</td></tr><tr key=${`${name} `} class="under long"><td colspan="2">${shown}</td></tr>`;
    })}</tbody></table></section>`;
}

/** The command that sets a parameter. @param {Box} box @param {string} name @param {string} value */
const setting = (box, name, value) => `aiorts conf ${named(box.kernel, box.name)} ${quoted(`${name}=${value}`)}`;

/** What a value may be, in words. @param {any} one */
function constraint(one) {
  const low = one.ge ?? one.gt, high = one.le ?? one.lt;
  if (low !== null && low !== undefined && high !== null && high !== undefined) return `${one.ge !== null ? "" : "above "}${said(low)} to ${one.le !== null ? "" : "below "}${said(high)}`;
  if (low !== null && low !== undefined) return `${one.ge !== null ? "at least" : "above"} ${said(low)}`;
  if (high !== null && high !== undefined) return `${one.le !== null ? "at most" : "below"} ${said(high)}`;
  return one.choices?.length ? one.choices.map((/** @type {unknown} */ each) => said(each) || "“”").join(" | ") : one.pattern ?? one.allowed ?? "";
}

/** @param {{calls: Record<string, any>}} props calls: by port or interface */
function Calls({ calls }) {
  const all = Object.entries(calls ?? {});
  if (!all.length) return null;
  return html`<section><h3 class="over">Calls of services</h3><table><thead><tr><th scope="col">interface</th><th scope="col" class="figure">calls</th><th scope="col" class="figure">failed</th></tr></thead>
    <tbody>${all.map(([name, one]) => {
      const bad = (one.failures ?? 0) + (one.timeouts ?? 0) + (one.refused ?? 0), mean = one.calls ? one.total_ns / one.calls / 1e6 : 0;
      return html`<tr key=${name}><td><${Cut} text=${name} /></td><td class="figure">${count(one.calls ?? 0)}<small>${one.calls ? `${number(mean)} ms each` : ""}</small></td>
        <td class=${`figure ${bad ? "bad" : ""}`}>${count(bad)}</td></tr>`;
    })}</tbody></table></section>`;
}
