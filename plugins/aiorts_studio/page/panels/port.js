/** A port in full: its type, what is connected to it, and the commands for it. */
import { commandsOf } from "../commands.js";
import { choose, edges, portId } from "../store.js";
import { portKind } from "../words.js";
import { Commands } from "./as_commands.js";
import { useAnswer } from "./asked.js";
import { ConnectorTable } from "./component.js";
import { Cut, html, said } from "./parts.js";
import { canPlot, plot } from "./plots.js";

/** @import {Box, Port} from "../types.js" */

const EVERY_MS = 1500;

/** @param {{box: Box, port: Port}} props */
export function PortPart({ box, port }) {
  const known = box.kind === "component", path = `${box.name}.${port.name}`;
  const { value, problem } = useAnswer(box.kernel, known ? "part" : "names", known ? { components: [box.name] } : {}, known ? EVERY_MS : 0);
  const report = known ? value?.components?.[box.name]?.ports?.[port.name] : undefined;
  const own = [...edges.value.values()].filter(({ from, to }) => portId(...(port.side === "out" ? from : to)) === portId(box.id, port.name));
  return html`<h2><${Cut} text=${path} /></h2>
    <p class="quiet">${portKind(port)}</p>
    ${report?.doc && html`<p class="doc">${report.doc}</p>`}
    ${problem && html`<p class="quiet" role="status">${problem}</p>`}
    <section><table><tbody>
      <tr><td>component</td><td class="figure"><button class="lead" onClick=${() => choose("box", box.id, { focus: true })}><${Cut} text=${box.name} /></button></td></tr>
      ${port.type && html`<tr><td>type</td><td class="figure"><${Cut} text=${port.type} /></td></tr>`}
      ${report?.shape && html`<tr><td>shape</td><td class="figure"><${Cut} text=${said(report.shape)} /></td></tr>`}
      ${port.unit && html`<tr><td>unit</td><td class="figure"><${Cut} text=${port.unit} /></td></tr>`}
      ${report?.interfaces?.map((/** @type {any} */ one) => html`<tr key=${one.name}><td>${one.polarity}</td><td class="figure"><${Cut} text=${one.name} /></td></tr>`)}
    </tbody></table></section>
    ${canPlot(port) && known && html`<p class="pills"><button onClick=${() => plot(box.kernel, path, port.type)} aria-label=${`Plot ${path}`}>Plot</button></p>`}
    <${ConnectorTable} box=${box} own=${own} none="It is not connected." />
    <${Commands} commands=${commandsOf({ kind: "port", id: portId(box.id, port.name) })} />`;
}
