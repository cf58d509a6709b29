const SVG = "http://www.w3.org/2000/svg";

/**
 * An SVG element. Texts become text nodes always: what a component is called is not ours to trust.
 * @param {string} name @param {Record<string, string | number | null>} [attributes] null: left out @param {...(Node | string)} children
 * @returns {SVGElement}
 */
export function make(name, attributes = {}, ...children) {
  const node = /** @type {SVGElement} */ (document.createElementNS(SVG, name));
  for (const [key, value] of Object.entries(attributes)) if (value !== null) node.setAttribute(key, String(value));
  node.append(...children);
  return node;
}

/**
 * An HTML element, with properties and text nodes.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} name @param {Record<string, string>} [attributes] @param {...(Node | string)} children
 * @returns {HTMLElementTagNameMap[K]}
 */
export function html(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children);
  return node;
}
