/**
 * The things that the server speaks of, and its messages. Ids are the server's: they stay as long as the thing exists.
 *
 * @typedef {{name: string, address: string, host: string, pid: number, state: "live" | "silent" | "ended", why: string,
 *   since_s: number, simulated: boolean, round_trip_ms: number | null}} Kernel
 *
 * @typedef {{id: number, kind: "kernel" | "context" | "process" | "composite" | "host", kernel: string, name: string,
 *   said: string, x: number, y: number, w: number, h: number, parent: number | null, folded: boolean}} Frame
 *
 * @typedef {{name: string, side: "in" | "out", kind: "data" | "service", type: string, unit: string, y: number}} Port
 *
 * @typedef {{message: string, file?: string, line?: number, at_ns?: number | string}} Failure
 *
 * @typedef {{id: number, kernel: string, name: string, type: string, kind: "component" | "folded" | "remote",
 *   state: string, said: string, error: Failure | null, infrastructure: boolean, frame: number | null, around: number | null, x: number,
 *   y: number, w: number, h: number, ports: Port[], members?: string[]}} Box
 * `members` are the components that a folded box stands for.
 *
 * @typedef {[number, number]} Point
 *
 * @typedef {{id: number, kernel: string, name: string, from: [number, string], to: [number, string], points: Point[],
 *   label: Point, policy: string, state: "up" | "down" | "waiting", why?: string, link: boolean,
 *   bundle: number}} Edge
 *
 * Figures of an edge: rate in Hz, lost samples in all, what was dropped by reason, samples that wait, lost per second, age and
 * round trip in ms. null: not known. `lossy` alone is known in the far view.
 * @typedef {{rate: number | null, dropped: number, backlog: number, loss: number, reasons: Record<string, number> | null,
 *   age: number | null, trip: number | null, lossy: boolean}} EdgeFigures
 *
 * Figures of a frame: lateness (p99) in ms, overruns, and which component caused most of them.
 * @typedef {{late: number | null, overruns: number, who: string}} FrameFigures
 *
 * A kernel as a whole, also what is folded: samples a second, lost samples in all, what has failed, and what loses samples.
 * @typedef {{components: number, connectors: number, rate: number | null, dropped: number, failed: [string, string, number | null][],
 *   lossy: [string, string, number, string[], "box" | "edge", number | null][]}} Total
 *
 * @typedef {{kind: "box" | "port" | "edge" | "frame" | "kernel", id: number | string}} Selection
 * Of a kernel the id is its address, of a port what `portId` makes.
 *
 * @typedef {{kernels: Kernel[], frames: Frame[], boxes: Box[], edges: Edge[]}} Things
 * @typedef {{kernels?: string[], frames?: number[], boxes?: number[], edges?: number[]}} Gone
 * @typedef {{t: "hello", right: "view" | "operate", files: boolean, period: number, cures: [string, string][], bursts: string}} Hello
 *   cures: what helps a slow reader, in words and as it is written; bursts: what a longer buffer helps
 * @typedef {{t: "picture", missed?: number} & Things} Picture
 * @typedef {{t: "change", gone?: Gone} & Partial<Things>} Change
 * @typedef {{t: "figures", at?: Record<string, number>, e?: Record<string, any[]>, b?: Record<string, any[]>,
 *   f?: Record<string, any[]>, k?: Record<string, any[]>}} Figures
 * @typedef {{t: "answer", id: number, value?: any, problem?: {code: string, text: string}}} Answer
 * @typedef {{t: "log", lines: LogLine[], missed?: number}} Log
 * @typedef {{kernel: string, at_ns: number | string, level: string, component: string, text: string, file?: string,
 *   line?: number}} LogLine
 * @typedef {{kernel: string, at_ns: number | string, component: string, context: string, kind: string,
 *   text: string}} Happening
 * @typedef {{t: "event" | "history", items: Happening[]}} Happenings
 * @typedef {{t: "values", id: number, t0: number, columns: number[][], fields: Record<string, number[][]>, unit?: string}} Values
 * @typedef {{t: "text", id: number, value: any}} Text
 * @typedef {{t: "recording", on: boolean, file: string | null, samples: number, why: string}} Recording
 * @typedef {Hello | Picture | Change | Figures | Answer | Log | Happenings | Values | Text | Recording} Message
 */

export {};
