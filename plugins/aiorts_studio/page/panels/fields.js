/** Which fields of a port's samples are numbers: from the schema of its type. Pure. */

/** Elements of a sequence that are offered one by one. */
const ELEMENTS = 16;
/** How many fields of one type are offered, and how deep inside one another they may be. */
const MOST = 200, DEEPEST = 6;

/** @typedef {{type?: string | string[], properties?: Record<string, Schema>, prefixItems?: Schema[], items?: Schema | false, $ref?: string,
 *   $defs?: Record<string, Schema>, anyOf?: Schema[], minItems?: number, maxItems?: number, "x-array"?: {dimensions?: number}}} Schema */

/** @param {string} text the JSON schema of frames @returns {string[]} paths inside the data; "" is the data itself */
export function fieldsOf(text) {
  /** @type {Schema} */
  const whole = JSON.parse(text), sample = whole.prefixItems?.[2] ?? whole, found = /** @type {string[]} */ ([]);
  const data = resolved(sample, whole).properties?.data ?? sample;
  walk(resolved(data, whole), "", 0);
  return found.slice(0, MOST);

  /** @param {Schema} schema @param {string} path @param {number} depth */
  function walk(schema, path, depth) {
    if (depth > DEEPEST || found.length > MOST) return;
    const inside = (/** @type {string | number} */ name) => (path ? `${path}.${name}` : String(name));
    const types = [schema.type ?? []].flat();
    if (schema["x-array"]?.dimensions === 1) for (let index = 0; index < ELEMENTS; index++) found.push(inside(index));
    if (types.some((one) => one === "number" || one === "integer" || one === "boolean")) found.push(path);
    for (const [name, one] of Object.entries(schema.properties ?? {})) if (name !== "tm") walk(resolved(one, whole), inside(name), depth + 1);
    if (schema.prefixItems) schema.prefixItems.forEach((one, index) => walk(resolved(one, whole), inside(index), depth + 1));
    else if (schema.items) for (let index = 0; index < Math.min(ELEMENTS, schema.maxItems ?? ELEMENTS); index++) walk(resolved(schema.items, whole), inside(index), depth + 1);
    for (const one of schema.anyOf ?? []) if (!found.includes(path)) walk(resolved(one, whole), path, depth + 1);
  }
}

/** @param {Schema} schema @param {Schema} whole @returns {Schema} */
function resolved(schema, whole) {
  const name = schema.$ref?.split("/").pop();
  return (name && whole.$defs?.[name]) || schema;
}
