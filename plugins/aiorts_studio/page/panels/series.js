/** The values that plots show: one watch a port, its fields as columns of minimum and maximum. */
import { signal } from "../vendor/preact-signals.js";
import { on, say } from "../store.js";

/** @import {Answer, Text, Values} from "../types.js" */

/** Columns that a field keeps: the longest window at the finest. */
const KEPT = 30_000;
const COLUMNS_PER_S = 50;

/**
 * A field that is watched. `times` in seconds of the kernel's clock, `low` and `high` of each column; the newest value.
 * @typedef {{key: string, kernel: string, path: string, field: string, times: number[], low: number[], high: number[], unit: string, problem: string, text: string}} Series
 */

/** @type {Map<string, Series>} */
const all = new Map();
/** Watches by number, and the number of each port's. @type {Map<number, {kernel: string, path: string, fields: string[]}>} */
const watches = new Map();
/** @type {Map<string, number>} */
const numbers = new Map();
let last = 0;
/** Counts what has come, for those who draw it. */
export const came = signal(0);

/** @param {string} kernel @param {string} path @param {string} field */
export const keyOf = (kernel, path, field) => `${kernel} ${path} ${field}`;

/** The values of a field from now on. @param {string} kernel @param {string} path @param {string} field a path; "" the data itself; "*" the whole value as text */
export function seriesOf(kernel, path, field) {
  const key = keyOf(kernel, path, field);
  let found = all.get(key);
  if (!found) {
    found = { key, kernel, path, field, times: [], low: [], high: [], unit: "", problem: "", text: "" };
    all.set(key, found);
    watch(kernel, path);
  }
  return found;
}

/** @param {Series} series */
export function drop(series) {
  if (all.delete(series.key)) watch(series.kernel, series.path);
}

/** Watch all wanted fields of a port, by one watch in place of the one before. @param {string} kernel @param {string} path */
function watch(kernel, path) {
  const port = `${kernel} ${path}`, before = numbers.get(port);
  if (before !== undefined) {
    say({ t: "unwatch", id: before });
    watches.delete(before);
    numbers.delete(port);
  }
  const fields = [...all.values()].filter((one) => one.kernel === kernel && one.path === path).map((one) => one.field);
  if (!fields.length) return;
  const id = ++last;
  numbers.set(port, id);
  watches.set(id, { kernel, path, fields });
  ask(id);
}

/** @param {number} id */
function ask(id) {
  const one = watches.get(id);
  if (one) say({ t: "watch", id, kernel: one.kernel, path: one.path, fields: one.fields.filter((field) => field !== "*"), columns_per_s: COLUMNS_PER_S });
}
on("hello", () => { for (const id of watches.keys()) ask(id); });

/** @param {number} id @param {string} field */
function of(id, field) {
  const one = watches.get(id);
  return one && all.get(keyOf(one.kernel, one.path, field));
}

on("values", (/** @type {Values} */ { id, t0, columns, fields, unit }) => {
  const one = watches.get(id);
  if (!one) return;
  const named = Object.entries(fields ?? {});
  if (!named.length && columns?.length) named.push([one.fields[0], columns]);
  for (const [field, news] of named) {
    const series = of(id, field);
    if (!series) continue;
    series.unit = unit ?? series.unit;
    series.problem = "";
    for (const [time, low, high] of news) {
      series.times.push(t0 + time);
      series.low.push(Number(low));
      series.high.push(Number(high));
    }
    if (series.times.length > 1.2 * KEPT) for (const list of [series.times, series.low, series.high]) list.splice(0, list.length - KEPT);
  }
  came.value++;
});
on("text", (/** @type {Text} */ { id, value }) => {
  const series = of(id, "*");
  if (series) series.text = JSON.stringify(value);
  came.value++;
});
// The server answers a watch that cannot be by its number.
on("answer", (/** @type {Answer & {watch?: number}} */ { watch: id, problem }) => {
  if (id === undefined || !problem) return;
  for (const field of watches.get(id)?.fields ?? []) {
    const series = of(id, field);
    if (series) series.problem = problem.text;
  }
  came.value++;
});

/** The first column that is not before a time, by halving. @param {number[]} times @param {number} from */
export function indexFrom(times, from) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < from) low = middle + 1;
    else high = middle;
  }
  return low;
}
