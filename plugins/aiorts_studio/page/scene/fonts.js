/** Sizes of the scene's text: as painted it is never smaller than 11 px; below a scale a canvas draws everything. */

const FAMILY = '"Segoe UI", Inter, Roboto, "Noto Sans", "Liberation Sans", Arial, sans-serif';
const PAINTED = 11;

/** @typedef {{name: number, text: number, title: number, type: boolean}} Sizes in px at scale 1; whether the type of a box has room */

export const FAR = 0.6;
/** A system this small is drawn in full down to a smaller scale, where text has to be as high as a row of ports. */
const SMALL = 80, FAR_OF_SMALL = 0.48;
/** The scale below which a canvas draws so many boxes. @param {number} boxes */
export const farBelow = (boxes) => (boxes <= SMALL ? FAR_OF_SMALL : FAR);
export const FAR_TEXT = `600 11.5px ${FAMILY}`;
export const FAR_PORT = `11px ${FAMILY}`;

const USUAL = { name: 14.5, text: 13.5, title: 15 };
/** Scales below which text is made larger, to what fits the next one: few steps, since each draws all boxes anew. */
const STEPS = [FAR_OF_SMALL, 0.54, FAR, 0.66, 0.73, PAINTED / USUAL.text];

/** The sizes for a scale of FAR or more. @param {number} scale @returns {Sizes} */
export function sizesAt(scale) {
  const low = STEPS.findLast((one) => one <= scale) ?? FAR_OF_SMALL, least = low === STEPS.at(-1) ? 0 : PAINTED / low + 0.05;
  return { name: Math.max(USUAL.name, least), text: Math.max(USUAL.text, least), title: Math.max(USUAL.title, least), type: low >= FAR };
}

/** A font as CSS says it. @param {number} size @param {boolean} [strong] */
export const font = (size, strong = false) => `${strong ? "600 " : ""}${size}px ${FAMILY}`;
