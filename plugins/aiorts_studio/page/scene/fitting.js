/** Cuts names to the room that there is. Widths are measured once a font and character. */

const CANVAS = document.createElement("canvas").getContext("2d");
/** @type {Map<string, Map<string, number>>} */
const widths = new Map();

/** The width of a text, in px at scale 1. @param {string} text @param {string} font as CSS says it */
export function widthOf(text, font) {
  const known = widths.get(font) ?? new Map();
  widths.set(font, known);
  let sum = 0;
  for (const one of text) {
    if (!known.has(one)) {
      if (CANVAS) CANVAS.font = font;
      known.set(one, CANVAS?.measureText(one).width ?? 8);
    }
    sum += known.get(one) ?? 8;
  }
  return sum;
}

/** The text, or its beginning and an ellipsis. @param {string} text @param {number} room in px @param {string} font */
export function cut(text, room, font) {
  if (widthOf(text, font) <= room) return text;
  let left = room - widthOf("…", font), kept = "";
  for (const one of text) {
    left -= widthOf(one, font);
    if (left < 0) break;
    kept += one;
  }
  return `${kept.trimEnd()}…`;
}
