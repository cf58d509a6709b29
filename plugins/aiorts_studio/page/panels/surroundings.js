/** A frame or a kernel in full. */
import { commandsOf } from "../commands.js";
import { at, boxes, choose, edges, frameFigures, kernels } from "../store.js";
import { count, hasEnded, kernelTrouble, number } from "../words.js";
import { useAnswer } from "./asked.js";
import { Commands } from "./as_commands.js";
import { Figure } from "./connector.js";
import { Cut, Lead, counted, html } from "./parts.js";

/** @import {Box, Frame, Kernel} from "../types.js" */

/** @param {{frame: Frame}} props */
export function FramePart({ frame }) {
  const kernel = kernels.value.get(frame.kernel);
  if (frame.kind === "kernel" && kernel) return html`<${KernelPart} kernel=${kernel} />`;
  const context = frame.kind === "context" && frame.name !== "", row = frameFigures.value.get(frame.id);
  const { value } = useAnswer(frame.kernel, context ? "part" : "names", context ? { contexts: [frame.name] } : {}, context ? 1500 : 0);
  const report = context ? value?.contexts?.[frame.name]?.statistics : undefined, blame = report?.last_blame;
  const timed = report?.policy !== "";   // a context without a rate is never late
  const missed = Object.entries(/** @type {Record<string, number>} */ (report?.missed ?? {})).sort((a, b) => b[1] - a[1]);
  return html`<h2><${Cut} text=${frame.name || "in no context"} /></h2><p class="quiet">${frame.kind}${frame.said && `, ${frame.said}`}</p>
    ${report && html`<section><h3 class="over">${timed ? "How punctual it is" : "What it has done"}</h3><table><tbody>
      <${Figure} name="cycles" value=${report.cycles} whole=${true} />
      ${timed && html`<${Figure} name="late, half of them" value=${report.lateness_p50_ns / 1e6} unit="ms" />
      <${Figure} name="late, 99 of 100" value=${report.lateness_p99_ns / 1e6} unit="ms" /><${Figure} name="late, the worst" value=${report.lateness_max_ns / 1e6} unit="ms" />
      <${Figure} name="overruns" value=${report.overruns ?? row?.overruns} whole=${true} bad=${report.overruns > 0} /><${Figure} name="cycles left out" value=${report.skipped} whole=${true} bad=${report.skipped > 0} />`}
      </tbody></table></section>`}
    ${missed.length > 0 && html`<section class="failure"><h3 class="over">Who was late</h3><ul class="plain">${missed.slice(0, 8).map(([who, times]) => html`<li key=${who}>
      <${Late} kernel=${frame.kernel} who=${who} times=${times} /></li>`)}</ul>
      ${blame?.file && html`<p class="quiet">last at <code>${blame.file.split("/").pop()}:${blame.line}</code>, held for ${number(blame.held_ns / 1e6)} ms</p>`}</section>`}
    <${Members} members=${[...boxes.value.values()].filter((box) => box.around === frame.id)} />
    <${Commands} commands=${commandsOf({ kind: "frame", id: frame.id })} />`;
}

/** @param {{kernel: string, who: string, times: number}} props who: as the kernel blames, "comp.on_execute (file.py:3)" */
function Late({ kernel, who, times }) {
  const name = /^([\w-]+)\.\w+ \(/.exec(who)?.[1];
  return html`<b>${count(times)}</b> <span>${who}</span>${name && html` <${Lead} kernel=${kernel} component=${name} />`}`;
}

/** @param {{members: Box[]}} props */
function Members({ members }) {
  if (!members.length) return null;
  return html`<section><h3 class="over">${counted(members.length, "component")}</h3><ul class="plain">${members.slice(0, 200).map((box) => html`<li key=${box.id}>
    <button class="lead" onClick=${() => choose("box", box.id)}><${Cut} text=${box.name} /></button></li>`)}</ul></section>`;
}

/** @param {{kernel: Kernel}} props */
export function KernelPart({ kernel }) {
  const trouble = kernelTrouble(kernel, kernel.since_s), own = [...boxes.value.values()].filter((box) => box.kernel === kernel.address && box.kind !== "remote");
  const ends = (/** @type {import("../types.js").Edge} */ edge) => [edge.from, edge.to].map(([id]) => boxes.value.get(id)?.kernel);
  const rows = [["address", kernel.address], ["host", kernel.host], ["process", String(kernel.pid)], ["time", kernel.simulated ? `simulated: ${number((at.value[kernel.address] ?? 0) / 1e9)} s` : "of this machine"],
    ["round trip", kernel.round_trip_ms === null ? "–" : `${number(kernel.round_trip_ms)} ms`],
    ["components", count(own.reduce((sum, box) => sum + (box.members?.length ?? 1), 0))], ["connectors", count([...edges.value.values()].filter((edge) => ends(edge).includes(kernel.address)).length)]];
  return html`<h2><${Cut} text=${kernel.name} /></h2><p class="quiet">kernel</p>
    <p class="pills"><span class=${`pill ${kernel.state === "live" ? "is-active" : hasEnded(kernel) ? "plain" : "is-silent"}`}>${kernel.state === "live" ? "live" : trouble}</span></p>
    ${kernel.why && !hasEnded(kernel) && html`<p class="bad">${kernel.why}</p>`}
    ${kernel.state === "silent" && html`<p class="doc">Its process has not answered. What is shown of it is old; it is picked up again as soon as it answers.</p>`}
    <section><table><tbody>${rows.map(([name, value]) => html`<tr key=${name}><td>${name}</td><td class="figure"><${Cut} text=${value} /></td></tr>`)}</tbody></table></section>
    <${Commands} commands=${commandsOf({ kind: "kernel", id: kernel.address })} />`;
}
