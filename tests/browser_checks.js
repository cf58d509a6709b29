// What is measured in a page of the studio; `browser_checks.py` judges it. One expression: an object of functions.
({
  store: () => import("/store.js"),

  /** Pairs of boxes that overlap, by the store's numbers and as they are drawn. */
  async overlaps() {
    const { boxes } = await this.store();
    const pairs = (all, slack) => all.flatMap(([name, a], index) => all.slice(index + 1)
      .filter(([, b]) => a.left < b.right - slack && b.left < a.right - slack && a.top < b.bottom - slack && b.top < a.bottom - slack)
      .map(([other]) => `${name} and ${other} overlap`));
    const laid = [...boxes.value.values()].map((box) => [box.name, { left: box.x, right: box.x + box.w, top: box.y, bottom: box.y + box.h }]);
    const drawn = [...document.querySelectorAll(".box .body:not(.under)")]
      .map((node) => [node.closest(".box").getAttribute("aria-label"), node.getBoundingClientRect()]);
    return [...pairs(laid, 0), ...pairs(drawn, 1)];
  },

  /** Edges that run through the inside of a box. */
  async through() {
    const { boxes, edges } = await this.store(), found = new Set();
    for (const { name, points } of edges.value.values()) {
      for (const [index, [x, y]] of points.slice(1).entries()) {
        const [fromX, fromY] = points[index], left = Math.min(x, fromX), right = Math.max(x, fromX);
        const top = Math.min(y, fromY), bottom = Math.max(y, fromY);
        for (const box of boxes.value.values()) {
          const across = left < box.x + box.w - 1 && right > box.x + 1, down = top < box.y + box.h - 1 && bottom > box.y + 1;
          if (across && down) found.add(`${name} runs through ${box.name}`);
        }
      }
    }
    return [...found];
  },

  /** Whether a node is painted: Chromium's own answer is wrong for SVG whose group is not displayed. */
  painted(node) {
    for (let one = node; one; one = one.parentElement) {
      const { display, visibility, opacity } = getComputedStyle(one);
      if (display === "none" || opacity === "0" || (one === node && visibility !== "visible")) return false;
    }
    return true;
  },

  /** [r, g, b, alpha] of a colour of a computed style. */
  colour(text) {
    const [r, g, b, alpha = 1] = (text.match(/[\d.]+/g) ?? [0, 0, 0, 0]).map(Number);
    return text.startsWith("color(srgb") ? [255 * r, 255 * g, 255 * b, alpha] : [r, g, b, alpha];
  },

  /** The first background that hides all behind it, from a node outwards. */
  background(node) {
    for (let one = node; one instanceof Element; one = one.parentElement) {
      const found = one instanceof SVGElement ? [0, 0, 0, 0] : this.colour(getComputedStyle(one).backgroundColor);
      if (found[3] === 1) return found;
    }
    return [255, 255, 255, 1];
  },

  /** What is painted below a text of the scene: a shape of the scene, or the room's background. */
  below(node, x, y) {
    const flat = ["path", "g", "svg", "text", "tspan"];
    for (const one of document.elementsFromPoint(x, y)) {
      const { fill, backgroundColor } = getComputedStyle(one);
      const found = this.colour(one instanceof SVGElement ? (fill === "none" ? "" : fill) : backgroundColor);
      if (found[3] === 1 && !flat.includes(one.tagName)) return found;
    }
    return this.background(document.querySelector("main"));
  },

  /** Each text that is painted: its words, its size in pixels, its colour, and the colour of what is behind it. */
  texts() {
    const found = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), range = document.createRange();
    const hidden = ".heard, [hidden], dialog:not([open]), .toast:not(.shown)";
    while (walk.nextNode()) {
      const text = walk.currentNode.data.trim(), node = walk.currentNode.parentElement, svg = node instanceof SVGElement;
      if (!text || ["OPTION", "SCRIPT", "NOSCRIPT"].includes(node.tagName) || node.closest(hidden)) continue;
      if (!this.painted(node)) continue;
      range.selectNodeContents(walk.currentNode);
      const { left, top, width, height } = range.getBoundingClientRect(), x = left + width / 2, y = top + height / 2;
      if (!width || !height || x < 0 || y < 0 || x > innerWidth || y > innerHeight) continue;
      if (svg && !document.elementFromPoint(x, y)?.closest("main > svg")) continue;   // covered, or outside of the scene
      const style = getComputedStyle(node), halo = svg && style.stroke !== "none" && parseFloat(style.strokeWidth) > 2;
      found.push({
        text: text.slice(0, 40), kind: node.getAttribute("class") ?? node.tagName,
        size: parseFloat(style.fontSize) * (svg ? node.getScreenCTM().a : 1),
        colour: this.colour(svg ? style.fill : style.color), opacity: svg ? 1 : Number(style.opacity),
        behind: halo ? this.colour(style.stroke) : svg ? this.below(node, x, y) : this.background(node),
      });
    }
    return found;
  },

  /** What can be pressed and is in view, with its size at scale 1. */
  targets() {
    const pressed = "button, a[href], input, select, summary, [role=treeitem], [role=tab], .box, .port-of .hit, .fold-body";
    return [...document.querySelectorAll(pressed)]
      .filter((node) => this.painted(node) && !node.closest("[hidden], dialog:not([open])"))
      .map((node) => {
        const { width, height, left, top, right, bottom } = node.getBoundingClientRect(), scale = node.getScreenCTM?.().a ?? 1;
        return {
          name: (node.getAttribute("aria-label") ?? node.textContent ?? "").trim().slice(0, 40), kind: node.getAttribute("class") ?? node.tagName,
          width: width / scale, height: height / scale, inView: width > 0 && right > 0 && bottom > 0 && left < innerWidth && top < innerHeight,
        };
      })
      .filter((one) => one.inView);
  },

  /** The middles of names in panels that are cut. */
  cuts() {
    return [...document.querySelectorAll(".cut")].filter((node) => node.checkVisibility() && node.scrollWidth > node.clientWidth)
      .map((node) => node.getBoundingClientRect())
      .map(({ left, top, width, height }) => [left + width / 2, top + height / 2])
      .filter(([x, y]) => document.elementFromPoint(x, y)?.closest(".cut"));
  },

  /** How many things of each kind there are. */
  async counts() {
    const { boxes, edges } = await this.store(), all = [...boxes.value.values()];
    return { component: all.length, port: all.reduce((sum, box) => sum + box.ports.length, 0), connector: edges.value.size };
  },
})
