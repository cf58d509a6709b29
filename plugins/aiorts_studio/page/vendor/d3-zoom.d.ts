import "d3-transition";
export * from "d3-zoom";
export { select } from "d3-selection";
