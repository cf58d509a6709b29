/** Sizes of the scene's text: as painted it is never smaller than 11 px; below scale FAR a canvas draws everything. */

const FAMILY = '"Segoe UI", Inter, Roboto, "Noto Sans", "Liberation Sans", Arial, sans-serif';
const PAINTED = 11;

/** @typedef {{name: number, text: number, title: number}} Sizes in px at scale 1 */

export const FAR = 0.6;
export const FAR_TEXT = `600 11.5px ${FAMILY}`;
export const FAR_PORT = `11px ${FAMILY}`;

const USUAL = { name: 14.5, text: 13.5, title: 15 };
/** Scales below which text is made larger, to what fits the next one: few steps, since each draws all boxes anew. */
const STEPS = [FAR, 0.66, 0.73, PAINTED / USUAL.text];

/** The sizes for a scale of FAR or more. @param {number} scale @returns {Sizes} */
export function sizesAt(scale) {
  const low = STEPS.findLast((one) => one <= scale) ?? FAR, least = low === STEPS.at(-1) ? 0 : PAINTED / low + 0.05;
  return { name: Math.max(USUAL.name, least), text: Math.max(USUAL.text, least), title: Math.max(USUAL.title, least) };
}

/** A font as CSS says it. @param {number} size @param {boolean} [strong] */
export const font = (size, strong = false) => `${strong ? "600 " : ""}${size}px ${FAMILY}`;
